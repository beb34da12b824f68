"""The same motions in chosen speeds as in the model's own, and an end where chosen speeds are singular."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax import robots
from tests.helpers import components

TIGHT: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-13, "max_steps": 20000}
COUNT = 21


class WithoutWeight(eqx.Module):
    """What holds an arm against gravity, and damps its speeds."""

    model: kj.Model
    damping: Any = 0.0

    def __call__(self, t, q, u):
        return -jnp.asarray(self.damping) * u - kj.gravity_force(self.model, q)


def moved(model, q, u, end, weightless, rtol=1e-12, atol=1e-13, **options):
    """COUNT states of a motion without weight: tolerances and parameters are traced, so that many motions share a program."""
    control = WithoutWeight(weightless, jnp.asarray(options.pop("damping", 0.0)))
    tolerances: dict[str, Any] = {"rtol": jnp.asarray(rtol), "atol": jnp.asarray(atol), "max_steps": 20000}
    return kj.simulate(model, q, u, np.linspace(0.0, end, COUNT), control=control, **tolerances, **options)


def in_own_speeds(model, q, rates, end, **options):
    return moved(model, q, rates, end, model, dense=True, **options)


rates_of_rows = jax.jit(jax.vmap(kj.rates_from_speeds, (None, 0, 0)))


class Turning(eqx.Module):
    """A matrix and a drift that depend on the state and on time."""

    def matrix(self, q, t):
        return jnp.eye(10) + 0.05 * jnp.sin(jnp.outer(q[:10], q[-10:]) + 2.0 * t)

    def drift(self, q, t):
        return jnp.cos(q[:10]) * jnp.sin(3.0 * t)


class OfPendulum(eqx.Module):
    """Two speeds that depend on state and time, with one parameter: they are singular where sin q2 is minus `offset`."""

    offset: jax.Array

    def matrix(self, q, t):
        turn = jnp.array([[1.0, 0.5 * jnp.sin(2.0 * t)], [0.3 * jnp.cos(q[0]), 1.0]])
        return turn * jnp.array([1.0, self.offset + jnp.sin(q[1])])[None]

    def drift(self, q, t):
        return jnp.cos(q) * jnp.sin(3.0 * t)


def in_speeds(made, model):
    return kj.with_speeds(model, kj.GeneralizedSpeeds(made.matrix, made.drift))


def swinging(pendulum, offset):
    return in_speeds(OfPendulum(jnp.asarray(offset)), pendulum)


@pytest.fixture(scope="module")
def arm():
    """Link C's angular velocity, far from where its components are singular."""
    model = robots.three_revolute_arm(origins=((0.0, 0.1, 0.2), (0.3, 0.0, 0.1)))
    return kj.with_speeds(model, kj.link_speeds(model, "C"))


def start(arm, q2=1.2, rate=0.1):
    q, rates = jnp.array([0.3, q2, -0.4]), jnp.array([0.9, rate, 0.6])
    return q, rates, kj.speeds_from_rates(arm, q, rates)


def pendulum_start(chosen, rate=0.1):
    q, rates = jnp.array([0.3, 1.2]), jnp.array([0.9, rate])
    return q, rates, kj.speeds_from_rates(chosen, q, rates)


def floating_start(model):
    rng = np.random.default_rng(3)
    q = rng.normal(size=model.nq)
    q[3:7] /= np.linalg.norm(q[3:7])
    q[7:11] /= np.linalg.norm(q[7:11])
    return jnp.asarray(q), jnp.asarray(rng.normal(size=model.nv))


def test_speeds_of_a_link_give_the_same_motion(arm):
    q, rates, u = start(arm)
    expected = in_own_speeds(arm.model, q, rates, 1.0)
    found = moved(arm, q, u, 1.0, arm.model)
    assert int(found.status) == kj.Status.SUCCESSFUL
    assert float(jnp.abs(found.q - expected.q).max()) < 1e-9
    back = rates_of_rows(arm, found.q, found.u)
    assert float(jnp.abs(back - expected.u).max()) < 1e-9
    # Not by doing nothing.
    assert float(jnp.abs(found.u - expected.u).max()) > 0.1


def test_a_specialized_model_moves_alike_in_chosen_speeds(pendulum):
    chosen = swinging(kj.specialize(pendulum), 1.5)
    q, rates, u = pendulum_start(chosen)
    expected = moved(pendulum, q, rates, 0.5, pendulum)
    found = moved(chosen, q, u, 0.5, pendulum)
    assert int(found.status) == kj.Status.SUCCESSFUL
    assert float(jnp.abs(found.q - expected.q).max()) < 1e-9
    assert float(jnp.abs(found.u - expected.u).max()) > 0.1


