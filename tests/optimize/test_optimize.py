"""Optimal motions of mechanisms: limits, costs, constraints, free durations, and what is refused."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj
from kanejax import constraints, costs
from kanejax._checkpoint import CheckpointError
from tests.helpers.mechanisms import relative

ARM = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" damping=".1" range="-3 3" limited="true"/>
    <inertial pos="0 0 -.25" mass="2" diaginertia=".05 .05 .01"/>
    <body name="fore" pos="0 0 -.5"><joint name="elbow" axis="0 1 0" damping=".05" range="-2.5 2.5" limited="true"/>
      <inertial pos="0 0 -.2" mass="1" diaginertia=".02 .02 .005"/><body name="tool" pos="0 0 -.4"/></body></body>
</worldbody></mujoco>"""
START, GOAL = np.array([-1.0, 0.5]), np.array([0.8, -0.6])
# Where the number of joints is not the matter: one of them compiles in a third of the time.
PENDULUM = """<mujoco><compiler angle="radian"/><worldbody>
  <body><joint name="hinge" axis="0 1 0" damping=".1" range="-3 3" limited="true"/>
    <inertial pos="0 0 -.5" mass="2" diaginertia=".05 .05 .01"/></body></worldbody></mujoco>"""


def solve(task):
    return kj.optimize(task, throw=False)


@pytest.fixture(scope="module")
def arm():
    return kj.load(ARM)


@pytest.fixture(scope="module")
def pendulum():
    return kj.load(PENDULUM)


def swing(pendulum, goal=0.8, **options):
    given = {"duration": 1.0, "costs": costs.torque(), "limits": kj.Limits(pendulum, u=3.0, tau=12.0), "steps": 20} | options
    return kj.MotionTask(pendulum, [-1.0], jnp.reshape(jnp.asarray(goal, pendulum.dtype), (1,)), **given)


def limits(arm):
    return kj.Limits(arm, u=3.0, tau=[12.0, 5.0])


def task(arm, goal=None, **options):
    given = {"duration": 1.0, "costs": costs.torque(), "limits": limits(arm), "steps": 20} | options
    return kj.MotionTask(arm, START, GOAL if goal is None else goal, **given)


def replayed(arm, motion):
    """The motion by MuJoCo, the forces held during each step, a thousandth of it at a time."""
    mj = kj.to_mujoco(arm).compile()
    mj.opt.timestep = float(motion.duration) / len(motion.tau) / 1000
    mj.opt.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(mj)
    data.qpos[:] = motion.q[0]
    for tau in np.asarray(motion.tau):
        for _ in range(1000):
            data.qfrc_applied[:] = tau
            mujoco.mj_step(mj, data)
    return data.qpos, data.qvel


def test_rest_to_rest_within_limits(arm):
    motion = kj.optimize(task(arm))
    assert bool(motion.converged)
    assert relative(motion.q[jnp.array([0, -1])], [START, GOAL]) < 1e-7
    assert np.abs(motion.u[jnp.array([0, -1])]).max() < 1e-7
    assert np.all(np.abs(motion.tau) < np.array([12.0, 5.0]) + 1e-6)
    assert np.abs(motion.u).max() < 3.0 + 1e-6
    assert float(motion.cost) == pytest.approx(float(np.sum(np.square(motion.tau)) / 20), rel=1e-12)
    assert list(motion.costs) == ["torque"]
    # The midpoint rule is of the second order, and the forces that it holds arrive.
    q, u = replayed(arm, motion)
    assert np.abs(q - GOAL).max() < 3e-3
    assert np.abs(u).max() < 0.1


def test_inverse_and_forward_dynamics_have_one_optimum(arm):
    inverse = solve(task(arm, integrator="euler"))
    forward = solve(task(arm, dynamics="forward", integrator="euler"))
    assert bool(inverse.converged & forward.converged)
    assert float(inverse.cost) == pytest.approx(float(forward.cost), rel=1e-8)
    for field in ("q", "u", "u_dot", "tau"):
        assert relative(getattr(inverse, field), getattr(forward, field)) < 1e-4


def test_many_models_goals_and_weights_by_vmap(pendulum):
    masses = pendulum.mass[None] * jnp.array([1.0, 0.8, 1.3])[:, None]
    goals, weights = np.array([0.8, 0.9, 0.7]), np.array([1.0, 2.0, 0.5])

    def of_one(mass, goal, weight):
        return kj.optimal_motion(swing(pendulum.replace(mass=mass), goal, costs=costs.torque(weight)))

    many = jax.jit(jax.vmap(of_one))(masses, goals, weights)
    assert many.converged.tolist() == [True] * 3
    one = solve(swing(pendulum.replace(mass=masses[1]), goals[1], costs=costs.torque(weights[1])))
    assert float(many.cost[1]) == pytest.approx(float(one.cost), rel=1e-9)
    assert relative(many.q[1], one.q) < 1e-6


