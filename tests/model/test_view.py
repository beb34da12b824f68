"""Views by name: reading, changing, and what they say of mistakes."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj

XML = """<mujoco><compiler angle="radian"/><worldbody>
<body name="base" pos="0 0 1"><freejoint name="float"/><inertial pos="0 0 0.1" mass="3" diaginertia="1 2 2.5"/>
  <body name="arm" pos="1 0 0" quat="0 1 0 0"><inertial pos="0.2 0 0" mass="0.5" diaginertia="0.1 0.2 0.25"/>
    <joint name="yaw" axis="0 1 0" pos="0.1 0 0" range="-1 2" damping="0.3" stiffness="4" ref="0.1" springref="0.2"/>
    <joint name="lift" type="slide" armature="0.7" frictionloss="0.6"/>
    <body name="hand"><joint name="wrist" type="ball" damping="0.2"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
  </body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def model() -> kj.Model:
    return kj.load(XML)


def test_bodies(model: kj.Model) -> None:
    arm = model.body("arm")
    assert (arm.name, arm.index, repr(arm)) == ("arm", 1, "<body 'arm'>")
    assert arm.mass == 0.5
    np.testing.assert_array_equal(arm.com, [0.2, 0, 0])
    np.testing.assert_allclose(arm.central_inertia, np.diag([0.1, 0.2, 0.25]), atol=1e-16)
    np.testing.assert_array_equal(arm.position, [1, 0, 0])
    np.testing.assert_array_equal(arm.quaternion, [0, 1, 0, 0])
    assert arm.parent is not None
    assert arm.parent.name == "base"
    assert model.body("base").parent is None
    assert [joint.name for joint in arm.joints] == ["yaw", "lift"]


def test_joints(model: kj.Model) -> None:
    yaw, lift, wrist = (model.joint(name) for name in ("yaw", "lift", "wrist"))
    assert (yaw.name, yaw.index, yaw.type, yaw.body.name, repr(yaw)) == ("yaw", 1, "revolute", "arm", "<joint 'yaw'>")
    assert (yaw.coordinates, yaw.speeds) == (slice(7, 8), slice(6, 7))
    assert (wrist.coordinates, wrist.speeds) == (slice(9, 13), slice(8, 11))
    np.testing.assert_array_equal(yaw.axis, [0, 1, 0])
    np.testing.assert_array_equal(yaw.anchor, [0.1, 0, 0])
    np.testing.assert_array_equal(yaw.range, [-1, 2])
    numbers = (yaw.damping, yaw.stiffness, yaw.coordinate_reference, yaw.spring_reference, lift.armature, lift.coulomb_friction)
    np.testing.assert_array_equal(numbers, [0.3, 4, 0.1, 0.2, 0.7, 0.6])
    np.testing.assert_array_equal(wrist.damping, [0.2, 0.2, 0.2])
    np.testing.assert_array_equal(wrist.spring_reference, [1, 0, 0, 0])
    assert lift.friction_width == 0.01


def test_set_changes_one_place_of_a_new_model(model: kj.Model) -> None:
    changed = model.body("arm").set(mass=2, com=[1, 2, 3], position=np.ones(3), quaternion=(1, 0, 0, 0), central_inertia=np.eye(3))
    np.testing.assert_array_equal(changed.mass, [3, 2, 1])
    np.testing.assert_array_equal(changed.com, [[0, 0, 0.1], [1, 2, 3], [0, 0, 0]])
    np.testing.assert_array_equal(changed.body("arm").central_inertia, np.eye(3))
    assert model.body("arm").mass == 0.5
    assert all(a.dtype == b.dtype for a, b in zip(jax.tree.leaves(model), jax.tree.leaves(changed), strict=True))

    changed = changed.joint("yaw").set(axis=[0, 0, 1], anchor=[0, 0, 0], stiffness=1, range=[0, 1], damping=7, spring_reference=5)
    changed = changed.joint("wrist").set(damping=0.5, armature=[1, 2, 3], spring_reference=[0, 1, 0, 0])
    np.testing.assert_array_equal(changed.damping, [0, 0, 0, 0, 0, 0, 7, 0, 0.5, 0.5, 0.5])
    np.testing.assert_array_equal(changed.armature[-3:], [1, 2, 3])
    np.testing.assert_array_equal(changed.spring_reference[7:], [5, 0, 0, 1, 0, 0])
    assert changed.body("arm").mass == 2


