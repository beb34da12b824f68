"""Checks of a URDF's links and joints, with errors that name the element, the value and the remedy."""

import collections
from xml.etree import ElementTree

from kanejax._errors import ModelFileError, UnsupportedModelError
from kanejax._io.mjcf_size import DEEPEST_TREE, LARGEST_TREE, too_large
from kanejax._io.xml_text import numbers_of, text_of

FIXED = "fixed"
_FLOATING = "floating"
_AXIAL_TYPES = ("revolute", "continuous", "prismatic", "planar")
_JOINT_TYPES = (*_AXIAL_TYPES, FIXED, _FLOATING, "spherical")
_INERTIA_ATTRIBUTES = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def check_expanded(robot: ElementTree.Element, origin: str) -> None:
    """Refuse a xacro template and a file without links."""
    if any("xacro" in element.tag for element in robot.iter()):
        raise ModelFileError(f"{origin}: the file is a xacro template; expand it first with `xacro in.xacro > out.urdf`")
    if robot.find("link") is None:
        raise ModelFileError(f"{origin}: the <robot> has no <link>, so there is nothing to load")


def check_links(links: list[ElementTree.Element], origin: str) -> None:
    """Refuse links without a name, or two of one name, and more than can be compiled."""
    if len(links) > LARGEST_TREE:
        raise ModelFileError(too_large(origin, f"{len(links)} links, but at most {LARGEST_TREE} can be loaded"))
    names = [text_of(link, "name", origin) for link in links]
    repeated = _repeated(names)
    if repeated:
        raise ModelFileError(f"{origin}: {names.count(repeated[0])} links are named {repeated[0]!r}; rename all but one")


def check_joints(joints: list[ElementTree.Element], origin: str, repair: bool, repaired: list[str]) -> None:
    """Check names, types and numbers of the joints; repairs go into the elements and the list `repaired`."""
    seen: set[str] = set()
    for joint in joints:
        name = text_of(joint, "name", origin)
        if name in seen:
            if not repair:
                raise ModelFileError(f"{origin}: two joints are named {name!r}; rename one, or load with repair=True")
            new_name = _unused_name(name, {other.get("name", "") for other in joints})
            joint.set("name", new_name)
            repaired.append(f"joint {name!r}: a second joint of this name is renamed {new_name!r}")
            name = new_name
        seen.add(name)
        owner = f"{origin}: joint {name!r}"
        kind = text_of(joint, "type", owner)
        if kind not in _JOINT_TYPES:
            raise ModelFileError(f"{owner}: type {kind!r} is unknown; the types are {', '.join(_JOINT_TYPES)}")
        _check_joint_numbers(joint, owner, repair, repaired)


def _check_joint_numbers(joint: ElementTree.Element, owner: str, repair: bool, repaired: list[str]) -> None:
    _check_origin(joint, owner)
    axis = joint.find("axis")
    if axis is not None and joint.get("type") in _AXIAL_TYPES:
        direction = numbers_of(axis, "xyz", 3, owner)
        if not any(abs(component) > 1e-12 for component in direction):
            if not repair:
                remedy = "write a direction, or load with repair=True for '1 0 0'"
                raise ModelFileError(f"{owner}: axis {axis.get('xyz')!r} is zero; {remedy}")
            repaired.append(f"joint {joint.get('name')!r}: axis {axis.get('xyz')!r} replaced by the default '1 0 0'")
            axis.set("xyz", "1 0 0")
    for tag, attributes in (("dynamics", ("damping", "friction")), ("limit", ("lower", "upper", "effort", "velocity"))):
        element = joint.find(tag)
        for attribute in attributes:
            if element is not None and element.get(attribute) is not None:
                numbers_of(element, attribute, 1, owner)


def _check_origin(element: ElementTree.Element, owner: str) -> None:
    origin = element.find("origin")
    for attribute in ("xyz", "rpy"):
        if origin is not None and origin.get(attribute) is not None:
            numbers_of(origin, attribute, 3, owner)


