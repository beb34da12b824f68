"""Preparing a URDF for MuJoCo's compiler: checks by name, and removal of what the dynamics do not read.

What MuJoCo does with a URDF, established with MuJoCo 4.0.0:

- A link without <inertial> gets its mass from its collision shapes at 1000 kg/m^3, or zero without shapes. The URDF
  specification says zero, and Pinocchio does zero. Visual and collision elements are removed here, so the mass is
  zero, and does not depend on which mesh files are present.
- <mimic> becomes an equality constraint (older releases dropped it) and is dropped with a log line on a fixed joint.
- Static links are fused by default. The fused inertia was right to rounding in a test with rotated <origin rpy> of both
  inertial and joint, contrary to a report of mis-rotation; but fused links vanish, so the compile here never fuses.
- A floating joint is accepted only below a link called "world"; a planar joint becomes two slides and a hinge, named
  with the endings _TX, _TY and _RZ; a non-standard "spherical" joint becomes a ball joint.
- Two joints of one name, and several root links, pass without a word; a loop is reported as "URDF body not found".
- Problems are logged to a file MUJOCO_LOG.TXT in the working directory, so what would cause them is removed
  beforehand.
"""

import collections
import copy
import dataclasses
from xml.etree import ElementTree

from kanejax._io.urdf_check import FIXED, check_expanded, check_inertial, check_joints, check_links, check_tree

_KEPT_IN_LINK = ("inertial",)
_KEPT_IN_INERTIAL = ("origin", "mass", "inertia")
_KEPT_IN_JOINT = ("origin", "parent", "child", "axis", "dynamics", "limit")
_KEPT_OF_MUJOCO = ("compiler", "option")


@dataclasses.dataclass(frozen=True)
class PreparedUrdf:
    """XML for MuJoCo's compiler, and sentences: features that change the dynamics, harmless ones, and changes made."""

    xml: str
    refused: tuple[str, ...]
    ignored: tuple[str, ...]
    repaired: tuple[str, ...]


def prepared_urdf(robot: ElementTree.Element, origin: str, *, repair: bool) -> PreparedUrdf:
    """Check a <robot> element and strip it to what the dynamics need; `origin` names the file in errors.

    Raises ModelFileError for what is malformed (with `repair`, missing numbers, zero axes and repeated joint names are
    replaced), UnsupportedModelError for what MuJoCo cannot compile.
    """
    robot = copy.deepcopy(robot)
    check_expanded(robot, origin)
    links, joints = robot.findall("link"), robot.findall("joint")
    repaired: list[str] = []
    check_links(links, origin)
    check_joints(joints, origin, repair, repaired)
    check_tree(links, joints, origin)
    for link in links:
        check_inertial(link, f"{origin}: link {link.get('name')!r}", repair, repaired)
    refused = _mimic_sentences(joints) + _compiler_sentences(robot)
    ignored = _ignored_sentences(robot, links, joints)
    _strip(robot, links, joints)
    xml = ElementTree.tostring(robot, encoding="unicode")
    return PreparedUrdf(xml, tuple(refused), tuple(ignored), tuple(repaired))


def _mimic_sentences(joints: list[ElementTree.Element]) -> list[str]:
    mimics = [(joint.get("name"), joint.find("mimic")) for joint in joints if joint.get("type") != FIXED]
    return [
        f"joint {name!r} mimics joint {mimic.get('joint')!r}: mimic joints are not modelled"
        for name, mimic in mimics
        if mimic is not None
    ]


def _compiler_sentences(robot: ElementTree.Element) -> list[str]:
    compilers = robot.findall("mujoco/compiler")
    if not any(compiler.get("inertiafromgeom") == "true" for compiler in compilers):
        return []
    return ["compiler inertiafromgeom='true': geometry of a URDF is not read; load it with MuJoCo and pass the MjModel"]


def _ignored_sentences(
    robot: ElementTree.Element, links: list[ElementTree.Element], joints: list[ElementTree.Element]
) -> list[str]:
    shapes = [link for link in links if link.find("visual") is not None or link.find("collision") is not None]
    colliding = [link for link in links if link.find("collision") is not None]
    massless = [link.get("name", "") for link in colliding if link.find("inertial") is None]
    moving = [joint for joint in joints if joint.get("type") != FIXED]
    sentences = []
    if shapes:
        sentences.append(f"visual and collision shapes are not read ({len(shapes)} links have some)")
    if massless:
        sentences.append(f"links with collision shapes but no <inertial> have zero mass: {', '.join(massless)}")
    for tag, consequence in (("safety_controller", "are not applied"), ("calibration", "is not read")):
        count = sum(joint.find(tag) is not None for joint in moving)
        if count:
            sentences.append(f"<{tag}> {consequence} ({count} joints have one)")
    if any(limit.get("velocity") is not None for joint in moving for limit in joint.findall("limit")):
        sentences.append("velocity limits of joints are not enforced")
    for joint in moving:
        limit = joint.find("limit")
        if joint.get("type") != "continuous" and _is_empty_range(limit):
            sentences.append(f"joint {joint.get('name')!r}: its equal lower and upper limits are dropped")
    others = collections.Counter(e.tag for e in robot if e.tag not in ("link", "joint", "material", "mujoco"))
    sentences += [f"<{tag}> elements are not read ({count})" for tag, count in sorted(others.items())]
    return sentences


def _is_empty_range(limit: ElementTree.Element | None) -> bool:
    if limit is None:
        return False
    lower, upper = limit.get("lower"), limit.get("upper")
    return lower is not None and upper is not None and float(lower) == float(upper)


def _strip(robot: ElementTree.Element, links: list[ElementTree.Element], joints: list[ElementTree.Element]) -> None:
    """Remove in place what MuJoCo need not see, above all references to files."""
    _keep(robot, ("link", "joint", "mujoco"))
    for extension in robot.findall("mujoco"):
        _keep(extension, _KEPT_OF_MUJOCO)
    for link in links:
        # MuJoCo gives the inertial of a link called "world" to its fixed frame, where it means nothing.
        _keep(link, () if link.get("name") == "world" else _KEPT_IN_LINK)
        for inertial in link.findall("inertial"):
            _keep(inertial, _KEPT_IN_INERTIAL)
    for joint in joints:
        _keep(joint, _KEPT_IN_JOINT)
        limit = joint.find("limit")
        if limit is not None and _is_empty_range(limit):
            # MuJoCo ignores such limits too, but logs each to a file.
            del limit.attrib["lower"], limit.attrib["upper"]


def _keep(element: ElementTree.Element, tags: tuple[str, ...]) -> None:
    for child in list(element):
        if child.tag not in tags:
            element.remove(child)
