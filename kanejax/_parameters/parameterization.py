"""All that is sought of a plant: theta, free coordinates; phi, the numbers themselves; and the plant that has them."""

from collections.abc import Sequence
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from kanejax._model.inertia import inertia_parameters, with_inertia_parameters
from kanejax._model.tree import Tree
from kanejax._parameters.block import Block, CarriedAlong, block
from kanejax._parameters.leaves import LEAVES
from kanejax._parameters.plant import Plant
from kanejax._parameters.unknowns import Unknown

# Leaves in which the signals are affine together, as long as friction does not depend on the load.
_AFFINE = {"inertia", "mass", "armature", "damping", "coulomb_friction", "stiffness", "offset", "stribeck_friction"}
_OF_INERTIA = ("mass", "com", "central_inertia")


@final
class Parameterization(eqx.Module):
    """Maps between free coordinates theta, numbers phi, and plants; pure functions of theta and phi, for jit, vmap and grad.

    Attributes:
        given: the plant that the numbers are sought of.
        blocks: the numbers of each unknown.
        specification: the unknowns that it was made from.
        linear: whether the signals of `signal` are affine in phi.
    """

    given: Plant
    blocks: tuple[Block, ...]
    specification: CarriedAlong = eqx.field(static=True)
    linear: bool = eqx.field(static=True)

    @property
    def tree(self) -> Tree:
        """Topology of the mechanism."""
        return self.given.model.tree

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """What is sought, one for each of the blocks."""
        return self.specification.value

    @property
    def names(self) -> tuple[str, ...]:
        """Of each number in phi, such as "link3.mcx", "joint2.damping" and "delay"; a tie is one number, "a,b.damping"."""
        return tuple(name for each in self.blocks for name in each.names)

    @property
    def units(self) -> tuple[str, ...]:
        """Of each number in phi; empty for pure numbers."""
        return tuple(unit for each in self.blocks for unit in each.units)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on where the start is not the given plant."""
        return tuple(note for each in self.blocks for note in each.notes.value)

    @property
    def phi0(self) -> Float[Array, " n"]:
        """The numbers of the given plant, as they are."""
        return jnp.concatenate([each.nominal for each in self.blocks])

    @property
    def theta0(self) -> Float[Array, " m"]:
        """The start: the given plant where it is physical and away from bounds, else near to it; `notes` says where."""
        return jnp.concatenate([each.theta0 for each in self.blocks])

    def phi(self, theta: Float[Array, " m"]) -> Float[Array, " n"]:
        """The numbers at these coordinates, all of which are physical and within bounds."""
        parts = zip(self.blocks, self._split(theta, 0), strict=True)
        return jnp.concatenate([each.coordinates.phi(part) for each, part in parts])

    def theta_of(self, phi: Float[Array, " n"]) -> Float[Array, " m"]:
        """The coordinates of these numbers, or of the nearest that are physical and within bounds."""
        parts = zip(self.blocks, self._split(phi, 1), strict=True)
        return jnp.concatenate([each.coordinates.theta(part) for each, part in parts])

    def step_limits(self, theta: Float[Array, " m"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """Least and greatest step along the coordinates that `moved` takes: derivatives vanish near the borders."""
        parts = zip(self.blocks, self._split(theta, 0), strict=True)
        least, greatest = zip(*(each.coordinates.step_limits(part) for each, part in parts), strict=True)
        return jnp.concatenate(least), jnp.concatenate(greatest)

    def moved(self, theta: Float[Array, " m"], step: Float[Array, " m"]) -> Float[Array, " m"]:
        """The coordinates after a step within the limits; single numbers change as their derivatives say.

        Args:
            theta: coordinates before it.
            step: their change, no longer than `step_limits`.
        """
        parts = zip(self.blocks, self._split(theta, 0), self._split(step, 0), strict=True)
        return jnp.concatenate([each.coordinates.moved(*rest) for each, *rest in parts])

    def at_border(self, theta: Float[Array, " m"]) -> Bool[Array, " n"]:
        """Which numbers in phi are all but at their bounds, and which belong to bodies that are all but flat or without mass."""
        parts = zip(self.blocks, self._split(theta, 0), strict=True)
        return jnp.concatenate([each.coordinates.at_border(part) for each, part in parts])

    def prior(self, theta: Float[Array, " m"]) -> Float[Array, " k"]:
        """Residuals whose squares sum to minus twice the logarithm of the prior; empty where nothing has one."""
        parts = zip(self.blocks, self._split(theta, 0), strict=True)
        return jnp.concatenate([each.prior_residuals(part) for each, part in parts])

    def assemble(self, phi: Float[Array, " n"]) -> tuple[Plant, Float[Array, "nbody 10"]]:
        """The plant with these numbers in its leaves, and the inertia parameters of all bodies.

        Where "inertia" is sought, the inertia parameters count, and mass, com and central_inertia of the plant are the given ones:
        so this is defined, and affine, for inertia parameters that no body can have.
        """
        parts, plant = self._split(phi, 1), self.given
        for each, part in zip(self.blocks, parts, strict=True):
            plant = each.written(plant, part)
        parameters = inertia_parameters(plant.model)
        for each, part in zip(self.blocks, parts, strict=True):
            if each.leaf == "inertia":
                parameters = parameters.at[np.array(each.rows)].set(part.reshape(-1, 10))
        return plant, parameters

    def plant(self, theta: Float[Array, " m"]) -> Plant:
        """The plant at these coordinates, with mass, com and central_inertia of what was found."""
        plant, parameters = self.assemble(self.phi(theta))
        rows = np.array([row for each in self.blocks if each.leaf == "inertia" for row in each.rows], int)
        found = with_inertia_parameters(plant.model, parameters)
        leaves = {name: getattr(plant.model, name).at[rows].set(getattr(found, name)[rows]) for name in _OF_INERTIA}
        return eqx.tree_at(lambda p: p.model, plant, plant.model.replace(**leaves))

    def starts(self, key: PRNGKeyArray, count: int, spread: float = 0.3) -> Float[Array, "count m"]:
        """Random coordinates, normally distributed about `theta0`, which is the first.

        Args:
            key: of the random numbers.
            count: how many, `theta0` included.
            spread: standard deviation of each coordinate.
        """
        theta0 = self.theta0
        noise = spread * jax.random.normal(key, (count, len(theta0)), theta0.dtype)
        return theta0[None] + noise.at[0].set(0.0)

    def _split(self, vector: jax.Array, which: int) -> list[jax.Array]:
        sizes = [each.coordinates.sizes[which] for each in self.blocks]
        if vector.shape != (sum(sizes),):
            raise ValueError(f"{('theta', 'phi')[which]} has shape {vector.shape}, but this parameterization needs ({sum(sizes)},)")
        return jnp.split(vector, np.cumsum(sizes)[:-1])


def parameterization(plant: Plant, unknowns: Sequence[Unknown | str]) -> Parameterization:
    """Say what is sought of a plant.

    Args:
        plant: the given, nominal plant; its numbers must be known, so not under `jax.jit`.
        unknowns: what is sought; a leaf's name stands for all of it.

    Raises:
        UnknownNameError: there is no such leaf, body or joint; the message lists those there are.
        InvalidParameterError: a number of the plant is not finite, or outside of its bounds.
        ValueError: nothing is sought, or something twice; or an unknown selects nothing, or numbers that do not exist.
    """
    specifications = tuple(Unknown(unknown) if isinstance(unknown, str) else unknown for unknown in unknowns)
    if not specifications:
        raise ValueError("nothing is sought; give at least one unknown, such as 'inertia'")
    plant.model.__check_init__()
    blocks = tuple(block(plant, unknown) for unknown in specifications)
    _check_conflicts(blocks, plant.model.tree)
    leaves = {unknown.leaf for unknown in specifications}
    linear = leaves <= _AFFINE and not np.any(np.asarray(plant.drives.load_friction))
    return Parameterization(plant, blocks, CarriedAlong(specifications), bool(linear))


def _check_conflicts(blocks: tuple[Block, ...], tree: Tree) -> None:
    """Raise ValueError where a number is sought twice, also as a part of "inertia"."""
    sought: set[tuple[str, int]] = set()
    for part in blocks:
        for row in part.rows:
            if (part.leaf, row) in sought:
                raise ValueError(f"{_owner(part.leaf, row, tree)}: {part.leaf!r} is sought twice")
            sought.add((part.leaf, row))
    for leaf, row in sorted(sought):
        if leaf in _OF_INERTIA and ("inertia", row) in sought:
            raise ValueError(f"body {tree.body_names[row]!r}: {leaf!r} is part of 'inertia', which is sought too; leave one out")


def _owner(leaf: str, row: int, tree: Tree) -> str:
    place = LEAVES[leaf].place
    if place == "plant":
        return "the plant"
    if place == "body":
        return f"body {tree.body_names[row]!r}"
    if place == "speed":
        row = int(tree.speed_joints[row])
    elif place == "coordinate":
        row = int(np.searchsorted(tree.q_start, row, side="right")) - 1
    return f"joint {tree.joint_names[row]!r}"
