"""What the file of a task may say, and what is refused."""

import inspect
import re
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax import constraints, costs
from kanejax._motion_task.keys import CONSTRAINTS, COSTS
from kanejax._motion_task.task_file import read_task
from kanejax._optimize.locked import with_locked_joints
from kanejax._toml import ConfigurationError

ARM = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" range="-3 3" limited="true"/>
    <inertial pos="0 0 -.25" mass="2" diaginertia=".05 .05 .01"/>
    <body name="fore" pos="0 0 -.5"><joint name="elbow" axis="0 1 0" range="-2.5 2.5" limited="true"/>
      <inertial pos="0 0 -.2" mass="1" diaginertia=".02 .02 .005"/><body name="tool" pos="0 0 -.4"/></body></body>
</worldbody></mujoco>"""
URDF = """<robot name="arm"><link name="base"/><link name="upper"><inertial><mass value="2"/>
<inertia ixx="0.05" iyy="0.05" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="12" velocity="2.5"/></joint></robot>"""
TASK = """
robot = "arm.xml"
duration = 1.0
[start]
q = [0.0, 0.5]
[goal]
q = { elbow = 0.1, shoulder = 1.0 }
[costs]
torque = 1.0
"""


@pytest.fixture
def read(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "arm.urdf").write_text(URDF)

    def given(text):
        (tmp_path / "task.toml").write_text(text)
        return read_task(tmp_path / "task.toml", kj.load_report)

    return given


def test_ten_lines_are_a_task(read):
    file = read(TASK)
    task = file.task
    np.testing.assert_array_equal(task.start.q, [0.0, 0.5])
    np.testing.assert_array_equal(task.goal.q, [1.0, 0.1])
    np.testing.assert_array_equal(task.goal.u, [0.0, 0.0])
    assert [term.name for term in task.costs] == ["torque"]
    assert (task.steps, task.integrator, task.is_free_in_time) == (50, "midpoint", False)
    assert (file.guess, file.guesses, dict(file.options), dict(file.output)) == (None, 1, {}, {})


def test_options_reach_the_task(read):
    text = TASK.replace("duration = 1.0", "duration = [0.5, 2.0]\ngravity = [0.0, 0.0, -1.62]")
    text = text.replace("[goal]", 'u = { elbow = 0.3 }\n[goal]\nu = "free"')
    text += """
    [limits]
    u = [1.0, 2.0]
    tau = { elbow = [-1.0, 3.0] }
    q = { elbow = 2.0 }
    passive = ["shoulder"]
    [solver]
    steps = 7
    dynamics = "forward"
    substeps = 2
    tolerance = 1e-6
    max_iterations = 9
    method = "interior_point"
    guesses = 5
    """
    file = read(text)
    task = file.task
    np.testing.assert_array_equal(task.duration, [0.5, 2.0])
    assert task.is_free_in_time
    np.testing.assert_array_equal(task.model.gravity, [0.0, 0.0, -1.62])
    np.testing.assert_array_equal(task.start.u, [0.0, 0.3])
    assert task.goal.u is None
    np.testing.assert_array_equal(task.limits.u, [[-1.0, -2.0], [1.0, 2.0]])
    np.testing.assert_array_equal(task.limits.tau, [[0.0, -1.0], [0.0, 3.0]])
    np.testing.assert_array_equal(task.limits.q, [[-3.0, -2.0], [3.0, 2.0]])
    assert (task.steps, task.dynamics, task.integrator, task.substeps) == (7, "forward", "rk4", 2)
    assert dict(file.options) == {"solver": "interior_point", "tolerance": 1e-6, "max_iterations": 9}
    assert file.guesses == 5


def test_limits_of_a_urdf(read):
    text = TASK.replace("arm.xml", "arm.urdf").replace("[0.0, 0.5]", "[0.0]").replace("elbow = 0.1, ", "")
    limits = read(text + '[limits]\nu = "robot"\ntau = "robot"').task.limits
    np.testing.assert_array_equal(limits.u, [[-2.5], [2.5]])
    np.testing.assert_array_equal(limits.tau, [[-12.0], [12.0]])


def test_every_term_can_be_written():
    """With all options of its function, but for those that the file gives in another way."""
    assert set(COSTS) == set(costs.__all__) - {"Cost"}
    assert set(CONSTRAINTS) == set(constraints.__all__) - {"Constraint"}
    for module, terms in ((costs, COSTS), (constraints, CONSTRAINTS)):
        for name, term in terms.items():
            options = set(inspect.signature(getattr(module, name)).parameters)
            assert set(term.keys) - {"motion", "name"} == options - {"name"}, name


def test_every_line_of_the_example_works(read, tmp_path):
    """Lines behind a '#' are tried one after another, in place of those with the same key."""
    example = (resources.files("kanejax") / "_motion_task/task_example.toml").read_text(encoding="utf-8")
    (tmp_path / "before").mkdir()
    nodes, steps = np.zeros((51, 2)), np.zeros((50, 2))
    np.savez(tmp_path / "before/motion.npz", ts=np.linspace(0, 1, 51), q=nodes, u=nodes, u_dot=steps, tau=steps, duration=1.0)
    lines = example.splitlines()
    headers = [i for i, line in enumerate(lines) if re.match(r"(# )?\[[\w.]+\]\s*(#|$)", line)]
    tried = []
    for number, line in enumerate(lines):
        found = re.match(r"# (\w+) = ", line)
        # The arm has no fingers.
        if not found or found[1] == "finger":
            continue
        changed = [*lines]
        changed[number] = line.removeprefix("# ")
        begin, end = max((i for i in headers if i < number), default=None), min((i for i in headers if i > number), default=None)
        if begin is not None:
            changed[begin] = lines[begin].removeprefix("# ")
        for i in range(begin or 0, end or len(lines)):
            if lines[i].startswith(f"{found[1]} = "):
                changed[i] = ""
        read("\n".join(changed))
        tried.append(found[1])
    assert len(tried) > 30
    everything = set(COSTS) | set(CONSTRAINTS)
    assert everything <= set(re.findall(r"^#? ?(\w+) = ", example, re.MULTILINE))


def test_terms_are_those_of_the_library(read):
    text = (
        TASK
        + """
    jerk = { weights = { shoulder = 1.0, elbow = 2.0 } }
    manipulability = [{ body = "tool", weight = 3.0 }, { body = "fore", point = [0.0, 0.0, 0.1] }]
    [[constraints.position]]
    body = "tool"
    target = [0.1, 0.0, -0.8]
    tolerance = 0.01
    at_end = false
    [[constraints.position]]
    body = "tool"
    target = [0.1, 0.0, -0.8]
    name = "second"
    [goal.constraints]
    direction = { body = "tool", target = [0.0, 0.0, -2.0], angle = 0.5 }
    """
    )
    task = read(text).task
    assert [term.name for term in task.costs] == ["torque", "jerk", "manipulability of tool", "manipulability of fore"]
    assert [term.name for term in task.constraints] == ["position of tool", "second"]
    at = kj.Moment(jnp.zeros(()), jnp.array([0.3, 0.4]), jnp.zeros(2), jerk=jnp.array([1.0, 2.0]))
    assert float(task.costs[1].function(task.model, at)) == 9.0
    wanted = constraints.position("tool", [0.1, 0.0, -0.8], tolerance=0.01, at_end=False)
    for found, same in ((task.constraints[0], True), (task.constraints[1], False)):
        np.testing.assert_allclose(found.function(task.model, at), wanted.function(task.model, at))
        assert bool(jnp.all(found.upper == wanted.upper)) is same
        assert found.at_end is not same
    (there,) = task.goal.constraints
    np.testing.assert_allclose(there.lower, np.cos(0.5))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[start]", "[start"), "task.toml: not TOML: "),
        (('robot = "arm.xml"', ""), "task.toml: there is no robot"),
        (("duration = 1.0", ""), "task.toml: there is no duration"),
        (("duration = 1.0", "duration = -1"), "the file duration is -1; it must be a positive number, or a pair"),
        (("duration = 1.0", "duration = [2.0, 1.0]"), "the task: duration is"),
        (("duration = 1.0", "duratoin = 1.0"), "the file has no key 'duratoin'; the keys are: robot, duration"),
        (("[costs]\ntorque = 1.0", ""), r"there is no table \[costs\]"),
        (("torque = 1.0", "torqe = 1.0"), r"\[costs\] has no 'torqe'; there are: torque"),
        (("torque = 1.0", "torque = -1.0"), r"\[costs\] torque weights is -1.0; it must be a number from 0 on"),
        (("torque = 1.0", "torque = { weight = 1.0 }"), r"\[costs\] torque has no key 'weight'; the keys are: weights"),
        (
            ("torque = 1.0", "torque = [1.0]"),
            r"\[costs\] torque weights has 1 numbers, but the robot has 2 speeds, of joints 'shou",
        ),
        (("torque = 1.0", "torque = { weights = { elbow = 1.0 } }"), r"\[costs\] torque weights has no number for 'shoulder'"),
        (("torque = 1.0", "manipulability = 1.0"), r"\[costs\] manipulability is 1.0; it must be a table with body"),
        (
            ("torque = 1.0", "manipulability = { body = 'tol' }"),
            r"\[costs\] manipulability: no body is named 'tol'; the bodies are: 'up",
        ),
        (("torque = 1.0", "manipulability = { point = [0, 0, 0] }"), "manipulability has no 'body', which is the name of a body"),
        (
            ("torque = 1.0", "tracking = { q = [[0.0]], duration = 1.0 }"),
            r"\[costs\] tracking q must be a list of at least two lists of 2",
        ),
        (
            ("torque = 1.0", "tracking = { motion = 'm.npz' }"),
            r"\[costs\] tracking motion is \"m.npz\", but .*m.npz is no motion.npz",
        ),
        (("torque = 1.0", "tracking = { motion = 'm.npz', duration = 1.0 }"), "has motion and duration; give one of them"),
        (("q = [0.0, 0.5]", "q = [0.0]"), r"\[start\] q has 1 numbers, but the robot has 2 coordinates"),
        (("q = [0.0, 0.5]", "q = { elbow = 0.5 }"), r"\[start\] q has no number for 'shoulder'; name every joint"),
        (("q = [0.0, 0.5]", "q = { elbw = 0.5 }"), r"\[start\] q: no joint is named 'elbw'; the joints are: 'shoulder', 'elbow'"),
        (
            ("q = [0.0, 0.5]", "q = { shoulder = [1.0, 2.0], elbow = 0.5 }"),
            r"\[start\] q shoulder has 2 numbers, but this joint has 1",
        ),
        (("q = [0.0, 0.5]", "q = 1.0"), r"\[start\] q is 1.0; it must be a list of numbers"),
        (("q = [0.0, 0.5]", "q = [nan, 0.5]"), r"\[start\] q is \[nan, 0.5\]; it must be a list of numbers"),
        (("q = [0.0, 0.5]", "u = 1.0"), r"\[start\] has neither q nor constraints"),
        (
            ("[goal]", "[goal.constraints]\nposition = { body = 'tool' }\n[goal]"),
            r"\[goal.constraints\] position has no 'target', which is",
        ),
        (("[costs]", "[locked]\nelbo = 1.0\n[costs]"), r"\[locked\]: no joint is named 'elbo'"),
        (("[costs]", "[locked]\nelbow = 'x'\n[costs]"), r"\[locked\] elbow is \"x\"; it must be a number"),
        (("[costs]", "[locked]\nelbow = [1.0, 2.0]\n[costs]"), r"\[locked\]: joint 'elbow' has 1 coordinates, not 2"),
        (("[costs]", "[locked]\nelbow = 1.0\nshoulder = 0.0\n[costs]"), r"\[locked\]: all joints are locked"),
        (("[costs]", "[limits]\nv = 1.0\n[costs]"), r"\[limits\] has no key 'v'; the keys are: q, u"),
        (("[costs]", "[limits]\nu = 'robot'\n[costs]"), r"\[limits\] u is \"robot\", but .*arm.xml states no limits of velocity"),
        (("[costs]", "[limits]\nu = { elbow = [1.0, 0.0] }\n[costs]"), r"\[limits\]: limits of u\[1\] are 1 and 0"),
        (("[costs]", "[limits]\npassive = ['x']\n[costs]"), r"\[limits\] passive: no joint is named 'x'"),
        (("[costs]", "[solver]\nsteps = 0\n[costs]"), r"\[solver\] steps is 0; it must be a whole number from 1 on"),
        (("[costs]", "[solver]\nintegrator = 'rk4'\n[costs]"), "the task: integrator is 'rk4'; with inverse dynamics use"),
        (("[costs]", "[solver]\nguess = 'x.npz'\n[costs]"), r"\[solver\] guess is \"x.npz\", but "),
        (("[costs]", "[output]\nreport = 1\n[costs]"), r"\[output\] report is 1; it must be true or false"),
    ],
)
def test_what_means_nothing_is_refused(read, change, message):
    assert change[0] in TASK
    with pytest.raises(ConfigurationError, match=message) as caught:
        read(TASK.replace(*change))
    assert str(caught.value).count("\n") == 0
    assert "task.toml: " in str(caught.value)


def test_a_guess_has_to_fit(read, tmp_path):
    nodes, steps = np.zeros((4, 2)), np.zeros((3, 2))
    np.savez(tmp_path / "m.npz", ts=np.linspace(0, 1, 4), q=nodes, u=nodes, u_dot=steps, tau=steps, duration=1.0)
    text = TASK + "[solver]\nguess = 'm.npz'\nsteps = "
    assert read(text + "3").guess.q.shape == (4, 2)
    with pytest.raises(ConfigurationError, match=r"\[solver\] guess has q of shape \(4, 2\), but this task needs \(5, 2\)"):
        read(text + "4")


BRANCHES = """<mujoco><worldbody>
  <body name="cart"><joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/><geom size=".1" mass="2"/>
    <body name="turret" pos=".1 .2 .3" euler="10 20 30"><joint name="turn" axis="1 1 2" pos=".1 0 .05" ref="20"/>
      <geom type="box" size=".1 .2 .3" pos=".1 .1 0" mass="1"/>
      <body name="left" pos="0 .2 0"><joint name="ball" type="ball" pos="0 .1 0" damping=".1"/>
        <geom type="box" size=".3 .1 .1" mass="1"/>
        <body name="rod" pos=".1 0 0"><joint name="rod" type="slide" axis="1 .2 0" armature=".3" stiffness="4"/>
          <geom size=".1" mass=".5"/></body></body>
      <body name="right" pos="0 -.2 0"><joint name="hinge" axis="0 0 1"/>
        <geom type="box" size=".1 .1 .2" pos="0 0 .2" mass="1"/></body></body></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize("names", [("turn", "rod"), ("x", "y", "ball")])
