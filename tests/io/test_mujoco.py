"""Models from MuJoCo: the same numbers as MuJoCo's, and what is refused."""

import functools
import warnings
from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj

INERTIAL = '<inertial pos="0.1 -0.05 0.2" mass="{}" fullinertia="0.03 0.04 0.05 0.002 -0.003 0.004"/>'
PARTS = 'armature="0.1" damping="0.4" stiffness="{}" pos="0.1 0.2 -0.1"'
# Every joint type, two and three joints on a body, springs, dampers, rotors, references and welded bodies.
MECHANISM = f"""<mujoco><compiler angle="radian"/><option gravity="1 -2 -9.81"/><worldbody>
<body name="base" pos="0 0 1" quat="1 0.2 0 0.3"><freejoint name="float"/>{INERTIAL.format(5)}
  <body name="upper" pos="0.3 0 0" quat="1 0.5 0.1 0"><joint name="shoulder" type="ball" {PARTS.format(3)}/>{INERTIAL.format(2)}
    <body name="lower" pos="0 0.2 0.4" quat="0.3 0.5 0.1 1">{INERTIAL.format(1)}
      <joint name="yaw" axis="1 2 3" ref="0.3" springref="-0.2" {PARTS.format(2)}/>
      <joint name="slide" type="slide" axis="0 1 2" ref="0.1" springref="0.4" {PARTS.format(5)}/>
      <joint name="roll" axis="1 0 0.1" {PARTS.format(1)}/>
      <body name="tool" pos="0 0 0.2" quat="1 1 0 0">{INERTIAL.format(0.5)}
        <body name="frame" pos="0.1 0 0" quat="1 0 1 0"/></body></body></body>
  <body name="tail" pos="-0.2 0.1 0"><joint name="tail" axis="0 0 -2"/>{INERTIAL.format(0.3)}</body></body>
<body name="cart" pos="0 2 0" quat="1 0 0.4 0">{INERTIAL.format(3)}<joint name="rail" type="slide" axis="1 0 0" ref="0.5"/>
  <body name="pole" quat="1 0 0 0.1"><joint name="pivot" axis="0 1 0" {PARTS.format(2)}/>{INERTIAL.format(0.2)}</body></body>
</worldbody></mujoco>"""


def compiled(xml: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(xml)


def states(mj_model: mujoco.MjModel, count: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return random coordinates, speeds and rates, one row a state."""
    random = np.random.default_rng(0)
    q = np.tile(mj_model.qpos0, (count, 1))
    for row in q:
        mujoco.mj_integratePos(mj_model, row, random.uniform(-2, 2, mj_model.nv), 1.0)
    return q, random.normal(size=(count, mj_model.nv)), random.normal(size=(count, mj_model.nv))


def terms(mj_model: mujoco.MjModel, q: np.ndarray, u: np.ndarray, u_dot: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return MuJoCo's mass matrix, bias force, passive force and inverse dynamics at one state."""
    mj_data = mujoco.MjData(mj_model)
    mj_data.qpos[:], mj_data.qvel[:], mj_data.qacc[:] = q, u, u_dot
    mujoco.mj_inverse(mj_model, mj_data)
    mass_matrix = np.zeros((mj_model.nv, mj_model.nv))
    for row, unit in zip(mass_matrix, np.eye(mj_model.nv), strict=True):
        mujoco.mj_mulM(mj_model, mj_data, row, unit)
    return mass_matrix, mj_data.qfrc_bias.copy(), mj_data.qfrc_passive.copy(), mj_data.qfrc_inverse.copy()


def assert_same_terms(a: mujoco.MjModel, b: mujoco.MjModel, relative: float = 1e-12) -> None:
    for state in zip(*states(a), strict=True):
        for expected, actual in zip(terms(a, *state), terms(b, *state), strict=True):
            np.testing.assert_allclose(actual, expected, rtol=0, atol=relative * np.abs(expected).max(initial=1e-300))


@functools.cache
def inverse_dynamics() -> Callable[..., jax.Array]:
    return jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))