def test_least_time_of_a_sliding_mass_is_that_of_bang_and_bang():
    """1 kg, 1 m, 1 N both ways: 2 s. With a speed limit of 0.5 m/s: 1 / 0.5 + 0.5 s."""
    slide = kj.load(
        """<mujoco><worldbody><body name="b"><joint name="x" type="slide" axis="1 0 0"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>"""
    )
    for limit, expected in ((np.inf, 2.0), (0.5, 2.5)):
        free = kj.MotionTask(
            slide, [0.0], [1.0], (0.1, 10.0), costs.duration(), limits=kj.Limits(slide, u=limit, tau=1.0), steps=20
        )
        motion = solve(free)
        assert bool(motion.converged)
        assert float(motion.duration) == pytest.approx(expected, rel=1e-5)


def test_rates_and_jerks_and_power_are_limited(arm):
    terms, least = (costs.torque(), costs.jerk(1e-4)), {"u": 3.0, "tau": [12.0, 5.0]}

    def within(**more):
        return solve(task(arm, limits=kj.Limits(arm, **least, **more), costs=terms))

    def greatest(motion):
        power = motion.tau * 0.5 * (motion.u[1:] + motion.u[:-1])
        rates = (20.0 * jnp.diff(each, axis=0) for each in (motion.tau, motion.u_dot))
        return dict(zip(("tau_rate", "jerk", "power"), (float(jnp.abs(each).max()) for each in (*rates, power)), strict=True))

    free = within(tau_rate=np.inf, jerk=np.inf, power=np.inf)
    limits = {name: 0.8 * value for name, value in greatest(free).items()}
    motion = within(**limits)
    assert bool(free.converged & motion.converged)
    assert all(value < limits[name] * (1.0 + 1e-6) for name, value in greatest(motion).items())
    assert float(motion.cost) > 1.01 * float(free.cost)


def test_a_place_to_arrive_at_and_a_ball_to_go_around(arm):
    """With a free duration, as in the guide: one program for both."""
    target = kj.poses(arm, jnp.asarray(GOAL)).origin[arm.tree.body("tool")]
    there = kj.Boundary(constraints=constraints.position("tool", target))
    row = arm.tree.body("tool")
    places = jax.jit(jax.vmap(lambda q: kj.poses(arm, q).origin[row]))

    def around(ball):
        clear = constraints.sphere_clearance("tool", 0.05, ball, 0.1)
        terms = costs.torque(), costs.duration(40.0)
        return solve(task(arm, there, duration=(0.3, 3.0), costs=terms, constraints=clear))

    free = around(jnp.array([9.0, 9.0, 9.0]))
    assert bool(free.converged)
    assert np.abs(places(free.q)[-1] - target).max() < 1e-7
    ball = places(free.q)[10]
    motion = around(ball)
    assert bool(motion.converged)
    # Constraints hold in the middle of each step.
    h = motion.duration / 20
    middles = places(motion.q[:-1] + 0.5 * h * (motion.u[:-1] + 0.25 * h * motion.u_dot))
    assert np.linalg.norm(np.asarray(middles) - np.asarray(ball), axis=1).min() == pytest.approx(0.15, abs=1e-6)
    assert float(motion.cost) > float(free.cost)


def test_a_body_on_a_ball_joint_turns_about_one_axis():
    """From rest to rest in a second, with the least squared torque, a ball turns as a sliding mass slides: 12 I angle^2."""
    xml = """<mujoco><option gravity="0 0 0"/><worldbody><body name="b"><joint name="ball" type="ball"/>
      <inertial pos="0 0 0" mass="1" diaginertia=".2 .2 .2"/></body></worldbody></mujoco>"""
    model = kj.load(xml)
    angle = 2.0
    goal = np.array([np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0])
    motion = solve(kj.MotionTask(model, [1.0, 0.0, 0.0, 0.0], goal, 1.0, costs.torque(), steps=40))
    assert bool(motion.converged)
    assert float(motion.cost) == pytest.approx(12 * 0.2**2 * angle**2, rel=2e-3)
    assert relative(motion.q[-1], goal) < 1e-7
    assert np.abs(motion.tau[:, 1:]).max() < 1e-6


