"""Parameters, coordinates and speeds in the order and in the form in which the recursions read them, and back."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._model.links import LinkParameters, Rows
from kanejax._model.tree import Tree
from kanejax._recursion.joints import CYCLE, Free, Joint, Step, StepFeatures
from kanejax._recursion.plan import Segment, segments
from kanejax._scalar import barrier, is_known, sincos
from kanejax._types import Matrix, Scalar, Symmetric, Vector

PyTree = Any


class Frames(NamedTuple):
    """Rotation to the components of an outer frame, and position of the origin in it."""

    rotation: Matrix
    position: Vector


class Link(NamedTuple):
    """Parameters of one row, or of all of a segment: `LinkParameters` by component."""

    placement: Frames
    mass: Scalar
    first_moment: Vector
    second_moment: Symmetric


class Column:
    """One component of the rows of an unrolled segment, some of them known numbers; a leaf for `jax.tree`."""

    def __init__(self, *rows: Scalar) -> None:
        self.rows = rows

    def __getitem__(self, row: int) -> Scalar:
        """The component of one row."""
        return self.rows[row]


def is_frozen(rows: PyTree) -> bool:
    """Whether rows hold numbers that are known while tracing."""
    return any(isinstance(x, np.ndarray | Column) for x in jax.tree.leaves(rows))


def split_parameters(tree: Tree, parameters: LinkParameters) -> list[Link]:
    """Link parameters by component, (length, *batch), for each segment."""
    return [_segment_parameters(tree, segment, parameters) for segment in segments(tree)]


def _segment_parameters(tree: Tree, segment: Segment, parameters: LinkParameters) -> Link:
    """Rows of one segment: all but the last of a link are massless, and all but the first only exchange axes."""
    rotation, position, mass, first_moment, second_moment = (take(leaf, segment.links) for leaf in parameters)
    rotation, position = _or_else(segment.first, rotation, np.array(CYCLE)), _or_else(segment.first, position, np.zeros(3))
    mass, first_moment = _or_else(segment.last, mass, np.zeros(())), _or_else(segment.last, first_moment, np.zeros(3))
    second_moment = _or_else(segment.last, second_moment, np.zeros(6))
    turns = all(tree.joint_types[link] == "revolute" for link in segment.links)

    def component(leaf: Rows, i: int) -> Scalar:
        # What regrouping leaves of links that turn is known to vanish along z.
        return 0.0 if turns and i == 2 and not isinstance(leaf, np.ndarray) else leaf[:, i]

    return Link(
        Frames(
            tuple(tuple(rotation[:, i, j] for j in range(3)) for i in range(3)),  # type: ignore[arg-type]
            tuple(position[:, i] for i in range(3)),  # type: ignore[arg-type]
        ),
        0.0 if turns and not isinstance(mass, np.ndarray) else mass,
        tuple(component(first_moment, i) for i in range(3)),  # type: ignore[arg-type]
        tuple(component(second_moment, i) for i in range(6)),  # type: ignore[arg-type]
    )


def _or_else(chosen: tuple[bool, ...], rows: Rows, other: np.ndarray) -> Rows:
    """The rows that are chosen, and `other` in place of the rest."""
    if all(chosen):
        return rows
    where = _column(chosen, rows.ndim)
    other = other.reshape(other.shape + (1,) * (rows.ndim - 1 - other.ndim))
    if isinstance(rows, np.ndarray):
        return np.where(where, rows, other)
    return jnp.where(where, rows, jnp.asarray(other, rows.dtype))


def _column(rows: Any, ndim: int) -> np.ndarray:
    """One number a row, for arrays (length, ...) of so many dimensions."""
    return np.array(rows).reshape((-1,) + (1,) * (ndim - 1))


def take(leaf: Any, rows: Sequence[int] | np.ndarray) -> Any:
    """Rows of an array: a slice where they follow one another, for that costs no gather."""
    index = np.asarray(rows, dtype=int)
    if len(index) and np.array_equal(index, np.arange(index[0], index[0] + len(index))):
        return leaf if len(index) == leaf.shape[0] else leaf[index[0] : index[0] + len(index)]
    return leaf[index]


def split_speeds(tree: Tree, u: Scalar) -> list[tuple[Scalar, ...]]:
    """Speeds or forces (nv, *batch), or one known number, as one component for each speed of a row, for each segment."""
    if is_known(u):
        return [(u,) * len(segment.speeds[0]) for segment in segments(tree)]
    return [tuple(take(u, speeds) for speeds in zip(*segment.speeds, strict=True)) for segment in segments(tree)]


def joint_rows(tree: Tree, segment: Segment) -> Joint:
    """What the joints of a segment are: numbers where all rows agree, one for each row where not."""
    if segment.free:
        return Free()
    kinds = [tree.joint_types[link] for link in segment.links]
    balls = [kind == "ball" and first for kind, first in zip(kinds, segment.first, strict=True)]
    return Step(*(_one_or_all(x) for x in ([k == "prismatic" for k in kinds], [k == "revolute" for k in kinds], balls)))


def _one_or_all(rows: list[bool]) -> float | np.ndarray:
    return float(rows[0]) if len(set(rows)) == 1 else np.array(rows, float)


def joint_features(tree: Tree, q: jax.Array) -> list[tuple[Scalar, ...]]:
    """Sines, cosines, displacements and quaternions of every row, for each segment."""
    return barrier([_features(tree, segment, q) for segment in segments(tree)])


def _features(tree: Tree, segment: Segment, q: jax.Array) -> tuple[Scalar, ...]:
    starts = np.array([tree.q_start[link] for link in segment.links])
    if segment.free:
        return tuple(take(q, starts + i) for i in range(7))
    joint = joint_rows(tree, segment)
    assert isinstance(joint, Step)
    coordinate = take(q, starts)
    angle, displacement = (_masked(coordinate, mask) for mask in (joint.hinge, joint.slides))
    sine, cosine = (0.0, 1.0) if isinstance(angle, float) else sincos(angle)
    quaternion = tuple(_quaternion_component(q, starts, i, joint.ball) for i in range(4))
    return StepFeatures(sine, cosine, displacement, quaternion)


def _masked(x: jax.Array, mask: float | np.ndarray) -> Scalar:
    """Rows of x times a mask, known zeros and ones aside."""
    if isinstance(mask, float):
        return x if mask else 0.0
    return x * jnp.asarray(_column(mask, x.ndim), x.dtype)


def _quaternion_component(q: jax.Array, starts: np.ndarray, i: int, mask: float | np.ndarray) -> Scalar:
    """A component of ball joints' quaternions, and of the unit quaternion in other rows."""
    if isinstance(mask, float):
        return take(q, starts + i) if mask else float(i == 0)
    component = take(q, np.where(mask == 1, starts + i, starts))
    return jnp.where(_column(mask == 1, q.ndim), component, jnp.asarray(i == 0, q.dtype))