def test_inverse_dynamics_of_every_joint_type() -> None:
    mj_model = compiled(MECHANISM)
    model = kj.from_mujoco(mj_model)
    q, u, u_dot = states(mj_model)
    expected = np.stack([terms(mj_model, *state)[3] for state in zip(q, u, u_dot, strict=True)])
    actual = inverse_dynamics()(model, q, u, u_dot)
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_names_and_numbers() -> None:
    mj_model = compiled(MECHANISM.replace("<joint ", '<joint frictionloss="0.6" ', 1))
    model = kj.from_mujoco(mj_model)
    tree = model.tree
    assert tree.body_names == ("base", "upper", "lower", "tool", "frame", "tail", "cart", "pole")
    assert tree.body_parents == (-1, 0, 1, 2, 3, 0, -1, 6)
    assert tree.joint_types == ("free", "ball", "revolute", "prismatic", "revolute", "revolute", "prismatic", "revolute")
    assert (model.nq, model.nv, model.dtype) == (mj_model.nq, mj_model.nv, jnp.float64)
    inertia = [[0.03, 0.002, -0.003], [0.002, 0.04, 0.004], [-0.003, 0.004, 0.05]]
    np.testing.assert_allclose(model.body("tool").central_inertia, inertia, atol=1e-15)
    np.testing.assert_array_equal(model.body("tool").com, [0.1, -0.05, 0.2])
    np.testing.assert_array_equal(model.joint("shoulder").coulomb_friction, [0.6, 0.6, 0.6])
    np.testing.assert_array_equal(model.friction_width, np.full(model.nv, 0.01))
    assert model.joint("slide").coordinate_reference == 0.1
    assert model.joint("slide").spring_reference == 0.4


def test_unnamed_bodies_and_joints_get_names_that_differ() -> None:
    body = '<body {}><joint {}/><geom size="0.1"/></body>'
    xml = body.format("", "") + body.format('name="body1"', 'name="joint0"') + body.format("", "")
    tree = kj.from_mujoco(compiled(f"<mujoco><worldbody>{xml}</worldbody></mujoco>")).tree
    assert tree.body_names == ("body1_2", "body1", "body3")
    assert tree.joint_names == ("joint0_2", "joint0", "joint2")


def test_ranges_are_infinite_where_there_are_none() -> None:
    joints = ('range="-1 2"', "", 'type="ball" range="0 1"', 'type="slide" range="-3 4"')
    xml = "".join(f'<body><joint {joint}/><geom size="0.1"/></body>' for joint in joints)
    model = kj.from_mujoco(compiled(f'<mujoco><compiler angle="radian"/><worldbody>{xml}</worldbody></mujoco>'))
    np.testing.assert_array_equal(model.joint_range, [[-1, 2], [-np.inf, np.inf], [-np.inf, np.inf], [-3, 4]])


def test_leaves_are_single_precision_without_x64() -> None:
    with jax.enable_x64(False):
        model = kj.from_mujoco(compiled(MECHANISM))
    assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves(model))


def test_a_spec_keeps_its_static_bodies() -> None:
    spec = mujoco.MjSpec.from_string(MECHANISM)
    spec.compiler.fusestatic = True
    assert spec.copy().compile().nbody < kj.from_mujoco(spec).nbody + 1 == 9
    assert spec.compiler.fusestatic


def test_option_flags_are_carried_out() -> None:
    flags = '<option gravity="1 -2 -9.81"><flag gravity="disable" damper="disable"/></option>'
    mj_model = compiled(MECHANISM.replace('<option gravity="1 -2 -9.81"/>', flags))
    model = kj.from_mujoco(mj_model)
    assert not np.any(model.gravity)
    assert not np.any(model.damping)
    assert np.any(mj_model.dof_damping)


def test_unmodelled_dynamics_are_refused_or_warned_of() -> None:
    mj_model = compiled(MECHANISM.replace("<option", '<option density="1.2"'))
    with pytest.raises(kj.UnsupportedModelError, match=r"MjModel: fluid forces.*strict=False"):
        kj.from_mujoco(mj_model)
    with pytest.warns(kj.IgnoredFeatureWarning, match="ignored, though it changes the dynamics: fluid forces"):
        model = kj.from_mujoco(mj_model, strict=False)
    assert model.nbody == 8


def test_edited_inertias_are_checked() -> None:
    mj_model = compiled(MECHANISM)
    mj_model.body("tool").inertia[:] = 1, 1, 3
    with pytest.raises(kj.InvalidInertiaError, match=r"body 'tool': principal moments 1, 1, 3 .*allow_unphysical=True"):
        kj.from_mujoco(mj_model)
    with pytest.warns(kj.UnphysicalInertiaWarning, match="body 'tool'"):
        kj.from_mujoco(mj_model, allow_unphysical=True)


def test_other_arguments_are_refused() -> None:
    with pytest.raises(TypeError, match="MjModel"):
        kj.from_mujoco("robot.xml")  # type: ignore[arg-type]


@pytest.mark.parametrize("option", ["", 'integrator="implicitfast"'])
def test_round_trip_keeps_the_dynamics(option: str) -> None:
    mj_model = compiled(MECHANISM.replace("<option", f"<option {option}"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        back = kj.to_mujoco(kj.from_mujoco(mj_model)).compile()
    assert [back.body(index).name for index in range(back.nbody)] == [mj_model.body(index).name for index in range(back.nbody)]
    np.testing.assert_array_equal(back.qpos0, mj_model.qpos0)
    assert_same_terms(mj_model, back)
