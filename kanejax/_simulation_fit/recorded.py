"""Motions of several runs as arrays one after another, with what is known of their errors."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from kanejax._errors import UnknownNameError
from kanejax._logs.motion import Motion
from kanejax._model.tree import Tree
from kanejax._simulation_fit.shooting import Measured


class Recorded(NamedTuple):
    """What was recorded.

    Attributes:
        times: [s] of the samples of each run.
        measured: samples of all runs.
        states: coordinates and speeds to start from.
        sigma: standard deviations of the outputs' errors, given or guessed.
        is_given: which of them are.
        count: number of samples that count, of each output.
        size: root mean square of each output.
    """

    times: tuple[Float[np.ndarray, " _"], ...]
    measured: Measured
    states: Float[np.ndarray, "n nx"]
    sigma: Float[Array, "noutput nv"]
    is_given: Bool[np.ndarray, "noutput nv"]
    count: Float[np.ndarray, "noutput nv"]
    size: Float[np.ndarray, "noutput nv"]

    @property
    def lengths(self) -> tuple[int, ...]:
        """Number of samples of each run."""
        return tuple(len(ts) for ts in self.times)

    @property
    def least(self) -> Float[np.ndarray, "noutput nv"]:
        """Size of the rounding errors of each output."""
        return float(jnp.finfo(self.sigma.dtype).eps) ** 0.75 * self.size

    def rounding(self, sigma: jax.Array) -> float:
        """Sum of squared residuals that are rounding errors."""
        return float(np.sum(self.count * (self.least / np.asarray(sigma, float)) ** 2))


def recorded(tree: Tree, motions: Sequence[Motion], outputs: tuple[str, ...], sigma: Mapping[str, Any], dtype: Any) -> Recorded:
    """Put motions one after another.

    Raises:
        ValueError: a motion does not fit the model, or a number that the simulation needs is not finite.
        UnknownNameError: sigma names what is no output.
    """
    if not motions:
        raise ValueError("there is no motion to fit")
    for name in sigma:
        if name not in outputs:
            raise UnknownNameError("output with a standard deviation", name, outputs)
    runs = [_checked(tree, motion, drives="effort" not in outputs) for motion in motions]
    columns = {name: np.concatenate([run[name] for run in runs]) for name in ("q", "u", "effort", "weight")}
    weight = columns["weight"]
    # What does not count may be no number, which must not get into sums.
    stacked = np.where(weight[:, None] > 0, np.stack([columns[name] for name in outputs], 1), 0.0)
    count = np.repeat(np.sum(weight, 0)[None], len(outputs), 0)
    total = np.maximum(np.sum(weight[:, None] * stacked**2, 0), 0.0)
    size = np.sqrt(total / np.maximum(count, 1.0))
    size = np.where(size > 0, size, 1.0)
    guess = np.maximum(
        np.stack([_errors([run[name] for run in runs], [run["weight"] for run in runs]) for name in outputs]), 1e-6 * size
    )
    is_given = np.zeros(guess.shape, bool)
    for name, value in sigma.items():
        guess[outputs.index(name)], is_given[outputs.index(name)] = _checked_sigma(name, value, tree.nv), True
    effort = np.where(weight > 0, columns["effort"], 0.0) if "effort" in outputs else columns["effort"]
    measured = Measured(*(jnp.asarray(x, dtype) for x in (np.concatenate([run["ts"] for run in runs]), stacked, effort, weight)))
    states = np.concatenate((columns["q"], columns["u"]), 1)
    return Recorded(tuple(run["ts"] for run in runs), measured, states, jnp.asarray(guess, dtype), is_given, count, size)


def _checked(tree: Tree, motion: Motion, drives: bool) -> dict[str, np.ndarray]:
    run = {name: np.asarray(getattr(motion, name), float) for name in ("ts", "q", "u", "effort", "weight")}
    if run["u"].shape[1] != tree.nv:
        raise ValueError(f"motion {motion.name!r} has {run['u'].shape[1]} joints, but the model has {tree.nv}")
    for name in ("q", "u", "effort") if drives else ("q", "u"):
        if not np.all(np.isfinite(run[name])):
            sample, joint = np.argwhere(~np.isfinite(run[name]))[0]
            where = f"{name} of joint {tree.joint_names[joint]!r} at {run['ts'][sample]:.6g} s"
            raise ValueError(f"motion {motion.name!r}: {where} is not finite, but the simulation needs it, whatever its weight")
    return run


def _checked_sigma(name: str, value: Any, nv: int) -> np.ndarray:
    array = np.asarray(value, float)
    if array.shape not in ((), (nv,)) or not np.all(np.isfinite(array) & (array > 0)):
        raise ValueError(f"sigma of {name} is {value}; it must be a positive number, or one for each of the {nv} speeds")
    return np.broadcast_to(array, nv)


def _errors(runs: Sequence[np.ndarray], weights: Sequence[np.ndarray]) -> np.ndarray:
    """Standard deviation of the errors of each channel, from the median size of second differences."""
    bends, counts = (np.concatenate(x) for x in zip(*(_bends(x, w) for x, w in zip(runs, weights, strict=True)), strict=True))
    sizes = [np.median(np.abs(bend[count])) if np.any(count) else 0.0 for bend, count in zip(bends.T, counts.T, strict=True)]
    return 1.4826 * np.array(sizes) / np.sqrt(6.0)


def _bends(x: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    counts = weight > 0
    return x[2:] - 2.0 * x[1:-1] + x[:-2], counts[2:] & counts[1:-1] & counts[:-2]
