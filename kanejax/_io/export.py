"""From a Model to MJCF and to MuJoCo's objects."""

from xml.etree import ElementTree

import mujoco
import numpy as np

from kanejax._errors import InvalidInertiaError, ModelFileError, UnsupportedModelError
from kanejax._io.assets import one_line
from kanejax._io.check import check_numbers
from kanejax._io.inertial import defect, described_moments
from kanejax._model.model import Model
from kanejax._model.tree import COORDINATES, SPEEDS, WORLD

_TAGS = {"revolute": "hinge", "prismatic": "slide", "ball": "ball", "free": "free"}
# MuJoCo's limits are numbers; this one, in rad or m, is never reached.
_NO_LIMIT = 1e10
# MuJoCo refuses bodies that move with less mass, or a smaller principal moment, than this.
_SMALLEST = 1e-15


def to_mujoco(model: Model) -> mujoco.MjSpec:
    """Convert a model to a spec; its `compile()` gives an MjModel with the same mass matrix, bias and passive forces.

    Coulomb friction becomes friction loss, which MuJoCo treats as a constraint; friction_width has no counterpart and is
    dropped.

    Args:
        model: without batch axes, and outside of `jax.jit`.

    Returns:
        The spec.

    Raises:
        InvalidInertiaError: MuJoCo refuses the inertia of a moving body.
        UnsupportedModelError: a number that MJCF cannot express, see `to_mjcf`.
        InvalidParameterError: a number is not finite, or lies where the dynamics are not defined.
    """
    text = to_mjcf(model)
    try:
        spec = mujoco.MjSpec.from_string(text)
        # A spec cannot be read after it failed to compile, so the try is on a copy.
        spec.copy().compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        refused = _refused_inertias(model)
        if refused:
            remedy = "Give the bodies inertias that MuJoCo accepts, or weld massless bodies to their neighbours"
            raise InvalidInertiaError(
                f"MuJoCo refuses the inertias of: {'; '.join(refused)}. {remedy} ({one_line(error)})"
            ) from error
        raise ModelFileError(f"MuJoCo cannot compile the model: {one_line(error)}") from error
    return spec


def to_mjcf(model: Model, *, name: str = "kanejax") -> str:
    """Write a model as MJCF, with every digit of its numbers.

    `load` reads it back as the same model, but for friction_width, which MJCF cannot express. Inertias are written as
    principal moments; where those break A + B >= C by rounding, which MuJoCo does not accept, they are changed by that.

    Args:
        model: without batch axes, and outside of `jax.jit`.
        name: of the model in the file.

    Returns:
        The XML.

    Raises:
        UnsupportedModelError: the speeds of a ball or free joint differ in armature, damping or friction, or a ball joint's
            spring is relaxed elsewhere than at (1, 0, 0, 0); MJCF cannot express that.
        InvalidParameterError: a number is not finite, or lies where the dynamics are not defined.
        ValueError: a leaf has a batch axis.
    """
    check_numbers(model)
    root = ElementTree.Element("mujoco", model=name)
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="false")
    ElementTree.SubElement(root, "option", gravity=numbers(model.gravity))
    elements = [ElementTree.SubElement(root, "worldbody")]
    tree = model.tree
    for body, parent in enumerate(tree.body_parents):
        element = ElementTree.SubElement(elements[0] if parent == WORLD else elements[parent + 1], "body")
        elements.append(element)
        joints = [joint for joint, moved in enumerate(tree.joint_bodies) if moved == body]
        _write_body(model, body, element, joints)
        for joint in joints:
            ElementTree.SubElement(element, "joint", _joint_attributes(model, joint))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def numbers(values: object) -> str:
    """Write numbers with as many digits as they have."""
    return " ".join(repr(float(value)) for value in np.ravel(np.asarray(values, float)))


