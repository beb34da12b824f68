"""Sweeps over the links of a tree, base to tip and tip to base, in scalar form.

Each segment of the plan is one `lax.scan` over its links, whose carry and inputs are tuples of scalars. So a program has a
few loops whatever the number of bodies, compiles in about a second, and runs in time linear in it.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from kanejax._model.joints import AbstractJoint
from kanejax._model.links import LinkParameters, Rows
from kanejax._model.plan import NONE, Segment, segments
from kanejax._model.tree import COORDINATES, SPEEDS, WORLD, Tree
from kanejax._scalar import add, barrier, is_known
from kanejax._types import Matrix, Scalar, Symmetric, Vector

PyTree = Any
Step = Callable[[type[AbstractJoint], PyTree, PyTree], tuple[PyTree, PyTree]]


class Frames(NamedTuple):
    """Rotation to the components of an outer frame, and position of the origin in it."""

    rotation: Matrix
    position: Vector


class Link(NamedTuple):
    """Parameters of one link, or of all of a segment: `LinkParameters` by component."""

    placement: Frames
    mass: Scalar
    first_moment: Vector
    inertia: Symmetric


def split_parameters(tree: Tree, parameters: LinkParameters) -> list[Link]:
    """Link parameters by component, (length, *batch), for each segment."""
    rotation, position, mass, first_moment, inertia = (_split(tree, leaf) for leaf in parameters)
    parts = zip(rotation, position, mass, first_moment, inertia, strict=True)
    return [
        Link(
            Frames(tuple(tuple(r[:, i, j] for j in range(3)) for i in range(3)), tuple(p[:, i] for i in range(3))),  # type: ignore[arg-type]
            m,
            tuple(h[:, i] for i in range(3)),  # type: ignore[arg-type]
            tuple(c[:, i] for i in range(6)),  # type: ignore[arg-type]
        )
        for r, p, m, h, c in parts
    ]


def _split(tree: Tree, of_links: Rows) -> list[Rows]:
    """Rows of an array over the links for each segment."""
    return [_take(of_links, segment.links) for segment in segments(tree)]


def _take(leaf: Rows, rows: Sequence[int] | np.ndarray) -> Rows:
    """Rows of an array: a slice where they follow one another, for that costs no gather."""
    index = np.asarray(rows, dtype=int)
    if len(index) and np.array_equal(index, np.arange(index[0], index[0] + len(index))):
        return leaf if len(index) == leaf.shape[0] else leaf[index[0] : index[0] + len(index)]
    return leaf[index]


def split_coordinates(tree: Tree, q: jax.Array) -> list[tuple[Scalar, ...]]:
    """Coordinates (nq, *batch) as one component for each coordinate of the joint type, for each segment."""
    return _split_joints(tree, q, tree.q_start, COORDINATES)


def split_speeds(tree: Tree, u: jax.Array) -> list[tuple[Scalar, ...]]:
    """Speeds or forces (nv, *batch), likewise."""
    return _split_joints(tree, u, tree.v_start, SPEEDS)


def _split_joints(tree: Tree, x: jax.Array, starts: Sequence[int], sizes: dict[str, int]) -> list[tuple[Scalar, ...]]:
    parts = []
    for segment in segments(tree):
        first = np.array([starts[link] for link in segment.links])
        size = sizes[tree.joint_types[segment.links[0]]]
        parts.append(tuple(_take(x, first + offset) for offset in range(size)))
    return parts


def joint_features(tree: Tree, q: jax.Array) -> list[tuple[Scalar, ...]]:
    """Sines, cosines, displacements or quaternions of every joint, for each segment."""
    parts = []
    for segment, coordinates in zip(segments(tree), split_coordinates(tree, q), strict=True):
        mask = np.array([tree.joint_types[link] == "revolute" for link in segment.links], q.dtype)
        parts.append(segment.joint.features(coordinates, jnp.asarray(mask.reshape((-1,) + (1,) * (q.ndim - 1)))))
    return barrier(parts)


def join_links[T](tree: Tree, parts: list[T], like: jax.Array) -> T:
    """Put components of (length, *batch) for each segment back together as (nlink, *batch), the batch that of `like`."""
    order = [link for segment in segments(tree) for link in segment.links]
    rows = [jax.tree.map(lambda x: as_rows(x, len(s.links), like), part) for s, part in zip(segments(tree), parts, strict=True)]  # noqa: B023
    joined = rows[0] if len(rows) == 1 else jax.tree.map(lambda *x: jnp.concatenate(x), *barrier(rows))
    return jax.tree.map(lambda x: _take(x, np.argsort(order)), joined)


def join_speeds(tree: Tree, parts: list[tuple[Scalar, ...]], like: jax.Array) -> jax.Array:
    """Put one component for each speed of the joint type, for each segment, back together as (nv, *batch)."""
    rows, order = [], []
    for segment, part in zip(segments(tree), parts, strict=True):
        for offset, component in enumerate(part):
            rows.append(as_rows(component, len(segment.links), like))
            order += [tree.v_start[link] + offset for link in segment.links]
    joined = rows[0] if len(rows) == 1 else jnp.concatenate(barrier(rows))
    return jnp.asarray(_take(joined, np.argsort(order)))


def as_rows(component: Scalar, length: int, like: jax.Array) -> jax.Array:
    """One component of a segment's links as an array (length, *batch), whether it was looped over, unrolled, or known."""
    shape = like.shape[1:]
    if isinstance(component, Column):
        # Materialised before and after: XLA evaluates what is fused into a stack for every row of it.
        return barrier(jnp.stack(barrier([jnp.broadcast_to(jnp.asarray(x, like.dtype), shape) for x in component.rows])))
    return jnp.broadcast_to(jnp.asarray(component, like.dtype), (length, *shape))


