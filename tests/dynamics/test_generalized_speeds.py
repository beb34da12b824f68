"""Equations of motion in speeds of the user's choice, against MuJoCo and the change of speeds written in numpy."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj
from tests.helpers.mechanisms import random_states, random_tree, relative
from tests.helpers.oracle import ask

TIME = 0.7


class Waves(eqx.Module):
    """Entries base + size sin(a . q + b t), for Y or Z, with derivatives by hand."""

    base: jax.Array
    a: jax.Array
    b: jax.Array
    size: float = eqx.field(static=True, default=0.2)

    def __call__(self, q, t):
        return self.base + self.size * jnp.sin(self.a @ q + self.b * t)

    def in_numpy(self, q, q_dot, t):
        phase = np.asarray(self.a) @ q + np.asarray(self.b) * t
        rate = np.asarray(self.a) @ q_dot + np.asarray(self.b)
        return np.asarray(self.base) + self.size * np.sin(phase), self.size * np.cos(phase) * rate


def waves(model, seed=0):
    """A well conditioned Y that depends on everything, and a Z."""
    rng, nv, nq = np.random.default_rng(seed), model.nv, model.nq
    scale = 0.2 if nv < 4 else 1.0 / nv
    matrix = Waves(jnp.eye(nv) * 1.5, jnp.asarray(rng.normal(size=(nv, nv, nq))), jnp.asarray(rng.normal(size=(nv, nv))), scale)
    drift = Waves(jnp.zeros(nv), jnp.asarray(rng.normal(size=(nv, nq))), jnp.asarray(rng.normal(size=nv)), 0.5)
    return matrix, drift


class Change(NamedTuple):
    """The change of speeds at one state, in numpy."""

    W: np.ndarray
    v: np.ndarray
    v_dot: np.ndarray
    Y: np.ndarray
    rest: np.ndarray


class Case(NamedTuple):
    mj: mujoco.MjModel
    model: kj.Model
    arm: kj.WithSpeeds
    q: jax.Array
    u: jax.Array
    u_dot: jax.Array
    change: Change

    def oracle(self, u, u_dot, tau=None):
        return ask(self.mj, self.q, u, u_dot, np.zeros(self.model.nv) if tau is None else tau)


def make(mj, seed=0):
    model = kj.from_mujoco(mj)
    matrix, drift = waves(model, seed)
    (q,), (u,), (u_dot,) = random_states(mj, 1, seed)
    arm = kj.with_speeds(model, kj.GeneralizedSpeeds(matrix, drift), t=TIME)
    Y, Z = np.asarray(matrix(q, TIME)), np.asarray(drift(q, TIME))
    W = np.linalg.inv(Y)
    v = W @ (u - Z)
    q_dot = np.asarray(kj.coordinate_rates(model, jnp.asarray(q), jnp.asarray(v)))
    rest = matrix.in_numpy(q, q_dot, TIME)[1] @ v + drift.in_numpy(q, q_dot, TIME)[1]
    change = Change(W, v, W @ (u_dot - rest), Y, rest)
    return Case(mj, model, arm, jnp.asarray(q), jnp.asarray(u), jnp.asarray(u_dot), change)


@pytest.fixture(params=("every type of joint", "hinges and slides"), scope="module")
def case(request):
    """Random trees with springs, dampers and rotors."""
    if request.param == "hinges and slides":
        return make(mujoco.MjModel.from_xml_string(random_tree(14, 6, ("hinge", "slide"))), 14)
    found = make(mujoco.MjModel.from_xml_string(random_tree(5, 7)), 5)
    assert set(found.model.tree.joint_types) == {"revolute", "prismatic", "ball", "free"}
    return found


def test_speeds_and_rates(case):
    assert relative(kj.rates_from_speeds(case.arm, case.q, case.u), case.change.v) < 1e-12
    assert relative(kj.speeds_from_rates(case.arm, case.q, jnp.asarray(case.change.v)), case.u) < 1e-12
    expected = np.sign(np.linalg.det(case.change.Y)) / np.linalg.cond(case.change.Y)
    assert relative(jax.jit(kj.speed_conditioning)(case.arm, case.q), expected) < 1e-12


def test_quaternions_need_not_be_of_unit_length(case):
    start = [int(i) for i in case.model.tree.turning_speeds[1]]
    longer = case.q
    for i in start:
        longer = longer.at[i : i + 4].multiply(1.7)
    assert relative(kj.bias_force(case.arm, longer, case.u), kj.bias_force(case.arm, case.q, case.u)) < 1e-12


def test_mass_matrix(case):
    W = case.change.W
    assert relative(kj.mass_matrix(case.arm, case.q), W.T @ case.oracle(case.change.v, case.u_dot).mass_matrix @ W) < 1e-12


def test_bias_passive_and_gravity_force(case):
    W, v, _, _, rest = case.change
    answer = case.oracle(v, case.u_dot)
    assert relative(kj.bias_force(case.arm, case.q, case.u), W.T @ (answer.bias - answer.mass_matrix @ W @ rest)) < 1e-11
    assert relative(kj.passive_force(case.arm, case.q, case.u), W.T @ answer.passive) < 1e-12
    still = case.oracle(np.zeros(case.model.nv), case.u_dot)
    assert relative(kj.gravity_force(case.arm, case.q), -W.T @ still.bias) < 1e-12


def test_inverse_dynamics_returns_the_forces_of_the_joints(case):
    answer = case.oracle(case.change.v, case.change.v_dot)
    assert relative(kj.inverse_dynamics(case.arm, case.q, case.u, case.u_dot), answer.inverse) < 1e-11


def test_forward_dynamics_takes_the_forces_of_the_joints(case):
    tau = random_states(case.mj, 1, 5)[2][0]
    expected = case.change.Y @ case.oracle(case.change.v, case.u_dot, tau).forward + case.change.rest
    assert relative(kj.forward_dynamics(case.arm, case.q, case.u, jnp.asarray(tau)), expected) < 1e-9


def test_generalized_forces(case):
    W, v, v_dot, _, _ = case.change
    answer, still = case.oracle(v, v_dot), case.oracle(np.zeros(case.model.nv), case.u_dot)
    inertia = -W.T @ (answer.mass_matrix @ v_dot + answer.bias - still.bias)
    assert relative(kj.generalized_inertia_force(case.arm, case.q, case.u, case.u_dot), inertia) < 1e-11
    tau = random_states(case.mj, 1, 5)[2][0]
    active = kj.generalized_active_force(case.arm, case.q, case.u, jnp.asarray(tau))
    assert relative(active, W.T @ (tau - still.bias + answer.passive)) < 1e-12


def test_active_and_inertia_forces_sum_to_zero(case):
    tau = kj.inverse_dynamics(case.arm, case.q, case.u, case.u_dot)
    active = kj.generalized_active_force(case.arm, case.q, case.u, tau)
    inertia = kj.generalized_inertia_force(case.arm, case.q, case.u, case.u_dot)
    assert float(jnp.abs(active + inertia).max() / jnp.abs(inertia).max()) < 1e-11


def test_equations_of_motion_hold_together(case):
    tau = kj.inverse_dynamics(case.arm, case.q, case.u, case.u_dot)
    assert relative(kj.forward_dynamics(case.arm, case.q, case.u, tau), case.u_dot) < 1e-9
    left = kj.mass_matrix(case.arm, case.q) @ case.u_dot + kj.bias_force(case.arm, case.q, case.u)
    right = case.change.W.T @ np.asarray(tau) + kj.passive_force(case.arm, case.q, case.u)
    assert relative(left, right) < 1e-11


def test_kinetic_energy_and_momentum(case):
    answer = case.oracle(case.change.v, case.u_dot)
    assert relative(kj.kinetic_energy(case.arm, case.q, case.u), answer.kinetic) < 1e-12
    assert relative(kj.momentum(case.arm, case.q, case.u).angular, answer.angular_momentum) < 1e-10


def test_partial_velocities(case):
    W, v, *_ = case.change
    answer, partial = case.oracle(v, case.u_dot), kj.partial_velocities(case.arm, case.q)
    assert relative(partial.angular, np.einsum("kri,rs->ksi", answer.jacobian_rotation, W)) < 1e-12
    assert relative(partial.linear, np.einsum("kri,rs->ksi", answer.jacobian_com, W)) < 1e-12


def test_partial_velocity_rates_are_derivatives_along_the_motion(case):
    rates, step, ends = kj.partial_velocity_rates(case.arm, case.q, case.u), 1e-6, []
    for sign in (1, -1):
        moved = np.array(case.q)
        mujoco.mj_integratePos(case.mj, moved, case.change.v, sign * step)
        ends.append(kj.partial_velocities(case.arm.at(TIME + sign * step), jnp.asarray(moved)))
    for rate, after, before in zip(rates, *ends, strict=True):
        assert relative(rate, (after - before) / (2 * step)) < 1e-8


def test_explicit_equations_equal_the_recursions(case):
    kane = jax.jit(kj.kane_equations)(case.arm, case.q, case.u)
    assert relative(kane.mass_matrix, kj.mass_matrix(case.arm, case.q)) < 1e-11
    assert relative(kane.gravity_force, kj.gravity_force(case.arm, case.q)) < 1e-11
    assert relative(kane.inertia_remainder - kane.gravity_force, kj.bias_force(case.arm, case.q, case.u)) < 1e-11
    for found, expected in zip(kane.partial, kj.partial_velocities(case.arm, case.q), strict=True):
        assert relative(found, expected) < 1e-12
    for found, expected in zip(kane.rates, kj.partial_velocity_rates(case.arm, case.q, case.u), strict=True):
        assert relative(found, expected) < 1e-12


def test_d_alembert_body_by_body(case):
    """Accelerations by differentiating velocities along the motion, projected on the chosen speeds' partial velocities."""
    model = case.model

    def velocities(q, u, t):
        partial = kj.partial_velocities(model, q)
        v = kj.rates_from_speeds(case.arm.at(t), q, u)
        return jnp.einsum("kri,r->ki", partial.angular, v), jnp.einsum("kri,r->ki", partial.linear, v)

    q_dot = kj.coordinate_rates(model, case.q, jnp.asarray(case.change.v))
    (w, _), (alpha, a) = jax.jvp(velocities, (case.q, case.u, jnp.asarray(TIME)), (q_dot, case.u_dot, jnp.asarray(1.0)))
    rotation = kj.poses(model, case.q).rotation
    inertia = np.einsum("kij,kjl,kml->kim", rotation, model.central_inertia, rotation)
    force = model.mass[:, None] * (a - model.gravity[None])
    moment = np.einsum("kij,kj->ki", inertia, alpha) + np.cross(w, np.einsum("kij,kj->ki", inertia, w))
    partial = kj.partial_velocities(case.arm, case.q)
    needed = np.einsum("kri,ki->r", partial.linear, force) + np.einsum("kri,ki->r", partial.angular, moment)
    needed += case.change.W.T @ (np.asarray(model.armature) * case.change.v_dot)
    tau = kj.inverse_dynamics(case.arm, case.q, case.u, case.u_dot)
    applied = case.change.W.T @ np.asarray(tau) + kj.passive_force(case.arm, case.q, case.u)
    assert relative(applied, needed) < 1e-11


