"""Changes to the elements of an XML file."""

import copy
from xml.etree import ElementTree

import numpy as np

from experiments.fuzz.mutations import NAMES, number

# Elements of MJCF that ask for much, name files, or change what others mean.
SNIPPETS = (
    '<include file="more.xml"/>',
    '<include file="{file}"/>',
    '<replicate count="{number}" offset="1 0 0"><body><joint/><geom size=".1"/></body></replicate>',
    '<flexcomp name="soft" type="grid" count="{number} 4 4" spacing=".1 .1 .1" dim="3"/>',
    '<flexcomp name="mesh" type="mesh" file="{file}" dim="2"/>',
    '<composite type="cable" count="{number} 1 1" size="1"/>',
    '<frame pos="{number} 0 0"><body><joint/><geom size=".1"/></body></frame>',
    '<body><joint type="ball"/><inertial pos="0 0 0" mass="{number}" diaginertia="{number} 1 1"/></body>',
    '<body><freejoint/><geom type="mesh" mesh="hull"/></body>',
    '<body mocap="true"><geom size="1"/></body>',
    '<attach model="self" body="torso" prefix="p"/>',
    '<asset><model name="self" file="{file}"/></asset>',
    '<asset><mesh name="file" file="{file}"/></asset>',
    '<asset><mesh name="ball" builtin="supersphere" params="{number} 1 1"/></asset>',
    '<asset><texture name="big" type="2d" builtin="flat" width="{number}" height="{number}"/></asset>',
    '<asset><texture name="file" file="{file}"/></asset>',
    '<asset><hfield name="big" nrow="{number}" ncol="{number}" size="1 1 1 1"/></asset>',
    '<size memory="{number}" nuser_body="{number}" nkey="{number}"/>',
    '<compiler inertiafromgeom="true"/>',
    '<compiler settotalmass="{number}"/>',
    '<compiler boundmass="{number}" boundinertia="{number}"/>',
    '<compiler balanceinertia="true" angle="radian"/>',
    '<compiler meshdir="{file}" assetdir="{file}" strippath="true"/>',
    '<compiler eulerseq="XYz" coordinate="local"/>',
    '<compiler><lengthrange mode="all" inttotal="{number}" timestep="{number}"/></compiler>',
    '<option gravity="{number} 0 0" density="{number}"/>',
    '<option><flag gravity="disable" contact="disable" energy="enable"/></option>',
    '<default class="main"><joint damping="{number}"/></default>',
    '<extension><plugin plugin="mujoco.elasticity.cable"><instance name="i"/></plugin></extension>',
    '<sensor><user name="u" dim="{number}"/></sensor>',
    '<sensor><contact num="{number}" geom1="ball"/></sensor>',
    '<actuator><general joint="hinge" dyntype="user" actdim="{number}"/></actuator>',
    '<equality><joint joint1="hinge" joint2="slide" polycoef="{number} 1 0 0 0"/></equality>',
    '<keyframe><key qpos="{number} {number}"/></keyframe>',
    '<custom><numeric name="big" size="{number}"/></custom>',
    '<joint name="hinge" type="hinge" springdamper="{number} {number}"/>',
    '<mimic joint="j1" multiplier="{number}"/>',
    '<mujoco><compiler balanceinertia="true" meshdir="{file}"/></mujoco>',
)
FILES = (
    "../secret.xml",
    "/etc/passwd",
    "/dev/zero",
    "meshes/../../secret.xml",
    "..\\secret.xml",
    "link.xml",
    "main.xml",
    "",
    "meshes",
    "none.obj",
    "a" * 5000,
)


def snippet(random: np.random.Generator) -> str:
    """An element with hostile numbers and files."""
    text = str(random.choice(SNIPPETS))
    while "{number}" in text:
        text = text.replace("{number}", _escaped(number(random)), 1)
    return text.replace("{file}", _escaped(str(random.choice(FILES))))


def changed_xml(data: bytes, random: np.random.Generator) -> bytes:
    """Change some elements and attributes."""
    root = ElementTree.fromstring(data)
    for _ in range(int(random.choice([1, 1, 1, 2, 3]))):
        _CHANGES[int(random.integers(0, len(_CHANGES)))](root, random)
    return ElementTree.tostring(root)


def wrapped(text: bytes, random: np.random.Generator) -> bytes:
    """Put a declaration, a document type or entities before a file."""
    heads = (
        b'<?xml version="1.0" encoding="utf-16"?>',
        b'<?xml version="1.0" encoding="iso-8859-1"?>',
        b'<?xml version="1.0" encoding="gb2312"?>',
        b'<?xml version="1.1"?>',
        b'<!DOCTYPE robot SYSTEM "file:///etc/passwd">',
        b'<!DOCTYPE r [<!ENTITY e SYSTEM "file:///etc/passwd">]>',
        b'<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]>',
        b'<!DOCTYPE r [<!ENTITY % p SYSTEM "file:///etc/passwd"> %p;]>',
        b"<?php exit ?>",
        b"<!-- -->" * 1000,
        b"\n\n ",
    )
    body = text[text.find(b"?>") + 2 :].lstrip() if text.startswith(b"<?xml") else text
    return heads[int(random.integers(0, len(heads)))] + body


