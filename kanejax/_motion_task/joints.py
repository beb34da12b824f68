"""Numbers by joint, as the file of a task gives them: one for all, a list, or a table."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from kanejax._io.xml_text import file_content, parsed_xml
from kanejax._model.model import Model
from kanejax._model.tree import COORDINATES, SPEEDS, Tree
from kanejax._optimize.limits import joint_ranges
from kanejax._toml import refuse


def of_joints(
    origin: str, label: str, value: Any, tree: Tree, *, coordinates: bool = False, others: float | None = None
) -> np.ndarray:
    """One number for each speed, or each coordinate.

    Args:
        origin: the file, for messages.
        label: what the numbers are, for messages.
        value: a number for all, one each, or numbers by joint.
        tree: of the model.
        coordinates: whether there is one for each coordinate.
        others: of joints that a table does not name; by default they have to be named.

    Raises:
        ConfigurationError: a joint is unknown or lacking, or there are more or fewer numbers than needed.
    """
    sizes, starts = (COORDINATES, tree.q_start) if coordinates else (SPEEDS, tree.v_start)
    count, what = (tree.nq, "coordinates") if coordinates else (tree.nv, "speeds")
    if not isinstance(value, Mapping):
        if np.ndim(value) and len(value) != count:
            refuse(
                origin, f"{label} has {len(value)} numbers, but the robot has {count} {what}, of joints {_listed(tree.joint_names)}"
            )
        return np.broadcast_to(np.asarray(value, float), (count,)).copy()
    check_joints(origin, label, value, tree)
    if others is None and (lacking := [name for name in tree.joint_names if name not in value]):
        refuse(origin, f"{label} has no number for {_listed(lacking)}; name every joint")
    found = np.full(count, 0.0 if others is None else others)
    for name, numbers in value.items():
        joint = tree.joint(name)
        size = sizes[tree.joint_types[joint]]
        if np.size(numbers) != size:
            refuse(origin, f"{label} {name} has {np.size(numbers)} numbers, but this joint has {size} {what}")
        found[starts[joint] : starts[joint] + size] = numbers
    return found


def limits_of_joints(origin: str, label: str, value: Any, model: Model, field: str) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest of each speed; of joints that a table does not name there is none, or their range.

    Raises:
        ConfigurationError: a joint is unknown, or there are more or fewer numbers than needed.
    """
    tree = model.tree
    if not isinstance(value, Mapping):
        greatest = of_joints(origin, label, value, tree)
        return -greatest, greatest
    check_joints(origin, label, value, tree)
    least, greatest = np.array(joint_ranges(model)) if field == "q" else (np.full(tree.nv, -np.inf), np.full(tree.nv, np.inf))
    for name, numbers in value.items():
        joint = tree.joint(name)
        speeds = slice(tree.v_start[joint], tree.v_start[joint] + SPEEDS[tree.joint_types[joint]])
        least[speeds], greatest[speeds] = numbers if np.ndim(numbers) else (-numbers, numbers)
    return least, greatest


def limits_of_robot(origin: str, label: str, robot: str, field: str, tree: Tree) -> dict[str, float]:
    """Greatest speeds or forces that the URDF of a robot, a path or its text, states by joint.

    Raises:
        ConfigurationError: the file is no URDF, or states none.
    """
    attribute = {"u": "velocity", "tau": "effort"}[field]
    is_text = robot.lstrip().startswith("<")
    root = parsed_xml(robot.lstrip() if is_text else file_content(robot), "the robot" if is_text else robot)
    joints = [joint for joint in root.iter("joint") if joint.get("name") in tree.joint_names]
    limits = [(joint.get("name", ""), joint.find("limit")) for joint in joints]
    found = {name: float(limit.get(attribute, "nan")) for name, limit in limits if limit is not None and limit.get(attribute)}
    if root.tag != "robot" or not found:
        refuse(origin, f'{label} is "robot", but {"the robot" if is_text else robot} states no limits of {attribute}; give numbers')
    return found


def check_joints(origin: str, label: str, names: Any, tree: Tree) -> None:
    """Refuse joints that are not in the model.

    Raises:
        ConfigurationError: there is one.
    """
    for name in names:
        if name not in tree.joint_names:
            refuse(origin, f"{label}: no joint is named {name!r}; the joints are: {_listed(tree.joint_names)}")


def _listed(names: Any) -> str:
    return ", ".join(repr(name) for name in names)
