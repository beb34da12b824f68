"""Stages as one sparse problem: the order of its variables and constraints, and the places of their derivatives.

Variables are state and control of one stage after another and the last state. Constraints are the gaps between a stage and the next
node and its rows, one stage after another, and the rows of the last node.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from kanejax._optimal_control.stages import Bounds, Derivatives, FinalValues, Path, StageValues


class Layout(NamedTuple):
    """Numbers of stages, states, controls, rows of each stage, and rows of the last node."""

    steps: int
    nx: int
    nw: int
    nc: int
    nf: int

    @classmethod
    def of(cls, path: Path, bounds: Bounds) -> "Layout":
        """Of a problem with such paths and bounds."""
        (steps, nw), nx = path.w.shape, path.x.shape[1]
        return cls(steps, nx, nw, bounds.stage.shape[2] - nx - nw, bounds.final.shape[1] - nx)

    @property
    def own(self) -> int:
        """Variables of a stage."""
        return self.nx + self.nw

    @property
    def of_stage(self) -> int:
        """Constraints of a stage."""
        return self.nx + self.nc

    @property
    def variables(self) -> int:
        """Number of them."""
        return self.steps * self.own + self.nx

    @property
    def constraints(self) -> int:
        """Number of them."""
        return self.steps * self.of_stage + self.nf

    def flat(self, path: Path) -> np.ndarray:
        """The variables of a path."""
        return _joined(np.concatenate((path.x[:-1], path.w), 1), path.x[-1])

    def path(self, v: np.ndarray, dtype: np.dtype) -> Path:
        """The path of the variables."""
        stages, last = self.by_stage(v)
        x = np.concatenate((stages[:, : self.nx], last[None]))
        return Path(jnp.asarray(x, dtype), jnp.asarray(stages[:, self.nx :], dtype))

    def by_stage(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of variables as those of the stages and of the last node; leading axes stay."""
        stages = v[..., : -self.nx].reshape(*v.shape[:-1], self.steps, self.own)
        return stages, v[..., -self.nx :]

    def by_kind(self, of_constraints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers of constraints as those of gaps, rows, and rows of the last node."""
        stages = of_constraints[: self.constraints - self.nf].reshape(self.steps, self.of_stage)
        return stages[:, : self.nx], stages[:, self.nx :], of_constraints[self.constraints - self.nf :]

    def of_variables(self, stage: ArrayLike, final: ArrayLike) -> np.ndarray:
        """The variables' part of lower and upper numbers of all that has bounds."""
        stage, final = np.asarray(stage)[:, :, : self.own], np.asarray(final)[:, : self.nx]
        return np.concatenate((stage.reshape(2, -1), final), 1)

    def of_constraints(self, gaps: ArrayLike, stage: ArrayLike, final: ArrayLike) -> np.ndarray:
        """Numbers of gaps, and the rows' part of numbers of all that has bounds; leading axes stay."""
        rows, final = np.asarray(stage)[..., self.own :], np.asarray(final)[..., self.nx :]
        stages = np.concatenate((np.broadcast_to(gaps, (*rows.shape[:-1], self.nx)), rows), -1)
        return np.concatenate((stages.reshape(*stages.shape[:-2], -1), final), -1)

    def constraint_values(self, path: Path, stage: StageValues, final: FinalValues) -> np.ndarray:
        """The constraints on a path."""
        gaps = np.asarray(stage.next) - np.asarray(path.x[1:])
        return _joined(np.concatenate((gaps, stage.rows), 1), final.rows)

    def gradient(self, at: Derivatives) -> np.ndarray:
        """Of the cost."""
        return _joined(at.cost, at.final_cost)

    def jacobian_places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the constraints' derivatives: a block of each stage, the next states, and the last node's block."""
        k, constraint, variable = np.arange(self.steps)[:, None, None], np.arange(self.of_stage), np.arange(self.own)
        rows, columns = np.broadcast_arrays(k * self.of_stage + constraint[:, None], k * self.own + variable)
        gaps, after = k * self.of_stage + np.arange(self.nx), (k + 1) * self.own + np.arange(self.nx)
        last_rows, last_columns = np.indices((self.nf, self.nx))
        last_rows, last_columns = last_rows + self.steps * self.of_stage, last_columns + self.steps * self.own
        return _joined(rows, gaps, last_rows), _joined(columns, after, last_columns)

    def jacobian(self, at: Derivatives) -> np.ndarray:
        """Derivatives of the constraints, at these places."""
        return _joined(np.concatenate((at.next, at.rows), 1), -np.ones((self.steps, self.nx)), at.final_rows)

    def hessian_places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the lower triangles of all blocks of the Lagrangian's second derivatives."""
        start, end = np.arange(self.steps)[:, None] * self.own, self.steps * self.own
        both = zip(np.tril_indices(self.own), np.tril_indices(self.nx), strict=True)
        rows, columns = (_joined(start + stage, end + last) for stage, last in both)
        return rows, columns

    def hessian(self, at: Derivatives) -> np.ndarray:
        """Second derivatives of the Lagrangian, at these places."""
        rows, columns = np.tril_indices(self.own)
        return _joined(np.asarray(at.hessian)[:, rows, columns], np.asarray(at.final_hessian)[np.tril_indices(self.nx)])


def _joined(*arrays: ArrayLike) -> np.ndarray:
    return np.concatenate([np.ravel(each) for each in arrays])
