"""Free coordinates theta of numbers phi that bodies and drives can have: any theta gives numbers within their bounds."""

import abc
import functools
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from kanejax._model.inertia import symmetric
from kanejax._parameters.pseudo_inertia import (
    inertia_of,
    inertia_parameters_of,
    matrix_from_coordinates,
    nearest_coordinates,
    pseudo_inertia,
    upper_triangle,
)

# What is nearer to its border than this, as a fraction of its scale, of its interval, or of the nominal body, is said to be at it.
AT_BORDER = 1e-3
# Numbers are kept this far from their bounds, as a fraction of their scale, where coordinates are sought for any number.
LEAST_DISTANCE = 1e-6
# What a step leaves of the distance from a bound; and coordinates below which softplus is the exponential function.
_LEAST_SHARE, _FAR = 0.1, -20.0


class AbstractCoordinates(eqx.Module):
    """A smooth map from free coordinates onto numbers."""

    @property
    @abc.abstractmethod
    def sizes(self) -> tuple[int, int]:
        """How many coordinates and how many numbers there are."""

    @abc.abstractmethod
    def phi(self, theta: Float[Array, " m"]) -> Float[Array, " n"]:
        """The numbers."""

    @abc.abstractmethod
    def theta(self, phi: Float[Array, " n"]) -> Float[Array, " m"]:
        """Coordinates of the numbers, or of the nearest that have some."""

    @abc.abstractmethod
    def step_limits(self, theta: Float[Array, " m"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """Least and greatest step along the coordinates that `moved` takes: derivatives vanish near the borders."""

    @abc.abstractmethod
    def moved(self, theta: Float[Array, " m"], step: Float[Array, " m"]) -> Float[Array, " m"]:
        """The coordinates after a step within the limits; single numbers change as their derivatives say."""

    @abc.abstractmethod
    def at_border(self, theta: Float[Array, " m"]) -> Bool[Array, " n"]:
        """Which numbers are all but at the border of what they can be."""


@final
class InertiaCoordinates(AbstractCoordinates):
    """Log-Cholesky coordinates of bodies, whose numbers are their inertia parameters.

    Attributes:
        factor: of the nominal bodies' pseudo-inertias.
    """

    factor: Float[Array, "bodies 4 4"]

    @property
    def sizes(self) -> tuple[int, int]:
        """Ten of both for each body."""
        return 10 * len(self.factor), 10 * len(self.factor)

    def phi(self, theta: Float[Array, " m"]) -> Float[Array, " n"]:
        """The inertia parameters."""
        return inertia_parameters_of(matrix_from_coordinates(theta.reshape(-1, 10), self.factor)).reshape(-1)

    def theta(self, phi: Float[Array, " n"]) -> Float[Array, " m"]:
        """Coordinates of the nearest bodies that can exist."""
        return nearest_coordinates(pseudo_inertia(phi.reshape(-1, 10)), self.factor).reshape(-1)

    def step_limits(self, theta: Float[Array, " m"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """One, by which moments change 7 times at most."""
        return -jnp.ones_like(theta), jnp.ones_like(theta)

    def moved(self, theta: Float[Array, " m"], step: Float[Array, " m"]) -> Float[Array, " m"]:
        """Their sum."""
        return theta + step

    def at_border(self, theta: Float[Array, " m"]) -> Bool[Array, " n"]:
        """All ten of bodies that are all but flat, or without mass, next to the nominal ones."""
        return _all_but_singular(theta.reshape(-1, 10), 4)


@final
class CentralInertiaCoordinates(AbstractCoordinates):
    """Log-Cholesky coordinates of second moments about the mass centres, whose numbers are the six of the central inertias.

    Attributes:
        factor: of the nominal bodies' second moments.
    """

    factor: Float[Array, "bodies 3 3"]

    @property
    def sizes(self) -> tuple[int, int]:
        """Six of both for each body."""
        return 6 * len(self.factor), 6 * len(self.factor)

    def phi(self, theta: Float[Array, " m"]) -> Float[Array, " n"]:
        """Entries xx, yy, zz, xy, xz, yz of the inertias."""
        return inertia_of(matrix_from_coordinates(theta.reshape(-1, 6), self.factor)).reshape(-1)

    def theta(self, phi: Float[Array, " n"]) -> Float[Array, " m"]:
        """Coordinates of the nearest inertias that can exist."""
        inertia = symmetric(phi.reshape(-1, 6))
        half_trace = 0.5 * jnp.trace(inertia, axis1=-2, axis2=-1)[:, None, None]
        second = half_trace * jnp.eye(3, dtype=phi.dtype)[None] - inertia
        return nearest_coordinates(second, self.factor).reshape(-1)

    def step_limits(self, theta: Float[Array, " m"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """One, by which moments change 7 times at most."""
        return -jnp.ones_like(theta), jnp.ones_like(theta)

    def moved(self, theta: Float[Array, " m"], step: Float[Array, " m"]) -> Float[Array, " m"]:
        """Their sum."""
        return theta + step

    def at_border(self, theta: Float[Array, " m"]) -> Bool[Array, " n"]:
        """All six of bodies that are all but flat next to the nominal ones."""
        return _all_but_singular(theta.reshape(-1, 6), 3)


@final
class BoundedCoordinates(AbstractCoordinates):
    """Coordinates of single numbers: a shift and a scale without bounds, softplus for one bound, the logistic function for two.

    Attributes:
        lower: least values, or minus infinity.
        upper: greatest values, or infinity.
        origin: where coordinates of numbers without bounds are zero.
        scale: a typical size of the numbers, or of their distances to their bounds.
    """

    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    origin: Float[Array, " n"]
    scale: Float[Array, " n"]

    @property
    def sizes(self) -> tuple[int, int]:
        """One for each."""
        return len(self.scale), len(self.scale)

    def phi(self, theta: Float[Array, " m"]) -> Float[Array, " n"]:
        """The numbers; above a bound by scale log(1 + e^theta)."""
        low, high = self._finite()
        free = self.origin + self.scale * theta
        above = low + self.scale * jax.nn.softplus(theta)
        below = high - self.scale * jax.nn.softplus(-theta)
        between = low + (high - low) * jax.nn.sigmoid(theta)
        return self._choice(free, above, below, between)

    def theta(self, phi: Float[Array, " n"]) -> Float[Array, " m"]:
        """Coordinates of the numbers, or of the nearest that are a millionth of the scale within their bounds."""
        low, high = self._finite()
        least = functools.partial(jnp.maximum, LEAST_DISTANCE)
        above, below = least((phi - low) / self.scale), least((high - phi) / self.scale)
        fraction = jnp.clip((phi - low) / jnp.where(high > low, high - low, 1.0), LEAST_DISTANCE, 1.0 - LEAST_DISTANCE)
        return self._choice(
            (phi - self.origin) / self.scale, _inverse_softplus(above), -_inverse_softplus(below), jax.scipy.special.logit(fraction)
        )

    def step_limits(self, theta: Float[Array, " m"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """Those by which a distance from a bound shrinks to a tenth."""
        part, share, rest = 1.0 - _LEAST_SHARE, jax.nn.sigmoid(theta), jax.nn.sigmoid(-theta)
        above, below = part / _relative_slope(theta), part / _relative_slope(-theta)
        free = jnp.full_like(theta, jnp.inf)
        return self._choice(-free, -above, -free, -part / rest), self._choice(free, free, below, part / share)

    def moved(self, theta: Float[Array, " m"], step: Float[Array, " m"]) -> Float[Array, " m"]:
        """Those of the numbers to which their derivatives lead."""
        share, rest = jax.nn.sigmoid(theta), jax.nn.sigmoid(-theta)
        least = functools.partial(jnp.maximum, _LEAST_SHARE)
        between = theta + jnp.log(least(1.0 + rest * step) / least(1.0 - share * step))
        return self._choice(theta + step, _moved_above(theta, step), -_moved_above(-theta, -step), between)

    def at_border(self, theta: Float[Array, " m"]) -> Bool[Array, " n"]:
        """Those that are all but at their bounds."""
        phi = self.phi(theta)
        size = jnp.where(jnp.isfinite(self.lower) & jnp.isfinite(self.upper), self.upper - self.lower, self.scale)
        return jnp.minimum(phi - self.lower, self.upper - phi) < AT_BORDER * size

    def _finite(self) -> tuple[jax.Array, jax.Array]:
        """The bounds, 0 where there is none."""
        return jnp.where(jnp.isfinite(self.lower), self.lower, 0.0), jnp.where(jnp.isfinite(self.upper), self.upper, 0.0)

    def _choice(self, free: jax.Array, above: jax.Array, below: jax.Array, between: jax.Array) -> jax.Array:
        has_lower, has_upper = jnp.isfinite(self.lower), jnp.isfinite(self.upper)
        return jnp.where(has_lower, jnp.where(has_upper, between, above), jnp.where(has_upper, below, free))


def _all_but_singular(theta: Float[Array, "bodies each"], n: int) -> Bool[Array, " numbers"]:
    """Whether the smallest length of each body, relative to the nominal one, is all but zero; for each of its numbers."""
    lengths = jnp.linalg.svd(upper_triangle(theta, n), compute_uv=False)
    return jnp.repeat(lengths[:, -1] < AT_BORDER, theta.shape[1])


def _inverse_softplus(y: jax.Array) -> jax.Array:
    return y + jnp.log(-jnp.expm1(-y))


def _relative_slope(theta: jax.Array) -> jax.Array:
    """The derivative of softplus, divided by it: one where it all but vanishes."""
    inside = jnp.maximum(theta, _FAR)
    return jnp.where(theta > _FAR, jax.nn.sigmoid(inside) / jax.nn.softplus(inside), 1.0)


def _moved_above(theta: jax.Array, step: jax.Array) -> jax.Array:
    """Where softplus has changed as its derivative says."""
    ratio, inside = jnp.maximum(1.0 + _relative_slope(theta) * step, _LEAST_SHARE), jnp.maximum(theta, _FAR)
    return jnp.where(theta > _FAR, _inverse_softplus(jax.nn.softplus(inside) * ratio), theta + jnp.log(ratio))
