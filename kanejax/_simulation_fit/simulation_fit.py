"""What the simulation stage returns, and tells on the way."""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Array, Float


class Iteration(NamedTuple):
    """One iteration: which window length [s] it worked with, and where it ended.

    Attributes:
        window: length [s] of the windows, None for whole runs.
        iteration: from 1 on, through all windows.
        cost: that of `SimulationFit`, of the best start.
        gap: root of the sum of squares of the gaps between pieces [rad/s, m/s].
        damping: of the next step.
        accepted: whether the step was taken.
    """

    window: float | None
    iteration: int
    cost: float
    gap: float
    damping: float
    accepted: bool


class Prediction(NamedTuple):
    """Simulated motion at the samples of one run; `effort` is that of the control, None without."""

    ts: Float[np.ndarray, " n"]
    q: Float[np.ndarray, "n nq"]
    u: Float[np.ndarray, "n nv"]
    effort: Float[np.ndarray, "n nv"] | None


@final
@dataclasses.dataclass(frozen=True, eq=False)
class SimulationFit:
    """What the simulation stage found.

    Attributes:
        theta: free coordinates, (m,).
        phi: parameters, (n,).
        converged: whether it came to a minimum.
        message: the same in words.
        iterations: steps that were tried.
        cost: sum of squared residuals, each divided by its standard deviation, or of Huber's function of them; and of the priors.
        history: one entry an iteration.
        factor: upper triangle R, (n + 1, n + 1): with the change d of phi the sum of squared residuals is that of R [d, 1], and the
            initial states have been taken out. Without priors. Of a robust fit residuals far out weigh less in it, and all is
            scaled to the precision that the residuals' sizes show, also where standard deviations were given.
        count: number of residuals, less that of the initial states that were fitted to them.
        sigma: standard deviation of each output, (nv,) each.
        rms: root mean square of the residuals of each output, (nv,) each.
        predicted: simulated motion of each run.
        starts: cost that each start came to, infinite where the simulation came to nothing.
        agreeing: how many of the starts came to this cost, and of how many.
    """

    theta: Float[Array, " m"]
    phi: Float[Array, " n"]
    converged: bool
    message: str
    iterations: int
    cost: float
    history: tuple[Iteration, ...]
    factor: Float[Array, "n1 n1"]
    count: int
    sigma: Mapping[str, Float[np.ndarray, " nv"]]
    rms: Mapping[str, Float[np.ndarray, " nv"]]
    predicted: tuple[Prediction, ...]
    starts: Float[np.ndarray, " starts"]
    agreeing: tuple[int, int]


class FitInterrupted(KeyboardInterrupt):
    """A fit was interrupted; `fit` is the best that was found until then."""

    def __init__(self, fit: SimulationFit) -> None:
        """Keep the fit."""
        self.fit = fit
        super().__init__(f"interrupted after {fit.iterations} iterations; error.fit is the best so far")
