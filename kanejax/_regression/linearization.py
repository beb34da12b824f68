"""The predicted signals of a plant, and their derivatives with respect to the parameters that are sought.

Reverse mode, once for each signal, through the recursion to the parameters of links and drives; from there to the parameters
that are sought, a product with a matrix that is the same for all states.
"""

import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._dynamics.regressor import prepare_with
from kanejax._evaluate import evaluate_prepared
from kanejax._model.prepared import Prepared
from kanejax._model.tree import Tree
from kanejax._parameters.parameterization import Parameterization
from kanejax._parameters.plant import Drives, force_and_load, motor_signal

# Samples that are evaluated at a time.
CHUNK = 512

_INERTIA = {"links.mass", "links.first_moment", "links.second_moment"}
_PLACEMENT = {"links.rotation", "links.position", *_INERTIA}
# What of the prepared parameters depends on which leaves of a model, where they are not of the same name.
_DEPENDENT = {
    **dict.fromkeys(("inertia", "mass", "com", "central_inertia"), _INERTIA),
    **dict.fromkeys(("body_position", "body_quaternion", "joint_axis", "joint_anchor"), _PLACEMENT),
}


class Samples(NamedTuple):
    """States and measured signals at many times, one a row; of all runs, for their order does not matter here.

    Attributes:
        q, u, u_dot: the motion at the time that the signal belongs to, (n, ...).
        effort: measured signals, (n, nv).
        weight: 0 for signals that do not count, otherwise 1, (n, nv).
        rates: of q, u and u_dot, for the delay; None where it is not sought.
    """

    q: jax.Array
    u: jax.Array
    u_dot: jax.Array
    effort: jax.Array
    weight: jax.Array
    rates: tuple[jax.Array, jax.Array, jax.Array] | None = None


class Linearization(NamedTuple):
    """Parameters that the recursions and the drives need, and how they depend on those that are sought."""

    leaves: dict[str, jax.Array]
    fixed: tuple[Prepared, Drives]
    matrix: Float[Array, "leaves n"]


@jax.jit
def linearization(parameterization: Parameterization, phi: Float[Array, " n"]) -> Linearization:
    """Prepare the evaluation at `phi`: once for all states."""
    prepared, drives = _prepared(parameterization, phi)
    sought = [unknown.leaf for unknown in parameterization.unknowns if unknown.leaf != "delay"]
    names = sorted(set().union(*(_DEPENDENT.get(leaf, {leaf}) for leaf in sought)))

    def dependent(phi: jax.Array) -> dict[str, jax.Array]:
        return _leaves(names, *_prepared(parameterization, phi))

    leaves, derivative = _leaves(names, prepared, drives), jax.jacfwd(dependent)(phi)
    rows = [derivative[name].reshape(-1, len(phi)) for name in leaves]
    matrix = jnp.concatenate(rows) if rows else jnp.zeros((0, len(phi)), phi.dtype)
    return Linearization(leaves, (prepared, drives), matrix)


def predicted(tree: Tree, at: Linearization, q: jax.Array, u: jax.Array, u_dot: jax.Array) -> Float[Array, " nv"]:
    """The signals at one state."""
    return _signals(tree, at.leaves, at.fixed, q, u, u_dot)


def predicted_with_derivative(
    tree: Tree, at: Linearization, sample: Samples, delay: int | None
) -> tuple[Float[Array, " nv"], Float[Array, "nv n"]]:
    """The signals at one state, and their derivative; `delay` is the index of that parameter, if it is sought."""
    state = sample.q, sample.u, sample.u_dot
    value = predicted(tree, at, *state)
    columns = []
    if at.leaves:
        by_leaves = jax.jacrev(lambda leaves: _signals(tree, leaves, at.fixed, *state))(at.leaves)
        columns = [by_leaves[name].reshape(tree.nv, -1) for name in at.leaves]
    wide = jnp.concatenate(columns, 1) if columns else jnp.zeros((tree.nv, 0), value.dtype)
    derivative = jnp.matmul(wide, at.matrix, precision="highest")
    if delay is not None and sample.rates is not None:
        later = jax.jvp(lambda *x: predicted(tree, at, *x), state, sample.rates)[1]
        derivative = derivative.at[:, delay].set(-later)
    return value, derivative


