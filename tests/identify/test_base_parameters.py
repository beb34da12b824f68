import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax._regression.base_parameters import grouped, random_states

PENDULUM = """<mujoco><worldbody><body name="rod"><joint name="hinge" axis="0 1 0"/>
<inertial pos="0 0 -1" mass="2" diaginertia="0.1 0.2 0.3"/></body></worldbody></mujoco>"""
PLANAR = """<mujoco><option gravity="0 0 0"/><worldbody><body name="a"><joint name="one" axis="0 0 1"/>
<inertial pos="0.5 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
<body name="b" pos="1 0 0"><joint name="two" axis="0 0 1"/><inertial pos="0.5 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
</body></body></worldbody></mujoco>"""


def test_a_pendulum_has_three():
    base = kj.base_parameters(kj.load(PENDULUM))
    assert base.formulas == ("rod.mcx", "rod.mcz", "rod.Iyy")
    assert base.alone(base.names.index("rod.mcx")) == 0
    assert base.alone(base.names.index("rod.m")) is None
    assert {base.names[i] for i in base.without_effect} == {"rod." + x for x in ("m", "mcy", "Ixx", "Izz", "Ixy", "Ixz", "Iyz")}


def test_a_planar_arm_groups_the_second_mass_with_the_first_inertia():
    """Of the two-link arm of the textbooks only Izz1 + l^2 m2, Izz2 and the mass moment of the second link count."""
    base = kj.base_parameters(kj.load(PLANAR))
    assert base.formulas == ("a.Izz + b.m", "b.mcx", "b.mcy", "b.Izz")
    assert "without effect: " in str(base)
    assert base.group(base.names.index("b.m")) == (0,)


@pytest.mark.filterwarnings("ignore::kanejax.UnphysicalInertiaWarning")
@pytest.mark.parametrize("robot", ["stanford_arm", "intelledex_605", "rrp_arm"])
def test_base_parameters_give_all_forces(robot):
    """The regressor has exactly their number of independent columns, and forces are theirs alone."""
    model = getattr(kj.robots, robot)()
    base = kj.base_parameters(model)
    states = random_states(model, 40, 7)
    rows = np.asarray(jax.vmap(kj.regressor, (None, 0, 0, 0))(model, *states)).reshape(-1, 10 * model.nbody)
    lengths = np.linalg.norm(rows, axis=0)
    assert len(base) == np.linalg.matrix_rank(rows / np.where(lengths > 0, lengths, 1), tol=1e-8)
    values = base.matrix @ np.asarray(kj.inertia_parameters(model)).ravel()
    force = rows @ np.asarray(kj.inertia_parameters(model)).ravel()
    np.testing.assert_allclose(rows[:, base.independent] @ values, force, atol=1e-12 * np.abs(force).max())


def test_single_precision_models_are_analysed_in_double():
    model = kj.robots.stanford_arm().astype(jnp.float32)
    with jax.enable_x64(False):
        base = kj.base_parameters(model)
    assert base.formulas == kj.base_parameters(model.astype(jnp.float64)).formulas


def test_columns_in_other_units_group_alike():
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(30, 3))
    columns = np.column_stack((columns, 2 * columns[:, 0] - columns[:, 2], np.zeros(30))) * [1e-5, 1.0, 1e5, 1.0, 1.0]
    base = grouped(columns, "abcde", range(5))
    assert list(base.independent) == [0, 1, 2]
    assert list(base.without_effect) == [4]
    np.testing.assert_allclose(columns[:, :3] @ base.matrix[:, 3], columns[:, 3], rtol=1e-8)