def test_identity_changes_nothing(case):
    same = kj.with_speeds(case.model, kj.GeneralizedSpeeds(lambda q, t: jnp.eye(case.model.nv)))
    assert relative(kj.bias_force(same, case.q, case.u), kj.bias_force(case.model, case.q, case.u)) < 1e-13
    found = kj.inverse_dynamics(same, case.q, case.u, case.u_dot)
    assert relative(found, kj.inverse_dynamics(case.model, case.q, case.u, case.u_dot)) < 1e-13
    assert float(kj.speed_conditioning(same, case.q)) == 1.0


def test_specialized_models(case):
    arm = kj.with_speeds(kj.specialize(case.model, keep=("mass",)), case.arm.speeds, t=TIME)
    for function in (kj.inverse_dynamics, kj.forward_dynamics, kj.generalized_inertia_force):
        expected = function(case.arm, case.q, case.u, case.u_dot)
        assert relative(function(arm, case.q, case.u, case.u_dot), expected) < 1e-10
    assert relative(kj.partial_velocities(arm, case.q).linear, kj.partial_velocities(case.arm, case.q).linear) < 1e-12
    assert relative(kj.kane_equations(arm, case.q, case.u).mass_matrix, kj.mass_matrix(case.arm, case.q)) < 1e-11


