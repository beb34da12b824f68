"""AUTOQ: coordinates recovered from torques, and the orders of the schemes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.thesis import autoq
from experiments.thesis.autotf import torques
from experiments.thesis.motion import motions


@pytest.fixture(scope="module")
def table():
    return autoq.table()


def test_table_is_exact_at_the_times_of_the_steps_and_nearly_between(table):
    h = autoq.TABLE_STEP
    # All steps are powers of two, no shorter than two intervals of the table.
    shortest = min(autoq.RECOVERED.values())
    assert shortest >= 2 * h
    assert np.log2(shortest / h) % 1 == 0
    for name in ("explicit", "implicit", "crank_nelson", "implicit_three_point", "crank_nelson_three_point"):
        assert np.all(np.log2(autoq.step_sizes(autoq.SCHEMES[name]) / h) % 1 == 0)
    at, between = table.ts[::64], table.ts[:-1:64] + 0.3 * h
    np.testing.assert_allclose(jax.jit(jax.vmap(table))(at), table.values[::64], rtol=0, atol=1e-15)
    np.testing.assert_allclose(jax.jit(jax.vmap(table))(between), torques(between), rtol=0, atol=1e-12)


def test_runge_kutta_recovers_the_coordinates(table):
    ts = np.linspace(0.0, 2.0, 9)
    scheme = autoq.SCHEMES["tsitouras"]
    q = autoq.recovered(scheme.solver, autoq.RECOVERED["tsitouras"], ts, table)
    np.testing.assert_allclose(q, motions(jnp.asarray(ts)).q, rtol=0, atol=1e-6)


def test_deviations_grow(table):
    """Why low orders cannot recover the motion: seven orders of magnitude."""
    assert 1e7 < autoq.growth(table) < 4e7


@pytest.mark.parametrize("name", ["crank_nelson", "tsitouras"])
def test_orders(name, table):
    scheme = autoq.SCHEMES[name]
    order = autoq.fitted_order(scheme, autoq.window_errors(scheme, table))
    assert order == pytest.approx(scheme.order, abs=0.06)