def test_set_works_under_transformations(model: kj.Model) -> None:
    def weight(mass: jax.Array) -> jax.Array:
        changed = model.body("arm").set(mass=mass).joint("yaw").set(damping=mass)
        return jnp.sum(changed.mass) + changed.joint("yaw").damping ** 2

    assert jax.jit(weight)(2.0) == 3 + 2 + 1 + 4
    assert jax.grad(weight)(2.0) == 5
    np.testing.assert_array_equal(jax.vmap(weight)(jnp.array([1.0, 2.0])), [6, 10])
    batch = jax.vmap(lambda mass: model.body("arm").set(mass=mass))(jnp.array([1.0, 2.0]))
    np.testing.assert_array_equal(jax.vmap(lambda each: each.body("arm").mass)(batch), [1, 2])
    with pytest.raises(
        ValueError, match=r"model\.mass has shape \(2, 3\) instead of \(3,\); view a batch of models under jax\.vmap"
    ):
        _ = batch.body("arm").mass


def test_views_of_gradients(model: kj.Model) -> None:
    gradient = jax.grad(lambda each: each.body("arm").mass ** 2)(model)
    assert gradient.body("arm").mass == 1


def test_views_in_single_precision(model: kj.Model) -> None:
    single = model.astype(jnp.float32).body("arm").set(mass=np.float64(2))
    assert single.dtype == jnp.float32


def test_views_are_documented_and_cannot_be_assigned_to(model: kj.Model) -> None:
    assert type(model.joint("yaw")).damping.__doc__ == "Force [N] or torque [N m] a unit of speed."
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(model.body("arm"), "mass", 2.0)  # noqa: B010


def test_unknown_names_list_the_valid_ones(model: kj.Model) -> None:
    with pytest.raises(kj.UnknownNameError, match="no body is named 'leg'; the names are: 'base', 'arm', 'hand'"):
        model.body("leg")
    with pytest.raises(kj.UnknownNameError, match="no joint is named 'arm'; the names are: 'float', 'yaw', 'lift', 'wrist'"):
        model.joint("arm")
    with pytest.raises(kj.UnknownNameError, match="no number of a body is named 'weight'; the names are: 'position'"):
        model.body("arm").set(weight=1)
    with pytest.raises(kj.UnknownNameError, match="no number of a joint is named 'mass'; the names are: 'axis'"):
        model.joint("yaw").set(mass=1)
    with pytest.raises(kj.UnknownNameError, match="no leaf of a model is named 'masses'; the names are: 'gravity'"):
        model.replace(masses=jnp.ones(3))


def test_shapes_are_checked(model: kj.Model) -> None:
    with pytest.raises(ValueError, match=r"body 'arm': com has shape \(2,\), but needs \(3,\)"):
        model.body("arm").set(com=[1, 2])
    with pytest.raises(ValueError, match=r"body 'arm': com has shape \(\), but needs \(3,\)"):
        model.body("arm").set(com=1)
    with pytest.raises(ValueError, match=r"joint 'wrist': armature has shape \(2,\), but needs \(3,\)"):
        model.joint("wrist").set(armature=[1, 2])
    with pytest.raises(ValueError, match=r"joint 'wrist': spring_reference has shape \(\), but needs \(4,\)"):
        model.joint("wrist").set(spring_reference=1)


def test_replace_converts_and_checks(model: kj.Model) -> None:
    np.testing.assert_array_equal(model.replace(gravity=[0, 0, -1]).gravity, [0, 0, -1])
    with pytest.raises((ValueError, TypeError), match="gravity"):
        model.replace(gravity=jnp.zeros(2))