@pytest.fixture(scope="module")
def chain():
    """Four joints: small enough to compile gradients of."""
    return make(mujoco.MjModel.from_xml_string(random_tree(3, 4, ("hinge", "slide"), chain=True)), 1)


def test_batches(chain):
    q, u, u_dot = (jnp.asarray(x) for x in random_states(chain.mj, 8, 2))
    times = jnp.linspace(0.0, 1.0, 8)

    def one(arm, t, q, u, u_dot):
        return kj.inverse_dynamics(arm.at(t), q, u, u_dot)

    found = jax.jit(jax.vmap(one, (None, 0, 0, 0, 0)))(chain.arm, times, q, u, u_dot)
    for row in (0, 3, 7):
        assert relative(found[row], one(chain.arm, times[row], q[row], u[row], u_dot[row])) < 1e-12


def test_gradients_reach_the_model_the_choice_the_time_and_the_state(chain):
    tau = jnp.asarray(random_states(chain.mj, 1, 5)[2][0])

    def loss(arm, q, u):
        return jnp.sum(jnp.sin(kj.forward_dynamics(arm, q, u, tau))) + jnp.sum(jnp.cos(kj.bias_force(arm, q, u)))

    arguments = (chain.arm, chain.q, chain.u)
    value_and_gradient = jax.jit(jax.value_and_grad(loss, (0, 1, 2)))
    gradient = value_and_gradient(*arguments)[1]
    rng = np.random.default_rng(4)
    leaves, structure = jax.tree.flatten(arguments)
    for index, leaf in enumerate(leaves):
        direction = jnp.asarray(rng.normal(size=leaf.shape))
        if not bool(jnp.all(jnp.isfinite(leaf))):
            continue

        def along(s, index=index, leaf=leaf, direction=direction):
            moved = [*leaves[:index], leaf + s * direction, *leaves[index + 1 :]]
            return value_and_gradient(*jax.tree.unflatten(structure, moved))[0]

        slope = (along(1e-6) - along(-1e-6)) / 2e-6
        found = jnp.vdot(jax.tree.leaves(gradient)[index], direction)
        assert abs(float(found - slope)) < 1e-7 * (1.0 + abs(float(slope))), index


