"""What a data set of trajectories is of: a model, times, and what is drawn at random for each trajectory."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, final

import numpy as np
from jaxtyping import Float

from kanejax._dataset.random_numbers import uniform_numbers
from kanejax._dataset.study_checks import (
    DENSITY,
    check_given_forces,
    check_options,
    check_parameters,
    check_random_forces,
    check_states,
    numbers_of,
)
from kanejax._model.coordinates import coordinates_within_ranges, numbers_for_coordinates
from kanejax._model.model import Model, leaf_shapes
from kanejax._simulate.checks import checked_times
from kanejax._simulate.control import Interpolation
from kanejax.distributions import AbstractDistribution, LogNormal, Normal


@final
@dataclasses.dataclass(frozen=True)
class Randomized:
    """How a parameter of the model differs from trajectory to trajectory.

    Attributes:
        distribution: of the factors, or of what is added; independent for each body, joint or speed.
        how: "factor" multiplies what the model has, one factor for all numbers of a body, joint or speed; "added" adds to every
            number.
    """

    distribution: AbstractDistribution = dataclasses.field(default_factory=LogNormal)
    how: Literal["factor", "added"] = "factor"


@final
@dataclasses.dataclass(frozen=True)
class RandomForces:
    """Forces at the joints that are drawn anew at equal distances in time.

    Attributes:
        distribution: of the forces [N m, N], independent for each speed and time; one value or (nv,) of its parameters.
        period: from one draw to the next [s].
        interpolation: as in `TorqueTable`; "hold" keeps each until the next.
    """

    distribution: AbstractDistribution
    period: float
    interpolation: Interpolation = "hold"


@final
@dataclasses.dataclass(frozen=True)
class GivenForces:
    """Forces at the joints, a table for each trajectory.

    Attributes:
        ts: times [s], (n,).
        values: forces [N m, N], (trajectories, n, nv).
        interpolation: as in `TorqueTable`.
    """

    ts: np.ndarray
    values: np.ndarray
    interpolation: Interpolation = "linear"


class Rows(NamedTuple):
    """What belongs to some trajectories, in the model's data type.

    Attributes:
        q0: generalized coordinates at the first time.
        u0: generalized speeds at the first time.
        leaves: randomised leaves of the model, by name, with a leading axis.
        forces: values of the tables of forces, or None.
    """

    q0: Float[np.ndarray, "count nq"]
    u0: Float[np.ndarray, "count nv"]
    leaves: dict[str, np.ndarray]
    forces: Float[np.ndarray, "count n nv"] | None


@final
@dataclasses.dataclass(frozen=True)
class Study:
    """Trajectories of one mechanism that differ in what is drawn at random, or given, for each of them.

    What is drawn for a trajectory depends on `seed` and on its number alone: not on how many there are, and not on how many are
    simulated together or where.

    Attributes:
        model: the mechanism.
        ts: times [s] to save, strictly increasing.
        trajectories: how many.
        q0: generalized coordinates at the first time: None for uniform within the joints' ranges, a distribution, whose parameters
            may be (nq,), for models without ball and free joints, or an array (trajectories, nq).
        u0: generalized speeds at the first time: a distribution, whose parameters may be (nv,), or an array (trajectories, nv).
        control: forces at the joints, or None for zero.
        parameters: leaves of the model that are randomised, by name; "density" is the mass and the central inertia of a body.
        seed: of what is drawn.
        options: of `simulate`, for all trajectories: `solver`, `dt0`, `rtol`, `atol`, `stepsize_controller`, `events`,
            `joint_limits` and `max_steps`.
    """

    model: Model
    ts: np.ndarray
    trajectories: int
    q0: AbstractDistribution | np.ndarray | None = None
    u0: AbstractDistribution | np.ndarray = dataclasses.field(default_factory=Normal)
    control: RandomForces | GivenForces | None = None
    parameters: Mapping[str, Randomized] = dataclasses.field(default_factory=dict)
    seed: int = 0
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that all of it goes together, by drawing one trajectory too.

        Raises:
            ValueError: it does not; the message names what.
        """
        object.__setattr__(self, "ts", checked_times(np.asarray(self.ts), self.model.dtype))
        if self.trajectories < 1:
            raise ValueError(f"trajectories is {self.trajectories}; there must be at least one")
        check_options(self.options)
        check_states(self.model, self.trajectories, self.q0, self.u0)
        check_parameters(self.model, self.parameters)
        if isinstance(self.control, RandomForces):
            check_random_forces(self.model, self.control.distribution, self.control.period)
        if isinstance(self.control, GivenForces):
            check_given_forces(self.model, self.trajectories, self.control.ts, self.control.values)
        self.rows(0, 1)

    def rows(self, first: int, count: int) -> Rows:
        """What belongs to some of the trajectories.

        Args:
            first: number of the first of them, from 0.
            count: how many.
        """
        model = self.model
        if self.q0 is None:
            q0 = coordinates_within_ranges(model, self._numbers("q0", first, count, numbers_for_coordinates(model)))
        else:
            q0 = self._values("q0", self.q0, first, count, model.nq)
        rows = Rows(q0, self._values("u0", self.u0, first, count, model.nv), self._leaves(first, count), self._forces(first, count))
        dtype = np.dtype(model.dtype)
        leaves = {name: leaf.astype(dtype) for name, leaf in rows.leaves.items()}
        forces = None if rows.forces is None else rows.forces.astype(dtype)
        return Rows(rows.q0.astype(dtype), rows.u0.astype(dtype), leaves, forces)

    @property
    def force_times(self) -> np.ndarray | None:
        """Times [s] of the tables of forces."""
        if not isinstance(self.control, RandomForces):
            return None if self.control is None else np.asarray(self.control.ts, self.ts.dtype)
        first, last = float(self.ts[0]), float(self.ts[-1])
        count = max(2, int(np.ceil((last - first) / self.control.period * (1 - 1e-9))) + 1)
        return (first + self.control.period * np.arange(count)).astype(self.ts.dtype)

    def _numbers(self, name: str, first: int, count: int, width: int) -> np.ndarray:
        return uniform_numbers(self.seed, name, first, count, width)

    def _values(self, name: str, source: Any, first: int, count: int, width: int) -> np.ndarray:
        if isinstance(source, AbstractDistribution):
            return source.of(self._numbers(name, first, count, width))
        return np.asarray(source[first : first + count], float)

    def _forces(self, first: int, count: int) -> np.ndarray | None:
        times = self.force_times
        if times is None:
            return None
        if isinstance(self.control, GivenForces):
            return np.asarray(self.control.values[first : first + count], float)
        assert self.control is not None
        numbers = self._numbers("forces", first, count, len(times) * self.model.nv).reshape(-1, self.model.nv)
        return self.control.distribution.of(numbers).reshape(count, len(times), self.model.nv)

    def _leaves(self, first: int, count: int) -> dict[str, np.ndarray]:
        found: dict[str, np.ndarray] = {}
        for name, randomized in self.parameters.items():
            for leaf in ("mass", "central_inertia") if name == DENSITY else (name,):
                nominal = found.get(leaf, np.asarray(getattr(self.model, leaf), float))
                found[leaf] = self._changed(name, randomized, nominal, leaf_shapes(self.model.tree)[leaf], first, count)
        return found

    def _changed(
        self, name: str, randomized: Randomized, nominal: np.ndarray, shape: tuple[int, ...], first: int, count: int
    ) -> np.ndarray:
        """A leaf with its factors, or with what is added."""
        width = numbers_of(shape, randomized.how)
        numbers = randomized.distribution.of(self._numbers(name, first, count, width))
        if randomized.how == "added":
            return nominal + numbers.reshape(count, *shape)
        return nominal * numbers.reshape(count, width, *(1 for _ in shape[1:]))
