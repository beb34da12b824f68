"""The numbers of one unknown: where they are in a plant, their free coordinates, where these start, and their prior."""

import math
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._errors import InvalidParameterError
from kanejax._model.inertia import inertia_parameters, six, symmetric
from kanejax._model.model import Model
from kanejax._parameters.coordinates import AbstractCoordinates
from kanejax._parameters.directions import tilted_axes, turned_quaternions
from kanejax._parameters.leaves import LEAVES, Element
from kanejax._parameters.plant import Drives, Plant
from kanejax._parameters.priors import Entropic, Gaussian, Geodesic
from kanejax._parameters.pseudo_inertia import entropic_residuals, geodesic_residuals
from kanejax._parameters.start import start_of_bodies, start_of_numbers
from kanejax._parameters.unknowns import Unknown, selected

# Leaves that mean nothing for bodies that are only frames.
_OF_MASS = ("inertia", "mass", "com", "central_inertia")

_RESIDUALS = {Entropic: entropic_residuals, Geodesic: geodesic_residuals}


@final
class CarriedAlong:
    """A value that no computation depends on: all are equal, so that none makes a program compile again."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        """Equal to all of its kind."""
        return isinstance(other, CarriedAlong)

    def __hash__(self) -> int:
        """The same for all."""
        return hash(CarriedAlong)


@final
class Block(eqx.Module):
    """The numbers of one unknown.

    Attributes:
        leaf: their leaf.
        rows: of the leaf.
        names: of the numbers.
        units: of the numbers.
        notes: sentences on where the start is not the given plant.
        prior: which kind of prior they have.
        coordinates: between theta and phi.
        nominal: phi of the given plant.
        std: of the prior: of a Gaussian one for each number, of others one; empty if there is none.
        theta0: the start.
    """

    leaf: str = eqx.field(static=True)
    rows: tuple[int, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    notes: CarriedAlong = eqx.field(static=True)
    prior: type | None = eqx.field(static=True)
    coordinates: AbstractCoordinates
    nominal: Float[Array, " n"]
    std: Float[Array, " std"]
    theta0: Float[Array, " m"]

    def prior_residuals(self, theta: Float[Array, " m"]) -> Float[Array, " k"]:
        """Numbers whose squares sum to minus twice the logarithm of the prior."""
        if self.prior is Gaussian:
            return (self.coordinates.phi(theta) - self.nominal) / self.std
        if self.prior in _RESIDUALS:
            return _RESIDUALS[self.prior](theta.reshape(-1, 10)).reshape(-1) / self.std
        return theta[:0]

    def written(self, plant: Plant, phi: Float[Array, " n"]) -> Plant:
        """The plant with these numbers; but for "inertia", which has no leaf of its own."""
        if self.leaf == "inertia":
            return plant
        in_drives = self.leaf in Drives.__dataclass_fields__
        leaf = getattr(plant.drives if in_drives else plant.model, self.leaf)
        rows = np.array(self.rows)
        if LEAVES[self.leaf].place == "plant":
            leaf = phi.reshape(leaf.shape)
        elif self.leaf == "body_quaternion":
            leaf = leaf.at[rows].set(turned_quaternions(leaf[rows], phi.reshape(-1, 3)))
        elif self.leaf == "joint_axis":
            leaf = leaf.at[rows].set(tilted_axes(leaf[rows], phi.reshape(-1, 2)))
        elif self.leaf == "central_inertia":
            leaf = leaf.at[rows].set(symmetric(phi.reshape(-1, 6)))
        else:
            # A tie has one number for all rows.
            leaf = leaf.at[rows].set(phi[0] if len(phi) == 1 else phi.reshape(leaf[rows].shape))
        where = (lambda p: getattr(p.drives, self.leaf)) if in_drives else (lambda p: getattr(p.model, self.leaf))
        return eqx.tree_at(where, plant, leaf)


def block(plant: Plant, unknown: Unknown) -> Block:
    """The numbers of an unknown of a plant; raises as `parameterization` does."""
    chosen, left_out = _with_mass(plant.model, unknown, selected(unknown, plant.model.tree))
    dtype = plant.model.dtype
    names = [element.name(unknown.leaf, part) for element in chosen for part in LEAVES[unknown.leaf].parts]
    units = [unit for element in chosen for unit in element.units(unknown.leaf)]
    nominal = _nominal(plant, unknown.leaf, chosen)
    for name, value in zip(names, nominal, strict=True):
        if not math.isfinite(value):
            raise InvalidParameterError(f"{name} is {value}; what is sought must start at a finite number")
    tie = ()
    if unknown.tied:
        tie = _note_of_tie(unknown.leaf, nominal)
        names, units = [_name_of_tie(unknown.leaf, chosen)], [_unit_of_tie(unknown.leaf, units)]
        nominal = nominal.mean(keepdims=True)
    if unknown.leaf in ("inertia", "central_inertia"):
        start = start_of_bodies(plant.model, unknown, chosen)
    else:
        start = start_of_numbers(plant.model, unknown, names, units, nominal)
    return Block(
        unknown.leaf,
        tuple(element.row for element in chosen),
        tuple(names),
        tuple(units),
        CarriedAlong((*left_out, *tie, *start.notes)),
        None if unknown.prior is None else type(unknown.prior),
        start.coordinates,
        jnp.asarray(nominal, dtype),
        jnp.asarray(_standard_deviations(unknown, names, nominal), dtype),
        start.theta,
    )


def _with_mass(model: Model, unknown: Unknown, chosen: list[Element]) -> tuple[list[Element], tuple[str, ...]]:
    """Of bodies that nobody named, only those that are more than a frame, and a sentence on the others."""
    if unknown.of is not None or unknown.leaf not in _OF_MASS:
        return chosen, ()
    has_mass = (np.asarray(model.mass) != 0) | np.asarray(model.central_inertia).any((1, 2))
    kept = [element for element in chosen if has_mass[element.row]]
    frames = [element.owner for element in chosen if not has_mass[element.row]]
    if not kept or not frames:
        return chosen, ()
    return kept, (f"{unknown.leaf} of {', '.join(frames)} is left out: without mass and inertia, a frame; name it to seek it",)


def _nominal(plant: Plant, leaf: str, chosen: list[Element]) -> np.ndarray:
    """The numbers of the given plant; zero for rotations, which start at it."""
    if leaf in ("body_quaternion", "joint_axis"):
        return np.zeros(len(chosen) * len(LEAVES[leaf].parts))
    if leaf == "inertia":
        values = inertia_parameters(plant.model)
    elif leaf == "central_inertia":
        values = six(0.5 * (plant.model.central_inertia + jnp.swapaxes(plant.model.central_inertia, -1, -2)))
    else:
        values = getattr(plant.drives if hasattr(plant.drives, leaf) else plant.model, leaf)
    values = np.asarray(values, float)
    rows = values if LEAVES[leaf].place == "plant" else values[[element.row for element in chosen]]
    return rows.reshape(-1)


def _standard_deviations(unknown: Unknown, names: list[str], nominal: np.ndarray) -> np.ndarray:
    """Of the prior: of a Gaussian one for each number; none without a prior."""
    if unknown.prior is None:
        return np.zeros(0)
    if not isinstance(unknown.prior, Gaussian):
        return np.array([unknown.prior.std])
    std: Any = unknown.prior.std
    parts = len(LEAVES[unknown.leaf].parts)
    if isinstance(std, tuple) and len(std) != parts:
        raise ValueError(f"prior of Unknown({unknown.leaf!r}) has {len(std)} standard deviations; give one, or {parts}")
    if unknown.leaf == "inertia" and not isinstance(std, tuple):
        raise ValueError("a Gaussian prior of 'inertia' needs ten standard deviations, in kg, kg m and kg m^2; or use Entropic")
    each = np.tile(np.broadcast_to(std, (parts,)), len(nominal) // parts)
    if not unknown.prior.relative:
        return each
    for name, value in zip(names, nominal, strict=True):
        if value == 0:
            raise ValueError(f"{name} is 0 in the given plant, and its Gaussian prior is relative to that; give an absolute one")
    return each * np.abs(nominal)


def _name_of_tie(leaf: str, chosen: list[Element]) -> str:
    return ".".join((",".join(".".join(filter(None, (element.owner, element.part))) for element in chosen), leaf))


def _unit_of_tie(leaf: str, units: list[str]) -> str:
    if len(set(units)) > 1:
        raise ValueError(f"Unknown({leaf!r}) ties numbers of different units: {', '.join(sorted(set(units)))}")
    return units[0]


def _note_of_tie(leaf: str, nominal: np.ndarray) -> tuple[str, ...]:
    low, high, mean = nominal.min(), nominal.max(), nominal.mean()
    if low == high:
        return ()
    return (f"{leaf} is tied, but goes from {low:.3g} to {high:.3g} in the given plant: it starts at the mean, {mean:.3g}",)
