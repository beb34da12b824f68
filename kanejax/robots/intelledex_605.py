"""The Intelledex 605, Nie's example: six revolute joints."""

import numpy as np

from kanejax._io.dh import DHLink, from_dh
from kanejax._model.model import Model

# Nie, Table 3 [m].
_L1, _L2 = 0.2794, 0.3226
_L12, _L13, _L22, _L31, _L41 = 0.1397, 0.1588, 0.0127, 0.1880, 0.1727
_RIGHT = np.pi / 2
# The middle links turn about parallel axes; the fifth tilts its own with n2 along the axis before.
_A5 = ((1, 0, 0), (0, 0, 1), (0, -1, 0))


def intelledex_605(*, l33: float = 0.0, l43: float = 0.0, l52: float = 0.0, l63: float = 0.0) -> Model:
    """The arm of Nie 1988, Figures 2.1 and 3.2, with the masses, lengths and principal moments of his Table 3.

    Frame k is fixed in link k, its origin on joint k, which turns about z of frame k-1. The thesis prints no table of L_k and D_k;
    they follow from the velocities of its mass centres, Nie (2.26)-(2.34). Gravity, 9.81 m/s^2, acts along y of the base, his n2.

    Args:
        l33: L33 [m], along the third joint's axis to the mass centre of link C and on to the fourth joint.
        l43: L43 [m], the same for link D and the fifth joint.
        l52: L52 [m], from the intersection with the fourth joint's axis back to the mass centre of link E.
        l63: L63 [m], from the wrist to the mass centre of link F.

    All four are symbols of the equations that Table 3 leaves out; zero unless given.

    Returns:
        The model, with links "A" to "F".
    """
    wrist = l33 + l43
    return from_dh(
        (
            DHLink(18.1440, (0.0, -_L12, _L13), (0.18, 0.045, 0.135), alpha=_RIGHT, name="A"),
            DHLink(12.2472, (0.0, -_L22, 0.0), (0.03, 0.03, 0.0232), alpha=-_RIGHT, name="B"),
            DHLink(8.6184, (_L31, 0.0, l33), (0.1041, 0.1041, 0.026), next_origin=(_L1, 0.0, l33), name="C"),
            DHLink(4.9896, (_L41, 0.0, l43), (0.0605, 0.0605, 0.026), next_origin=(_L2, 0.0, l43), name="D"),
            DHLink(
                1.3608, (0.0, wrist - l52, 0.0), (0.0048, 0.0048, 0.0035), rotation=_A5, next_origin=(0.0, wrist, 0.0), name="E"
            ),
            DHLink(0.9072, (0.0, 0.0, l63), (0.0040, 0.0040, 0.0030), name="F"),
        ),
        convention="nie",
        gravity=(0.0, 9.81, 0.0),
    )
