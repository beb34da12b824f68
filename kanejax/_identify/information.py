"""How well data determine what was fitted: the covariance of base parameters, whatever the correlation of the errors.

Errors of real signals are not independent from sample to sample, and intervals that say they are come out far too narrow. The
estimate's covariance is A^-1 M A^-1 with the information A = J^T J of the scaled regressor and M = J^T C J for the errors'
covariance C (White 1980). Errors are taken as stationary: then C is their cross-spectral density S(f), and with
J(f) the discrete Fourier transform of a block of rows, M is the sum over blocks and frequencies of J(f)^H S(f) J(f). The density
is the mean over the blocks' residuals (Welch 1967). Residuals are smaller than errors by what the fit has taken up: they are
divided by one less the leverage of their signal at each frequency, which errs on the safe side (MacKinnon and White 1985, HC3).
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Complex, Float

from kanejax._identify.base_parameters import BaseParameters
from kanejax._identify.linear_estimate import UNEXCITED
from kanejax._identify.linearization import Samples, linearization, predicted_with_derivative
from kanejax._identify.parameterization import Parameterization

# Fewest and most samples of a block.
_SHORTEST, _LONGEST = 32, 2048


class Spectrum(NamedTuple):
    """Power spectral density of the errors of each signal, one-sided: frequencies (m,) [Hz] and densities (m, nv)."""

    frequency: Float[np.ndarray, " m"]
    density: Float[np.ndarray, "m nv"]


class Information(NamedTuple):
    """What the data say about the base parameters.

    Attributes:
        covariance: of the base parameters, (nbase, nbase).
        white: the same, if errors were independent of each other.
        condition_number: of the scaled regressor's columns, each divided by its length.
        spectrum: of the errors.
        weak: combinations of base parameters that the data hardly excite, one a row, each with its largest share first.
    """

    covariance: Float[np.ndarray, "nbase nbase"]
    white: Float[np.ndarray, "nbase nbase"]
    condition_number: float
    spectrum: Spectrum
    weak: tuple[dict[int, float], ...]


def information(
    parameterization: Parameterization,
    phi: Float[Array, " n"],
    sigma: Float[Array, " nv"],
    base: BaseParameters,
    runs: Sequence[Samples],
    errors: Sequence[Float[Array, "samples nv"]],
    period: float,
) -> Information:
    """Information on base parameters from runs with uniform time stamps.

    Args:
        parameterization: what was fitted.
        phi: its values.
        sigma: standard deviations by which the signals were weighted.
        base: the base parameters.
        runs: samples of each run, in the order of time.
        errors: measured less predicted signals of each run.
        period: of sampling [s].
    """
    count = sum(len(run.q) for run in runs)
    length = _block_length(count, min(len(run.q) for run in runs))
    blocks = jax.tree.map(lambda *x: jnp.concatenate(x), *[_blocks(run, length) for run in runs])
    scaled = jnp.concatenate([_cut(error / sigma[None], length) for error in errors])
    chosen = jnp.asarray(base.independent)
    density = _cross_density(scaled)
    gram = _gram(parameterization, phi, sigma, chosen, blocks)
    inverse, condition, weak = inverted(np.asarray(gram, float))
    leverage = _leverage(parameterization, phi, sigma, chosen, blocks, jnp.asarray(inverse, phi.dtype))
    # Where a signal's errors are nearly all taken up, there is nothing to give them back from.
    left = jnp.clip(1.0 - leverage, 0.1, 1.0).astype(density.dtype)
    density = density / left[:, :, None] / left[:, None, :]
    middle = np.asarray(_middle(parameterization, phi, sigma, chosen, blocks, density), float)
    covariance = inverse @ middle @ inverse
    frequency = np.fft.rfftfreq(length, period)
    one_sided = 2.0 * period * np.asarray(jnp.real(jnp.diagonal(density, axis1=1, axis2=2)) * sigma[None] ** 2)
    return Information(covariance, inverse, condition, Spectrum(frequency, one_sided), weak)


def _block_length(count: int, shortest_run: int) -> int:
    wanted = 2 ** round(np.log2(4.0 * np.sqrt(count)))
    return int(min(max(wanted, _SHORTEST), _LONGEST, shortest_run))


def _cut(x: jax.Array, length: int) -> jax.Array:
    """Whole blocks of rows, (blocks, length, ...); what is left at the end stays out."""
    whole = len(x) // length * length
    return x[:whole].reshape(-1, length, *x.shape[1:])


def _blocks(run: Samples, length: int) -> Samples:
    """All samples in blocks, the last filled up with copies that do not count."""
    spare = -len(run.q) % length
    full = jax.tree.map(lambda x: jnp.concatenate((x, jnp.broadcast_to(x[-1:], (spare, *x.shape[1:])))), run)
    full = full._replace(weight=full.weight.at[len(run.q) :].set(0.0))
    return jax.tree.map(lambda x: _cut(x, length), full)


@jax.jit
def _cross_density(errors: Float[Array, "blocks length nv"]) -> Complex[Array, "frequencies nv nv"]:
    """Covariance of the blocks' Fourier transforms; the identity for independent errors of size one."""
    length = errors.shape[1]
    taper = jnp.asarray(np.sqrt(8.0 / 3.0) * np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2, errors.dtype)
    halves = errors.reshape(-1, errors.shape[-1])
    between = halves[length // 2 : length // 2 + (len(errors) - 1) * length].reshape(-1, length, errors.shape[-1])
    waves = jnp.fft.rfft(jnp.concatenate((errors, between)) * taper[None, :, None], axis=1) / np.sqrt(length).item()
    return jnp.einsum("bfi,bfj->fij", waves, jnp.conj(waves)) / len(waves)


def _rows(parameterization: Parameterization, at: object, sigma: jax.Array, chosen: jax.Array, block: Samples) -> jax.Array:
    """Scaled regressor of the base parameters over one block, (length, nv, nbase)."""
    delay = parameterization.names.index("delay") if "delay" in parameterization.names else None
    tree = parameterization.tree
    derivative = jax.vmap(lambda sample: predicted_with_derivative(tree, at, sample, delay)[1])(block)  # type: ignore[arg-type]
    counts = (block.weight > 0)[..., None]
    return jnp.where(counts, derivative[..., chosen] / sigma[None, :, None], 0.0)


@jax.jit
def _gram(parameterization: Parameterization, phi: jax.Array, sigma: jax.Array, chosen: jax.Array, blocks: Samples) -> jax.Array:
    """Products of the regressor's columns."""
    at = linearization(parameterization, phi)

    def take_up(total: jax.Array, block: Samples) -> tuple[jax.Array, None]:
        rows = _rows(parameterization, at, sigma, chosen, block)
        return total + jnp.einsum("cri,crj->ij", rows, rows, precision="highest"), None

    return lax.scan(take_up, jnp.zeros((len(chosen), len(chosen)), phi.dtype), blocks)[0]


@jax.jit
def _leverage(
    parameterization: Parameterization, phi: jax.Array, sigma: jax.Array, chosen: jax.Array, blocks: Samples, inverse: jax.Array
) -> Float[Array, "frequencies nv"]:
    """The share of each signal's errors, at each frequency, that the fit takes up."""
    at = linearization(parameterization, phi)

    def take_up(total: jax.Array, block: Samples) -> tuple[jax.Array, None]:
        waves = jnp.fft.rfft(_rows(parameterization, at, sigma, chosen, block), axis=0)
        share = jnp.einsum("fji,ik,fjk->fj", jnp.conj(waves), inverse.astype(waves.dtype), waves)
        return total + jnp.real(share) / len(block.q), None

    count, length = blocks.q.shape[:2]
    zero = jnp.zeros((length // 2 + 1, parameterization.tree.nv), phi.dtype)
    return lax.scan(take_up, zero, blocks)[0] / count


@jax.jit
def _middle(
    parameterization: Parameterization, phi: jax.Array, sigma: jax.Array, chosen: jax.Array, blocks: Samples, density: jax.Array
) -> Float[Array, "nbase nbase"]:
    """Covariance of what the errors do to the gradient."""
    at = linearization(parameterization, phi)
    length = blocks.q.shape[1]
    # A real signal's other half of the frequencies is the conjugate of this one.
    twice = jnp.full(length // 2 + 1, 2.0, phi.dtype).at[0].set(1.0)
    twice = twice.at[-1].set(1.0) if length % 2 == 0 else twice

    def take_up(total: jax.Array, block: Samples) -> tuple[jax.Array, None]:
        waves = jnp.fft.rfft(_rows(parameterization, at, sigma, chosen, block), axis=0)
        weighted = jnp.einsum("fij,fjk->fik", density, waves) * (twice / length)[:, None, None].astype(waves.dtype)
        return total + jnp.real(jnp.einsum("fik,fil->kl", jnp.conj(waves), weighted)), None

    return lax.scan(take_up, jnp.zeros((len(chosen), len(chosen)), phi.dtype), blocks)[0]


def inverted(gram: np.ndarray) -> tuple[np.ndarray, float, tuple[dict[int, float], ...]]:
    """Inverse of the information, the condition number, and the combinations that hardly count."""
    if not len(gram):
        return np.zeros((0, 0)), 1.0, ()
    lengths = np.sqrt(np.diag(gram))
    scale = np.where(lengths > 0, lengths, 1.0)
    values, vectors = np.linalg.eigh(gram / scale[:, None] / scale[None, :])
    kept = values > UNEXCITED**2 * values[-1]
    weak = tuple(_shares(column / scale) for column in vectors[:, ~kept].T)
    turned = vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None]
    return turned @ turned.T, float(np.sqrt(values[-1] / max(values[0], 1e-32 * values[-1]))), weak


def _shares(row: np.ndarray) -> dict[int, float]:
    order = [int(i) for i in np.argsort(-np.abs(row)) if abs(row[i]) > 0.1 * np.abs(row).max()]
    return {i: float(row[i]) for i in order}
