"""Sweeps over the links of a tree, base to tip and tip to base.

The tree is cut into chains without branches; each chain is one `lax.scan` over its links, whose carry and inputs are tuples
of scalars. Chains of the same kind that start equally deep in the tree, such as legs or fingers, run as one more axis of one scan.
So the program has a few loops whatever the number of bodies, compiles in about a second, and runs in time linear in it.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from kanejax._model.joints import KINDS, JointKind
from kanejax._model.links import Links, take
from kanejax._model.tree import COORDINATES, SPEEDS, WORLD, Tree
from kanejax._scalar import barrier, is_known
from kanejax._types import Scalar

PyTree = Any
T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Segment:
    """Chains that one scan runs over.

    Attributes:
        kind: the joint type of all links, or "mixed" for revolute and prismatic ones.
        chains: the links of each chain, base first, padded at the tip with -1 to the longest.
        parents: where each chain starts: (segment, chain) whose tip carries it, or None for the world.
    """

    kind: str
    chains: tuple[tuple[int, ...], ...]
    parents: tuple[tuple[int, int] | None, ...]

    @property
    def joint(self) -> type[JointKind]:
        """The joint type's class."""
        return KINDS[self.kind]

    @functools.cached_property
    def index(self) -> np.ndarray:
        """Links as (length, chains), or (length,) for a single chain."""
        index = np.array(self.chains, dtype=int).T
        return index[:, 0] if len(self.chains) == 1 else index


@functools.lru_cache(maxsize=256)
def segments(tree: Tree) -> tuple[Segment, ...]:
    """Cut the tree into segments, each after the ones that carry it."""
    chains, starts = _chains(tree)
    depth: dict[int, int] = {}
    for number, start in enumerate(starts):
        depth[number] = 0 if start is None else depth[start] + 1
    found: list[Segment] = []
    place: dict[int, tuple[int, int]] = {}
    for level in range(max(depth.values(), default=-1) + 1):
        kinds = {number: _chain_kind(tree, chains[number]) for number in depth if depth[number] == level}
        for kind in sorted(set(kinds.values())):
            # A chain joins longer ones while no more than half of its scan is padding.
            waiting = sorted((n for n in kinds if kinds[n] == kind), key=lambda n: -len(chains[n]))
            while waiting:
                longest = len(chains[waiting[0]])
                group = [n for n in waiting if 2 * len(chains[n]) >= longest]
                waiting = [n for n in waiting if n not in group]
                for position, number in enumerate(group):
                    place[number] = (len(found), position)
                padded = tuple(chains[n] + (WORLD,) * (longest - len(chains[n])) for n in group)
                parents = tuple(None if starts[n] is None else place[starts[n]] for n in group)  # type: ignore[index]
                found.append(Segment(kind, padded, parents))
    return tuple(found)


def _chains(tree: Tree) -> tuple[list[tuple[int, ...]], list[int | None]]:
    """Chains without branches, each of revolute and prismatic joints or of one ball or free joint, and what carries them."""
    children: dict[int, list[int]] = {link: [] for link in range(-1, tree.njoint)}
    for link, parent in enumerate(tree.link_parents):
        children[parent].append(link)
    chains: list[tuple[int, ...]] = []
    starts: list[int | None] = []
    waiting: list[tuple[int, int | None]] = [(link, None) for link in children[WORLD]]
    while waiting:
        link, start = waiting.pop(0)
        chain = [link]
        while len(children[chain[-1]]) == 1 and _runs_on(tree, chain[-1], children[chain[-1]][0]):
            chain.append(children[chain[-1]][0])
        waiting += [(child, len(chains)) for child in children[chain[-1]]]
        chains.append(tuple(chain))
        starts.append(start)
    return chains, starts


def _runs_on(tree: Tree, link: int, child: int) -> bool:
    return SPEEDS[tree.joint_types[link]] == SPEEDS[tree.joint_types[child]] == 1


def _chain_kind(tree: Tree, chain: tuple[int, ...]) -> str:
    kinds = {tree.joint_types[link] for link in chain}
    return kinds.pop() if len(kinds) == 1 else "mixed"


