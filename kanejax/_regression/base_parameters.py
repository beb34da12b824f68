"""Base parameters: the combinations of parameters that the motion depends on, and what is grouped into each.

Parameters whose columns of the regressor are combinations of others' are told from the motion only together with those: their
columns are found by orthogonalising one after another, in an order that makes the groups those of the literature (Gautier and
Khalil 1990): what a link cannot tell apart is counted with links nearer to the base.
"""

import dataclasses
from collections.abc import Sequence
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from kanejax._dynamics.regressor import regressor
from kanejax._model.inertia import NAMES
from kanejax._model.model import Model

# Of the ten parameters of a body, those that are rather grouped into others come last.
ORDER = (4, 7, 8, 9, 6, 1, 2, 5, 3, 0)
# A column is a combination of others when less than this fraction of it is left.
TOLERANCE = 1e-9
# It is no more than rounding errors when it is this small beside the largest.
_NOTHING = 1e-13


@final
@dataclasses.dataclass(frozen=True, eq=False)
class BaseParameters:
    """Which combinations of parameters the data of a mechanism can determine.

    Attributes:
        names: of all parameters.
        independent: indices of those that each name a group, one a base parameter.
        without_effect: indices of those that no force depends on.
        matrix: base parameters from all parameters; one in the column of the group's own.
    """

    names: tuple[str, ...]
    independent: Int[np.ndarray, " nbase"]
    without_effect: Int[np.ndarray, " none"]
    matrix: Float[np.ndarray, "nbase n"]

    def __len__(self) -> int:
        """Number of base parameters."""
        return len(self.independent)

    @property
    def formulas(self) -> tuple[str, ...]:
        """Each base parameter as a sum, such as `link1.Izz + link2.Iyy + 0.25 link2.m`."""
        return tuple(
            _sum([(1.0, self.names[own]), *((row[i], self.names[i]) for i in np.flatnonzero(row) if i != own)])
            for own, row in zip(self.independent, self.matrix, strict=True)
        )

    def group(self, index: int) -> tuple[int, ...]:
        """The base parameters that a parameter enters."""
        return tuple(int(i) for i in np.flatnonzero(self.matrix[:, index]))

    def alone(self, index: int) -> int | None:
        """The base parameter that is this parameter and nothing else, or None."""
        groups = self.group(index)
        single = len(groups) == 1 and np.count_nonzero(self.matrix[groups[0]]) == 1
        return groups[0] if single else None

    def __str__(self) -> str:
        """List the formulas, and what has no effect."""
        nothing = ", ".join(self.names[i] for i in self.without_effect)
        return "\n".join((*self.formulas, *((f"without effect: {nothing}",) if nothing else ())))


def base_parameters(model: Model, *, states: int | None = None, seed: int = 0) -> BaseParameters:
    """Group the inertia parameters of a model into those that its motion can tell apart.

    Found at random states, in float64 whatever JAX's settings: a property of the mechanism's geometry and its gravity. What a
    recorded motion excites is another question.

    Args:
        model: the mechanism; its inertias do not matter.
        states: number of random states; enough by default.
        seed: of the random states.

    Returns:
        The groups, with formulas. `matrix @ inertia_parameters(model).ravel()` are the base parameters' values.
    """
    names = tuple(f"{body}.{name}" for body in model.tree.body_names for name in NAMES)
    order = [10 * body + i for body in range(model.nbody) for i in ORDER]
    with jax.enable_x64(True):
        wide = model.astype(jnp.float64)
        rows = jax.jit(jax.vmap(regressor, (None, 0, 0, 0)))(
            wide, *random_states(wide, states or enough_states(len(names), wide), seed)
        )
        rows = np.asarray(rows).reshape(-1, len(names))
    return grouped(rows, names, order)


def enough_states(count: int, model: Model) -> int:
    """States whose forces are a few times as many as the parameters."""
    return 20 + 4 * count // max(model.nv, 1)


def random_states(model: Model, states: int, seed: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Coordinates, speeds and rates (states, ...); forces do not depend on the length of quaternions."""
    random = np.random.default_rng(seed)
    sizes = (model.nq, model.nv, model.nv)
    q, u, u_dot = (jnp.asarray(random.normal(scale=2.0, size=(states, size)), model.dtype) for size in sizes)
    return q, u, u_dot


def grouped(columns: Float[np.ndarray, "rows n"], names: Sequence[str], order: Sequence[int]) -> BaseParameters:
    """Group parameters by the columns of their regressor.

    Args:
        columns: of the regressor, at states that excite everything.
        names: of the parameters.
        order: of the parameters; those that come later are grouped into earlier ones.
    """
    lengths = np.linalg.norm(columns, axis=0)
    largest = lengths.max(initial=0.0)
    effective = [i for i in order if lengths[i] > _NOTHING * largest]
    # Only the angles between the columns matter: a triangular factor has them, with as many rows as columns.
    factor = np.linalg.qr(columns / np.where(lengths > 0, lengths, 1.0), mode="r")
    independent, basis = [], np.zeros((len(factor), 0))
    for i in effective:
        left = factor[:, i]
        # Twice, for what rounding leaves of the first time.
        for _ in range(2):
            left = left - basis @ (basis.T @ left)
        if (length := np.linalg.norm(left)) > TOLERANCE:
            independent.append(i)
            basis = np.column_stack((basis, left / length))
    independent.sort()
    matrix = np.zeros((len(independent), len(names)))
    if independent:
        kept = factor[:, independent]
        shares = np.linalg.lstsq(kept, factor[:, effective], rcond=None)[0]
        shares[np.abs(shares) < 1e-7 * np.abs(shares).max(axis=0)] = 0.0
        matrix[:, effective] = shares * lengths[effective] / lengths[independent][:, None]
        matrix[:, independent] = np.eye(len(independent))
    others = np.setdiff1d(np.arange(len(names)), effective)
    return BaseParameters(tuple(names), np.array(independent, int), others, matrix)


def _sum(terms: Sequence[tuple[float, str]]) -> str:
    text = ""
    for factor, name in terms:
        size = f"{abs(factor):.4g}"
        sign = ("- " if factor < 0 else "") if not text else (" - " if factor < 0 else " + ")
        text += sign + ("" if size == "1" else f"{size} ") + name
    return text
