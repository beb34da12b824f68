"""A body more, welded to one of a model: a payload or a tool, whose inertia can then be sought."""

import dataclasses
from typing import Any

import jax.numpy as jnp

from kanejax._model.model import Model
from kanejax._model.tree import WORLD, Tree

_LEAVES = {"position": "body_position", "quaternion": "body_quaternion"}


def with_payload(
    model: Model,
    body: str,
    name: str = "payload",
    *,
    position: Any = (0.0, 0.0, 0.0),
    quaternion: Any = (1.0, 0.0, 0.0, 0.0),
    mass: Any = 0.0,
    com: Any = (0.0, 0.0, 0.0),
    central_inertia: Any = ((0.0,) * 3,) * 3,
) -> Model:
    """The model with a body more, fixed to one that it has.

    Without mass it changes nothing; `Unknown("inertia", of="payload", scale=(2.0, 0.1))` then seeks its inertia, from a ball of
    2 kg with a radius of gyration of 0.1 m. The joints keep their order; the body comes after all those that hang on the one it
    is fixed to, as MuJoCo would have it.

    Args:
        model: the mechanism.
        body: name of the body that carries the payload.
        name: of the payload.
        position: of its frame in the carrying body's [m], (3,).
        quaternion: (w, x, y, z) of its frame in the carrying body's, (4,).
        mass: [kg], ().
        com: mass centre in the payload's frame [m], (3,).
        central_inertia: about the mass centre in the payload's axes [kg m^2], (3, 3).

    Raises:
        UnknownNameError: there is no body to carry it; the message lists those there are.
        ValueError: a body has its name already, or a shape is wrong.
    """
    tree = model.tree
    if name in tree.body_names:
        raise ValueError(f"a body is named {name!r} already; give the payload another name")
    parent = tree.body(body)
    row = 1 + max(index for index in range(tree.nbody) if parent in _ancestors(tree, index))
    numbers = {"position": position, "quaternion": quaternion, "mass": mass, "com": com, "central_inertia": central_inertia}
    inserted = {}
    for number, value in numbers.items():
        leaf = _LEAVES.get(number, number)
        own, new = getattr(model, leaf), jnp.asarray(value)
        if new.shape != own.shape[1:]:
            raise ValueError(f"{number} of payload {name!r} has shape {new.shape}, but needs {own.shape[1:]}")
        inserted[leaf] = jnp.concatenate((own[:row], new.astype(own.dtype)[None], own[row:]))
    return dataclasses.replace(model, tree=_with_body(tree, row, parent, name), **inserted)


def _with_body(tree: Tree, row: int, parent: int, name: str) -> Tree:
    parents = [index + (index >= row) for index in tree.body_parents]
    return dataclasses.replace(
        tree,
        body_names=(*tree.body_names[:row], name, *tree.body_names[row:]),
        body_parents=(*parents[:row], parent, *parents[row:]),
        joint_bodies=tuple(index + (index >= row) for index in tree.joint_bodies),
    )


def _ancestors(tree: Tree, body: int) -> set[int]:
    """The bodies that carry a body, and itself."""
    found = set()
    while body != WORLD:
        found.add(body)
        body = tree.body_parents[body]
    return found
