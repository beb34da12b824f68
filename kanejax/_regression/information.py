"""How well data determine what was fitted: the covariance of base parameters, whatever the correlation of the errors.

Errors of real signals are not independent from sample to sample, and intervals that say they are come out far too narrow. The
estimate's covariance is A^-1 M A^-1 with the information A = J^T J of the scaled regressor and M = J^T C J for the errors'
covariance C (White 1980). Errors are taken as stationary: then C is their cross-spectral density S(f), and with
J(f) the discrete Fourier transform of a block of rows, M is the sum over blocks and frequencies of J(f)^H S(f) J(f). The density
is the mean over the blocks' residuals (Welch 1967). Residuals are smaller than errors by what the fit has taken up: their density
is divided by one less the leverage of each signal at each frequency (MacKinnon and White 1985, HC2).
"""

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from kanejax._parameters.parameterization import Parameterization
from kanejax._regression.base_parameters import BaseParameters
from kanejax._regression.huber import HUBER
from kanejax._regression.linear_estimate import UNEXCITED, scaled_gram
from kanejax._regression.linearization import CHUNK, Samples, chunks, derivatives, linearization

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
    runs = [jax.tree.map(np.asarray, run) for run in runs]
    length = _block_length(sum(len(run.q) for run in runs), max(len(run.q) for run in runs))
    limit = HUBER if robust else np.inf
    scaled = [np.asarray(error / sigma[None]) for error in errors]
    inside = [run._replace(weight=np.where(np.abs(x) < limit, run.weight, 0.0)) for run, x in zip(runs, scaled, strict=True)]
    density, share = _cross_density([np.clip(x, -limit, limit) for x in scaled], [run.weight for run in runs], length)
    at, chosen = linearization(parameterization, phi), jnp.asarray(base.independent)

    def total(of_blocks: Callable[..., jax.Array], runs: Sequence[Samples], *given: Any) -> np.ndarray:
        """Sum over the blocks of what a function makes of the scaled regressor of the base parameters."""
        some = length * max(CHUNK // length, 1)
        pieces = itertools.chain.from_iterable(chunks(run, some) for run in runs)
        parts = (of_blocks(_scaled(derivatives(parameterization, at, x), x.weight, sigma, chosen, length), *given) for x in pieces)
        return np.asarray(sum(map(np.asarray, parts)), float)

    inverse, condition, weak, unexcited = inverted(total(_products, inside))
    count = sum(-(-len(run.q) // length) for run in runs)
    leverage = total(_leverage, runs, jnp.asarray(inverse, phi.dtype)) / (count * length * share)
    # Where a signal's errors are nearly all taken up, there is nothing to give them back from.
    left = np.sqrt(np.clip(1.0 - leverage, 0.1, 1.0))
    density = density / left[:, :, None] / left[:, None, :]
    middle = total(_middle, runs, density.astype(np.result_type(phi.dtype, np.complex64)), length)
    covariance = inverse @ middle @ inverse
    frequency = np.fft.rfftfreq(length, period)
    one_sided = 2.0 * period * np.real(np.diagonal(density, axis1=1, axis2=2)) * np.asarray(sigma) ** 2
    return Information(covariance, inverse, condition, Spectrum(frequency, one_sided), weak, unexcited)


def _block_length(count: int, longest_run: int) -> int:
    wanted = 2 ** round(np.log2(4.0 * np.sqrt(count)))
    return int(min(max(wanted, _SHORTEST), _LONGEST, longest_run))


def _cut(x: np.ndarray, length: int) -> np.ndarray:
    """Whole blocks of rows, (blocks, length, ...); what is left at the end stays out."""
    whole = len(x) // length * length
    return x[:whole].reshape(-1, length, *x.shape[1:])


def _cross_density(
    errors: Sequence[np.ndarray], weights: Sequence[np.ndarray], length: int
) -> tuple[Complex[np.ndarray, "frequencies nv nv"], Float[np.ndarray, " nv"]]:
    """Covariance of the blocks' Fourier transforms, the identity for independent errors of size one; and the share that counts.

    Blocks overlap by half. Errors that do not count are zeros, for which the covariance is corrected.
    """
    both = [np.concatenate([_cut(x[start:], length) for x in parts for start in (0, length // 2)]) for parts in (errors, weights)]
    blocks, counts = both[0].astype(float), (both[1] > 0).astype(float)
    taper = np.sqrt(8.0 / 3.0) * np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2
    waves = np.fft.rfft(blocks * taper[None, :, None], axis=1) / np.sqrt(length)
    density = np.einsum("bfi,bfj->fij", waves, np.conj(waves)) / len(waves)
    shares = np.einsum("bti,btj->ij", counts, counts) / (len(blocks) * length)
    least = 1.0 / (len(blocks) * length)
    return np.where(shares > 0, density / np.maximum(shares, least), 0.0), np.maximum(np.diagonal(shares), least)


@functools.partial(jax.jit, static_argnums=4)
def _scaled(derivative: jax.Array, weight: jax.Array, sigma: jax.Array, chosen: jax.Array, length: int) -> jax.Array:
    """Scaled regressor of the base parameters over some blocks, (blocks, length, nv, nbase)."""
    rows = jnp.where((weight > 0)[..., None], derivative[..., chosen] / sigma[None, :, None], 0.0)
    return rows.reshape(-1, length, *rows.shape[1:])


@jax.jit
def _products(rows: jax.Array) -> Float[Array, "nbase nbase"]:
    """Of the regressor's columns."""
    return jnp.einsum("bcri,bcrj->ij", rows, rows, precision="highest")


@jax.jit
def _leverage(rows: jax.Array, inverse: jax.Array) -> Float[Array, "frequencies nv"]:
    """What the fit takes up of each signal's errors, at each frequency."""
    waves = jnp.fft.rfft(rows, axis=1)
    return jnp.real(jnp.einsum("bfji,ik,bfjk->fj", jnp.conj(waves), inverse.astype(waves.dtype), waves))


@functools.partial(jax.jit, static_argnums=2)
def _middle(rows: jax.Array, density: jax.Array, length: int) -> Float[Array, "nbase nbase"]:
    """Covariance of what the errors do to the gradient."""
    # A real signal's other half of the frequencies is the conjugate of this one.
    twice = np.full(length // 2 + 1, 2.0)
    twice[0] = 1.0
    twice[-1] = 1.0 if length % 2 == 0 else 2.0
    waves = jnp.fft.rfft(rows, axis=1)
    weighted = jnp.einsum("fij,bfjk->bfik", density, waves) * jnp.asarray(twice / length, waves.dtype)[None, :, None, None]
    return jnp.real(jnp.einsum("bfik,bfil->kl", jnp.conj(waves), weighted))


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
