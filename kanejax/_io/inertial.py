"""A body's inertial numbers, whether a rigid body can have them, and the nearest numbers that it can have.

A mass distribution has second moments about its mass centre with eigenvalues s_1, s_2, s_3 >= 0; its principal moments
of inertia are the sums of two of them. So numbers are physical when mass >= 0 and every s_i = (A + B + C) / 2 -
moment_i >= 0, which says both that the moments are not negative and that none exceeds the sum of the others. Equality
is allowed: a point mass, a thin rod, a flat plate and a massless frame are all physical.
"""

import dataclasses

import numpy as np

# A second moment may be negative by this fraction of the largest principal moment: decimals rounded in a file do that.
RELATIVE_TOLERANCE = 1e-6
# ... or by the mass times this length squared, in m: the noise around zero that exporters write for point masses.
TOLERANCE_LENGTH = 1e-6
# Repair raises second moments to this fraction of the largest principal moment.
REPAIR_FLOOR = 1e-6
# Repair gives a moving body that needs a mass this mass in kg and an isotropic inertia of this radius of gyration in m.
REPAIR_MASS = 1e-3
REPAIR_RADIUS = 1e-2


@dataclasses.dataclass(frozen=True)
class Inertial:
    """Mass in kg, mass centre in m from the body's origin, inertia in kg m^2 about the mass centre; in body axes."""

    mass: float
    com: np.ndarray
    central_inertia: np.ndarray


def defect(mass: float, moments: np.ndarray) -> str | None:
    """Say in words what no rigid body can have, given a mass and principal moments; None where all is well."""
    if mass < 0:
        return f"mass {mass:.6g} kg is negative"
    second_moments = moments.sum() / 2 - moments
    excess = -second_moments.min()
    if excess <= RELATIVE_TOLERANCE * np.abs(moments).max() + TOLERANCE_LENGTH**2 * mass:
        return None
    listed = described_moments(moments)
    if moments.min() < -RELATIVE_TOLERANCE * np.abs(moments).max():
        return f"principal moments {listed} kg m^2 include a negative one"
    share = 2 * excess / moments.max()
    return (
        f"principal moments {listed} kg m^2 break the triangle inequality A + B >= C by {2 * excess:.3g} kg m^2, "
        f"{100 * share:.3g} % of C"
    )


def nearest_physical_moments(moments: np.ndarray, smallest: float = 0.0) -> np.ndarray:
    """Return principal moments whose second moments are clipped from below, in the same order.

    The bound is `smallest`, in kg m^2, or `REPAIR_FLOOR` of the largest moment where that is more. The principal axes
    stay.
    """
    floor = max(REPAIR_FLOOR * moments.max(), smallest)
    second_moments = np.maximum(moments.sum() / 2 - moments, floor)
    return second_moments.sum() - second_moments


def described_moments(moments: np.ndarray) -> str:
    """Return principal moments as text, ascending."""
    return ", ".join(f"{moment:.6g}" for moment in np.sort(moments))
