"""The best of the starts of the simulation stage: the sizes of its residuals, and the motion that it predicts."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from kanejax._parameters.parameterization import Parameterization
from kanejax._regression.huber import HUBER
from kanejax._simulation_fit.recorded import Recorded
from kanejax._simulation_fit.shooting import Linearization, Shooting
from kanejax._simulation_fit.simulation_fit import Prediction


class Best(NamedTuple):
    """Where the best start is.

    Attributes:
        shooting: how motion is simulated there.
        data: that it is compared with.
        sigma: standard deviations of the outputs, which weigh the residuals.
        theta: free coordinates.
        at: residuals and sensitivities.
    """

    shooting: Shooting
    data: Recorded
    sigma: Float[Array, "noutput nv"]
    theta: Float[Array, " m"]
    at: Linearization

    @property
    def fitted(self) -> int:
        """Number of unknowns that were fitted to the data."""
        pieces = self.shooting.pieces
        sought = ~np.append(False, np.asarray(pieces.joined)[:-1]) & ~np.asarray(self.shooting.given)
        return len(self.theta) + int(np.sum(sought)) * self.at.states.shape[-1]

    @property
    def sizes(self) -> Float[np.ndarray, "noutput nv"]:
        """Standard deviations of each output's errors."""
        count = self.data.count
        left = np.maximum(count * self._share_left, 1.0)
        if not self.shooting.robust:
            return np.sqrt(np.asarray(self.at.squares, float) / left)
        sizes = np.where(self._counting, np.asarray(self.at.sizes, float), np.nan)
        missing = np.isnan(sizes).all((0, 1))
        median = 1.4826 * np.nanmedian(np.where(missing, 0.0, sizes), (0, 1))
        return np.asarray(self.sigma, float) * median * np.sqrt(count / left)

    @property
    def precision(self) -> float:
        """What a robust fit's factor has to be multiplied by to be that of its covariance (Huber 1964); 1 for others."""
        if not self.shooting.robust:
            return 1.0
        sizes = np.asarray(self.at.sizes, float)[self._counting]
        spread = float(np.mean(np.minimum(sizes, HUBER) ** 2)) / max(self._share_left, 1e-3)
        weight = float(np.mean(HUBER / np.maximum(sizes, HUBER)))
        return float(np.mean(sizes < HUBER)) / np.sqrt(spread * weight) if spread > 0 else 1.0

    def predictions(self, parameterization: Parameterization) -> tuple[Prediction, ...]:
        """Simulated motion of each run."""
        inside, index = np.asarray(self.shooting.inside), np.asarray(self.shooting.pieces.index)[:, :-1]
        states, outputs = np.empty(self.data.states.shape), np.empty((len(self.data.states), *self.sigma.shape))
        states[index[inside]], outputs[index[inside]] = np.asarray(self.at.states)[inside], np.asarray(self.at.predicted)[inside]
        names, nq, found, first = self.shooting.outputs, parameterization.tree.nq, [], 0
        for ts in self.data.times:
            here = slice(first, first + len(ts))
            first += len(ts)
            effort = outputs[here, names.index("effort")] if "effort" in names else None
            found.append(Prediction(ts, states[here, :nq], states[here, nq:], effort))
        return tuple(found)

    @property
    def _share_left(self) -> float:
        """Of the residuals' freedom, what the fit has not taken up."""
        return 1.0 - self.fitted / max(int(self.data.count.sum()), 1)

    @property
    def _counting(self) -> np.ndarray:
        """Which residuals of the pieces count."""
        index = np.asarray(self.shooting.pieces.index)[:, :-1]
        weight = np.where(np.asarray(self.shooting.inside)[..., None], np.asarray(self.shooting.measured.weight)[index], 0.0)
        return np.broadcast_to((weight > 0)[:, :, None], (*index.shape, *self.sigma.shape))
