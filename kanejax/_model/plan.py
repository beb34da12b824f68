"""How the recursions walk a tree: the order of the links, and where states are kept at branches.

A segment is what one loop runs over: all revolute and prismatic joints that can be reached from one another without crossing
a ball or free joint, depth first; or a single ball or free joint. Along a chain the parent's state is the loop's carry; at a
branch it is kept in a slot for the other children.
"""

import dataclasses
import functools

from kanejax._model.joints import KINDS, AbstractJoint
from kanejax._model.tree import SPEEDS, WORLD, Tree

NONE = -1


@dataclasses.dataclass(frozen=True)
class Segment:
    """Links that one loop runs over, parents before children.

    Attributes:
        kind: the joint type of all links, or "mixed" for revolute and prismatic ones.
        links: in the order of the loop.
        carrier: the link outside the segment that its first links hang on, -1 for the world.
        restore: slot with the state of a link's parent, -1 where that is the link before it; slot 0 is the carrier's.
        save: slot that keeps a link's own state, -1 where none does.
        slots: how many there are.
        leaves: whether a link has no child in the segment.
    """

    kind: str
    links: tuple[int, ...]
    carrier: int
    restore: tuple[int, ...]
    save: tuple[int, ...]
    slots: int
    leaves: tuple[bool, ...]

    @property
    def joint(self) -> type[AbstractJoint]:
        """The joint type's class."""
        return KINDS[self.kind]

    @property
    def branches(self) -> bool:
        """Whether any slot is in use."""
        return any(slot != NONE for slot in (*self.restore, *self.save))

    def kept(self, link: int) -> int:
        """Slot with the state of `link` when the loop ends; -1 if that is the loop's carry, `link` being the last."""
        return NONE if link == self.links[-1] else self.save[self.links.index(link)]


@functools.lru_cache(maxsize=256)
def segments(tree: Tree) -> tuple[Segment, ...]:
    """Cut the tree into segments, each after the one that carries it."""
    children: dict[int, list[int]] = {link: [] for link in range(WORLD, tree.njoint)}
    for link, parent in enumerate(tree.link_parents):
        children[parent].append(link)
    found: list[Segment] = []
    carriers = [WORLD]
    while carriers:
        carrier = carriers.pop(0)
        roots = [child for child in children[carrier] if _in_loop(tree, child)]
        alone = [child for child in children[carrier] if not _in_loop(tree, child)]
        if roots:
            found.append(_Walk(tree, children).segment(carrier, roots))
            alone += [child for link in found[-1].links for child in children[link] if not _in_loop(tree, child)]
        for link in alone:
            found.append(Segment(tree.joint_types[link], (link,), tree.link_parents[link], (NONE,), (NONE,), 1, (True,)))
        carriers += alone
    return tuple(found)


def _in_loop(tree: Tree, link: int) -> bool:
    return SPEEDS[tree.joint_types[link]] == 1


class _Walk:
    """Depth-first walk that gives every link at a branch a slot."""

    def __init__(self, tree: Tree, children: dict[int, list[int]]) -> None:
        self.tree, self.children = tree, children
        self.order: list[int] = []
        self.restore: list[int] = []
        self.save: list[int] = []
        self.leaves: list[bool] = []
        self.slots = 1

    def segment(self, carrier: int, roots: list[int]) -> Segment:
        """Walk all trees that stand on `roots`."""
        for position, root in enumerate(sorted(roots, key=self.size)):
            self.visit(root, NONE if position == 0 else 0)
        kinds = {self.tree.joint_types[link] for link in self.order}
        kind = kinds.pop() if len(kinds) == 1 else "mixed"
        return Segment(kind, tuple(self.order), carrier, tuple(self.restore), tuple(self.save), self.slots, tuple(self.leaves))

    def visit(self, link: int, restored: int) -> None:
        """Add a link and everything on it."""
        waiting = [(link, restored)]
        while waiting:
            link, restored = waiting.pop()
            inside = sorted((child for child in self.children[link] if _in_loop(self.tree, child)), key=self.size)
            slot = NONE
            if len(inside) > 1 or len(inside) < len(self.children[link]):
                slot, self.slots = self.slots, self.slots + 1
            self.order.append(link)
            self.restore.append(restored)
            self.save.append(slot)
            self.leaves.append(not inside)
            waiting += [(child, slot if position else NONE) for position, child in reversed(list(enumerate(inside)))]

    def size(self, link: int) -> int:
        """Number of links in a subtree."""
        return int(self.tree.link_ancestors[:, link].sum())
