"""What is believed of unknown numbers before data are seen."""

import dataclasses
from collections.abc import Sequence
from typing import final


@final
@dataclasses.dataclass(frozen=True)
class Gaussian:
    """The numbers are those of the given plant, with normally distributed errors.

    Attributes:
        std: standard deviation, in the unit of the numbers; one for all, or one for each number of a body or joint, such as the
            three of "com". For "body_quaternion" and "joint_axis" an angle [rad].
        relative: whether `std` is a fraction of each number instead.
    """

    std: float | Sequence[float]
    relative: bool = False

    def __post_init__(self) -> None:
        """Store numbers that can be hashed, and check them."""
        values = (self.std,) if isinstance(self.std, int | float) else tuple(float(value) for value in self.std)
        for value in values:
            _check("Gaussian", value)
        object.__setattr__(self, "std", float(values[0]) if isinstance(self.std, int | float) else values)


@final
@dataclasses.dataclass(frozen=True)
class Entropic:
    """The bodies are near to those of the given plant, by the entropic divergence of their mass distributions; for "inertia".

    It depends on no unit and no choice of frame (Lee, Wensing and Park 2020). In minus twice the logarithm of the prior it counts
    1 / std^2, and is the sum of squares of small log-Cholesky coordinates, twice for logarithms: with std = 0.1 each length of the
    body is known to a tenth or so.

    Attributes:
        std: standard deviation, without unit.
    """

    std: float = 1.0

    def __post_init__(self) -> None:
        """Check the number."""
        _check("Entropic", self.std)


@final
@dataclasses.dataclass(frozen=True)
class Geodesic:
    """The bodies are near to those of the given plant, by the affine-invariant distance of their pseudo-inertias; for "inertia".

    Like `Entropic`, to which it is equal for small changes, and alike for growing and shrinking (Lee and Park 2018). Its square
    counts 1 / std^2 in minus twice the logarithm of the prior.

    Attributes:
        std: standard deviation, without unit.
    """

    std: float = 1.0

    def __post_init__(self) -> None:
        """Check the number."""
        _check("Geodesic", self.std)


Prior = Gaussian | Entropic | Geodesic


def _check(name: str, std: float) -> None:
    if not 0 < std < float("inf"):
        raise ValueError(f"std of {name} is {std}; it must be positive and finite")
