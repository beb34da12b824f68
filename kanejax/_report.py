"""What the command line prints of a model: a tree, and dictionaries."""

import math
from typing import Any

import numpy as np
from rich.text import Text
from rich.tree import Tree as RichTree

from kanejax._model.model import Model
from kanejax._model.tree import COORDINATES, SPEEDS, WORLD

# Parameters of a joint's speeds, and their units for rotations and translations.
_UNITS = {
    "armature": ("kg m^2", "kg"),
    "damping": ("N m s/rad", "N s/m"),
    "coulomb_friction": ("N m", "N"),
    "stiffness": ("N m/rad", "N/m"),
}


def model_dict(model: Model) -> dict[str, Any]:
    """Bodies and joints of a model as lists of dictionaries, in SI units and radians; None for ranges without an end."""
    return {
        "nbody": model.nbody,
        "nq": model.nq,
        "nv": model.nv,
        "gravity": _list(model.gravity),
        "bodies": [_body(model, body) for body in range(model.nbody)],
        "joints": [_joint(model, joint) for joint in range(model.njoint)],
    }


def model_tree(model: Model, title: str) -> RichTree:
    """Bodies and joints of a model as a tree for `rich.print`."""
    label = Text.assemble(
        (title, "bold"), f"\n{model.nbody} bodies, {model.njoint} joints, {model.nq} coordinates, {model.nv} speeds"
    )
    root = RichTree(label.append(f"\ngravity {_vector(model.gravity)} m/s^2"))
    branches: dict[int, RichTree] = {WORLD: root}
    for body, parent in enumerate(model.tree.body_parents):
        branches[body] = branches[parent].add(_body_label(model, body))
    return root


def _body(model: Model, body: int) -> dict[str, Any]:
    tree, parent = model.tree, model.tree.body_parents[body]
    return {
        "name": tree.body_names[body],
        "parent": None if parent == WORLD else tree.body_names[parent],
        "joints": [tree.joint_names[joint] for joint, moved in enumerate(tree.joint_bodies) if moved == body],
        "mass": float(model.mass[body]),
        "com": _list(model.com[body]),
        "central_inertia": _list(model.central_inertia[body]),
        "principal_moments": _list(_principal_moments(model, body)),
    }


def _joint(model: Model, joint: int) -> dict[str, Any]:
    tree, kind = model.tree, model.tree.joint_types[joint]
    speeds = slice(tree.v_start[joint], tree.v_start[joint] + SPEEDS[kind])
    axial = COORDINATES[kind] == 1
    return {
        "name": tree.joint_names[joint],
        "type": kind,
        "body": tree.body_names[tree.joint_bodies[joint]],
        "axis": _list(model.joint_axis[joint]) if axial else None,
        "range": [bound if math.isfinite(bound) else None for bound in _list(model.joint_range[joint])] if axial else None,
        "stiffness": float(model.stiffness[joint]),
        **{name: _list(getattr(model, name)[speeds]) for name in ("armature", "damping", "coulomb_friction")},
    }


def _body_label(model: Model, body: int) -> Text:
    values = _body(model, body)
    label = Text(values["name"], style="bold")
    joints = [joint for joint, moved in enumerate(model.tree.joint_bodies) if moved == body]
    if not joints:
        label.append(" welded", style="not bold dim")
    for joint in joints:
        label.append(f"\n{_joint_sentence(_joint(model, joint))}", style="not bold cyan")
    if values["mass"] or any(values["principal_moments"]):
        moments = ", ".join(f"{moment:.4g}" for moment in values["principal_moments"])
        text = f"\n{values['mass']:.4g} kg, mass centre {_vector(model.com[body])} m, principal moments {moments} kg m^2"
        label.append(text, style="not bold")
    return label


def _joint_sentence(values: dict[str, Any]) -> str:
    sentence = f"{values['name']}: {values['type']}"
    turns = 1 if values["type"] == "prismatic" else 0
    if values["axis"] is not None:
        sentence += f" along {_vector(values['axis'])}" if turns else f" about {_vector(values['axis'])}"
        low, high = values["range"]
        if low is not None or high is not None:
            ends = f"{-math.inf if low is None else low:.4g} to {math.inf if high is None else high:.4g}"
            sentence += f", {ends} {('rad', 'm')[turns]}"
    for name, units in _UNITS.items():
        numbers = np.ravel(values[name])
        if numbers.any():
            shown = f"{numbers[0]:.4g}" if np.all(numbers == numbers[0]) else _vector(numbers)
            unit = f" {units[turns]}" if values["axis"] is not None else ""
            sentence += f", {name.replace('_', ' ')} {shown}{unit}"
    return sentence


def _principal_moments(model: Model, body: int) -> np.ndarray:
    inertia = np.asarray(model.central_inertia[body], float)
    return np.linalg.eigvalsh(0.5 * (inertia + inertia.T))


def _vector(values: Any) -> str:
    # Adding zero makes a negative zero positive.
    return "(" + ", ".join(f"{float(value) + 0.0:.4g}" for value in np.ravel(values)) + ")"


def _list(values: Any) -> list:
    return np.asarray(values, float).tolist()
