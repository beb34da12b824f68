"""Writing a model's inertias into the text of a URDF, of which everything else stays as it is."""

import os
import re
import xml.parsers.expat
from typing import NamedTuple

import numpy as np

from kanejax._errors import ModelFileError
from kanejax._io.check import check_numbers
from kanejax._io.export import numbers
from kanejax._io.xml_text import file_content, parsed_xml
from kanejax._model.model import Model


class _Link(NamedTuple):
    """Where, in bytes, a <link> begins and its start tag ends, and its <inertial> elements from begin to end."""

    begin: int
    tag_end: int
    inertials: list[tuple[int, int]]


def to_urdf_inertials(model: Model, urdf: str | os.PathLike[str]) -> str:
    """Return the text of a URDF with the <inertial> of each link replaced by the model's mass, mass centre and inertia.

    A body's frame in a model that was loaded from a URDF is the frame of its link, so the numbers are written as they are,
    with every digit. Links without an <inertial> get one where the body has a mass or an inertia. Comments, shapes, joints
    and all else stay, to the byte; joint parameters of the model are not written.

    Args:
        model: the numbers; its bodies are links of the URDF, by name.
        urdf: path of the URDF that the model was loaded from, or its text.

    Returns:
        The text of the new URDF.

    Raises:
        ModelFileError: the file cannot be read, is no URDF, or lacks a link for a body.
        InvalidParameterError: a number is not finite.
        ValueError: a leaf has a batch axis.
    """
    check_numbers(model)
    text, origin = _text_and_origin(urdf)
    root = parsed_xml(text, origin)
    if root.tag != "robot":
        raise ModelFileError(f"{origin}: the root element is <{root.tag}>; a URDF starts with <robot>")
    data = text.encode()
    links = _links(data)
    missing = [name for name in model.tree.body_names if name not in links]
    if missing:
        listed = ", ".join(repr(name) for name in missing)
        raise ModelFileError(f"{origin}: no <link> for body {listed}; give the URDF that the model was loaded from")
    # From the end of the text to its beginning, so that the places before stay where they are.
    for name in sorted(model.tree.body_names, key=lambda name: links[name].begin, reverse=True):
        data = _with_inertial(data, links[name], model, model.tree.body(name))
    return data.decode()


def _text_and_origin(urdf: str | os.PathLike[str]) -> tuple[str, str]:
    if isinstance(urdf, str) and urdf.lstrip().startswith("<"):
        # A declared encoding is that of the file, not of the string.
        return re.sub(r"^\s+(?=<\?xml)", "", urdf), "XML string"
    data = file_content(urdf)
    declared = re.match(rb"""\s*<\?xml[^>]*encoding=["']([^"']+)["']""", data)
    try:
        return data.decode(declared[1].decode() if declared else "utf-8-sig"), str(urdf)
    except (ValueError, LookupError) as error:
        raise ModelFileError(f"{urdf}: its text cannot be decoded ({error}); declare its encoding in the first line") from error


def _links(data: bytes) -> dict[str, _Link]:
    """Find the links of a robot, by name."""
    links: dict[str, _Link] = {}
    path: list[tuple[str, int]] = []
    parser = xml.parsers.expat.ParserCreate("utf-8")

    def start(tag: str, attributes: dict[str, str]) -> None:
        begin = parser.CurrentByteIndex
        if [element for element, _ in path] == ["robot"] and tag == "link":
            links[attributes.get("name", "")] = _Link(begin, tag_end(data, begin), [])
        path.append((tag, begin))

    def end(tag: str) -> None:
        begin = path.pop()[1]
        if tag == "inertial" and [element for element, _ in path] == ["robot", "link"]:
            next(reversed(links.values())).inertials.append((begin, tag_end(data, parser.CurrentByteIndex)))

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(data, True)
    return links


def tag_end(data: bytes, begin: int) -> int:
    """Where the tag that begins at `begin` ends; a '>' between quotes does not end it."""
    match = re.compile(rb"""<(?:[^"'>]|"[^"]*"|'[^']*')*>""").match(data, begin)
    assert match is not None, "the text is well-formed XML"
    return match.end()


def _with_inertial(data: bytes, link: _Link, model: Model, body: int) -> bytes:
    if not link.inertials and not np.any(model.mass[body]) and not np.any(model.central_inertia[body]):
        return data
    if link.inertials:
        first, end = link.inertials[0]
        indent = _indent(data, first)
        # MuJoCo reads the first <inertial>; a second one would contradict it.
        for second in reversed(link.inertials[1:]):
            data = data[: second[0]] + data[second[1] :]
        return data[:first] + _inertial(model, body, indent) + data[end:]
    indent = _indent(data, link.begin) + b"  "
    inserted = indent.join([b"\n", _inertial(model, body, indent)])
    tag = data[link.begin : link.tag_end]
    if tag.endswith(b"/>"):
        tag_name = b"</link>"
        inserted = tag[:-2].rstrip() + b">" + inserted + b"\n" + indent[:-2] + tag_name
        return data[: link.begin] + inserted + data[link.tag_end :]
    return data[: link.tag_end] + inserted + data[link.tag_end :]


def _indent(data: bytes, begin: int) -> bytes:
    """The blanks before an element, if there is nothing else on its line."""
    before = data[data.rfind(b"\n", 0, begin) + 1 : begin]
    return before if not before.strip() else b""


def _inertial(model: Model, body: int, indent: bytes) -> bytes:
    inertia = np.asarray(model.central_inertia[body], float)
    inertia = 0.5 * (inertia + inertia.T)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = ([numbers(element) for element in row] for row in inertia)
    lines = [
        "<inertial>",
        f'  <origin xyz="{numbers(model.com[body])}" rpy="0 0 0"/>',
        f'  <mass value="{numbers(model.mass[body])}"/>',
        f'  <inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/>',
        "</inertial>",
    ]
    return (b"\n" + indent).join(line.encode() for line in lines)
