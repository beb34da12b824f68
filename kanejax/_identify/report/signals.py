"""The signals of a plant, one for each generalized speed: their names, units, and how well they are predicted."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kanejax._identify.result import Comparison, Identification
from kanejax._parameters.leaves import elements

Vector = Float[np.ndarray, " n"]


class Errors(NamedTuple):
    """Errors of the predictions of all samples of some runs that count, for each signal; nan for those that do not count.

    Attributes:
        rms: root mean square of the measured signal.
        residual: root mean square of the residuals of the identified plant.
        relative: norm of these over the norm of the measured signal.
        nominal: the same of the nominal plant.
    """

    rms: Float[np.ndarray, " nv"]
    residual: Float[np.ndarray, " nv"]
    relative: Float[np.ndarray, " nv"]
    nominal: Float[np.ndarray, " nv"]


def signal_names(identification: Identification) -> tuple[str, ...]:
    """The joint of each signal; with the direction, where a joint has several speeds."""
    found = elements("damping", identification.plant.model.tree)
    return tuple(" ".join(filter(None, (element.owner, element.part))) for element in found)


def signal_units(identification: Identification) -> tuple[str, ...]:
    """N m or N where a signal is a force, "signal" where a gain other than one stands between them."""
    tree, gains = identification.plant.model.tree, np.asarray(identification.drives.gain)
    units = [element.units("offset")[0] for element in elements("damping", tree)]
    return tuple(unit if gain == 1.0 else "signal" for unit, gain in zip(units, gains, strict=True))


def signal_lines(comparison: Comparison, index: int) -> tuple[Vector, Vector, Vector]:
    """One signal of a run: as it was measured, nan where it does not count, and as both plants predict it."""
    measured = np.where(comparison.weight[:, index] > 0, comparison.measured[:, index], np.nan)
    return measured, comparison.predicted[:, index], comparison.nominal[:, index]


def errors(comparisons: Sequence[Comparison]) -> Errors:
    """Errors over all samples of all these runs."""
    measured, predicted, nominal, weight = (
        np.concatenate([getattr(comparison, field) for comparison in comparisons])
        for field in ("measured", "predicted", "nominal", "weight")
    )
    counts = weight > 0
    number = np.where(counts.any(axis=0), counts.sum(axis=0), np.nan)
    rms, residual, other = (
        np.sqrt(np.sum(np.square(np.where(counts, values, 0.0)), axis=0) / number)
        for values in (measured, measured - predicted, measured - nominal)
    )
    size = np.where(rms > 0, rms, np.nan)
    return Errors(rms, residual, residual / size, other / size)


def sample_count(comparisons: Sequence[Comparison]) -> int:
    """Samples of all these runs."""
    return sum(len(comparison.ts) for comparison in comparisons)


def duration(comparisons: Sequence[Comparison]) -> float:
    """Time [s] that all these runs take."""
    return float(sum(comparison.ts[-1] - comparison.ts[0] for comparison in comparisons if len(comparison.ts)))