class Column:
    """One component of the links of an unrolled segment, some of them known numbers; a leaf for `jax.tree`."""

    def __init__(self, *rows: Scalar) -> None:
        self.rows = rows

    def __getitem__(self, row: int) -> Scalar:
        """The component of one link."""
        return self.rows[row]


def is_frozen(rows: PyTree) -> bool:
    """Whether rows hold numbers that are known while tracing; then loops over them are unrolled, so that products fold."""
    return any(isinstance(x, np.ndarray | Column) for x in jax.tree.leaves(rows))


def base_to_tip(tree: Tree, step: Step, root: PyTree, inputs: list[PyTree], like: jax.Array, unroll: int = 1) -> list[PyTree]:
    """Run `step(joint type, state of the parent link, inputs of the link) -> (its state, its output)` over all links.

    `root` is the world's state, of known numbers or scalars of the batch's shape, which is that of `like` (n, *batch).
    `inputs` and the result are lists over the segments. Segments of no more than `unroll` links are unrolled.
    """
    states: dict[int, PyTree] = {WORLD: root}
    outputs: list[PyTree] = []
    plan = segments(tree)
    carriers = {segment.carrier for segment in plan}
    for segment, rows in zip(plan, inputs, strict=True):
        of_type = functools.partial(step, segment.joint)
        if _unrolled(segment, rows, unroll):
            collected = []
            for i, link in enumerate(segment.links):
                states[link], output = barrier(of_type(states[tree.link_parents[link]], _row(rows, i)))
                collected.append(output)
            outputs.append(jax.tree.map(Column, *collected))
            continue
        tip, kept, output = _outward(segment, of_type, _filled(states[segment.carrier], like), rows)
        outputs.append(output)
        for link in carriers.intersection(segment.links):
            slot = segment.kept(link)
            states[link] = tip if slot == NONE else jax.tree.map(lambda x: x[slot], kept)  # noqa: B023
    return outputs


def tip_to_base(tree: Tree, step: Step, zero: PyTree, inputs: list[PyTree], like: jax.Array, unroll: int = 1) -> list[PyTree]:
    """Run `step(joint type, sum over the children, inputs of the link) -> (what its parent receives, its output)`.

    `zero` is what a link without children receives; the rest is as for `base_to_tip`.
    """
    plan = segments(tree)
    received: dict[int, PyTree] = {}
    outputs: list[PyTree] = [None] * len(plan)
    for number in reversed(range(len(plan))):
        segment, rows = plan[number], inputs[number]
        of_type = functools.partial(step, segment.joint)
        if _unrolled(segment, rows, unroll):
            collected: list[PyTree] = [None] * len(segment.links)
            for i, link in reversed(list(enumerate(segment.links))):
                sent, collected[i] = barrier(of_type(received.get(link, zero), _row(rows, i)))
                _hand_over(received, tree.link_parents[link], sent)
            outputs[number] = jax.tree.map(Column, *collected)
        else:
            from_outside = {link: _filled(received[link], like) for link in segment.links if link in received}
            sent, outputs[number] = _inward(segment, of_type, _filled(zero, like), from_outside, rows)
            _hand_over(received, segment.carrier, sent)
    return outputs


def _filled(state: PyTree, like: jax.Array) -> PyTree:
    """Every scalar as an array of the batch's shape, also known numbers and those of parameters alone: a loop's carry must be."""
    shape = like.shape[1:]

    def fill(x: Scalar) -> jax.Array:
        x = jnp.asarray(x, like.dtype)
        return jnp.broadcast_to(x, jnp.broadcast_shapes(x.shape, shape))

    return jax.tree.map(fill, state)


def _unrolled(segment: Segment, rows: PyTree, unroll: int) -> bool:
    return len(segment.links) <= unroll or is_frozen(rows)


def _row(rows: PyTree, i: int) -> PyTree:
    """Inputs of one link; constants become known numbers."""

    def pick(x: Scalar) -> Scalar:
        if is_known(x):
            return x
        return float(x[i]) if isinstance(x, np.ndarray) else x[i]

    return jax.tree.map(pick, rows)


def _hand_over(received: dict[int, PyTree], link: int, sent: PyTree) -> None:
    received[link] = jax.tree.map(add, received[link], sent) if link in received else sent


