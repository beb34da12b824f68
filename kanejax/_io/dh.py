"""Serial arms from tables: Denavit-Hartenberg parameters, standard or modified, and Nie's tables of A, L and D."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._io.check import DEFAULT_FRICTION_WIDTH, check_model
from kanejax._io.rotation import quaternion_of, rotation_about
from kanejax._model.model import Model
from kanejax._model.tree import Tree

Convention = Literal["standard", "modified", "nie"]
# Numbers in nested sequences or arrays.
Numbers = Sequence[Any] | np.ndarray | jax.Array
_CONVENTIONS = ("standard", "modified", "nie")
_JOINT_TYPES = ("revolute", "prismatic")
# Columns that every row has, with their units.
_COLUMNS = {"mass": "kg", "alpha": "rad", "a": "m", "d": "m", "theta": "rad"}
# A rotation matrix may be this far from orthonormal: tables have rounded numbers.
_ORTHONORMAL = 1e-4


@final
@dataclasses.dataclass(frozen=True)
class DHLink:
    """One row of a table: a link, and the joint that moves it; see `from_dh` for where its frame is.

    Attributes:
        mass: in kg.
        com: mass centre in the link's frame, (3,) in m; D_k of Nie.
        central_inertia: about the mass centre in the link's axes, (3, 3), or (3,) if these are principal, in kg m^2.
        joint: "revolute" or "prismatic". Its coordinate is added to theta or to d.
        alpha: angle in rad between the joint's axis and the next one, about x; of the modified convention, the one before.
        a: distance in m of these axes along x.
        d: distance in m along the joint's axis.
        theta: angle in rad about the joint's axis.
        rotation: A_k at zero coordinate, (3, 3), from the link's to the previous link's components, instead of alpha and
            theta; not in the modified convention.
        next_origin: from the link's origin to the next link's, in the link's frame, (3,) in m, instead of a and d: L_k of
            Nie; only in his convention.
        name: of the link, "link1" for the first unless given.
        joint_name: of the joint, "joint1" for the first unless given.
        armature: inertia of the rotor, reflected to the joint.
        damping: force or torque a unit of speed.
        coulomb_friction: greatest friction force or torque.
        joint_range: least and greatest coordinate, if there are any.
    """

    mass: float
    com: Numbers = (0.0, 0.0, 0.0)
    central_inertia: Numbers = (0.0, 0.0, 0.0)
    joint: str = "revolute"
    alpha: float = 0.0
    a: float = 0.0
    d: float = 0.0
    theta: float = 0.0
    rotation: Numbers | None = None
    next_origin: Numbers | None = None
    name: str | None = None
    joint_name: str | None = None
    armature: float = 0.0
    damping: float = 0.0
    coulomb_friction: float = 0.0
    joint_range: Numbers = (-np.inf, np.inf)


class _Placed(NamedTuple):
    """A link's frame in the previous one at zero coordinate, and in the link's frame its joint and the next origin."""

    position: np.ndarray
    rotation: np.ndarray
    axis: np.ndarray
    anchor: np.ndarray
    next_origin: np.ndarray


def from_dh(
    links: Sequence[DHLink],
    *,
    convention: Convention = "standard",
    base_position: Numbers = (0.0, 0.0, 0.0),
    base_rotation: Numbers | None = None,
    gravity: Numbers = (0.0, 0.0, -9.81),
    allow_unphysical: bool = False,
) -> Model:
    """Build a serial arm from a table with a row a link, from the base outwards.

    The frame of link k, in which its mass centre and inertia are given, and which is the body's frame in the model:

    - "standard" (Denavit and Hartenberg, Paul): fixed at the far end of link k, z along the axis of joint k+1. In the frame
      before, it is Rz(theta) Tz(d) Tx(a) Rx(alpha), and joint k acts along z of the frame before.
    - "modified" (Craig): fixed at the near end of link k, z along the axis of joint k. In the frame before, it is
      Rx(alpha) Tx(a) Rz(theta) Tz(d).
    - "nie" (Nie 1988, II.1 and III.2): with the directions of the standard frame, but its origin on the axis of joint k,
      which is z of the frame before. A_k = Rz(theta) Rx(alpha) or `rotation`; L_k is `next_origin`, or made of a and d. As in
      Nie (3.22)-(3.23), a prismatic joint adds q_k n3^(k-1) to D_k and L_k; the body's frame moves along. L_0 is `base_position`.

    Args:
        links: the rows.
        convention: where the frames are.
        base_position: of the frame before the first, in the world, (3,).
        base_rotation: from components in the frame before the first to the world's, (3, 3); the identity unless given.
        gravity: acceleration of free fall in the world.
        allow_unphysical: keep inertias that no rigid body can have, with an UnphysicalInertiaWarning.

    Returns:
        The model, with a friction_width of 0.01 rad/s or m/s. Leaves are float64 if `jax_enable_x64` is set, otherwise
        float32.

    Raises:
        TypeError: a row is no DHLink.
        ValueError: a row lacks a number, has a wrong shape, joint type or rotation matrix, or numbers that its convention does
            not read. The message names the row.
        InvalidInertiaError: no rigid body can have a link's inertia, or a joint moves no inertia.
        InvalidParameterError: a number is not finite.
    """
    if convention not in _CONVENTIONS:
        raise ValueError(f"convention {convention!r} is unknown; the conventions are {', '.join(_CONVENTIONS)}")
    for number, link in enumerate(links, start=1):
        if not isinstance(link, DHLink):
            raise TypeError(f"row {number} is of type {type(link).__name__}; give DHLink(mass=..., alpha=..., a=..., d=...)")
        for field in ("name", "joint_name"):
            name = getattr(link, field)
            if name is not None and not isinstance(name, str):
                raise ValueError(f"row {number}: {field} = {name!r} is no text")
    tree = _tree(links)
    labels = [f"row {number}, link {name!r}" for number, name in enumerate(tree.body_names, start=1)]
    placed = [_placed(link, convention, label) for link, label in zip(links, labels, strict=True)]
    turn = np.eye(3) if base_rotation is None else _rotation(base_rotation, "base_rotation")
    frames = _chained(placed, _array(base_position, (3,), "base_position"), turn)
    model = _model(tree, links, labels, frames, _array(gravity, (3,), "gravity"))
    check_model(model, allow_unphysical=allow_unphysical)
    return model


def _tree(links: Sequence[DHLink]) -> Tree:
    count = len(links)
    return Tree(
        body_names=tuple(link.name or f"link{number}" for number, link in enumerate(links, start=1)),
        body_parents=tuple(range(-1, count - 1)),
        joint_names=tuple(link.joint_name or f"joint{number}" for number, link in enumerate(links, start=1)),
        joint_types=tuple("prismatic" if link.joint == "prismatic" else "revolute" for link in links),
        joint_bodies=tuple(range(count)),
    )


def _placed(link: DHLink, convention: Convention, label: str) -> _Placed:
    """Place a link's frame; of Nie's convention, but for the position, which the row before has."""
    _check_row(link, convention, label)
    z = np.array([0.0, 0.0, 1.0])
    if convention == "modified":
        tilt = rotation_about(0, link.alpha)
        position = np.array([link.a, 0.0, 0.0]) + link.d * tilt[:, 2]
        return _Placed(position, tilt @ rotation_about(2, link.theta), z, np.zeros(3), np.zeros(3))
    if link.rotation is None:
        rotation = rotation_about(2, link.theta) @ rotation_about(0, link.alpha)
    else:
        rotation = _rotation(link.rotation, f"{label}: rotation")
    # The joint's axis is z of the frame before.
    axis = rotation.T @ z
    along = np.array([link.a, 0.0, 0.0]) + link.d * axis
    if convention == "standard":
        return _Placed(rotation @ along, rotation, axis, -along, np.zeros(3))
    if link.next_origin is not None:
        along = _array(link.next_origin, (3,), f"{label}: next_origin")
        # Otherwise found in the next row's body, or never in the last one.
        if not np.isfinite(along).all():
            raise ValueError(f"{label}: next_origin = {' '.join(f'{number:.6g}' for number in along)} is not finite")
    return _Placed(np.zeros(3), rotation, axis, np.zeros(3), along)


def _chained(placed: list[_Placed], base_position: np.ndarray, base_rotation: np.ndarray) -> list[_Placed]:
    """Put the first frame on the base, and each other one where the row before has its origin."""
    chained, origin, turn = [], base_position, base_rotation
    for row in placed:
        chained.append(row._replace(position=origin + turn @ row.position, rotation=turn @ row.rotation))
        origin, turn = row.next_origin, np.eye(3)
    return chained


def _model(tree: Tree, links: Sequence[DHLink], labels: list[str], frames: list[_Placed], gravity: np.ndarray) -> Model:
    count, dtype = len(links), jax.dtypes.canonicalize_dtype(float)

    def leaf(rows: object, *shape: int) -> jax.Array:
        return jnp.asarray(np.asarray(rows, float).reshape(shape), dtype)

    def column(name: str, *shape: int) -> jax.Array:
        rows = [_array(getattr(link, name), shape, f"{label}: {name}") for link, label in zip(links, labels, strict=True)]
        return leaf(rows, count, *shape)

    return Model(
        tree=tree,
        gravity=leaf(gravity, 3),
        body_position=leaf([frame.position for frame in frames], count, 3),
        body_quaternion=leaf([quaternion_of(frame.rotation) for frame in frames], count, 4),
        joint_axis=leaf([frame.axis for frame in frames], count, 3),
        joint_anchor=leaf([frame.anchor for frame in frames], count, 3),
        mass=column("mass"),
        com=column("com", 3),
        central_inertia=leaf([_inertia(link, label) for link, label in zip(links, labels, strict=True)], count, 3, 3),
        armature=column("armature"),
        damping=column("damping"),
        stiffness=leaf(np.zeros(count), count),
        spring_reference=leaf(np.zeros(count), count),
        coordinate_reference=leaf(np.zeros(count), count),
        coulomb_friction=column("coulomb_friction"),
        friction_width=leaf(np.full(count, DEFAULT_FRICTION_WIDTH), count),
        joint_range=column("joint_range", 2),
    )


def _check_row(link: DHLink, convention: Convention, label: str) -> None:
    """Refuse an unknown joint type, numbers that are missing, and numbers that would not be read."""
    if link.joint not in _JOINT_TYPES:
        raise ValueError(f"{label}: joint {link.joint!r} is unknown; the types are {', '.join(_JOINT_TYPES)}")
    for name, unit in _COLUMNS.items():
        value = getattr(link, name)
        if value is None or not np.isfinite(_array(value, (), f"{label}: {name}")):
            raise ValueError(f"{label}: {name} = {value!r} is not a finite number; give it in {unit}")
    if link.rotation is not None and (convention == "modified" or link.alpha or link.theta):
        raise ValueError(f"{label}: give either rotation or alpha and theta; the modified convention takes the latter only")
    if link.next_origin is not None and (convention != "nie" or link.a or link.d):
        raise ValueError(f"{label}: give either next_origin or a and d; only convention='nie' takes the former")


def _array(values: Any, shape: tuple[int, ...], label: str) -> np.ndarray:
    array = _float_array(values, f"{label} = {values!r} is no array of numbers; it needs the shape {shape}")
    if array.shape != shape:
        raise ValueError(f"{label} has shape {array.shape}, but needs {shape}")
    return array


def _float_array(values: Any, problem: str) -> np.ndarray:
    try:
        # NumPy would read a text, a truth value or a date as a number; None becomes NaN.
        if np.asarray(values).dtype.kind in "SUbmMV":
            raise TypeError
        return np.asarray(values, float)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(problem) from error


def _rotation(values: Numbers, label: str) -> np.ndarray:
    rotation = _array(values, (3, 3), label)
    if not np.allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=_ORTHONORMAL) or np.linalg.det(rotation) < 0:
        raise ValueError(f"{label} is not a rotation matrix: its rows must be orthonormal and its determinant 1")
    # The nearest rotation matrix to rounded numbers.
    left, _, right = np.linalg.svd(rotation)
    return left @ right


def _inertia(link: DHLink, label: str) -> np.ndarray:
    values = link.central_inertia
    inertia = _float_array(
        values, f"{label}: central_inertia = {values!r} is no array of numbers; it needs the shape (3, 3) or (3,)"
    )
    if inertia.shape == (3,):
        return np.diag(inertia)
    if inertia.shape != (3, 3):
        raise ValueError(f"{label}: central_inertia has shape {inertia.shape}, but needs (3, 3), or (3,) for principal moments")
    # What is not finite is left to `check_model`.
    if np.isfinite(inertia).all() and not np.allclose(inertia, inertia.T, rtol=0, atol=1e-9 * np.abs(inertia).max()):
        raise ValueError(f"{label}: central_inertia is not symmetric; products of inertia are its off-diagonal elements")
    return inertia
