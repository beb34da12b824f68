"""Three revolute joints with perpendicular axes, Nie's example for the choice of generalized speeds."""

import numpy as np

from kanejax._io.dh import DHLink, Numbers, from_dh
from kanejax._model.model import Model

_RIGHT = np.pi / 2


def three_revolute_arm(
    *,
    masses: Numbers = (18.1440, 12.2472, 8.6184),
    coms: Numbers = ((0.0, -0.1397, 0.1588), (0.0, -0.0127, 0.0), (0.1880, 0.0, 0.0)),
    central_inertias: Numbers = ((0.18, 0.045, 0.135), (0.03, 0.03, 0.0232), (0.1041, 0.1041, 0.026)),
    origins: Numbers = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    gravity: Numbers = (0.0, 9.81, 0.0),
) -> Model:
    """The manipulator of Nie 1988, Figure 2.2, by which he chooses the link whose angular velocity gives the speeds.

    Each joint's axis is perpendicular to the next: of his angular velocities with q_dot for speeds, w^3 = (s2 c3 u1 - s3 u2) c1
    - (s2 s3 u1 + c3 u2) c2 + (c2 u1 + u3) c3, and w^1, w^2 follow with A_1 = Rz(q1) Rx(90 deg), A_2 = Rz(q2) Rx(-90 deg),
    A_3 = Rz(q3). The figure gives no numbers; the defaults are those of the first three links of the Intelledex 605, which
    have these axes too: Nie's Table 3.

    Args:
        masses: of the links, (3,) in kg.
        coms: mass centres in the links' frames, (3, 3) in m; frame k has its origin on joint k, D_k of Nie.
        central_inertias: principal moments about the mass centres, (3, 3), or full, (3, 3, 3), in kg m^2.
        origins: from the first to the second and from the second to the third joint, (2, 3) in m, in the frames of the first
            and of the second link, L_k of Nie; zero where the axes intersect.
        gravity: acceleration of free fall in the base's frame, (3,).

    Returns:
        The model, with links "A", "B", "C".

    Raises:
        ValueError: an argument has a wrong number of rows or a wrong shape.
        InvalidInertiaError: no rigid body can have a link's inertia.
    """
    for name, rows, count in (
        ("masses", masses, 3),
        ("coms", coms, 3),
        ("central_inertias", central_inertias, 3),
        ("origins", origins, 2),
    ):
        if len(rows) != count:
            raise ValueError(
                f"{name} has {len(rows)} rows; this arm needs {count}, one for each link{' but the last' * (count == 2)}"
            )
    links = [
        DHLink(mass, com, inertia, alpha=alpha, next_origin=origin, name=name)
        for mass, com, inertia, alpha, origin, name in zip(
            masses, coms, central_inertias, (_RIGHT, -_RIGHT, 0.0), (*origins, None), "ABC", strict=True
        )
    ]
    return from_dh(links, convention="nie", gravity=gravity)