def _outward(segment: Segment, step: Callable, start: PyTree, rows: PyTree) -> tuple[PyTree, PyTree, PyTree]:
    """Loop from base to tip: the last link's state, the slots, and the outputs."""
    if not segment.branches:
        tip, output = _scan(step, start, rows, reverse=False)
        return tip, None, output
    # One slot more than there are takes what nobody needs.
    slots = jax.tree.map(lambda x: jnp.broadcast_to(x[None], (segment.slots + 1, *x.shape)), start)

    def branching_step(carry: tuple[PyTree, PyTree], row: tuple) -> tuple[tuple[PyTree, PyTree], PyTree]:
        (before, slots), (restores, restore, saves, save, inputs) = carry, row
        parent = jax.tree.map(lambda kept, state: jnp.where(restores, _read(kept, restore), state), slots, before)
        state, output = step(parent, inputs)
        # Conditionals, not selections: most links leave the slots alone, and then nothing is moved.
        slots = lax.cond(saves, lambda: jax.tree.map(lambda kept, x: _write(kept, save, x), slots, state), lambda: slots)
        return (state, slots), output

    (tip, kept), output = _scan(branching_step, (start, slots), (*_slot_rows(segment), rows), reverse=False)
    return tip, kept, output


def _inward(segment: Segment, step: Callable, zero: PyTree, received: dict[int, PyTree], rows: PyTree) -> tuple[PyTree, PyTree]:
    """Loop from tip to base: what the carrier receives, and the outputs."""
    start = received.get(segment.links[-1], zero)
    if not segment.branches:
        return _scan(step, start, rows, reverse=True)
    slots = jax.tree.map(lambda x: jnp.zeros((segment.slots + 1, *x.shape), x.dtype), zero)
    for link in segment.links[:-1]:
        if link in received:
            slots = jax.tree.map(lambda kept, x: kept.at[segment.kept(link)].set(x), slots, received[link])  # noqa: B023

    def branching_step(carry: tuple[PyTree, PyTree], row: tuple) -> tuple[tuple[PyTree, PyTree], PyTree]:
        (after, slots), (restores, restore, _, save, ends, inputs) = carry, row
        outer = jax.tree.map(lambda kept, x: jnp.where(ends, 0.0, x) + _read(kept, save), slots, after)
        sent, output = step(outer, inputs)
        slots = lax.cond(restores, lambda: jax.tree.map(lambda kept, x: _add(kept, restore, x), slots, sent), lambda: slots)
        return (sent, slots), output

    ends = [leaf and link != segment.links[-1] for leaf, link in zip(segment.leaves, segment.links, strict=True)]
    (sent, slots), output = _scan(branching_step, (start, slots), (*_slot_rows(segment), jnp.array(ends), rows), reverse=True)
    return jax.tree.map(lambda x, kept: x + kept[0], sent, slots), output


def _slot_rows(segment: Segment) -> tuple[jax.Array, ...]:
    """Whether and where each link restores its parent's state, and where it saves its own; the last slot is for nothing."""
    restore, save = np.array(segment.restore, np.int32), np.array(segment.save, np.int32)
    spare = np.int32(segment.slots)
    rows = (restore != NONE, np.where(restore == NONE, spare, restore), save != NONE, np.where(save == NONE, spare, save))
    return tuple(jnp.asarray(row) for row in rows)


def _read(slots: jax.Array, index: Scalar) -> jax.Array:
    return lax.dynamic_index_in_dim(slots, index, 0, keepdims=False)


def _write(slots: jax.Array, index: Scalar, value: jax.Array) -> jax.Array:
    return lax.dynamic_update_index_in_dim(slots, value, index, 0)


def _add(slots: jax.Array, index: Scalar, value: jax.Array) -> jax.Array:
    return _write(slots, index, _read(slots, index) + value)


def _scan(step: Callable, start: PyTree, rows: PyTree, reverse: bool) -> tuple[PyTree, PyTree]:
    """`lax.scan`, but numbers that are known while tracing stay known in inputs and outputs."""
    traced_rows, with_known_inputs = _part_known(rows)
    with_known_outputs: Callable[[list], PyTree] | None = None

    def traced_step(carry: PyTree, traced: list) -> tuple[PyTree, list]:
        nonlocal with_known_outputs
        carry, output = step(carry, with_known_inputs(traced))
        traced_output, with_known_outputs = _part_known(output)
        return carry, traced_output

    start, outputs = lax.scan(traced_step, start, traced_rows, reverse=reverse)
    assert with_known_outputs is not None
    return start, with_known_outputs(outputs)


def _part_known(tree: PyTree) -> tuple[list, Callable[[list], PyTree]]:
    """The traced leaves of a tree, and the way back to the tree from others in their place."""
    leaves, structure = jax.tree.flatten(tree)
    known = {i: leaf for i, leaf in enumerate(leaves) if is_known(leaf)}

    def rebuild(traced: list) -> PyTree:
        rest = iter(traced)
        return jax.tree.unflatten(structure, [known[i] if i in known else next(rest) for i in range(len(leaves))])

    return [leaf for leaf in leaves if not is_known(leaf)], rebuild
