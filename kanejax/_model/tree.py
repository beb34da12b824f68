"""The static part of a model: which body hangs on which, by which joints."""

import dataclasses
import functools
from typing import Literal, final

import numpy as np

from kanejax._errors import UnknownNameError

JointType = Literal["revolute", "prismatic", "ball", "free"]
COORDINATES: dict[str, int] = {"revolute": 1, "prismatic": 1, "ball": 4, "free": 7}
SPEEDS: dict[str, int] = {"revolute": 1, "prismatic": 1, "ball": 3, "free": 6}
WORLD = -1


@final
@dataclasses.dataclass(frozen=True)
class Tree:
    """Topology of a mechanism, in MuJoCo's order: parents before children, the joints of a body one after another.

    Attributes:
        body_names: one name a body; the world is not a body.
        body_parents: index of the parent body, -1 for the world.
        joint_names: one name a joint.
        joint_types: "revolute", "prismatic", "ball" or "free".
        joint_bodies: index of the body that the joint moves. Several joints on one body act in their order.
    """

    body_names: tuple[str, ...]
    body_parents: tuple[int, ...]
    joint_names: tuple[str, ...]
    joint_types: tuple[JointType, ...]
    joint_bodies: tuple[int, ...]

    def __post_init__(self) -> None:
        """Check what the rest relies on."""
        for body, parent in enumerate(self.body_parents):
            if not WORLD <= parent < body:
                raise ValueError(f"body {self.body_names[body]!r} has parent {parent}: parents must come before children")
        if list(self.joint_bodies) != sorted(self.joint_bodies):
            raise ValueError(f"joints must be listed in the order of their bodies, got bodies {self.joint_bodies}")
        for name, kind, body in zip(self.joint_names, self.joint_types, self.joint_bodies, strict=True):
            if kind not in COORDINATES:
                raise ValueError(f"joint {name!r} has type {kind!r}; the types are {', '.join(COORDINATES)}")
            if kind == "free" and (self.body_parents[body] != WORLD or self.joint_bodies.count(body) > 1):
                raise ValueError(f"free joint {name!r} must be the only joint of a body that hangs on the world")
        for label, names in (("body", self.body_names), ("joint", self.joint_names)):
            if len(set(names)) != len(names):
                twice = sorted({name for name in names if names.count(name) > 1})
                raise ValueError(f"{label} names must differ, but {', '.join(twice)} occur more than once")

    @property
    def nbody(self) -> int:
        """Number of bodies, the world not counted."""
        return len(self.body_names)

    @property
    def njoint(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @functools.cached_property
    def nq(self) -> int:
        """Number of generalized coordinates."""
        return sum(COORDINATES[kind] for kind in self.joint_types)

    @functools.cached_property
    def nv(self) -> int:
        """Number of generalized speeds."""
        return sum(SPEEDS[kind] for kind in self.joint_types)

    @functools.cached_property
    def q_start(self) -> tuple[int, ...]:
        """Index of each joint's first generalized coordinate."""
        return _starts(COORDINATES[kind] for kind in self.joint_types)

    @functools.cached_property
    def v_start(self) -> tuple[int, ...]:
        """Index of each joint's first generalized speed."""
        return _starts(SPEEDS[kind] for kind in self.joint_types)

    @functools.cached_property
    def coordinate_names(self) -> tuple[str, ...]:
        """Of each generalized coordinate: its joint's, numbered where that has several."""
        return self._numbered(COORDINATES)

    @functools.cached_property
    def speed_names(self) -> tuple[str, ...]:
        """Of each generalized speed: its joint's, numbered where that has several."""
        return self._numbered(SPEEDS)

    def _numbered(self, sizes: dict[str, int]) -> tuple[str, ...]:
        counts = [(name, sizes[kind]) for name, kind in zip(self.joint_names, self.joint_types, strict=True)]
        return tuple(name if count == 1 else f"{name}[{i}]" for name, count in counts for i in range(count))

    @functools.cached_property
    def speed_joints(self) -> np.ndarray:
        """The joint that each generalized speed belongs to."""
        return np.repeat(np.arange(self.njoint), [SPEEDS[kind] for kind in self.joint_types]).astype(int)

    @functools.cached_property
    def plain_speeds(self) -> tuple[np.ndarray, np.ndarray]:
        """The speeds that are the rates of a coordinate, and these coordinates: all but those of quaternions."""
        counts = {"revolute": 1, "prismatic": 1, "ball": 0, "free": 3}
        offsets = [(v, q, i) for kind, v, q in self._starts for i in range(counts[kind])]
        return np.array([v + i for v, _, i in offsets], int), np.array([q + i for _, q, i in offsets], int)

    @functools.cached_property
    def turning_speeds(self) -> tuple[np.ndarray, np.ndarray]:
        """The first speed and the first coordinate of each quaternion."""
        offsets = [(v, q, 3 if kind == "free" else 0) for kind, v, q in self._starts if kind in ("ball", "free")]
        return np.array([v + i for v, _, i in offsets], int), np.array([q + i for _, q, i in offsets], int)

    @property
    def _starts(self) -> list[tuple[str, int, int]]:
        return list(zip(self.joint_types, self.v_start, self.q_start, strict=True))

    @functools.cached_property
    def body_links(self) -> tuple[int, ...]:
        """The link each body is fixed in: the last joint between the world and it, -1 if there is none.

        A link is what one joint moves: the body for the last joint of a body, a massless frame for those before it. Links are
        numbered like joints. Bodies welded to their parent share its link.
        """
        links: list[int] = []
        for body, parent in enumerate(self.body_parents):
            own = [joint for joint, moved in enumerate(self.joint_bodies) if moved == body]
            links.append(own[-1] if own else (WORLD if parent == WORLD else links[parent]))
        return tuple(links)

    @functools.cached_property
    def link_parents(self) -> tuple[int, ...]:
        """The link that each joint's link hangs on, -1 for the world."""
        parents: list[int] = []
        for joint, body in enumerate(self.joint_bodies):
            if joint > 0 and self.joint_bodies[joint - 1] == body:
                parents.append(joint - 1)
            else:
                parent = self.body_parents[body]
                parents.append(WORLD if parent == WORLD else self.body_links[parent])
        return tuple(parents)

    @functools.cached_property
    def link_ancestors(self) -> np.ndarray:
        """(njoint, njoint) booleans: [k, j] says that link j carries link k, or is it."""
        ancestors = np.eye(self.njoint, dtype=bool)
        for link, parent in enumerate(self.link_parents):
            if parent != WORLD:
                ancestors[link] |= ancestors[parent]
        return ancestors

    @functools.cached_property
    def body_moved_by(self) -> np.ndarray:
        """(nbody, nv) booleans: whether a generalized speed moves a body."""
        moved = np.zeros((self.nbody, self.nv), bool)
        for body, link in enumerate(self.body_links):
            if link != WORLD:
                moved[body] = self.link_ancestors[link][self.speed_joints]
        return moved

    def body(self, name: str) -> int:
        """Index of the body called `name`. Raises UnknownNameError, which lists the names there are."""
        return _index("body", name, self.body_names)

    def joint(self, name: str) -> int:
        """Index of the joint called `name`. Raises UnknownNameError, which lists the names there are."""
        return _index("joint", name, self.joint_names)


class OnTree:
    """Sizes of what has a tree."""

    tree: Tree

    @property
    def nq(self) -> int:
        """Number of generalized coordinates."""
        return self.tree.nq

    @property
    def nv(self) -> int:
        """Number of generalized speeds."""
        return self.tree.nv

    @property
    def nbody(self) -> int:
        """Number of bodies, the world not counted."""
        return self.tree.nbody

    @property
    def njoint(self) -> int:
        """Number of joints."""
        return self.tree.njoint


def _starts(sizes) -> tuple[int, ...]:  # noqa: ANN001
    starts, total = [], 0
    for size in sizes:
        starts.append(total)
        total += size
    return tuple(starts)


def _index(label: str, name: str, names: tuple[str, ...]) -> int:
    if name not in names:
        raise UnknownNameError(label, name, names)
    return names.index(name)