@functools.partial(jax.jit, static_argnames="tree")
def predicted_at_samples(tree: Tree, at: Linearization, samples: Samples) -> Float[Array, "samples nv"]:
    """`predicted` at many states."""
    return jax.vmap(lambda sample: predicted(tree, at, sample.q, sample.u, sample.u_dot))(samples)


@functools.partial(jax.jit, static_argnames=("tree", "delay"))
def predicted_with_derivatives(
    tree: Tree, at: Linearization, samples: Samples, delay: int | None
) -> tuple[Float[Array, "samples nv"], Float[Array, "samples nv n"]]:
    """`predicted_with_derivative` at many states."""
    return jax.vmap(lambda sample: predicted_with_derivative(tree, at, sample, delay))(samples)


def chunks(samples: Samples, size: int = CHUNK) -> Iterator[Samples]:
    """Samples in pieces of one size, so that logs of all lengths take the same programs; copies that do not count fill the last."""
    whole = jax.tree.map(np.asarray, samples)
    for first in range(0, len(whole.q), size):
        piece = jax.tree.map(lambda x: x[first : first + size], whole)  # noqa: B023
        if spare := size - len(piece.q):
            piece = jax.tree.map(lambda x: np.concatenate((x, np.broadcast_to(x[-1:], (spare, *x.shape[1:])))), piece)
            piece.weight[-spare:] = 0.0
        yield piece


def derivatives(parameterization: Parameterization, at: Linearization, samples: Samples) -> Float[np.ndarray, "samples nv n"]:
    """How the signals depend on what is sought, at so many samples that they fit into memory."""
    tree, delay = parameterization.tree, delay_index(parameterization)
    parts = [np.asarray(predicted_with_derivatives(tree, at, piece, delay)[1]) for piece in chunks(samples)]
    return np.concatenate(parts)[: len(samples.q)]


def delay_index(parameterization: Parameterization) -> int | None:
    """Which of the parameters that are sought is the delay."""
    return parameterization.names.index("delay") if "delay" in parameterization.names else None


def _prepared(parameterization: Parameterization, phi: jax.Array) -> tuple[Prepared, Drives]:
    plant, parameters = parameterization.assemble(phi)
    return prepare_with(plant.model, parameters), plant.drives


def _leaves(names: list[str], prepared: Prepared, drives: Drives) -> dict[str, jax.Array]:
    parts = {"links": prepared.links}
    found = {}
    for name in names:
        owner, _, leaf = name.rpartition(".")
        whole: Any = parts[owner] if owner else prepared if leaf in Prepared._fields else drives
        found[name] = getattr(whole, leaf)
    return found


def _with(leaves: dict[str, jax.Array], prepared: Prepared, drives: Drives) -> tuple[Prepared, Drives]:
    """Put leaves that were taken out back in their places."""
    links = prepared.links._replace(**{name[6:]: x for name, x in leaves.items() if name.startswith("links.")})
    own = {name: x for name, x in leaves.items() if name in Prepared._fields}
    others = {name: x for name, x in leaves.items() if not name.startswith("links.") and name not in Prepared._fields}
    return prepared._replace(links=links, **own), drives.replace(**others)


def _signals(
    tree: Tree, leaves: dict[str, jax.Array], fixed: tuple[Prepared, Drives], q: jax.Array, u: jax.Array, u_dot: jax.Array
) -> jax.Array:
    prepared, drives = _with(leaves, *fixed)
    force, load = evaluate_prepared(force_and_load, tree, prepared, q, u, u_dot)
    return motor_signal(drives, prepared.friction_width, force, load, u)
