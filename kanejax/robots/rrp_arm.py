"""The arm with two revolute joints and a prismatic one of Kane and Levinson 1983, which holds a rigid body."""

import dataclasses
from typing import Literal

import jax.numpy as jnp
import numpy as np

from kanejax._io.check import check_model
from kanejax._io.dh import DHLink, from_dh
from kanejax._model.model import Model

# Distances [m] L1 = A C1, L2 = B C2 and LB = A B; the place of C_R from C3 along i2, j2, k2.
_L1, _L2, _LB = 0.3, 0.5, 1.1
_P = (0.2, 0.4, 0.6)
# From components along (k1, i1, j1) to those along (j0, k0, i0), and from (i2, j2, k2) to (k1, i1, j1), at zero coordinates.
_NEXT_AXES = ((0, 0, 1), (1, 0, 0), (0, 1, 0))
# Link 1 turns about i1 alone, so that nothing but A_x = 11 matters of its inertia; A_y and A_z are set to the same.
_LINK1 = DHLink(87.0, (_L1, 0, 0), (11, 11, 11), rotation=_NEXT_AXES, next_origin=(_LB, 0, 0), name="link1", joint_name="q3")
_LINK2 = DHLink(63.0, (0, 0, _L2), (7, 6, 2), rotation=_NEXT_AXES, next_origin=(0, 0, _L2), name="link2", joint_name="q1")
_LINK3 = DHLink(42.0, (0, 0, 0), (5, 4, 1), joint="prismatic", name="link3", joint_name="q2")
# D of Kane and Levinson (1.35), the central inertia [kg m^2] of RB in (i2, j2, k2).
_RB_MASS = 50.0
_RB_INERTIA = ((2.0, 0.6, -1.1), (0.6, 2.5, 0.75), (-1.1, 0.75, 1.3))


def rrp_arm(*, load: Literal["welded", "fused"] = "welded") -> Model:
    """The arm with three degrees of freedom of Kane and Levinson 1983, with the data of its simulation.

    Link 1 turns by q3 about the vertical i0 = i1, at A. Link 2 turns in link 1 by q1 about the horizontal j1 = j2, at B.
    Link 3 slides in link 2 by q2 along k2, and holds a rigid body RB. Equation numbers (1.x) are those of the chapter on
    open kinematic chains that has these data.

    The joints carry the names of the text's coordinates, and come from the base outwards, in the order of its generalized
    speeds (1.3): the model's q is (q3, q1, q2) in rad, rad, m, and its u is (u1, u2, u3) = (q3', q1', q2').

    Frames are those of Nie's convention (`from_dh`), which for this arm has the text's axes. Of (x, y, z):

    - the world is (j0, k0, i0), with its origin at A, and z up;
    - "link1" is (k1, i1, j1), at A, with C1 at L1 x and B at LB x;
    - "link2" is (i2, j2, k2), at B, with C2 at L2 z;
    - "link3" is (i2, j2, k2), at its mass centre C3, which is q2 away from C2 along z;
    - "RB" is (i2, j2, k2), at C3, with its mass centre C_R at (px, py, pz).

    At q = 0 the text's axes (i, j, k) of the world and of both links agree.

    L1, L2, LB = 0.3, 0.5, 1.1 m; (px, py, pz) = (0.2, 0.4, 0.6) m; masses of links 1, 2, 3 and RB 87, 63, 42 and 50 kg;
    central principal moments [kg m^2] Ax = 11, B = (7, 6, 2), C = (5, 4, 1); central inertia of RB D11, D22, D33 = 2, 2.5, 1.3,
    D12 = 0.6, D13 = -1.1, D23 = 0.75; gravity 9.81 m/s^2. The text has no Ay and Az, which do not matter; they are set to Ax.

    The printed inertia of RB is not one that a rigid body can have: its principal moments 0.1103, 2.7889, 2.9008 break A + B >= C
    by 0.0016. The equations of motion are well defined all the same, because link 3 and RB together are a possible body.

    Args:
        load: "welded" keeps RB as a body of its own, welded to link 3, with an UnphysicalInertiaWarning; MuJoCo refuses it.
            "fused" makes one body "link3" of link 3 and RB by the parallel axis theorem, with the same equations of motion and
            no warning.

    Returns:
        The model.

    Raises:
        ValueError: `load` is neither.
    """
    if load == "fused":
        return from_dh((_LINK1, _LINK2, _fused()), convention="nie")
    if load != "welded":
        raise ValueError(f"load {load!r} is unknown; give 'welded' or 'fused'")
    model = _with_load(from_dh((_LINK1, _LINK2, _LINK3), convention="nie"))
    check_model(model, allow_unphysical=True)
    return model


def _with_load(model: Model) -> Model:
    """Hang RB on the last link, without a joint: a table has a joint in every row."""
    tree = dataclasses.replace(
        model.tree, body_names=(*model.tree.body_names, "RB"), body_parents=(*model.tree.body_parents, model.nbody - 1)
    )
    rows = {
        "body_position": np.zeros(3),
        "body_quaternion": np.array([1.0, 0.0, 0.0, 0.0]),
        "mass": np.array(_RB_MASS),
        "com": np.array(_P),
        "central_inertia": np.array(_RB_INERTIA),
    }
    leaves = {name: jnp.concatenate((getattr(model, name), jnp.asarray(row, model.dtype)[None])) for name, row in rows.items()}
    return dataclasses.replace(model, tree=tree, **leaves)


def _fused() -> DHLink:
    """Link 3 with RB as one body: masses, first moments, and inertias about the common mass centre add."""
    mass = _LINK3.mass + _RB_MASS
    com = _RB_MASS * np.array(_P) / mass
    inertia = np.diag(_LINK3.central_inertia) + np.array(_RB_INERTIA)
    inertia += _LINK3.mass * _about(-com) + _RB_MASS * _about(np.array(_P) - com)
    return dataclasses.replace(_LINK3, mass=mass, com=com, central_inertia=inertia)


def _about(arm: np.ndarray) -> np.ndarray:
    """What the parallel axis theorem adds for a unit mass, (3, 3), from the mass centre's place `arm` (3,)."""
    return arm @ arm * np.eye(3) - np.outer(arm, arm)
