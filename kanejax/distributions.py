"""Distributions for the initial states, forces and parameters of a `Study`, by name in files and as classes in Python.

Each turns numbers between 0 and 1 into what it describes, one by one, so that a trajectory's draws do not depend on which
others are drawn with it.
"""

import abc
import dataclasses
from typing import Any, final

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.special import ndtri


def _numbers(**options: Any) -> Any:
    """A field that is a number or an array of them."""
    return eqx.field(converter=lambda x: np.asarray(x, float), **options)


class AbstractDistribution(eqx.Module):
    """Independent numbers; what is given as an array has a value for each of them, in the order of what is drawn."""

    def __str__(self) -> str:
        """Name and parameters."""
        values = ", ".join(f"{field.name} = {getattr(self, field.name).tolist()}" for field in dataclasses.fields(self))
        return f"{type(self).__name__}({values})"

    @abc.abstractmethod
    def of(self, numbers: Float[np.ndarray, "count width"]) -> Float[np.ndarray, "count width"]:
        """Values for numbers that are uniform between 0 and 1."""

    @property
    @abc.abstractmethod
    def least(self) -> float:
        """No value is less."""


@final
class Fixed(AbstractDistribution):
    """The same value every time.

    Attributes:
        value: a number, or one for each.
    """

    value: Any = _numbers()

    def of(self, numbers: Float[np.ndarray, "count width"]) -> Float[np.ndarray, "count width"]:
        """The value."""
        return np.broadcast_to(self.value, numbers.shape).copy()

    @property
    def least(self) -> float:
        """The value."""
        return float(np.min(self.value))


@final
class Uniform(AbstractDistribution):
    """Uniform between two values.

    Attributes:
        low: the least.
        high: the greatest.
    """

    low: Any = _numbers()
    high: Any = _numbers()

    def __check_init__(self) -> None:
        """Check the order."""
        if not np.all(self.low <= self.high):
            raise ValueError(f"Uniform goes from low = {self.low} to high = {self.high}; low must not be greater")

    def of(self, numbers: Float[np.ndarray, "count width"]) -> Float[np.ndarray, "count width"]:
        """Values between both."""
        return self.low + (self.high - self.low) * numbers

    @property
    def least(self) -> float:
        """The lower end."""
        return float(np.min(self.low))


@final
class LogUniform(AbstractDistribution):
    """Uniform in the logarithm: for sizes that are known to a factor.

    Attributes:
        low: the least, positive.
        high: the greatest.
    """

    low: Any = _numbers()
    high: Any = _numbers()

    def __check_init__(self) -> None:
        """Check the order."""
        if not np.all((self.low > 0) & (self.low <= self.high)):
            raise ValueError(f"LogUniform goes from low = {self.low} to high = {self.high}; low must be positive and not greater")

    def of(self, numbers: Float[np.ndarray, "count width"]) -> Float[np.ndarray, "count width"]:
        """Values between both."""
        return self.low * (self.high / self.low) ** numbers

    @property
    def least(self) -> float:
        """The lower end."""
        return float(np.min(self.low))


@final
class Normal(AbstractDistribution):
    """Normal.

    Attributes:
        mean: of the values.
        std: standard deviation, not negative.
    """

    mean: Any = _numbers(default=0.0)
    std: Any = _numbers(default=1.0)

    def __check_init__(self) -> None:
        """Check the deviation."""
        if not np.all(self.std >= 0):
            raise ValueError(f"Normal has std = {self.std}; it must not be negative")

    def of(self, numbers: Float[np.ndarray, "count width"]) -> Float[np.ndarray, "count width"]:
        """Values around the mean."""
        return self.mean + self.std * ndtri(numbers)

    @property
    def least(self) -> float:
        """Without a bound, unless nothing is random."""
        return -np.inf if np.any(self.std > 0) else float(np.min(self.mean))


@final
class LogNormal(AbstractDistribution):
    """Normal in the logarithm: for factors, which stay positive.

    Attributes:
        median: half of the values are less; positive.
        sigma: standard deviation of the natural logarithm, not negative: about the relative deviation if small.
    """

    median: Any = _numbers(default=1.0)
    sigma: Any = _numbers(default=0.1)

    def __check_init__(self) -> None:
        """Check the signs."""
        if not (np.all(self.median > 0) and np.all(self.sigma >= 0)):
            raise ValueError(f"LogNormal has median = {self.median} and sigma = {self.sigma}; they must be positive")

    def of(self, numbers: Float[np.ndarray, "count width"]) -> Float[np.ndarray, "count width"]:
        """Values around the median."""
        return self.median * np.exp(self.sigma * ndtri(numbers))

    @property
    def least(self) -> float:
        """Zero, which it comes near to."""
        return 0.0


BY_NAME: dict[str, type[AbstractDistribution]] = {
    "fixed": Fixed,
    "uniform": Uniform,
    "log-uniform": LogUniform,
    "normal": Normal,
    "log-normal": LogNormal,
}