def test_time_dependent_speeds_of_ball_and_free_joints(floating):
    chosen = in_speeds(Turning(), floating)
    q, rates = floating_start(floating)
    ts = np.linspace(0.2, 0.8, 7)
    expected = kj.simulate(floating, q, rates, ts, **TIGHT)
    found = kj.simulate(chosen, q, kj.speeds_from_rates(chosen.at(0.2), q, rates), ts, **TIGHT)
    assert int(found.status) == kj.Status.SUCCESSFUL
    assert float(jnp.abs(found.q - expected.q).max()) < 1e-9
    back = jax.jit(jax.vmap(lambda t, q, u: kj.rates_from_speeds(chosen.at(t), q, u)))(ts, found.q, found.u)
    assert float(jnp.abs(back - expected.u).max()) < 1e-9


def test_equal_steps_and_control_in_chosen_speeds(pendulum):
    chosen = swinging(pendulum, 1.5)
    q, rates, u = pendulum_start(chosen)

    def damping(t, q, u):
        return -0.5 * kj.rates_from_speeds(chosen.at(t), q, u) - kj.gravity_force(pendulum, q)

    found = kj.simulate(chosen, q, u, np.linspace(0.0, 0.5, COUNT), control=damping, dt0=1e-3)
    expected = moved(pendulum, q, rates, 0.5, pendulum, damping=0.5)
    assert int(found.status) == kj.Status.SUCCESSFUL
    assert float(jnp.abs(found.q - expected.q).max()) < 1e-9


@pytest.mark.parametrize("rate", [-1.5, -3.0])
def test_a_motion_that_comes_to_the_singularity_ends_there_undisturbed(arm, rate):
    q, rates, u = start(arm, rate=rate)
    found = moved(arm, q, u, 2.0, arm.model, rtol=1e-6, atol=1e-8)
    assert kj.Status(int(found.status)) is kj.Status.SINGULAR_SPEEDS
    assert not bool(found.ok)
    assert found.event_names[int(found.event)] == "singular speeds"
    first, last = kj.speed_conditioning(arm, q), kj.speed_conditioning(arm, jnp.asarray(found.q_end))
    assert abs(float(last / first) - 1e-3) < 1e-9
    assert 0.0 < float(found.q_end[1]) < 2e-3
    expected = in_own_speeds(arm.model, q, rates, 2.0)
    reached = np.asarray(found.reached)
    assert 0 < reached.sum() < COUNT
    assert float(jnp.abs(found.q - expected.q)[reached].max()) < 1e-6
    q_end, rates_end = expected.evaluate(found.t_end)
    assert float(jnp.abs(found.q_end - q_end).max()) < 1e-6
    # Three digits less than the tolerance.
    assert float(jnp.abs(kj.rates_from_speeds(arm, jnp.asarray(found.q_end), jnp.asarray(found.u_end)) - rates_end).max()) < 1e-2
    with pytest.raises(kj.SimulationError, match=r"SINGULAR_SPEEDS at t = .* Go on in other speeds"):
        moved(arm, q, u, 2.0, arm.model, rtol=1e-6, atol=1e-8, throw=True)


LOOSER: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-10}
SINGULAR_BETWEEN = [kj.Status.SUCCESSFUL, kj.Status.SINGULAR_SPEEDS, kj.Status.SUCCESSFUL]


@pytest.fixture(scope="module")
def passing(pendulum):
    """Speeds that are singular where the pendulum is straight."""
    return swinging(pendulum, 0.0)


@pytest.fixture(scope="module")
def three(passing):
    """First states, of which the second moves to where the speeds are singular; and the motions, of which the third is heavier."""
    q, u = (jnp.stack([pendulum_start(passing, rate)[i] for rate in (0.1, -2.0, 0.2)]) for i in (0, 2))
    heavier = eqx.tree_at(lambda a: a.model.mass, passing, passing.model.mass[None] * jnp.array([1.0, 1.0, 1.2])[:, None])
    ts = np.linspace(0.0, 0.8, COUNT)
    return q, u, kj.simulate_batch(heavier, q, u, ts, threads=1, control=WithoutWeight(passing.model), **LOOSER)


def test_a_batch_in_which_one_is_singular(passing, three):
    q, u, in_lanes = three
    at_once = jax.vmap(lambda q, u: moved(passing, q, u, 0.8, passing.model, **LOOSER))(q, u)
    for batch in (at_once, in_lanes):
        assert np.asarray(batch.status).tolist() == SINGULAR_BETWEEN
    for row in (0, 2):
        alone = np.asarray(moved(passing, q[row], u[row], 0.8, passing.model, **LOOSER).q)
        assert float(np.abs(alone - at_once.q[row]).max()) < 1e-9
        # The lanes' third one is heavier.
        assert (float(np.abs(alone - in_lanes.q[row]).max()) < 1e-9) == (row == 0)