def split_links(tree: Tree, of_links: T, neutral: float = 0.0) -> list[T]:
    """Rows of every component, for each segment as (length, [chains,] *batch); `neutral` where a chain is padded."""

    def pick(leaf: jax.Array, segment: Segment) -> jax.Array:
        if WORLD in segment.index:
            leaf = jnp.concatenate((leaf, jnp.full_like(leaf[:1], neutral)))
        return take(leaf, segment.index)

    return [jax.tree.map(lambda leaf: pick(leaf, segment), of_links) for segment in segments(tree)]


def split_placements(tree: Tree, links: Links) -> list[Links]:
    """Link parameters for each segment; the padding has identity placements and no mass."""
    placed = split_links(tree, links)
    diagonal = split_links(tree, tuple(links.placement.rotation[i][i] for i in range(3)), neutral=1.0)
    return [
        part._replace(placement=part.placement._replace(rotation=_with_diagonal(part.placement.rotation, ones)))
        for part, ones in zip(placed, diagonal, strict=True)
    ]


def _with_diagonal(matrix: tuple, diagonal: tuple) -> tuple:
    return tuple(tuple(diagonal[i] if i == j else x for j, x in enumerate(row)) for i, row in enumerate(matrix))


def split_coordinates(tree: Tree, q: jax.Array) -> list[tuple[Scalar, ...]]:
    """Coordinates (nq, *batch) as one component for each coordinate of the joint type, for each segment."""
    return _split_dofs(tree, q, tree.q_start, COORDINATES)


def split_speeds(tree: Tree, u: jax.Array, neutral: float = 0.0) -> list[tuple[Scalar, ...]]:
    """Speeds or forces (nv, *batch), likewise."""
    return _split_dofs(tree, u, tree.v_start, SPEEDS, neutral)


def _split_dofs(tree: Tree, x: jax.Array, starts: Sequence[int], sizes: dict[str, int], neutral: float = 0.0) -> list:
    parts = []
    for segment in segments(tree):
        padded = WORLD in segment.index
        source = jnp.concatenate((x, jnp.full_like(x[:1], neutral))) if padded else x
        first = np.vectorize(lambda link: len(x) if link == WORLD else starts[link], otypes=[int])(segment.index)
        size = 1 if segment.kind == "mixed" else sizes[segment.kind]
        parts.append(tuple(take(source, np.where(first == len(x), first, first + offset)) for offset in range(size)))
    return parts


def joint_features(tree: Tree, q: jax.Array) -> list[tuple[Scalar, ...]]:
    """Sines, cosines, displacements or quaternions of every joint, for each segment."""
    coordinates = split_coordinates(tree, q)
    masks = _revolute_masks(tree, q)
    return barrier([s.joint.features(c, m) for s, c, m in zip(segments(tree), coordinates, masks, strict=True)])


def _revolute_masks(tree: Tree, like: jax.Array) -> list[jax.Array]:
    """For each segment 1 where a link is revolute, 0 where it is prismatic, shaped to broadcast along the batch of `like`."""
    mask = np.array([kind == "revolute" for kind in (*tree.joint_types, "revolute")], like.dtype)
    return [jnp.asarray(mask[s.index].reshape(s.index.shape + (1,) * (like.ndim - 1))) for s in segments(tree)]


def join_links(tree: Tree, parts: list[T]) -> T:
    """Put components of (length, [chains,] *batch) for each segment back together as (nlink, *batch)."""
    flat, order = [], []
    for segment, part in zip(segments(tree), parts, strict=True):
        links = segment.index.reshape(-1)
        flat.append(jax.tree.map(functools.partial(_flatten, segment), part))
        order += [link for link in links if link != WORLD]
    joined = flat[0] if len(flat) == 1 else jax.tree.map(lambda *rows: jnp.concatenate(rows), *barrier(flat))
    return take(joined, np.argsort(order))


def join_speeds(tree: Tree, parts: list[tuple[Scalar, ...]]) -> jax.Array:
    """Put one component for each speed of the joint type, for each segment, back together as (nv, *batch)."""
    rows, order = [], []
    for segment, part in zip(segments(tree), parts, strict=True):
        links = [link for link in segment.index.reshape(-1) if link != WORLD]
        for offset, component in enumerate(part):
            rows.append(_flatten(segment, component))
            order += [tree.v_start[link] + offset for link in links]
    joined = rows[0] if len(rows) == 1 else jnp.concatenate(barrier(rows))
    return take(joined, np.argsort(order))


