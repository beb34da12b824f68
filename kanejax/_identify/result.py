"""What an identification found, and how sure it is."""

import dataclasses
from typing import Literal, NamedTuple, final

import numpy as np
from jaxtyping import Array, Float

from kanejax._model.model import Model
from kanejax._parameters.parameterization import Parameterization
from kanejax._parameters.plant import Drives, Plant
from kanejax._regression.information import Spectrum

Determined = Literal["alone", "in combination", "not at all", "not by these data"]


class Estimate(NamedTuple):
    """One parameter: nominal and found value, and how sure it is.

    Where the data do not determine it alone, what they determine of it is a base parameter, and its standard deviation and interval
    are nan.

    Attributes:
        name: of the body, joint or motor, and of the parameter.
        unit: of the numbers.
        nominal: value as loaded.
        value: found.
        std: standard deviation.
        lower: lower end of the 95 % interval.
        upper: upper end of it.
        determined: whether motion determines it "alone", "in combination" with others, or "not at all"; "not by these data" where
            motion could, but this one does not.
    """

    name: str
    unit: str
    nominal: float
    value: float
    std: float
    lower: float
    upper: float
    determined: Determined


class BaseEstimates(NamedTuple):
    """Combinations of parameters that motion can tell apart, see `base_parameters`."""

    formulas: tuple[str, ...]
    nominal: Float[np.ndarray, " nbase"]
    value: Float[np.ndarray, " nbase"]
    std: Float[np.ndarray, " nbase"]
    correlation: Float[np.ndarray, "nbase nbase"]
    condition_number: float


class Stage(NamedTuple):
    """One stage of the identification: how it ended, its cost, and the size of its residuals.

    `rms` is of each signal's residuals, in a robust fit a standard deviation from their median; of the stage "simulation", of the
    coordinates' residuals.
    """

    name: str
    converged: bool
    message: str
    iterations: int
    cost: float
    rms: Float[np.ndarray, " nv"]


class Comparison(NamedTuple):
    """Measured signals of one run beside those that the identified and the nominal plant predict.

    Attributes:
        name: of the run.
        ts: times [s].
        measured: signals, in the unit of the motors' signals.
        predicted: by the identified plant.
        nominal: by the plant as it was loaded.
        weight: of each sample in the fit; 0 does not count.
    """

    name: str
    ts: Float[np.ndarray, " n"]
    measured: Float[np.ndarray, "n nv"]
    predicted: Float[np.ndarray, "n nv"]
    nominal: Float[np.ndarray, "n nv"]
    weight: Float[np.ndarray, "n nv"]


@final
@dataclasses.dataclass(frozen=True, eq=False)
class Identification:
    """What `identify` returns.

    Attributes:
        plant: the identified plant.
        nominal: the plant that the identification started from.
        parameterization: what was sought.
        phi: values of all parameters, in the order of `estimates`.
        estimates: each parameter, with what the data say about it.
        base: the combinations that the data can tell apart.
        sentences: what the data do not determine, and what else one should know before trusting the numbers.
        stages: how each stage ended.
        training: measured and predicted signals of the runs that were fitted.
        validation: the same of runs that were held out.
        noise: power spectral density of the training residuals.
        consistency: smallest eigenvalue of each body's pseudo-inertia over its trace: positive for what a rigid body can have.
    """

    plant: Plant
    nominal: Plant
    parameterization: Parameterization
    phi: Float[Array, " n"]
    estimates: tuple[Estimate, ...]
    base: BaseEstimates
    sentences: tuple[str, ...]
    stages: tuple[Stage, ...]
    training: tuple[Comparison, ...]
    validation: tuple[Comparison, ...]
    noise: Spectrum
    consistency: Float[np.ndarray, " nbody"]

    @property
    def model(self) -> Model:
        """The identified model."""
        return self.plant.model

    @property
    def drives(self) -> Drives:
        """The identified drives."""
        return self.plant.drives

    @property
    def converged(self) -> bool:
        """Whether every stage converged."""
        return all(stage.converged for stage in self.stages)

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of a parameter, by name."""
        from kanejax._errors import UnknownNameError

        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise UnknownNameError("identified parameter", name, (estimate.name for estimate in self.estimates))


def relative_error(comparison: Comparison, predicted: Float[np.ndarray, "n nv"] | None = None) -> Float[np.ndarray, " nv"]:
    """Norm of the residuals over the norm of the measured signal, for each signal; nan for signals that do not count.

    Args:
        comparison: of one run.
        predicted: signals to compare instead of those of the identified plant.

    Returns:
        One number a signal.
    """
    predicted = comparison.predicted if predicted is None else predicted
    counts = comparison.weight > 0
    left = np.linalg.norm(np.where(counts, comparison.measured - predicted, 0.0), axis=0)
    size = np.linalg.norm(np.where(counts, comparison.measured, 0.0), axis=0)
    return np.where(size > 0, left / np.where(size > 0, size, 1.0), np.nan)
