"""How well data determine what was fitted: the covariance of base parameters, whatever the correlation of the errors.

Errors of real signals are not independent from sample to sample, and intervals that say they are come out far too narrow. The
estimate's covariance is A^-1 M A^-1 with the information A = J^T J of the scaled regressor and M = J^T C J for the errors'
covariance C (White 1980). Errors are taken as stationary: then C is their cross-spectral density S(f), and with
J(f) the discrete Fourier transform of a block of rows, M is the sum over blocks and frequencies of J(f)^H S(f) J(f). The density
is the mean over the blocks' residuals (Welch 1967). Residuals are smaller than errors by what the fit has taken up: their density
is divided by one less the leverage of each signal at each frequency (MacKinnon and White 1985, HC2).
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Complex, Float

from kanejax._identify.base_parameters import BaseParameters
from kanejax._identify.compress import HUBER
from kanejax._identify.linear_estimate import UNEXCITED, scaled_gram
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
        weak: changes of base parameters that change no signal, each with its largest first and at 1.
        unexcited: base parameters that take part in such a change.
    """

    covariance: Float[np.ndarray, "nbase nbase"]
    white: Float[np.ndarray, "nbase nbase"]
    condition_number: float
    spectrum: Spectrum
    weak: tuple[dict[int, float], ...]
    unexcited: Bool[np.ndarray, " nbase"]


def information(
    parameterization: Parameterization,
    phi: Float[Array, " n"],
    sigma: Float[Array, " nv"],
    base: BaseParameters,
    runs: Sequence[Samples],
    errors: Sequence[Float[Array, "_ nv"]],
    period: float,
    robust: bool = False,
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
        robust: whether errors far out counted less, by Huber's function (Huber 1964): they then enter as what it cuts them to, and
            add nothing to the information.
    """
    length = _block_length(sum(len(run.q) for run in runs), max(len(run.q) for run in runs))
    blocks = jax.tree.map(lambda *x: jnp.concatenate(x), *[_blocks(run, length) for run in runs])
    cut = [jnp.clip(error / sigma[None], -HUBER, HUBER) if robust else error / sigma[None] for error in errors]
    chosen = jnp.asarray(base.independent)
    density, share = _cross_density(cut, [run.weight for run in runs], length)
    inner = blocks
    if robust:
        inside = [
            _blocks(run._replace(weight=jnp.where(jnp.abs(x) < HUBER, run.weight, 0.0)), length)
            for run, x in zip(runs, cut, strict=True)
        ]
        inner = jax.tree.map(lambda *x: jnp.concatenate(x), *inside)
    inverse, condition, weak, unexcited = inverted(np.asarray(_gram(parameterization, phi, sigma, chosen, inner), float))
    leverage = _leverage(parameterization, phi, sigma, chosen, blocks, jnp.asarray(inverse, phi.dtype)) / share[None]
    # Where a signal's errors are nearly all taken up, there is nothing to give them back from.
    left = jnp.sqrt(jnp.clip(1.0 - leverage, 0.1, 1.0)).astype(density.dtype)
    density = density / left[:, :, None] / left[:, None, :]
    middle = np.asarray(_middle(parameterization, phi, sigma, chosen, blocks, density), float)
    covariance = inverse @ middle @ inverse
    frequency = np.fft.rfftfreq(length, period)
    one_sided = 2.0 * period * np.asarray(jnp.real(jnp.diagonal(density, axis1=1, axis2=2)) * sigma[None] ** 2)
    return Information(covariance, inverse, condition, Spectrum(frequency, one_sided), weak, unexcited)


def _block_length(count: int, longest_run: int) -> int:
    wanted = 2 ** round(np.log2(4.0 * np.sqrt(count)))
    return int(min(max(wanted, _SHORTEST), _LONGEST, longest_run))


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


def _cross_density(
    errors: Sequence[jax.Array], weights: Sequence[jax.Array], length: int
) -> tuple[Complex[Array, "frequencies nv nv"], Float[Array, " nv"]]:
    """Covariance of the blocks' Fourier transforms, the identity for independent errors of size one; and the share that counts.

    Blocks overlap by half. Errors that do not count are zeros, for which the covariance is corrected.
    """
    both = [jnp.concatenate([_cut(x[start:], length) for x in parts for start in (0, length // 2)]) for parts in (errors, weights)]
    blocks, counts = both[0], (both[1] > 0).astype(both[0].dtype)
    taper = jnp.asarray(np.sqrt(8.0 / 3.0) * np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2, blocks.dtype)
    waves = jnp.fft.rfft(blocks * taper[None, :, None], axis=1) / np.sqrt(length).item()
    density = jnp.einsum("bfi,bfj->fij", waves, jnp.conj(waves)) / len(waves)
    shares = jnp.einsum("bti,btj->ij", counts, counts) / (len(blocks) * length)
    least = 1.0 / (len(blocks) * length)
    density = jnp.where(shares[None] > 0, density / jnp.maximum(shares, least)[None].astype(density.dtype), 0.0)
    return density, jnp.maximum(jnp.diagonal(shares), least)


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


def inverted(gram: np.ndarray) -> tuple[np.ndarray, float, tuple[dict[int, float], ...], np.ndarray]:
    """Inverse of the information, the condition number, changes that change no signal, and what takes part in them."""
    if not len(gram):
        return np.zeros((0, 0)), 1.0, (), np.zeros(0, bool)
    scaled, length = scaled_gram(gram)
    values, vectors = np.linalg.eigh(scaled)
    kept = values > UNEXCITED**2 * values[-1]
    loose = vectors[:, ~kept]
    turned = vectors[:, kept] / np.sqrt(values[kept]) / length[:, None]
    scale = np.where(np.isfinite(length), length, 1.0)
    weak = tuple(_shares(column, scale) for column in loose.T)
    condition = float(np.sqrt(values[-1] / max(values[0], 1e-32 * values[-1], 1e-300)))
    return turned @ turned.T, condition, weak, np.sum(loose**2, 1) > 1e-6


def _shares(column: np.ndarray, scale: np.ndarray) -> dict[int, float]:
    """A change of unit columns as one of the parameters themselves."""
    order = [int(i) for i in np.argsort(-np.abs(column)) if abs(column[i]) > 1e-3]
    changes = column / scale
    return {i: float(changes[i] / changes[order[0]]) for i in order}
