"""The twelve equations of Nie's program ANGLE, derived by hand, against the library's simulation of the same arm."""

from collections.abc import Callable

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import kanejax as kj
from tests.thesis.hand.angle import rates
from tests.thesis.hand.arm import Symbols
from tests.thesis.hand.cases import random_arm, random_states, table_3
from tests.thesis.hand.torque import motion, speed_matrix, torque, variables

# Both integrators are of order 8 with steps to this tolerance.
TIGHT = 1e-12
TIMES = np.linspace(0, 1, 21)


def integrated(arm: Symbols, q: np.ndarray, q_dot: np.ndarray, tau: Callable[[float], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and their rates at TIMES, from the twelve equations in q and the generalized speeds of (2.18)."""
    start = np.concatenate((q, speed_matrix(q) @ q_dot))
    solution = solve_ivp(
        lambda t, y: np.concatenate(rates(arm, y[:6], y[6:], tau(t))),
        (TIMES[0], TIMES[-1]),
        start,
        method="DOP853",
        rtol=TIGHT,
        atol=TIGHT,
        t_eval=TIMES,
    )
    q, u = solution.y[:6].T, solution.y[6:].T
    # The equations are singular where link B turns about the axis of A; the motion stays away from there.
    assert np.abs(np.sin(q[:, 1])).min() > 0.4
    return q, np.linalg.solve(speed_matrix(q), u[..., None])[..., 0]


def test_rates_undo_torques():
    """ANGLE's equations, under TORQUE's torques, give back the accelerations, for 1500 states."""
    arm, states = random_arm().symbols, random_states(1500)
    u = np.einsum("nrs,ns->nr", speed_matrix(states.q), states.q_dot)
    q_dot, u_dot = rates(arm, states.q, u, torque(arm, *states))
    values = variables(arm, *states)
    expected = np.stack([values[f"UP{r}"] for r in range(1, 7)], -1)
    np.testing.assert_allclose(q_dot, states.q_dot, rtol=0, atol=1e-12 * np.abs(states.q_dot).max())
    np.testing.assert_allclose(u_dot, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_forward_dynamics():
    """q' and u' as from the library, for random states and torques, in the generalized speeds of (2.18)."""
    arm, (q, q_dot, _) = random_arm(), random_states(1500)
    tau = np.random.default_rng(1).uniform(-50, 50, q.shape)
    q_ddot = np.asarray(jax.jit(jax.vmap(kj.forward_dynamics, (None, 0, 0, 0)))(arm.model, q, q_dot, tau))
    u = np.einsum("nrs,ns->nr", speed_matrix(q), q_dot)
    _, u_dot = rates(arm.symbols, q, u, tau)
    values = variables(arm.symbols, q, q_dot, q_ddot)
    expected = np.stack([values[f"UP{r}"] for r in range(1, 7)], -1)
    np.testing.assert_allclose(u_dot, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_same_motion_under_a_torque_history():
    """A second under torques that swing about those that hold the arm at first."""
    arm = random_arm()
    q, q_dot = np.array([0.1, 1.5, 0.2, -0.3, 0.4, 0.5]), np.array([0.3, -0.2, 0.1, 0.4, -0.3, 0.2])
    still = torque(arm.symbols, q, np.zeros(6), np.zeros(6))
    amplitude, frequency = np.array([3.0, 4.0, 2.0, 1.0, 0.3, 0.1]), np.arange(2.0, 8.0)
    by_hand = integrated(arm.symbols, q, q_dot, lambda t: still + amplitude * np.sin(frequency * t))
    simulated = kj.simulate(
        arm.model,
        q,
        q_dot,
        TIMES,
        control=lambda t, q, u: still + amplitude * jnp.sin(frequency * t),
        solver=diffrax.Dopri8(),
        rtol=TIGHT,
        atol=TIGHT,
        throw=True,
    )
    # The arm moves by radians, some of it at 10 rad/s, so that this compares motions and not the state at first.
    assert np.abs(by_hand[0][-1] - q).max() > 1
    np.testing.assert_allclose(simulated.q, by_hand[0], rtol=0, atol=1e-9 * np.abs(by_hand[0]).max())
    np.testing.assert_allclose(simulated.u, by_hand[1], rtol=0, atol=1e-9 * np.abs(by_hand[1]).max())


def test_torques_of_a_motion_give_back_the_motion():
    """The thesis's own check: ANGLE under TORQUE's output, for the first second of the specified motion."""
    arm = table_3().symbols
    q, q_dot, _ = motion(TIMES)
    by_hand = integrated(arm, q[0], q_dot[0], lambda t: torque(arm, *motion(np.array(t))))
    np.testing.assert_allclose(by_hand[0], q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(by_hand[1], q_dot, rtol=0, atol=1e-8)
