"""Sweeps over the links of a tree, base to tip and tip to base, in scalar form.

Free joints are steps of their own; everything that is not a free joint is one `lax.scan`, whose carry and inputs are tuples of
scalars. So a program has a few loops whatever the number of bodies, compiles in about a second, and runs in time linear in it.
Only for specialized models, whose parameters are known numbers, the loops over a batch are written out.
"""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from kanejax._model.tree import WORLD, Tree
from kanejax._recursion.joints import Joint
from kanejax._recursion.plan import NONE, Segment, segments
from kanejax._recursion.rows import Column, is_frozen, joint_rows
from kanejax._scalar import add, barrier, is_known
from kanejax._types import Scalar

PyTree = Any
# (joint, state, inputs of a row) -> (state, output).
RowFunction = Callable[[Any, PyTree, PyTree], tuple[PyTree, PyTree]]


def base_to_tip(tree: Tree, step: RowFunction, root: PyTree, inputs: list[PyTree], like: jax.Array) -> list[PyTree]:
    """Run `step(joint, state of the parent, inputs of the row) -> (its state, its output)` over all rows.

    `root` is the world's state, of known numbers or scalars of the batch's shape, which is that of `like` (n, *batch).
    `inputs` and the result are lists over the segments. For a batch, loops over known numbers are unrolled, so that products fold.
    """
    states: dict[int, PyTree] = {WORLD: root}
    outputs: list[PyTree] = []
    for segment, rows in zip(segments(tree), inputs, strict=True):
        joints = joint_rows(tree, segment)
        if _unrolled(segment, rows, like):
            outputs.append(_unrolled_outward(tree, segment, step, states, (joints, rows)))
        else:
            before = [_filled(states[carrier], like) for carrier in segment.carriers]
            outputs.append(_outward(segment, step, before, _traced((joints, rows), like)))
    return outputs


def tip_to_base(tree: Tree, step: RowFunction, zero: PyTree, inputs: list[PyTree], like: jax.Array) -> list[PyTree]:
    """Run `step(joint, sum over the children, inputs of the row) -> (what its parent receives, its output)`.

    `zero` is what a link without children receives; the rest is as for `base_to_tip`.
    """
    received: dict[int, PyTree] = {}
    outputs: list[PyTree] = []
    for segment, rows in reversed(list(zip(segments(tree), inputs, strict=True))):
        joints = joint_rows(tree, segment)
        if _unrolled(segment, rows, like):
            outputs.append(_unrolled_inward(tree, segment, step, zero, received, (joints, rows)))
        else:
            sent, output = _inward(segment, step, _filled(zero, like), _traced((joints, rows), like))
            received = dict(zip(segment.carriers, sent, strict=True))
            outputs.append(output)
    return outputs[::-1]


def is_written_out(tree: Tree, inputs: list[PyTree], like: jax.Array) -> bool:
    """Whether the sweeps write out every row of these inputs."""
    return all(_unrolled(segment, rows, like) for segment, rows in zip(segments(tree), inputs, strict=True))


def written_out(tree: Tree, inputs: list[PyTree]) -> Iterator[tuple[Segment, int, Joint, PyTree]]:
    """Every row of every segment, parents first: its segment and place there, its joint, and its inputs."""
    for segment, rows in zip(segments(tree), inputs, strict=True):
        joints = joint_rows(tree, segment)
        for i in range(len(segment.links)):
            joint, row = _row((joints, rows), i)
            yield segment, i, joint, row


def _unrolled(segment: Segment, rows: PyTree, like: jax.Array) -> bool:
    """Whether to write out every row. Known numbers fold then; one state is faster in a loop."""
    return segment.free or (is_frozen(rows) and like.ndim > 1)


def _filled(state: PyTree, like: jax.Array) -> PyTree:
    """Every scalar as an array of the batch's shape, also known numbers and those of parameters alone: a loop's carry must be."""
    shape = like.shape[1:]

    def fill(x: Scalar) -> jax.Array:
        x = jnp.asarray(x, like.dtype)
        return jnp.broadcast_to(x, jnp.broadcast_shapes(x.shape, shape))

    return jax.tree.map(fill, state)


def _traced(rows: PyTree, like: jax.Array) -> PyTree:
    """Numbers that differ from row to row, as inputs of a loop."""
    return jax.tree.map(lambda x: jnp.asarray(x, like.dtype) if isinstance(x, np.ndarray) else x, rows)