def _write_body(model: Model, body: int, element: ElementTree.Element, joints: list[int]) -> None:
    tree = model.tree
    position, quaternion = model.body_position[body], model.body_quaternion[body]
    if any(tree.joint_types[joint] == "free" and model.stiffness[joint] for joint in joints):
        # The place of a body with a free joint does not matter, save that MuJoCo's spring is relaxed there.
        start = tree.q_start[joints[0]]
        position, quaternion = model.spring_reference[start : start + 3], model.spring_reference[start + 3 : start + 7]
    element.attrib.update(name=tree.body_names[body], pos=numbers(position), quat=numbers(quaternion))
    mass, moments, axes = _principal(model, body)
    moves = tree.body_links[body] != WORLD
    # MuJoCo checks the inertia of bodies that do not move too, where it does not matter.
    if (mass or moments.any()) and (moves or defect(mass, moments) is None):
        attributes = {"pos": numbers(model.com[body]), "mass": numbers(mass), "diaginertia": numbers(moments)}
        if axes is not None:
            attributes["quat"] = numbers(_quaternion(axes))
        ElementTree.SubElement(element, "inertial", attributes)


def _principal(model: Model, body: int) -> tuple[float, np.ndarray, np.ndarray | None]:
    """Mass, principal moments and, unless they are the body's, principal axes as columns."""
    mass, inertia = float(model.mass[body]), np.asarray(model.central_inertia[body], float)
    inertia = 0.5 * (inertia + inertia.T)
    moments, axes = np.diag(inertia).copy(), None
    if np.any(inertia != np.diag(moments)):
        moments, axes = np.linalg.eigh(inertia)
        axes = axes * np.sign(np.linalg.det(axes))
    if defect(mass, moments) is None:
        moments = np.maximum(moments, 0.0)
        largest = np.argmax(moments)
        others = np.delete(moments, largest)
        moments[largest] = min(moments[largest], others[0] + others[1])
    return mass, moments, axes


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    return quaternion


def _joint_attributes(model: Model, joint: int) -> dict[str, str]:
    tree = model.tree
    kind = tree.joint_types[joint]
    start, end = tree.v_start[joint], tree.v_start[joint] + SPEEDS[kind]
    attributes = {"name": tree.joint_names[joint], "type": _TAGS[kind]}
    if kind != "free":
        attributes["pos"] = numbers(model.joint_anchor[joint])
    if COORDINATES[kind] == 1:
        axis, coordinate = np.asarray(model.joint_axis[joint], float), tree.q_start[joint]
        attributes["axis"] = numbers(axis / np.linalg.norm(axis))
        attributes["ref"] = numbers(model.coordinate_reference[coordinate])
        attributes["springref"] = numbers(model.spring_reference[coordinate])
        limits = np.asarray(model.joint_range[joint], float)
        attributes["limited"] = "true" if np.isfinite(limits).any() else "false"
        if np.isfinite(limits).any():
            attributes["range"] = numbers(np.clip(limits, -_NO_LIMIT, _NO_LIMIT))
    elif model.stiffness[joint] and kind == "ball":
        _check_spring_reference(model, joint)
    attributes["stiffness"] = numbers(model.stiffness[joint])
    for attribute, leaf in (("armature", "armature"), ("damping", "damping"), ("frictionloss", "coulomb_friction")):
        values = np.asarray(getattr(model, leaf)[start:end])
        if np.any(values != values[0]):
            raise UnsupportedModelError(
                f"joint {tree.joint_names[joint]!r}: {leaf} = {numbers(values)} differs among its speeds; MJCF has one number "
                "for all of them"
            )
        attributes[attribute] = numbers(values[0])
    return {key: value for key, value in attributes.items() if key in ("limited", "range") or value.strip("0. ")}


def _check_spring_reference(model: Model, joint: int) -> None:
    start = model.tree.q_start[joint]
    reference = np.asarray(model.spring_reference[start : start + 4], float)
    if np.any(reference[1:] != 0):
        raise UnsupportedModelError(
            f"joint {model.tree.joint_names[joint]!r}: its spring is relaxed at {numbers(reference)}; MJCF has only springs "
            "of ball joints that are relaxed at 1 0 0 0"
        )


def _refused_inertias(model: Model) -> list[str]:
    """Moving bodies whose mass or principal moments MuJoCo may refuse."""
    refused = []
    for body, (name, link) in enumerate(zip(model.tree.body_names, model.tree.body_links, strict=True)):
        mass, moments, _ = _principal(model, body)
        problem = defect(mass, moments)
        if problem is None and body in model.tree.joint_bodies and min(mass, moments.min()) < _SMALLEST:
            problem = f"mass {mass:.6g} kg, principal moments {described_moments(moments)} kg m^2 are too small for a jointed body"
        if link != WORLD and problem is not None:
            refused.append(f"body {name!r}: {problem}")
    return refused