def check_tree(links: list[ElementTree.Element], joints: list[ElementTree.Element], origin: str) -> None:
    """Refuse joints that do not make a tree with one root, and floating joints anywhere but on a root named world."""
    names = {link.get("name", "") for link in links}
    parent_of: dict[str, str] = {}
    floating = []
    for joint in joints:
        owner = f"{origin}: joint {joint.get('name')!r}"
        parent, child = _end(joint, "parent", names, owner), _end(joint, "child", names, owner)
        if child in parent_of:
            raise ModelFileError(f"{origin}: link {child!r} is the child of two joints; a URDF must be a tree")
        parent_of[child] = parent
        if joint.get("type") == _FLOATING:
            floating.append((joint.get("name"), parent))
    roots = [link.get("name") for link in links if link.get("name") not in parent_of]
    if len(roots) > 1:
        listed = ", ".join(repr(root) for root in roots[:8])
        raise ModelFileError(f"{origin}: {len(roots)} links have no parent ({listed}); join all but one to the others")
    _check_depths(parent_of, names, origin)
    if "world" in parent_of:
        raise ModelFileError(f"{origin}: the link 'world' has a parent; rename it, the name means the fixed frame")
    for name, parent in floating:
        if parent != "world":
            raise UnsupportedModelError(
                f"{origin}: floating joint {name!r} hangs on link {parent!r}; only a root named 'world' can carry one"
            )


def _end(joint: ElementTree.Element, tag: str, names: set[str], owner: str) -> str:
    """Return the name of a joint's parent or child link."""
    end = joint.find(tag)
    if end is None:
        raise ModelFileError(f"{owner} has no <{tag} link=...>; write it")
    name = text_of(end, "link", owner)
    if name not in names:
        raise ModelFileError(f"{owner}: its {tag} link {name!r} does not exist; correct the name or add the link")
    return name


def _unused_name(name: str, used: set[str]) -> str:
    return next(f"{name}_{number}" for number in range(2, len(used) + 3) if f"{name}_{number}" not in used)


def _check_depths(parent_of: dict[str, str], names: set[str], origin: str) -> None:
    depths: dict[str, int] = {}
    for name in sorted(names):
        path, link = [], name
        while link in parent_of and link not in depths:
            path.append(link)
            # Not yet known, so that a loop ends here.
            depths[link] = -1
            link = parent_of[link]
        depth = depths.get(link, 0)
        if depth < 0:
            raise ModelFileError(f"{origin}: link {name!r} hangs on a loop of joints; a URDF must be a tree")
        depths.update({above: depth + count for count, above in enumerate(reversed(path), 1)})
    if max(depths.values(), default=0) > DEEPEST_TREE:
        raise ModelFileError(too_large(origin, f"more than {DEEPEST_TREE} links one below another"))


def check_inertial(link: ElementTree.Element, owner: str, repair: bool, repaired: list[str]) -> None:
    """Check that the numbers of a link's <inertial> are there and finite; `repair` writes 0 for missing ones."""
    inertial = link.find("inertial")
    if inertial is None:
        return
    _check_origin(inertial, owner)
    for tag, attributes in (("mass", ("value",)), ("inertia", _INERTIA_ATTRIBUTES)):
        element = inertial.find(tag)
        if element is None:
            if not repair:
                raise ModelFileError(f"{owner}: <inertial> has no <{tag}>; write it, or load with repair=True for zero")
            element = ElementTree.SubElement(inertial, tag, dict.fromkeys(attributes, "0"))
            repaired.append(f"link {link.get('name')!r}: missing <{tag}> taken as zero")
        for attribute in attributes:
            if element.get(attribute) is None and repair:
                element.set(attribute, "0")
                repaired.append(f"link {link.get('name')!r}: missing {tag} {attribute} taken as zero")
            numbers_of(element, attribute, 1, owner)


def _repeated(names: list[str]) -> list[str]:
    return [name for name, count in collections.Counter(names).items() if count > 1]