def join_links[T](tree: Tree, parts: list[T], like: jax.Array) -> T:
    """Put components of (length, *batch) for each segment together as (nlink, *batch), the batch that of `like`."""
    plan = segments(tree)
    order = [link for segment in plan for link, last in zip(segment.links, segment.last, strict=True) if last]
    rows = [
        jax.tree.map(lambda x: take(as_rows(x, len(s.links), like), np.flatnonzero(s.last)), part)  # noqa: B023
        for s, part in zip(plan, parts, strict=True)
    ]
    return jax.tree.map(lambda *x: in_order(list(x), order), *rows)


def join_speeds(tree: Tree, parts: list[tuple[Scalar, ...]], like: jax.Array) -> jax.Array:
    """Put one component for each speed of a row, for each segment, back together as (nv, *batch)."""
    rows, order = [], []
    for segment, part in zip(segments(tree), parts, strict=True):
        for component, speeds in zip(part, zip(*segment.speeds, strict=True), strict=True):
            rows.append(as_rows(component, len(segment.links), like))
            order += speeds
    return in_order(rows, order)


def in_order(rows: list[jax.Array], order: Sequence[int] | np.ndarray) -> jax.Array:
    """Concatenate rows and put them where `order` says that each belongs."""
    # Materialised before: XLA evaluates what is fused into a concatenation for every row of it.
    joined = rows[0] if len(rows) == 1 else jnp.concatenate(barrier(rows))
    return jnp.asarray(take(joined, np.argsort(order)))


def as_rows(component: Scalar, length: int, like: jax.Array) -> jax.Array:
    """One component of a segment's rows as an array (length, *batch), whether it was looped over, unrolled, or known."""
    shape = like.shape[1:]
    if isinstance(component, Column):
        # Materialised before and after: XLA evaluates what is fused into a stack for every row of it.
        return barrier(jnp.stack(barrier([jnp.broadcast_to(jnp.asarray(x, like.dtype), shape) for x in component.rows])))
    return jnp.broadcast_to(jnp.asarray(component, like.dtype), (length, *shape))


def ball_coupling(tree: Tree, u: jax.Array) -> Scalar:
    """What ball joints' rates have and their three steps have not, (nv, *batch).

    The steps turn with one another: the second adds w_1 x u_2 and the third (w_1 + w_2) x u_3 to the angular acceleration,
    u_2 u_3 along x, -u_1 u_3 along y and u_1 u_2 along z. With rates less these, the steps make the motion of the joint.
    """
    starts = [start for kind, start in zip(tree.joint_types, tree.v_start, strict=True) if kind == "ball"]
    if not starts:
        return 0.0
    sign, left, right = np.zeros(tree.nv), np.arange(tree.nv), np.arange(tree.nv)
    for start in starts:
        sign[start : start + 3] = (1, -1, 1)
        left[start : start + 3], right[start : start + 3] = (start + 1, start, start), (start + 2, start + 2, start + 1)
    return jnp.asarray(_column(sign, u.ndim), u.dtype) * u[left] * u[right]