def test_float32(chain):
    arm = jax.tree.map(lambda x: x.astype(jnp.float32), chain.arm)
    q, u, u_dot = (x.astype(jnp.float32) for x in (chain.q, chain.u, chain.u_dot))
    assert arm.dtype == jnp.float32
    for function in (kj.inverse_dynamics, kj.forward_dynamics, kj.generalized_active_force):
        found = function(arm, q, u, u_dot)
        assert found.dtype == jnp.float32
        assert relative(found, function(chain.arm, chain.q, chain.u, chain.u_dot)) < 2e-5
    assert jax.eval_shape(kj.kane_equations, arm, q, u).mass_matrix.dtype == jnp.float32


def test_changing_a_parameter_of_the_choice_does_not_compile_again(chain):
    count = 0

    @jax.jit
    def function(arm, q):
        nonlocal count
        count += 1
        return kj.mass_matrix(arm, q)

    function(chain.arm, chain.q)
    other = eqx.tree_at(lambda arm: arm.speeds.matrix.base, chain.arm, 2.0 * jnp.eye(chain.model.nv))
    assert relative(function(other, chain.q), kj.mass_matrix(other, chain.q)) < 1e-12
    assert count == 1


def test_errors(chain):
    model, q = chain.model, chain.q
    with pytest.raises(ValueError, match=r"matrix returns shape \(3, 3\), but this model needs \(4, 4\) = \(nv, nv\)"):
        kj.with_speeds(model, kj.GeneralizedSpeeds(lambda q, t: jnp.eye(3)))
    with pytest.raises(ValueError, match=r"drift returns shape \(1,\), but this model needs \(4,\) = \(nv,\)"):
        kj.with_speeds(model, kj.GeneralizedSpeeds(lambda q, t: jnp.eye(4), lambda q, t: jnp.zeros(1)))
    with pytest.raises(TypeError, match=r"matrix is ndarray; give a function of \(q, t\)"):
        kj.GeneralizedSpeeds(np.eye(4))
    singular = kj.with_speeds(model, kj.GeneralizedSpeeds(lambda q, t: jnp.diag(jnp.array([1.0, 1.0, 0.0, 1.0]))))
    for function in (kj.rates_from_speeds, kj.speeds_from_rates):
        with pytest.raises(ValueError, match="the chosen speeds do not determine the motion at q = "):
            function(singular, q, chain.u)
    with pytest.raises(ValueError, match=r"u has shape \(3,\), but this model needs \(4,\) = \(nv,\)"):
        kj.rates_from_speeds(chain.arm, q, chain.u[:3])
    with pytest.raises(AttributeError, match=r"with chosen speeds has no 'gravity'; .* takes the model itself, its `model`"):
        _ = chain.arm.gravity