def _flatten(segment: Segment, component: jax.Array) -> jax.Array:
    """(length, [chains,] *batch) to (links, *batch), without the padding."""
    real = segment.index.reshape(-1) != WORLD
    flat = component.reshape(real.shape + component.shape[segment.index.ndim :])
    return flat if real.all() else flat[np.flatnonzero(real)]


def base_to_tip(
    tree: Tree, step: Callable[[type[JointKind], PyTree, PyTree], tuple[PyTree, PyTree]], root: PyTree, inputs: list[PyTree], unroll: int = 1
) -> list[PyTree]:
    """Run `step(joint type, state of the parent link, inputs of the link) -> (its state, its output)` over all links.

    `root` is the world's state, its scalars of the batch's shape; `inputs` and the result are lists over the segments.
    """
    tips: list[tuple[PyTree, int]] = []
    outputs: list[PyTree] = []
    for segment, rows in zip(segments(tree), inputs, strict=True):
        start = _gather_tips(segment, tips, root)
        tip, output = _scan(functools.partial(step, segment.joint), start, rows, len(segment.index), unroll, reverse=False)
        tips.append((tip, len(segment.chains)))
        outputs.append(output)
    return outputs


def tip_to_base(
    tree: Tree, step: Callable[[type[JointKind], PyTree, PyTree], tuple[PyTree, PyTree]], zero: PyTree, inputs: list[PyTree], unroll: int = 1
) -> list[PyTree]:
    """Run `step(joint type, sum over the children, inputs of the link) -> (what its parent receives, its output)`.

    `zero` is what a link without children receives, its scalars of the batch's shape.
    """
    plan = segments(tree)
    received: dict[tuple[int, int], list[PyTree]] = {}
    outputs: list[PyTree] = [None] * len(plan)
    for number in reversed(range(len(plan))):
        segment, rows = plan[number], inputs[number]
        at_tip = [_total(received.get((number, chain), []), zero) for chain in range(len(segment.chains))]
        start = at_tip[0] if len(at_tip) == 1 else jax.tree.map(lambda *x: jnp.stack(x), *barrier(at_tip))
        sent, outputs[number] = _scan(functools.partial(step, segment.joint), start, rows, len(segment.index), unroll, reverse=True)
        for chain, parent in enumerate(segment.parents):
            if parent is not None:
                own = sent if len(segment.chains) == 1 else jax.tree.map(lambda x: x[chain], sent)  # noqa: B023
                received.setdefault(parent, []).append(own)
    return outputs


def _gather_tips(segment: Segment, tips: list[tuple[PyTree, int]], root: PyTree) -> PyTree:
    def tip(parent: tuple[int, int] | None) -> PyTree:
        if parent is None:
            return root
        number, chain = parent
        state, chains = tips[number]
        return state if chains == 1 else jax.tree.map(lambda x: x[chain], state)

    starts = [tip(parent) for parent in segment.parents]
    return starts[0] if len(starts) == 1 else jax.tree.map(lambda *x: jnp.stack(x), *barrier(starts))


def _total(received: list[PyTree], zero: PyTree) -> PyTree:
    if not received:
        return zero
    return functools.reduce(lambda a, b: jax.tree.map(jnp.add, a, b), received)


def _scan(step: Callable[[PyTree, PyTree], tuple[PyTree, PyTree]], start: PyTree, rows: PyTree, length: int, unroll: int, reverse: bool) -> tuple:
    """`lax.scan`, but numbers that are known while tracing stay known in inputs and outputs; unrolled when short enough."""
    traced_rows, with_known_inputs = _part_known(rows)
    with_known_outputs: Callable[[list], PyTree] | None = None

    def traced_step(carry: PyTree, traced: list) -> tuple[PyTree, list]:
        nonlocal with_known_outputs
        carry, output = step(carry, with_known_inputs(traced))
        traced_output, with_known_outputs = _part_known(output)
        return carry, traced_output

    if length > unroll:
        start, outputs = lax.scan(traced_step, start, traced_rows, reverse=reverse, unroll=unroll)
    else:
        collected: list[list] = [[]] * length
        for i in reversed(range(length)) if reverse else range(length):
            start, collected[i] = barrier(traced_step(start, [x[i] for x in traced_rows]))
        outputs = [jnp.stack(x) if length > 1 else x[0][None] for x in zip(*collected, strict=True)]
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