def test_progress_interrupt_and_going_on(arm, tmp_path):
    seen, path = [], tmp_path / "search.npz"

    def stop(motion):
        seen.append(int(motion.iterations))
        raise KeyboardInterrupt

    with pytest.raises(kj.OptimizationInterrupted) as caught:
        kj.optimize(task(arm), progress=stop, checkpoint=path)
    assert seen == [10]
    whole = kj.optimize(task(arm))
    assert float(kj.optimize(task(arm), caught.value.motion).cost) == pytest.approx(float(whole.cost), rel=1e-9)
    for done in (False, True):
        rest = kj.optimize(task(arm), progress=lambda motion: seen.append(int(motion.iterations)), checkpoint=path)
        assert seen == [10, int(whole.iterations)], done
        for one, other in zip(jax.tree.leaves(rest), jax.tree.leaves(whole), strict=True):
            np.testing.assert_array_equal(one, other)
    with pytest.raises(CheckpointError, match=r"search\.npz belongs to other inputs; remove it to begin anew"):
        kj.optimize(task(arm, duration=1.1), checkpoint=path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"goal": [0.8, -2.8]}, "coordinate of joint 'elbow' at the goal is -2.8, beyond its limits -2.5 and 2.5"),
        (
            {"duration": 0.3},
            "joint 'shoulder' moves by 1.8, which takes at least 0.6 s at its greatest speed, but the duration is at most 0.3",
        ),
        ({"goal": kj.Boundary(GOAL, [0.0, 4.0])}, "speed of joint 'elbow' at the goal is 4"),
    ],
)
def test_what_cannot_be_is_refused(arm, change, message):
    with pytest.raises(kj.InfeasibleTaskError, match=message):
        kj.optimize(task(arm, **change))


def test_a_search_that_fails_names_what_stands_in_the_way(arm):
    weak = kj.Limits(arm, u=3.0, tau=[1.0, 5.0])
    with pytest.raises(
        kj.OptimizationError, match=r"(force|coordinate|speed) of shoulder at t = .* s is .*, but has to be|jumps"
    ) as caught:
        kj.optimize(task(arm, limits=weak))
    assert not bool(caught.value.motion.converged)
    assert float(caught.value.motion.errors.violation) > 1e-3
    assert not bool(kj.optimize(task(arm, limits=weak), throw=False).converged)


def test_costs_that_are_not_finite_are_named(arm):
    broken = kj.Cost(lambda model, at: jnp.log(at.u[0] - 10.0), name="logarithm")
    with pytest.raises(kj.NonFiniteTaskError, match="the cost 'logarithm' is nan at the first guess"):
        kj.optimize(task(arm, costs=(costs.torque(), broken)))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"goal": [0.0, 0.0, 0.0]}, ValueError, r"goal.q has shape \(3,\), but this model needs \(2,\)"),
        ({"goal": [0.0, np.nan]}, ValueError, r"goal.q\[1\] is nan"),
        ({"duration": -1.0}, ValueError, "duration is -1.0; give a positive number"),
        ({"duration": (2.0, 1.0)}, ValueError, "duration is"),
        ({"steps": 0}, ValueError, "steps is 0"),
        ({"integrator": "rk4"}, ValueError, "integrator is 'rk4'; with inverse dynamics use 'midpoint' or 'euler'"),
        ({"costs": ()}, ValueError, "costs is empty"),
        ({"costs": (costs.torque(), costs.torque(2.0))}, ValueError, "several costs or constraints are called torque"),
    ],
)
def test_bad_tasks_are_refused(arm, change, error, message):
    with pytest.raises(error, match=message):
        task(arm, **change)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"torque": 1.0}, TypeError, "no limits of torque; there are q, u"),
        ({"u": [1.0, 2.0, 3.0]}, ValueError, r"a limit of u has shape \(3,\)"),
        ({"tau": (1.0, -1.0)}, ValueError, r"limits of tau\[0\] are 1 and -1"),
        ({"u": np.nan}, ValueError, r"limits of u\[0\] are nan"),
        ({"passive": ("wrist",)}, kj.UnknownNameError, "wrist"),
    ],
)
def test_bad_limits_are_refused(arm, change, error, message):
    with pytest.raises(error, match=message):
        kj.Limits(arm, **change)


def test_functions_of_wrong_shape_are_named(arm):
    vector = kj.Cost(lambda model, at: at.tau, name="vector")
    with pytest.raises(ValueError, match=r"cost 'vector' returns shape \(2,\); it has to return one number"):
        kj.optimize(task(arm, costs=vector))
    wrong = kj.Constraint(lambda model, at: at.q, upper=np.zeros(3), name="three")
    with pytest.raises(ValueError, match=r"upper of constraint 'three' has shape \(3,\), but its function returns \(2,\)"):
        kj.optimize(task(arm, constraints=wrong))


def test_a_guess_of_another_length_is_refused(arm):
    guess = kj.straight_guess(task(arm, steps=10))
    with pytest.raises(ValueError, match=r"guess.q has shape \(11, 2\), but this task needs \(21, 2\)"):
        kj.optimize(task(arm), guess)


def test_float32(pendulum):
    motion = kj.optimize(swing(pendulum.astype(jnp.float32)))
    assert bool(motion.converged)
    assert motion.q.dtype == motion.tau.dtype == motion.cost.dtype == jnp.float32
    assert float(motion.cost) == pytest.approx(float(solve(swing(pendulum)).cost), rel=1e-3)
