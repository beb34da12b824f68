"""Scalar form: folding of known numbers, and the sine and cosine pair."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kanejax import _scalar as scalar


def test_known_zeros_and_ones_are_folded():
    x = jnp.asarray(3.0)
    assert scalar.mul(0.0, x) == 0.0
    assert isinstance(scalar.mul(0.0, x), float)
    assert scalar.mul(1.0, x) is x
    assert scalar.add(0.0, x) is x
    assert scalar.sub(x, 0.0) is x
    assert scalar.cross((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)) == (0.0, 0.0, 1.0)
    program = jax.make_jaxpr(lambda a, b, c: scalar.apply(scalar.IDENTITY, (a, b, c)))(x, x, x)
    assert not program.eqns


@pytest.mark.parametrize(("dtype", "limit", "tolerance"), [("float64", 1e6, 2.5e-16), ("float32", 1e4, 1.3e-7)])
def test_sincos_is_accurate_to_rounding(dtype, limit, tolerance):
    near = np.linspace(-30, 30, 100_001)
    far = np.random.default_rng(0).uniform(-limit, limit, 100_000) * 0.99
    x = np.concatenate((near, far, [0.0, -0.0, np.pi / 4, np.pi / 2, np.pi])).astype(dtype)
    s, c = jax.jit(scalar.sincos)(jnp.asarray(x))
    exact = x.astype(np.longdouble)
    assert s.dtype == dtype
    assert np.abs(np.asarray(s, np.longdouble) - np.sin(exact)).max() <= tolerance
    assert np.abs(np.asarray(c, np.longdouble) - np.cos(exact)).max() <= tolerance


@pytest.mark.parametrize("value", [1e7, 1e15, -1e300, np.inf, np.nan])
def test_sincos_of_huge_arguments_is_the_library_s(value):
    x = jnp.asarray([value, 0.5])
    s, c = jax.jit(scalar.sincos)(x)
    np.testing.assert_array_equal(s, jnp.sin(x))
    np.testing.assert_array_equal(c, jnp.cos(x))


def test_sincos_has_derivatives_of_every_order():
    x = jnp.asarray(0.7)
    third = jax.grad(jax.grad(jax.grad(lambda x: scalar.sincos(x)[0])))(x)
    assert float(abs(third + jnp.cos(x))) < 1e-15
    assert float(abs(jax.jacfwd(lambda x: scalar.sincos(x)[1])(x) + jnp.sin(x))) < 1e-15