def _row(rows: PyTree, i: int) -> PyTree:
    """Inputs of one row; constants become known numbers."""

    def pick(x: Scalar) -> Scalar:
        if is_known(x):
            return x
        return float(x[i]) if isinstance(x, np.ndarray) else x[i]

    return jax.tree.map(pick, rows)


def _unrolled_outward(tree: Tree, segment: Segment, step: RowFunction, states: dict[int, PyTree], rows: tuple) -> PyTree:
    """Row after row: the outputs; adds the states of the links to `states`."""
    outputs, state = [], None
    for i, link in enumerate(segment.links):
        joint, inputs = _row(rows, i)
        state = states[tree.link_parents[link]] if segment.first[i] else state
        state, output = barrier(step(joint, state, inputs))
        outputs.append(output)
        if segment.last[i]:
            states[link] = state
    return jax.tree.map(Column, *outputs)


def _unrolled_inward(
    tree: Tree, segment: Segment, step: RowFunction, zero: PyTree, received: dict[int, PyTree], rows: tuple
) -> PyTree:
    """Row after row: the outputs; adds to what links have received."""
    outputs, sent = [], None
    for i, link in reversed(list(enumerate(segment.links))):
        joint, inputs = _row(rows, i)
        sent, output = barrier(step(joint, received.get(link, zero) if segment.last[i] else sent, inputs))
        outputs.append(output)
        if segment.first[i]:
            parent = tree.link_parents[link]
            received[parent] = jax.tree.map(add, received[parent], sent) if parent in received else sent
    return jax.tree.map(Column, *outputs[::-1])


def _outward(segment: Segment, step: RowFunction, before: list[PyTree], rows: tuple) -> PyTree:
    """Loop from base to tip."""
    if not segment.branches:
        return _scan(lambda state, row: step(row[0], state, row[1]), before[0], rows, reverse=False)[1]
    # One slot more than there are takes what nobody needs.
    spare = segment.slots + 1 - len(before)
    slots = jax.tree.map(lambda *x: jnp.stack([*x, *[jnp.zeros_like(x[0])] * spare]), *before)

    def branching_step(carry: tuple[PyTree, PyTree], row: tuple) -> tuple[tuple[PyTree, PyTree], PyTree]:
        (before, slots), (restores, restore, saves, save, (joint, inputs)) = carry, row
        parent = jax.tree.map(lambda kept, state: jnp.where(restores, _read(kept, restore), state), slots, before)
        state, output = step(joint, parent, inputs)
        # Conditionals, not selections: most links leave the slots alone, and then nothing is moved.
        slots = lax.cond(saves, lambda: jax.tree.map(lambda kept, x: _write(kept, save, x), slots, state), lambda: slots)
        return (state, slots), output

    return _scan(branching_step, (before[0], slots), (*_slot_rows(segment), rows), reverse=False)[1]


def _inward(segment: Segment, step: RowFunction, zero: PyTree, rows: tuple) -> tuple[list[PyTree], PyTree]:
    """Loop from tip to base: what each carrier receives, and the outputs."""
    if not segment.branches:
        sent, output = _scan(lambda outer, row: step(row[0], outer, row[1]), zero, rows, reverse=True)
        return [sent], output
    slots = jax.tree.map(lambda x: jnp.zeros((segment.slots + 1, *x.shape), x.dtype), zero)

    def branching_step(carry: tuple[PyTree, PyTree], row: tuple) -> tuple[tuple[PyTree, PyTree], PyTree]:
        (after, slots), (restores, restore, _, save, ends, (joint, inputs)) = carry, row
        outer = jax.tree.map(lambda kept, x: jnp.where(ends, 0.0, x) + _read(kept, save), slots, after)
        sent, output = step(joint, outer, inputs)
        slots = lax.cond(restores, lambda: jax.tree.map(lambda kept, x: _add(kept, restore, x), slots, sent), lambda: slots)
        return (sent, slots), output

    (sent, slots), output = _scan(
        branching_step, (zero, slots), (*_slot_rows(segment), jnp.array(segment.leaves), rows), reverse=True
    )
    kept = [jax.tree.map(lambda x: x[slot], slots) for slot in range(len(segment.carriers))]  # noqa: B023
    return [jax.tree.map(jnp.add, sent, kept[0]), *kept[1:]], output


def _slot_rows(segment: Segment) -> tuple[jax.Array, ...]:
    """Whether and where each row restores its parent's state, and where it saves its own; the last slot is for nothing."""
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