def test_a_robot_with_locked_joints_moves_like_the_whole_one(names):
    whole = kj.load(BRANCHES)
    tree, random = whole.tree, np.random.default_rng(0)
    q, u, u_dot = (random.normal(size=n) for n in (whole.nq, whole.nv, whole.nv))
    start = tree.q_start[tree.joint("ball")]
    q[start : start + 4] /= np.linalg.norm(q[start : start + 4])
    parts = {name: whole.joint(name) for name in names}
    locked = with_locked_joints(whole, {name: q[part.coordinates] for name, part in parts.items()})
    for part in parts.values():
        u[part.speeds] = u_dot[part.speeds] = 0.0
    free_q, free_v = np.ones(whole.nq, bool), np.ones(whole.nv, bool)
    for part in parts.values():
        free_q[part.coordinates] = free_v[part.speeds] = False
    assert locked.tree.joint_names == tuple(name for name in tree.joint_names if name not in names)
    expected, found = kj.poses(whole, jnp.asarray(q)), kj.poses(locked, jnp.asarray(q[free_q]))
    for field in ("rotation", "origin", "com"):
        np.testing.assert_allclose(getattr(found, field), getattr(expected, field), atol=1e-12, err_msg=field)
    force = jax.jit(kj.inverse_dynamics)(whole, *(jnp.asarray(each) for each in (q, u, u_dot)))
    of_locked = jax.jit(kj.inverse_dynamics)(locked, *(jnp.asarray(each) for each in (q[free_q], u[free_v], u_dot[free_v])))
    np.testing.assert_allclose(of_locked, np.asarray(force)[free_v], rtol=1e-10, atol=1e-10 * np.abs(force).max())


def test_all_joints_of_a_body_are_locked_or_none():
    with pytest.raises(kj.UnsupportedModelError, match="joint 'y' moves body 'cart' too; lock all of its joints, or none"):
        with_locked_joints(kj.load(BRANCHES), {"x": 0.0})
    with pytest.raises(kj.UnknownNameError, match="no joint is named 'z'"):
        with_locked_joints(kj.load(BRANCHES), {"z": 0.0})
