"""The Stanford arm, Kane and Levinson's example: five revolute joints and a prismatic one."""

import numpy as np

from kanejax._io.dh import DHLink, Numbers, from_dh
from kanejax._model.model import Model

_RIGHT = np.pi / 2
# Paul 1981: masses [kg], mass centres in the links' frames [m], moments of inertia about the axes of these frames [kg m^2].
_MASSES = (9.29, 5.01, 4.25, 1.08, 0.63, 0.51)
_COMS = ((0, 0.0175, -0.1105), (0, -0.1054, 0), (0, 0, -0.6447), (0, 0.0092, -0.0054), (0, 0, 0.0566), (0, 0, 0.1554))
_INERTIAS = (
    *((0.276, 0.255, 0.071), (0.108, 0.018, 0.100), (2.51, 2.51, 0.006)),
    *((0.002, 0.001, 0.001), (0.003, 0.003, 0.0004), (0.013, 0.013, 0.0003)),
)


def stanford_arm(
    *,
    masses: Numbers = _MASSES,
    coms: Numbers = _COMS,
    inertias: Numbers = _INERTIAS,
    armatures: Numbers = (0.0,) * 6,
    base_height: float = 0.412,
    shoulder_offset: float = 0.154,
) -> Model:
    """The arm of T. R. Kane and D. A. Levinson, "The use of Kane's dynamical equations in robotics", 1983.

    Nie 1988 compares with their operation counts but gives no data of the arm. The defaults are those of R. P. Paul, "Robot
    manipulators: mathematics, programming and control", 1981, Tables 6.5 and 6.6, and the lengths of Paul's "Modelling,
    trajectory calculation and servoing of a computer controlled arm", Stanford AIM-177, 1972, Figure 2.3, as P. Corke's Robotics
    Toolbox (`mdl_stanford`) republishes them; the book was not seen. Two readings differ from the toolbox's, which no such
    arm could have:

    - Its mass centres of links 2 to 6 are ten times farther out (6.4 m for the boom); taken as slips in the unit, cm.
    - It calls the moments central. Taken as about the axes of the links' frames, in which the products of inertia vanish: as
      central moments, 2.51 kg m^2 would be those of a uniform boom 2.7 m long, and 0.013 kg m^2 of a hand 0.55 m long; so
      read the boom is 1.4 m long, and all links have inertias that rigid bodies can have.

    Standard Denavit and Hartenberg frames, so that frame k is at the far end of link k, and the last one at the wrist, where
    its mass centre's distance is counted from. The third coordinate is the distance [m] of the wrist from the shoulder, and
    the boom's turn of -90 degrees the toolbox's. Gravity acts along -z of the base, which is the first joint's axis.

    Args:
        masses: of the links, (6,) in kg.
        coms: mass centres in the links' frames, (6, 3) in m.
        inertias: moments of inertia about the axes of the links' frames, (6, 3), or inertia matrices, (6, 3, 3), in kg m^2.
        armatures: inertias of the motors, reflected to the joints, (6,) in kg m^2, of the third in kg; none unless given, as with
            Kane and Levinson. Paul's are (0.953, 2.193, 0.782, 0.106, 0.097, 0.020).
        base_height: from the base to the second joint's axis [m].
        shoulder_offset: of the boom from the first joint's axis [m].

    Returns:
        The model, with links "A" to "F".

    Raises:
        ValueError: an argument has a wrong number of rows or a wrong shape.
        InvalidInertiaError: no rigid body can have a link's inertia.
    """
    for name, rows in (("masses", masses), ("coms", coms), ("inertias", inertias), ("armatures", armatures)):
        if len(rows) != 6:
            raise ValueError(f"{name} has {len(rows)} rows; this arm needs 6, one for each link")
    kinds = ("revolute", "revolute", "prismatic", "revolute", "revolute", "revolute")
    table = zip(
        masses, coms, inertias, armatures, kinds, (-_RIGHT, _RIGHT, 0.0, -_RIGHT, _RIGHT, 0.0),
        (base_height, shoulder_offset, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, -_RIGHT, 0.0, 0.0, 0.0), "ABCDEF", strict=True,
    )  # fmt: skip
    links = [
        DHLink(mass, com, _central(mass, com, inertia, name), joint, alpha=alpha, d=d, theta=theta, armature=armature, name=name)
        for mass, com, inertia, armature, joint, alpha, d, theta, name in table
    ]
    return from_dh(links)


def _central(mass: float, com: Numbers, inertia: Numbers, name: str) -> np.ndarray:
    """Inertia matrix about the mass centre, from moments about the axes of the frame: the parallel axis theorem."""
    at, about_origin = np.asarray(com, float), np.asarray(inertia, float)
    if at.shape != (3,) or about_origin.shape not in ((3,), (3, 3)):
        raise ValueError(
            f"link {name!r}: com has shape {at.shape} and inertia {about_origin.shape}; they need (3,), and (3,) or (3, 3)"
        )
    if about_origin.ndim == 1:
        about_origin = np.diag(about_origin)
    return about_origin - mass * (at @ at * np.eye(3) - np.outer(at, at))
