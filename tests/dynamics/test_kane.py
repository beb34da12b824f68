"""Kane's explicit equations, d'Alembert's principle and the recursions say the same."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj
from kanejax._evaluate import check_state
from kanejax._kinematics.partial_velocity import speed_axes
from tests.helpers.mechanisms import random_states, random_tree, relative

SEEDS = (2, 9)


@pytest.fixture(params=SEEDS)
def case(request):
    mj = mujoco.MjModel.from_xml_string(random_tree(request.param, 6))
    (q,), (u,), (u_dot,) = random_states(mj, 1)
    return mj, kj.from_mujoco(mj), jnp.asarray(q), jnp.asarray(u), jnp.asarray(u_dot)


def test_explicit_equations_equal_the_recursions(case):
    _, model, q, u, u_dot = case
    kane = jax.jit(kj.kane_equations)(model, q, u)
    assert relative(kane.mass_matrix, kj.mass_matrix(model, q)) < 1e-11
    assert relative(kane.inertia_remainder - kane.gravity_force, kj.bias_force(model, q, u)) < 1e-11
    assert relative(kane.gravity_force, kj.gravity_force(model, q)) < 1e-11
    inertia_force = -(kane.mass_matrix @ u_dot + kane.inertia_remainder)
    assert relative(kj.generalized_inertia_force(model, q, u, u_dot), inertia_force) < 1e-11


def test_active_and_inertia_forces_sum_to_zero(case):
    _, model, q, u, u_dot = case
    tau = kj.inverse_dynamics(model, q, u, u_dot)
    total = kj.generalized_active_force(model, q, u, tau) + kj.generalized_inertia_force(model, q, u, u_dot)
    assert float(jnp.abs(total).max() / jnp.abs(tau).max()) < 1e-11


def test_rates_are_derivatives_along_the_motion(case):
    mj, model, q, u, _ = case
    rates = kj.partial_velocity_rates(model, q, u)
    step, ends = 1e-6, []
    for sign in (1, -1):
        moved = np.array(q)
        mujoco.mj_integratePos(mj, moved, np.asarray(u), sign * step)
        ends.append(kj.partial_velocities(model, jnp.asarray(moved)))
    for rate, after, before in zip(rates, *ends, strict=True):
        assert relative(rate, (after - before) / (2 * step)) < 1e-8


def test_reactions_project_on_the_driving_forces(case):
    _, model, q, u, u_dot = case
    reactions = jax.jit(kj.joint_reactions)(model, q, u, u_dot)
    axes = speed_axes(model.tree, kj.poses(model, q))
    joint = model.tree.speed_joints
    along = (axes.angular * reactions.moment[joint]).sum(1) + (axes.linear * reactions.force[joint]).sum(1)
    driving = kj.inverse_dynamics(model, q, u, u_dot) - model.armature * u_dot + kj.passive_force(model, q, u)
    assert relative(along, driving) < 1e-11


def test_forward_and_inverse_dynamics_undo_each_other(case):
    _, model, q, u, u_dot = case
    tau = kj.inverse_dynamics(model, q, u, u_dot)
    assert relative(kj.forward_dynamics(model, q, u, tau), u_dot) < 1e-9


def test_coulomb_friction_is_smooth_and_saturates():
    mj = mujoco.MjModel.from_xml_string(random_tree(1, 2, ("hinge",)))
    model = kj.from_mujoco(mj)
    model = model.replace(
        coulomb_friction=jnp.full(2, 3.0), friction_width=jnp.full(2, 0.1), damping=jnp.zeros(2), stiffness=jnp.zeros(2)
    )
    q = jnp.zeros(2)
    assert relative(kj.passive_force(model, q, jnp.array([1e3, -1e3])), [-3.0, 3.0]) < 1e-6
    assert relative(kj.passive_force(model, q, jnp.array([0.1, 0.0])), [-3.0 / np.sqrt(2), 0.0]) < 1e-12
    slope = jax.jacobian(lambda u: kj.passive_force(model, q, u))(jnp.zeros(2))
    assert relative(jnp.diag(slope), [-30.0, -30.0]) < 1e-12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": jnp.zeros(3)}, r"q has shape \(3,\), but this model needs \(2,\) = \(nq,\)"),
        ({"u": jnp.zeros((5, 2))}, r"u has shape \(5, 2\).*batches go through jax.vmap"),
        ({"u_dot": jnp.zeros(2, jnp.float16)}, "u_dot has dtype float16; use float32 or float64"),
        ({"u": jnp.zeros(2, jnp.float32)}, "u has dtype float32, but the model has float64"),
    ],
)
def test_states_that_do_not_fit_are_named(change, message):
    model = kj.from_mujoco(mujoco.MjModel.from_xml_string(random_tree(1, 2, ("hinge",))))
    state = {"q": jnp.zeros(2), "u": jnp.zeros(2), "u_dot": jnp.zeros(2)} | change
    with pytest.raises(ValueError, match=message):
        check_state(model, **state)


def test_every_argument_is_looked_at():
    model = kj.from_mujoco(mujoco.MjModel.from_xml_string(random_tree(1, 2, ("hinge",))))
    good, bad = jnp.zeros(2), jnp.zeros(2, jnp.float32)
    with pytest.raises(ValueError, match="tau has dtype float32, but the model has float64"):
        kj.generalized_active_force(model, good, good, bad)
    with pytest.raises(ValueError, match="u has dtype float32, but the model has float64"):
        kj.partial_velocity_rates(model, good, bad)