def _elements(root: ElementTree.Element) -> list[ElementTree.Element]:
    return list(root.iter())


def _any(root: ElementTree.Element, random: np.random.Generator) -> ElementTree.Element:
    elements = _elements(root)
    return elements[int(random.integers(0, len(elements)))]


def _with_parent(root: ElementTree.Element, random: np.random.Generator) -> tuple[ElementTree.Element, int] | None:
    pairs = [(parent, index) for parent in root.iter() for index in range(len(parent))]
    return pairs[int(random.integers(0, len(pairs)))] if pairs else None


def _delete(root: ElementTree.Element, random: np.random.Generator) -> None:
    if found := _with_parent(root, random):
        del found[0][found[1]]


def _repeat(root: ElementTree.Element, random: np.random.Generator) -> None:
    if found := _with_parent(root, random):
        for _ in range(int(random.choice([1, 1, 2, 60]))):
            found[0].insert(found[1], copy.deepcopy(found[0][found[1]]))


def _move(root: ElementTree.Element, random: np.random.Generator) -> None:
    if found := _with_parent(root, random):
        _any(root, random).append(copy.deepcopy(found[0][found[1]]))


def _nest(root: ElementTree.Element, random: np.random.Generator) -> None:
    if found := _with_parent(root, random):
        parent, index = found
        for _ in range(int(random.choice([1, 2, 40, 250]))):
            outer = ElementTree.Element(parent[index].tag, parent[index].attrib)
            outer.append(parent[index])
            parent[index] = outer


def _rename(root: ElementTree.Element, random: np.random.Generator) -> None:
    _any(root, random).tag = str(random.choice([_any(root, random).tag, "include", "x:y", "INCLUDE", "robot", "mujoco", "\u00e9"]))


def _attribute(root: ElementTree.Element, random: np.random.Generator) -> tuple[ElementTree.Element, str] | None:
    pairs = [(element, key) for element in root.iter() for key in element.attrib]
    return pairs[int(random.integers(0, len(pairs)))] if pairs else None


def _delete_attribute(root: ElementTree.Element, random: np.random.Generator) -> None:
    if found := _attribute(root, random):
        del found[0].attrib[found[1]]


def _change_number(root: ElementTree.Element, random: np.random.Generator) -> None:
    if found := _attribute(root, random):
        words = found[0].attrib[found[1]].split() or [""]
        words[int(random.integers(0, len(words)))] = number(random)
        found[0].attrib[found[1]] = " ".join(words)


def _change_length(root: ElementTree.Element, random: np.random.Generator) -> None:
    if found := _attribute(root, random):
        words = found[0].attrib[found[1]].split()
        found[0].attrib[found[1]] = " ".join(words[:-1] if random.random() < 0.5 else words * int(random.integers(2, 30)))


def _exchange_values(root: ElementTree.Element, random: np.random.Generator) -> None:
    if (found := _attribute(root, random)) and (other := _attribute(root, random)):
        found[0].attrib[found[1]] = other[0].attrib[other[1]]


def _same_key(root: ElementTree.Element, random: np.random.Generator) -> None:
    """Give a name or reference the value of another one: loops, and two of one name."""
    if found := _attribute(root, random):
        values = [element.attrib[found[1]] for element in root.iter() if found[1] in element.attrib]
        found[0].attrib[found[1]] = str(random.choice(values))


def _change_name(root: ElementTree.Element, random: np.random.Generator) -> None:
    if found := _attribute(root, random):
        found[0].attrib[found[1]] = str(random.choice(NAMES))


def _add_attribute(root: ElementTree.Element, random: np.random.Generator) -> None:
    if found := _attribute(root, random):
        _any(root, random).attrib[found[1]] = str(random.choice([found[0].attrib[found[1]], number(random)]))


def _insert(root: ElementTree.Element, random: np.random.Generator) -> None:
    parent = _any(root, random) if random.random() < 0.5 else root
    parent.insert(int(random.integers(0, len(parent) + 1)), ElementTree.fromstring(snippet(random)))


_CHANGES = (
    *(_delete, _repeat, _move, _nest, _rename, _delete_attribute, _change_number, _change_number, _change_number),
    *(_change_length, _exchange_values, _same_key, _change_name, _add_attribute, _insert, _insert, _insert),
)


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
