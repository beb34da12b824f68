"""How the recursions walk a tree: the order of the links, and where states are kept at branches.

A segment is what one loop runs over. Free joints, which only bases have, are segments of one row each; everything else is one
segment, depth first, with one row for each generalized speed. Along a chain the parent's state is the loop's carry; at a branch
it is kept in a slot for the other children.
"""

import dataclasses
import functools

from kanejax._model.tree import SPEEDS, WORLD, Tree

NONE = -1


@dataclasses.dataclass(frozen=True)
class Segment:
    """Rows that one loop runs over, parents before children.

    Attributes:
        free: whether the segment is a single free joint.
        links: the link of each row. A ball joint has three rows, the last of which carries the link.
        speeds: the generalized speeds of each row: six of a free joint, or one.
        carriers: what the segment hangs on: the world, and links of free joints. Their states are in the first slots.
        restore: slot with the state that a row starts from, -1 where that is the row before it, or the first carrier.
        save: slot that keeps a row's own state, -1 where none does.
        slots: how many there are.
        leaves: whether nothing hangs on a row.
    """

    free: bool
    links: tuple[int, ...]
    speeds: tuple[tuple[int, ...], ...]
    carriers: tuple[int, ...]
    restore: tuple[int, ...]
    save: tuple[int, ...]
    slots: int
    leaves: tuple[bool, ...]

    @property
    def branches(self) -> bool:
        """Whether any slot is in use."""
        return any(slot != NONE for slot in (*self.restore, *self.save))

    @functools.cached_property
    def first(self) -> tuple[bool, ...]:
        """Whether a row is the first of its link."""
        return tuple(row == 0 or self.links[row - 1] != link for row, link in enumerate(self.links))

    @functools.cached_property
    def last(self) -> tuple[bool, ...]:
        """Whether a row is the last of its link, the one that the link's own frame and inertia belong to."""
        return (*self.first[1:], True)


@functools.lru_cache(maxsize=256)
def segments(tree: Tree) -> tuple[Segment, ...]:
    """Cut the tree into segments, each after those that carry it."""
    found: list[Segment] = []
    for link, (kind, start) in enumerate(zip(tree.joint_types, tree.v_start, strict=True)):
        if kind == "free":
            found.append(Segment(True, (link,), (tuple(range(start, start + 6)),), (WORLD,), (NONE,), (NONE,), 1, (True,)))
    if len(found) < tree.njoint:
        found.append(_Walk(tree).segment())
    return tuple(found)


class _Walk:
    """Depth-first walk that gives every link at a branch a slot.

    Children are taken in the model's order, which is MuJoCo's depth first: rows of arrays then need no gathering.
    """

    def __init__(self, tree: Tree) -> None:
        self.tree = tree
        self.children: dict[int, list[int]] = {link: [] for link in range(WORLD, tree.njoint)}
        for link, parent in enumerate(tree.link_parents):
            if tree.joint_types[link] != "free":
                self.children[parent].append(link)
        outside = (WORLD, *(link for link, kind in enumerate(tree.joint_types) if kind == "free"))
        self.carriers = tuple(link for link in outside if self.children[link])
        self.links: list[int] = []
        self.speeds: list[tuple[int, ...]] = []
        self.restore: list[int] = []
        self.save: list[int] = []
        self.leaves: list[bool] = []
        self.slots = len(self.carriers)

    def segment(self) -> Segment:
        """Walk everything that does not hang on a free joint's link, and everything that does."""
        for slot, carrier in enumerate(self.carriers):
            for root in self.children[carrier]:
                self.visit(root, slot if self.links else NONE)
        restore, save, leaves = tuple(self.restore), tuple(self.save), tuple(self.leaves)
        return Segment(False, tuple(self.links), tuple(self.speeds), self.carriers, restore, save, self.slots, leaves)

    def visit(self, link: int, restored: int) -> None:
        """Add a link and everything on it."""
        waiting = [(link, restored)]
        while waiting:
            link, restored = waiting.pop()
            outer = self.children[link]
            slot = NONE
            if len(outer) > 1:
                slot, self.slots = self.slots, self.slots + 1
            self.add(link, restored, slot, leaf=not outer)
            waiting += [(child, slot if position else NONE) for position, child in reversed(list(enumerate(outer)))]

    def add(self, link: int, restored: int, saved: int, leaf: bool) -> None:
        """Add the rows of one link."""
        count = SPEEDS[self.tree.joint_types[link]]
        start = self.tree.v_start[link]
        between = [NONE] * (count - 1)
        self.links += [link] * count
        self.speeds += [(start + i,) for i in range(count)]
        self.restore += [restored, *between]
        self.save += [*between, saved]
        self.leaves += [*([False] * (count - 1)), leaf]
