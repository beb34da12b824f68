"""Riccati's recursion against the same equations solved as one matrix."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kanejax._optimal_control.products import product
from kanejax._optimal_control.riccati import Quadratic, Slopes, minimizer
from tests.helpers.mechanisms import relative

N, NX, NW = 6, 3, 2


def problem(seed, least=0.1):
    """Curvature is positive where states obey the stages, though not everywhere."""
    rng = np.random.default_rng(seed)
    hessian = rng.normal(size=(N, NX + NW, NX + NW))
    hessian = np.einsum("kij,klj->kil", hessian, hessian)
    hessian[:, :NX, :NX] -= least * np.eye(NX)
    quadratic = Quadratic(*map(jnp.asarray, (hessian, np.eye(NX), 0.5 * rng.normal(size=(N, NX, NX + NW)))))
    return quadratic, Slopes(*map(jnp.asarray, (rng.normal(size=(N, NX + NW)), rng.normal(size=NX), rng.normal(size=(N, NX)))))


def dense(quadratic, slopes):
    """All conditions of optimality at once: unknowns are x0, w0, x1, ..., xN, and the multipliers of each stage."""
    size, width = N * (NX + NW) + NX, NX + NW
    hessian, gradient = np.zeros((size, size)), np.zeros(size)
    constraint, gap = np.zeros((N * NX, size)), np.asarray(slopes.gap).ravel()
    for k in range(N):
        here = slice(k * width, (k + 1) * width)
        hessian[here, here] = quadratic.hessian[k]
        gradient[here] = slopes.stage[k]
        rows = slice(k * NX, (k + 1) * NX)
        constraint[rows, here] = quadratic.next[k]
        constraint[rows, (k + 1) * width : (k + 1) * width + NX] = -np.eye(NX)
    hessian[-NX:, -NX:], gradient[-NX:] = quadratic.final, slopes.final
    whole = np.block([[hessian, constraint.T], [constraint, np.zeros((N * NX, N * NX))]])
    found = np.linalg.solve(whole, -np.concatenate((gradient, gap)))
    nodes = np.concatenate((found[: N * width].reshape(N, width)[:, :NX], found[None, N * width : size]))
    null = np.linalg.svd(constraint)[2][N * NX :]
    return (
        nodes,
        found[: N * width].reshape(N, width)[:, NX:],
        found[size:].reshape(N, NX),
        np.linalg.eigvalsh(null @ hessian @ null.T),
    )


def test_same_as_one_matrix():
    step = jax.jit(minimizer)(*problem(0))
    x, w, multiplier, curvature = dense(*problem(0))
    assert curvature[0] > 0
    assert bool(step.is_minimum)
    assert relative(step.x, x) < 1e-10
    assert relative(step.w, w) < 1e-10
    assert relative(step.multiplier, multiplier) < 1e-10


def test_extra_curvature_is_that_of_all_directions():
    quadratic, slopes = problem(2)
    more = 0.7 * jnp.eye(NX + NW)
    direct = jax.jit(minimizer)(
        quadratic._replace(hessian=quadratic.hessian + more[None], final=quadratic.final + more[:NX, :NX]), slopes
    )
    for given, expected in zip(jax.jit(minimizer)(quadratic, slopes, 0.7), direct, strict=True):
        assert relative(given, expected) < 1e-12


@pytest.mark.parametrize("size", [0, 1, 24, 25])
@pytest.mark.parametrize("shape", [(), (3,)])
def test_products_of_all_sizes(size, shape):
    rng = np.random.default_rng(size)
    a, b = rng.normal(size=(5, size)), rng.normal(size=(size, *shape))
    np.testing.assert_allclose(product(jnp.asarray(a), jnp.asarray(b)), a @ b, rtol=0, atol=1e-14 * max(size, 1))


def test_gains_are_how_controls_follow_states():
    quadratic, slopes = problem(1)
    start = jnp.array([0.3, -0.2, 0.5])

    def from_start(value):
        held = quadratic.hessian.at[0, :NX, :NX].add(1e12 * jnp.eye(NX))
        return jax.jit(minimizer)(
            quadratic._replace(hessian=held), slopes._replace(stage=slopes.stage.at[0, :NX].add(-1e12 * value))
        )

    here, there = from_start(jnp.zeros(NX)), from_start(start)
    expected = jnp.einsum("kwx,kx->kw", here.gains, there.x[:-1] - here.x[:-1])
    assert relative(there.w - here.w, expected) < 1e-8


@pytest.mark.parametrize("seed", range(6))
def test_says_where_there_is_no_minimum(seed):
    quadratic, slopes = problem(seed, least=3.0 * seed)
    curvature = dense(quadratic, slopes)[-1]
    assert bool(jax.jit(minimizer)(quadratic, slopes).is_minimum) == (curvature[0] > 0)
