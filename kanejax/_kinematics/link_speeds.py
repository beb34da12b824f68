"""Generalized speeds after Nie's advice: the angular velocity of a link in the middle of the chain, II.2."""

import itertools
from collections.abc import Sequence
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float, Int

from kanejax._kinematics.partial_velocity import partial_velocities
from kanejax._kinematics.pose import poses
from kanejax._model.generalized_speeds import AbstractSpeeds, SpeedTerms
from kanejax._model.model import Model
from kanejax._model.specialized import Specialized
from kanejax._model.tree import Tree
from kanejax._types import Coordinates

COMPONENTS = ("x", "y", "z")
SAMPLES = 256
# Choices whose mean determinant is this near to the best are equally good, and the first of them is taken.
TIE = 0.9
SINGULAR = 1e-6


@final
class LinkSpeeds(AbstractSpeeds):
    """Components of a body's angular velocity along its own axes, in place of the rates of some of its revolute joints.

    Attributes:
        body: index of the body; static.
        slots: the generalized speeds that are replaced; static.
        components: the component, 0 to 2 for x to z, in place of each; static.
    """

    body: int = eqx.field(static=True)
    slots: tuple[int, ...] = eqx.field(static=True)
    components: tuple[int, ...] = eqx.field(static=True)

    def terms(self, model: Model | Specialized, q: Coordinates, t: Float[Array, ""]) -> SpeedTerms:
        """Rows of the identity matrix, and in the slots the partial angular velocities of the body, Nie (2.17)-(2.18)."""
        rows = body_axes(model, q, self.body)
        matrix = jnp.eye(model.nv, dtype=q.dtype).at[np.array(self.slots)].set(rows[np.array(self.components)])
        return SpeedTerms(matrix, jnp.zeros(model.nv, q.dtype))


def link_speeds(
    model: Model | Specialized,
    body: str | None = None,
    *,
    joints: Sequence[str] | None = None,
    components: Sequence[str] | None = None,
) -> LinkSpeeds:
    """Speeds for `with_speeds` that make the angular velocity of one body as simple as can be, as Nie (2.18) does.

    Components of the body's angular velocity along its own axes replace the rates of as many revolute joints that move it; all
    other speeds stay the model's own. Three components, or as many as are independent: two where two joints turn the body, or
    where the axes of all of them stay in one plane. What is not given is chosen so that the determinant of Y is greatest in the
    mean over random configurations, the first joints and components among equals. Y follows the model's leaves.

    Args:
        model: the mechanism.
        body: name of the body; by default the one in the middle, as in the thesis: on the path from the world that has most
            revolute joints, n of them, the body that the joint number (n + 1) // 2 moves.
        joints: names of the revolute joints whose rates are replaced.
        components: "x", "y" or "z" in place of each joint, in the same order.

    Raises:
        UnknownNameError: there is no such body or joint.
        ValueError: a joint is not revolute or does not move the body; components are not as many as joints; the components never
            determine the rates; or there is something to choose, and the model's leaves are traced.
    """
    tree = model.tree
    chosen = middle_body(tree) if body is None else tree.body(body)
    movers = revolute_joints(tree, chosen)
    if not movers:
        raise ValueError(f"no revolute joint moves body {tree.body_names[chosen]!r}: its angular velocity replaces no rates")
    slots = None if joints is None else tuple(_slot(tree, chosen, name) for name in joints)
    rows = None if components is None else tuple(_component(name) for name in components)
    if slots is not None and rows is not None and not 0 < len(slots) == len(rows):
        raise ValueError(f"{len(rows)} components replace the rates of as many joints, but {len(slots)} are given")
    known = not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(model))
    if known:
        slots, rows = _best(model, chosen, slots, rows, tuple(tree.v_start[joint] for joint in movers))
    elif slots is None or rows is None:
        raise ValueError("a model under jit, vmap or grad has no values to choose by; give joints and components")
    return LinkSpeeds(chosen, slots, rows)


def body_axes(model: Model | Specialized, q: Coordinates, body: Int[ArrayLike, ""]) -> Float[Array, "3 nv"]:
    """Partial angular velocities of a body: columns of components along its own axes."""
    rotation = poses(model, q).rotation[body]
    return jnp.matmul(rotation.T, partial_velocities(model, q).angular[body].T, precision="highest")


def middle_body(tree: Tree) -> int:
    """Of the path from the world with most revolute joints, n of them, the body that joint (n + 1) // 2 moves."""
    paths = [revolute_joints(tree, body) for body in range(tree.nbody)]
    longest = max(paths, key=len, default=[])
    if not longest:
        raise ValueError("a model without revolute joints has no rates that the angular velocity of a body can replace")
    return tree.joint_bodies[longest[(len(longest) + 1) // 2 - 1]]


def revolute_joints(tree: Tree, body: int) -> list[int]:
    """The revolute joints that move a body."""
    moving = tree.body_moved_by[body]
    return [j for j, kind in enumerate(tree.joint_types) if kind == "revolute" and moving[tree.v_start[j]]]


def _best(
    model: Model | Specialized,
    body: int,
    slots: tuple[int, ...] | None,
    rows: tuple[int, ...] | None,
    movers: tuple[int, ...],
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The largest number of rates that can be replaced, and the choice with the greatest mean determinant."""
    axes = _sampled_axes(model, body)
    given = slots or rows
    for count in [len(given)] if given else range(min(3, len(movers)), 0, -1):
        choices = [
            (columns, components)
            for columns in ([slots] if slots else itertools.combinations(movers, count))
            for components in ([rows] if rows else itertools.combinations(range(3), count))
        ]
        means = np.array([np.abs(np.linalg.det(axes[:, r][:, :, c])).mean() for c, r in choices])
        if len(means) and means.max() > SINGULAR:
            return choices[int(np.argmax(means >= TIE * means.max()))]
    names = ", ".join(repr(model.tree.joint_names[model.tree.speed_joints[slot]]) for slot in slots or movers)
    raise ValueError(
        f"these components of the angular velocity of body {model.tree.body_names[body]!r} never determine the rates of {names}: "
        "axes lie in one plane, or too many rates are replaced; give fewer joints or others"
    )


def _sampled_axes(model: Model | Specialized, body: int) -> np.ndarray:
    """The body's partial angular velocities, (SAMPLES, 3, nv), at random coordinates."""
    rng = np.random.default_rng(0)
    q = jnp.asarray(rng.uniform(-np.pi, np.pi, (SAMPLES, model.nq)), model.dtype)
    with jax.ensure_compile_time_eval():
        return np.asarray(_axes_of_states(model, q, body), np.float64)


@jax.jit
def _axes_of_states(model: Model | Specialized, q: Float[Array, "_ nq"], body: Int[ArrayLike, ""]) -> Float[Array, "_ 3 nv"]:
    return jax.vmap(body_axes, (None, 0, None))(model, q, body)


def _slot(tree: Tree, body: int, name: str) -> int:
    joint = tree.joint(name)
    if joint not in revolute_joints(tree, body):
        raise ValueError(f"joint {name!r} is not a revolute joint that moves body {tree.body_names[body]!r}")
    return tree.v_start[joint]


def _component(name: str) -> int:
    if name not in COMPONENTS:
        raise ValueError(f"component {name!r} is unknown; give 'x', 'y' or 'z'")
    return COMPONENTS.index(name)
