from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj

Q0, U0 = np.array([0.3, -0.8]), np.array([0.5, 1.0])
TS = np.linspace(0, 2, 9)
TIGHT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}


def test_a_joint_limit_stops_the_simulation(pendulum):
    q0 = jnp.array([[0.3, -0.8], [0.0, 0.0]])
    u0 = jnp.array([[5.0, 1.0], [0.0, 0.1]])
    both = jax.jit(jax.vmap(lambda q, u: kj.simulate(pendulum, q, u, TS, joint_limits=True, **TIGHT)))(q0, u0)
    assert both.event_names == ("joint limit",)
    assert list(both.status) == [kj.Status.EVENT, kj.Status.SUCCESSFUL]
    assert list(both.event) == [0, -1]
    assert all(both.ok)
    np.testing.assert_allclose(both.q_end[0, 0], 0.5, atol=1e-12)
    np.testing.assert_array_equal(both.reached, np.isfinite(both.q[:, :, 0]))
    assert not both.reached[0, -1]
    # A simulation that ends there has no event, and comes to the same state.
    t = float(both.t_end[0])
    end = kj.simulate(pendulum, q0[0], u0[0], np.array([0.0, t]), **TIGHT)
    np.testing.assert_allclose(end.q_end, both.q_end[0], atol=1e-9)


def test_events_have_names_and_directions(pendulum):
    events = {
        "high": lambda t, q, u: q[0] - 10.0,
        "swings back": kj.StateEvent(lambda t, q, u: u[0], "falling"),
        "swings out": kj.StateEvent(lambda t, q, u: u[0], "rising"),
    }
    trajectory = kj.simulate(pendulum, Q0, U0, TS, events=events, **TIGHT)
    assert trajectory.event_names[trajectory.event] == "swings back"
    assert trajectory.status == kj.Status.EVENT
    np.testing.assert_allclose(trajectory.u_end[0], 0, atol=1e-11)


def test_bouncing_conserves_energy(pendulum):
    bounce = kj.JointLimitBounce(pendulum)
    q0, u0 = np.array([0.3, -0.8]), np.array([5.0, 1.0])
    trajectory = kj.simulate(pendulum, q0, u0, TS, joint_limits=True, on_event=bounce, **TIGHT)
    assert trajectory.num_events >= 4
    assert trajectory.status == kj.Status.SUCCESSFUL
    assert np.all(trajectory.q[:, 0] <= 0.5 + 1e-9)
    assert np.all(trajectory.q[:, 0] >= -1 - 1e-9)
    energy = jax.jit(jax.vmap(lambda q, u: kj.kinetic_energy(pendulum, q, u) + kj.potential_energy(pendulum, q)))(
        trajectory.q, trajectory.u
    )
    np.testing.assert_allclose(energy, energy[0], rtol=1e-7)


@pytest.fixture(scope="module")
def restarting(pendulum):
    """Values, their pullback and the trajectory of a motion that jumps back once from where it falls back: one program."""

    def motion(q, ts):
        events = {"falls back": kj.StateEvent(lambda t, q, u: q[0] - 0.1, "falling")}
        reverse = {"on_event": lambda t, q, u: (q, -0.5 * u), "max_events": 1}
        trajectory = kj.simulate(pendulum, q, U0, ts, events=events, **reverse, **TIGHT)
        # Times that were not reached have no gradient.
        reached = jnp.sum(jnp.where(trajectory.reached[:, None], trajectory.q, 0.0))
        return jnp.stack((jnp.sum(trajectory.q_end), trajectory.t_end, reached)), trajectory

    @jax.jit
    def values_and_pullback(q, ts, cotangent):
        values, pullback, trajectory = jax.vjp(lambda q: motion(q, ts), q, has_aux=True)
        return values, pullback(cotangent)[0], trajectory

    return values_and_pullback


def gradients_and_differences(restarting, ts):
    """Of all values by the two coordinates, (3, 2) each."""
    q0, h = jnp.asarray(Q0), 1e-5
    gradients = np.stack([restarting(q0, ts, jnp.asarray(e))[1] for e in np.eye(3)])
    ahead, behind = (np.stack([restarting(q0 + s * e, ts, jnp.zeros(3))[0] for e in np.eye(2)], 1) for s in (h, -h))
    return gradients, (ahead - behind) / (2 * h)


def test_restarts_have_gradients(restarting):
    trajectory = restarting(jnp.asarray(Q0), TS[:3], jnp.zeros(3))[2]
    assert trajectory.num_events == 1
    assert trajectory.status == kj.Status.SUCCESSFUL
    gradients, expected = gradients_and_differences(restarting, TS[:3])
    np.testing.assert_allclose(gradients[[0, 2]], expected[[0, 2]], rtol=1e-6)
    np.testing.assert_array_equal(gradients[1], 0.0)


LONGER = np.array([0.0, 0.25, 5.0])


def test_events_beyond_the_greatest_number_stop(restarting):
    trajectory = restarting(jnp.asarray(Q0), LONGER, jnp.zeros(3))[2]
    assert trajectory.num_events == 1
    assert trajectory.status == kj.Status.EVENT
    assert trajectory.event == 0
    np.testing.assert_allclose(trajectory.q_end[0], 0.1, atol=1e-11)
    np.testing.assert_array_equal(trajectory.reached, [True, True, False])
    assert np.isnan(trajectory.q[-1]).all()


def test_the_time_of_an_event_has_gradients_and_times_that_were_not_reached_have_none(restarting):
    gradients, expected = gradients_and_differences(restarting, LONGER)
    np.testing.assert_allclose(gradients, expected, rtol=1e-6)


def test_bad_events_are_refused(pendulum):
    with pytest.raises(ValueError, match=r"q0\[0\] = 0.7 of joint 'shoulder' is outside of its range -1.0 to 0.5"):
        kj.simulate(pendulum, np.array([0.7, 0.0]), U0, TS, joint_limits=True)
    with pytest.raises(TypeError, match="event 'event' is float"):
        kj.simulate(pendulum, Q0, U0, TS, events=3.0)
    with pytest.raises(ValueError, match="has no direction, which on_event needs"):
        kj.simulate(pendulum, Q0, U0, TS, events=lambda t, q, u: q[0], on_event=lambda t, q, u: (q, u))
    with pytest.raises(ValueError, match="on_event needs events"):
        kj.simulate(pendulum, Q0, U0, TS, on_event=lambda t, q, u: (q, u))
