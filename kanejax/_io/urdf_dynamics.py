"""Writing a model's damping and friction into the text of a URDF, of which everything else stays as it is."""

import re
import xml.parsers.expat
from typing import Any, NamedTuple

import numpy as np

from kanejax._errors import ModelFileError
from kanejax._io.check import check_numbers
from kanejax._io.export import numbers
from kanejax._io.urdf_inertials import tag_end
from kanejax._io.xml_text import parsed_xml
from kanejax._model.model import Model

_LEAVES = {"damping": "damping", "friction": "coulomb_friction"}


class _Joint(NamedTuple):
    """Where, in bytes, the start tags of a <joint>'s <dynamics> begin, and its end tag."""

    dynamics: list[int]
    end: list[int]


def with_joint_dynamics(model: Model, text: str) -> str:
    """Return the text of a URDF with the model's damping and Coulomb friction in the <dynamics> of its joints.

    Joints without <dynamics> get one where the model has damping or friction. Other attributes stay, to the byte.

    Args:
        model: the numbers; its joints that turn or slide are joints of the URDF, by name.
        text: of the URDF.

    Raises:
        ModelFileError: the text is no XML, or lacks a joint.
        InvalidParameterError: a number is not finite.
        ValueError: a leaf has a batch axis.
    """
    check_numbers(model)
    parsed_xml(text, "URDF")
    data, tree = text.encode(), model.tree
    joints = _joints(data)
    values = {}
    for joint, (name, kind) in enumerate(zip(tree.joint_names, tree.joint_types, strict=True)):
        if kind not in ("revolute", "prismatic"):
            continue
        if name not in joints:
            raise ModelFileError(f"URDF: no <joint> named {name!r}; give the URDF that the model was loaded from")
        values[name] = {key: getattr(model, leaf)[tree.v_start[joint]] for key, leaf in _LEAVES.items()}
    # From the end of the text to its beginning, so that the places before stay where they are.
    for name in sorted(values, key=lambda name: joints[name].end[0], reverse=True):
        data = _with_dynamics(data, joints[name], values[name])
    return data.decode()


def _joints(data: bytes) -> dict[str, _Joint]:
    """Find the joints of a robot, by name."""
    joints: dict[str, _Joint] = {}
    path: list[str] = []
    parser = xml.parsers.expat.ParserCreate("utf-8")

    def start(tag: str, attributes: dict[str, str]) -> None:
        if path == ["robot"] and tag == "joint":
            joints[attributes.get("name", "")] = _Joint([], [])
        if path == ["robot", "joint"] and tag == "dynamics":
            next(reversed(joints.values())).dynamics.append(parser.CurrentByteIndex)
        path.append(tag)

    def end(tag: str) -> None:
        path.pop()
        if path == ["robot"] and tag == "joint":
            next(reversed(joints.values())).end.append(parser.CurrentByteIndex)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(data, True)
    return joints


def _with_dynamics(data: bytes, joint: _Joint, values: dict[str, Any]) -> bytes:
    if not joint.dynamics:
        if not any(np.any(value) for value in values.values()):
            return data
        attributes = " ".join(f'{key}="{numbers(value)}"' for key, value in values.items())
        place = joint.end[0]
        return data[:place] + f"<dynamics {attributes}/>".encode() + data[place:]
    for begin in reversed(joint.dynamics):
        end = tag_end(data, begin)
        tag = data[begin:end]
        for key, value in values.items():
            tag = _with_attribute(tag, key, numbers(value))
        data = data[:begin] + tag + data[end:]
    return data


def _with_attribute(tag: bytes, key: str, value: str) -> bytes:
    written = f'{key}="{value}"'.encode()
    found = re.search(rb"(?<=\s)" + key.encode() + rb"""\s*=\s*(?:"[^"]*"|'[^']*')""", tag)
    if found:
        return tag[: found.start()] + written + tag[found.end() :]
    return b"<dynamics " + written + tag.removeprefix(b"<dynamics")