def test_domain_randomisation_in_chosen_speeds(passing, three):
    q, u, in_lanes = three
    # Against the weight of the lighter one, as in the lanes.
    heavier = eqx.tree_at(lambda a: a.model.mass, passing, passing.model.mass * 1.2)
    alone = np.asarray(moved(heavier, q[2], u[2], 0.8, passing.model, **LOOSER).q)
    light = np.asarray(moved(passing, q[2], u[2], 0.8, passing.model, **LOOSER).q)
    assert float(np.abs(in_lanes.q[2] - alone).max()) < 1e-9
    assert float(np.abs(in_lanes.q[2] - light).max()) > 1e-3


@pytest.mark.slow
def test_gradients_of_a_motion_do_not_depend_on_the_speeds(pendulum):
    """Reverse mode of adaptive steps in chosen speeds, beside forward mode of equal steps in the model's own."""
    chosen = swinging(pendulum, 1.5)
    q, rates, _ = pendulum_start(chosen)
    ts = np.linspace(0.0, 0.4, 3)
    # Adaptive steps do not see the sharp rise of a friction that is zero, but its derivative does.
    point = pendulum.replace(friction_width=jnp.ones(2)), rates

    def by_chosen(model, rates, offset):
        moving = swinging(model, offset)
        return jnp.sum(jnp.sin(kj.simulate(moving, q, kj.speeds_from_rates(moving, q, rates), ts, rtol=1e-11, atol=1e-12).q))

    def by_own(model, rates):
        return jnp.sum(jnp.sin(kj.simulate(model, q, rates, ts, dt0=1e-3).q))

    *gradient, by_offset = jax.jit(jax.grad(by_chosen, (0, 1, 2)))(*point, jnp.asarray(1.5))
    slope = jax.jit(lambda direction: jax.jvp(by_own, point, direction)[1])
    for found, expected in zip(jax.tree.leaves(gradient), jax.tree.leaves(components.gradient(slope, point)), strict=True):
        assert float(jnp.abs(found - expected).max()) < 1e-8 * (1.0 + float(np.abs(expected).max()))
    assert float(jnp.abs(by_offset)) < 1e-8


def test_float32(pendulum):
    chosen = swinging(pendulum, 1.5)
    single = jax.tree.map(lambda x: x.astype(jnp.float32), chosen)
    q, rates, u = pendulum_start(chosen)
    ts = np.linspace(0.0, 0.5, COUNT)
    found = kj.simulate(single, q.astype(jnp.float32), u.astype(jnp.float32), ts, control=WithoutWeight(single.model))
    assert found.q.dtype == jnp.float32
    assert int(found.status) == kj.Status.SUCCESSFUL
    expected = moved(pendulum, q, rates, 0.5, pendulum)
    assert float(np.abs(np.asarray(found.q, np.float64) - expected.q).max()) < 1e-3


def bouncing(pendulum, offset):
    """In chosen speeds, and in the model's own."""
    chosen = swinging(pendulum, offset)
    q, rates = jnp.array([0.1, 0.2]), jnp.array([4.0, -1.0])
    ts, options = np.linspace(0.0, 1.0, 6), {"joint_limits": True, **TIGHT}
    own = kj.simulate(pendulum, q, rates, ts, on_event=kj.JointLimitBounce(pendulum, 0.8), **options)
    u = kj.speeds_from_rates(chosen, q, rates)
    with pytest.raises(ValueError, match="JointLimitBounce's model"):
        kj.simulate(chosen, q, u, ts, on_event=kj.JointLimitBounce(pendulum, 0.8), **options)
    return kj.simulate(chosen, q, u, ts, on_event=kj.JointLimitBounce(chosen, 0.8), **options), own


def test_bounces_in_chosen_speeds(pendulum):
    """At the stop of the first joint; in whatever speeds."""
    found, expected = bouncing(pendulum, 1.5)
    assert int(found.num_events) == int(expected.num_events) > 0
    assert float(jnp.abs(found.q - expected.q).max()) < 1e-8


def test_the_singularity_is_no_event_of_the_user(pendulum):
    """It ends the motion also where events are passed on."""
    found, own = bouncing(pendulum, 0.9)
    assert kj.Status(int(found.status)) is kj.Status.SINGULAR_SPEEDS
    assert int(found.num_events) > 0
    assert found.event_names == ("joint limit", "singular speeds")
    reached = np.asarray(found.reached)
    assert float(jnp.abs(found.q - own.q)[reached].max()) < 1e-8


def test_singular_first_states_are_refused(arm):
    q, rates, _ = start(arm)
    with pytest.raises(ValueError, match=r"the chosen speeds do not determine the motion at q0 = .* choose other speeds"):
        kj.simulate(arm, q.at[1].set(0.0), rates, np.array([0.0, 1.0]))
