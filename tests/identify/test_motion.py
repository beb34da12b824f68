"""Motions: interpolation, delays, and parting into training and validation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kanejax._logs.motion import Motion, split


def signal(t, rate=0):
    """A curve and its derivatives, with a column for each of two joints."""
    omega = np.array([2.0, 3.0])
    return omega**rate * np.array([1.0, 0.5]) * np.sin(omega * np.asarray(t)[:, None] + np.array([0.0, 1.0]) + rate * np.pi / 2)


def motion(ts, dtype=np.float64, **others):
    arrays = (ts, signal(ts), signal(ts, 1), signal(ts, 2), 10.0 * signal(ts))
    return Motion(*(np.asarray(x, dtype) for x in arrays), **others)


def test_interpolation_converges_with_the_fourth_power_of_the_step():
    times = np.linspace(0.3, 3.7, 77)
    errors = []
    for n in (101, 201):
        found = motion(np.linspace(0.0, 4.0, n)).at(jnp.asarray(times))
        exact = (signal(times), signal(times, 1), signal(times, 2), 10.0 * signal(times))
        errors.append([np.abs(x - y).max() for x, y in zip((found.q, found.u, found.u_dot, found.effort), exact, strict=True)])
    coarse, fine = np.array(errors)
    # With exact slopes q and u are of fourth order; slopes of parabolas leave u_dot and effort at third.
    assert np.all(coarse / fine > [13, 13, 7, 7])
    assert np.all(fine < [1e-7, 1e-6, 1e-4, 1e-4])
    np.testing.assert_array_equal(found.ts, times)


def test_interpolation_at_irregular_samples_keeps_them_and_cubics_are_exact():
    ts = np.array([0.0, 0.1, 0.15, 0.4, 0.5, 0.9])
    cubic, quadratic = ts**3 - ts, 3.0 * ts**2 - 1.0
    made = Motion(ts, *(jnp.asarray(x)[:, None] for x in (cubic, quadratic, 6.0 * ts, ts**2)))
    for array, again in zip(jax.tree.leaves(made), jax.tree.leaves(made.at(made.ts)), strict=True):
        np.testing.assert_allclose(again, array, atol=1e-15)
    times = np.linspace(0.0, 0.9, 31)
    found = made.at(jnp.asarray(times))
    for array, exact in (
        (found.q, times**3 - times),
        (found.u, 3 * times**2 - 1),
        (found.u_dot, 6 * times),
        (found.effort, times**2),
    ):
        np.testing.assert_allclose(array[:, 0], exact, atol=1e-14)


def test_two_samples_are_enough():
    made = Motion(np.arange(2.0), *np.array([[0.0, 1.0], [1.0, 1.0], [0.0, 0.0], [2.0, 4.0]])[..., None])
    np.testing.assert_allclose(made.at(jnp.array([0.25])).effort, [[2.5]])


def test_weights_between_and_outside():
    weight = np.ones((5, 2))
    weight[2, 0] = 0.0
    made = motion(np.arange(5.0), weight=weight)
    found = made.at(jnp.array([-0.1, 0.0, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 4.1])).weight
    np.testing.assert_array_equal(found[:, 0], [0, 1, 1, 0, 0, 0, 1, 1, 0])
    np.testing.assert_array_equal(found[:, 1], [0, 1, 1, 1, 1, 1, 1, 1, 0])
    outside = made.at(jnp.array([-3.0, 9.0]))
    np.testing.assert_allclose(outside.q, made.q[jnp.array([0, 4])], rtol=1e-15)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_states_that_delayed_efforts_belong_to(dtype):
    ts = np.linspace(0.0, 4.0, 401)
    made = motion(ts, dtype)
    delayed = jax.jit(Motion.delayed)(made, 0.0123)
    assert all(array.dtype == dtype for array in jax.tree.leaves(delayed))
    inner = slice(2, None)
    np.testing.assert_allclose(delayed.q[inner], signal(ts - 0.0123)[inner], atol=1e-7 if dtype == np.float64 else 1e-5)
    np.testing.assert_array_equal(delayed.effort, made.effort)
    np.testing.assert_array_equal(delayed.ts, made.ts)
    np.testing.assert_array_equal(delayed.weight[:3], [[0, 0], [0, 0], [1, 1]])
    np.testing.assert_array_equal(made.delayed(-0.0123).weight[-3:], [[1, 1], [0, 0], [0, 0]])


def test_derivative_with_respect_to_the_delay():
    ts = np.linspace(0.0, 4.0, 401)
    made = motion(ts)
    for delay in (0.0, 0.0123):
        rates = jax.jacfwd(lambda d: made.delayed(d).q)(delay)
        backward = jax.jacrev(lambda d: made.delayed(d).q)(delay)
        np.testing.assert_allclose(rates, backward, rtol=1e-12, atol=1e-12)
        inner = slice(2, None) if delay else slice(None)
        np.testing.assert_allclose(rates[inner], -signal(ts - delay, 1)[inner], atol=1e-5)
    by_q = jax.jacrev(lambda q: Motion(made.ts, q, made.u, made.u_dot, made.effort).at(jnp.array([0.5]))[0:1].q[0, 0])(made.q)
    np.testing.assert_allclose(by_q[:, 0].sum(), 1.0, rtol=1e-12)


def test_split_keeps_the_end_of_each_motion():
    first, second = motion(np.linspace(0.0, 4.0, 401), name="first"), motion(np.array([0.0, 1.0, 2.0, 9.0, 9.5, 10.0]))
    fitted, kept = split([first, second])
    assert [len(x) for x in fitted] == [300, 3]
    assert [len(x) for x in kept] == [101, 3]
    assert kept[0].name == fitted[0].name == "first"
    np.testing.assert_array_equal(jnp.concatenate((fitted[0].q, kept[0].q)), first.q)
    for fraction in (0.0, 1.0):
        with pytest.raises(ValueError, match=rf"validation is {fraction}; it must be between 0 and 1"):
            split([first], fraction)
    with pytest.raises(ValueError, match=r"motion 'motion' has 6 samples, too few to keep a part of 0.01 for validation"):
        split([second], 0.01)


def test_bad_motions_are_refused():
    ts, q = np.arange(3.0), np.zeros((3, 2))
    with pytest.raises(ValueError, match=r"motion 'motion': ts has shape \(0,\), but needs \(n,\) with n of at least 1"):
        Motion(ts[:0], q[:0], q[:0], q[:0], q[:0])
    with pytest.raises(ValueError, match=r"effort has shape \(2, 2\), but needs \(3, nv\), and u has \(3, 2\)"):
        Motion(ts, q, q, q, q[:2])
    with pytest.raises(ValueError, match=r"u_dot has shape \(3, 1\), but needs \(3, nv\)"):
        Motion(ts, q, q, q[:, :1], q)
    with pytest.raises(ValueError, match=r"motion 'slow': ts must be strictly increasing"):
        Motion(np.array([0.0, 1.0, 1.0]), q, q, q, q, name="slow")
    ball = Motion(ts, np.zeros((3, 4)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"cannot be interpolated: q has shape \(3, 4\) and u \(3, 3\): u is not q's rate"):
        ball.at(ball.ts)
    with pytest.raises(ValueError, match=r"motion 'motion' cannot be interpolated: it has one sample"):
        motion(np.arange(3.0))[:1].at(ball.ts)
