"""A mechanism with every kind of trouble in it, and the ways to cause each in one trajectory of a batch.

All trajectories share one program: what differs between them are leaves, initial states and the parameters of the control.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import kanejax as kj

MECHANISM = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="base" pos="0 0 1"><freejoint name="float"/>
    <inertial pos="0.02 0.01 -0.03" mass="2" diaginertia="0.03 0.02 0.04"/>
    <body name="arm" pos="0.2 0 0"><joint name="shoulder" type="ball"/>
      <inertial pos="0.1 0.02 0" mass="0.7" diaginertia="0.004 0.006 0.005"/>
      <body name="forearm" pos="0.25 0 0"><joint name="elbow" axis="0 1 0" range="-2.5 2.5"/>
        <inertial pos="0.1 0 0.01" mass="0.5" diaginertia="0.001 0.002 0.002"/>
        <body name="hand" pos="0.2 0 0"><joint name="wrist" axis="1 0 0"/>
          <inertial pos="0.05 0.01 0.02" mass="0.3" diaginertia="0.0004 0.0006 0.0005"/></body></body></body></body>
</worldbody></mujoco>"""
# Where things are in q and u, and rows of the leaves.
BASE_QUATERNION, ELBOW_Q = slice(3, 7), 11
ELBOW_U = 9
FOREARM, HAND = 2, 3
ELBOW, WRIST = 2, 3


class Control(NamedTuple):
    """What a control law does to elbow and wrist; `disturbed` reads it.

    Attributes:
        gain: of the elbow's speed, negative for friction.
        value: added from `start` [s] on, where the elbow is above `above` [rad].
        chatter: force against the sign of the elbow's speed.
    """

    gain: Any = 0.0
    value: Any = 0.0
    start: Any = 0.0
    above: Any = -1e30
    chatter: Any = 0.0


class Case(NamedTuple):
    """One trajectory, or a batch of them."""

    model: kj.Model
    q: np.ndarray
    u: np.ndarray
    control: Control


Fault = Callable[[Case], Case]


def disturbed(t: jax.Array, q: jax.Array, u: jax.Array, how: Control) -> jax.Array:
    """The control law of all trajectories."""
    started = (t >= how.start) & (q[ELBOW_Q] > how.above)
    elbow = how.gain * u[ELBOW_U] + jnp.where(started, how.value, jnp.zeros_like(how.value)) - how.chatter * jnp.sign(u[ELBOW_U])
    return jnp.zeros_like(u).at[ELBOW_U].set(elbow)


def healthy(seed: int) -> Case:
    """A random motion of a mechanism whose masses are up to a fifth off, of about a radian a second."""
    rng = np.random.default_rng(seed)
    model = kj.load(MECHANISM)
    scale = rng.uniform(0.8, 1.2, (model.tree.nbody, 1))
    model = model.replace(mass=model.mass * scale[:, 0], central_inertia=model.central_inertia * scale[..., None])
    q = rng.normal(size=model.nq)
    for start in (3, 7):
        q[start : start + 4] /= np.linalg.norm(q[start : start + 4])
    return Case(model, q, rng.normal(size=model.nv), Control())


def stacked(cases: list[Case], dtype: Any) -> Case:
    """A batch of cases in one data type; numbers beyond it become zero or infinite."""
    with np.errstate(over="ignore", under="ignore"):
        return jax.tree.map(lambda *x: np.stack([np.asarray(y) for y in x]).astype(dtype), *cases)


def leaf(name: str, value: Any, *rows: int | tuple[int, ...]) -> Fault:
    """The model's leaf set to a value, in some rows or in all."""

    def change(case: Case) -> Case:
        values = np.array(getattr(case.model, name))
        if rows:
            for row in rows:
                values[row] = value
        else:
            values[...] = value
        return case._replace(model=eqx.tree_at(lambda m: getattr(m, name), case.model, values))

    return change


def scaled(factor: float, *bodies: int) -> Fault:
    """Masses and inertias of bodies times a factor."""

    def change(case: Case) -> Case:
        mass, inertia = np.array(case.model.mass), np.array(case.model.central_inertia)
        for body in bodies:
            mass[body] *= factor
            inertia[body] *= factor
        return case._replace(model=eqx.tree_at(lambda m: (m.mass, m.central_inertia), case.model, (mass, inertia)))

    return change


def coordinate(value: Any, where: Any = ELBOW_Q) -> Fault:
    """Initial coordinates set to a value."""
    return lambda case: case._replace(q=_set(case.q, where, value))


def speed(value: Any, where: Any = ELBOW_U) -> Fault:
    """Initial speeds set to a value."""
    return lambda case: case._replace(u=_set(case.u, where, value))


def quaternion_length(length: float) -> Fault:
    """The initial quaternion of the base times a length."""
    return lambda case: case._replace(q=_set(case.q, BASE_QUATERNION, case.q[BASE_QUATERNION] * length))


def control(**how: float) -> Fault:
    """A disturbance by the control."""
    return lambda case: case._replace(control=Control(**how))


def both(*changes: Fault) -> Fault:
    """One change after the other."""

    def change(case: Case) -> Case:
        for each in changes:
            case = each(case)
        return case

    return change


def _set(values: np.ndarray, where: Any, value: Any) -> np.ndarray:
    values = values.copy()
    values[where] = value
    return values


COAXIAL = leaf("joint_axis", (0.0, 1.0, 0.0), WRIST)
RELAXED = both(coordinate(0.0), speed(1.0))
FAULTS: dict[str, Fault] = {
    "tip of 1e-12 of its mass": scaled(1e-12, HAND),
    "tip without mass and inertia": scaled(0.0, HAND),
    "tip without inertia, mass on the joint's axis": both(leaf("central_inertia", 0.0, HAND), leaf("com", (0.05, 0.0, 0.0), HAND)),
    "tip of 1e-310 kg (float32: 1e-40)": scaled(1e-310, HAND),
    "link without mass between": scaled(0.0, FOREARM),
    "coaxial joints, link without mass between": both(COAXIAL, scaled(0.0, FOREARM)),
    "coaxial joints, 1e-12 of its mass between": both(COAXIAL, scaled(1e-12, FOREARM)),
    "both outer links without mass": scaled(0.0, FOREARM, HAND),
    "no mass at all": scaled(0.0, 0, 1, 2, 3),
    "tip of negative mass": scaled(-1.0, HAND),
    "negative armature, -1 kg m^2": leaf("armature", -1.0, ELBOW_U),
    "NaN for a mass": leaf("mass", np.nan, HAND),
    "infinity for a mass": leaf("mass", np.inf, HAND),
    "infinity for gravity": leaf("gravity", np.inf),
    "joint axis of length zero": leaf("joint_axis", 0.0, ELBOW),
    "body quaternion of length zero": leaf("body_quaternion", 0.0, HAND),
    "spring of 1e5 N m/rad, nearly relaxed": both(leaf("stiffness", 1e5, ELBOW), RELAXED),
    "spring of 1e9 N m/rad, nearly relaxed": both(leaf("stiffness", 1e9, ELBOW), RELAXED),
    "spring of 1e5 N m/rad, a radian off": both(leaf("stiffness", 1e5, ELBOW), coordinate(1.0)),
    "damping of 1e3 N m s/rad, from rest": both(leaf("damping", 1e3, ELBOW_U), speed(0.0)),
    "damping of 1e9 N m s/rad, from rest": both(leaf("damping", 1e9, ELBOW_U), speed(0.0)),
    "damping of 1e3 N m s/rad at 1 rad/s": both(leaf("damping", 1e3, ELBOW_U), speed(1.0)),
    "negative damping, -1 N m s/rad": leaf("damping", -1.0, ELBOW_U),
    "friction of 1 N m, width 1e-8 rad/s": both(leaf("coulomb_friction", 1.0, ELBOW_U), leaf("friction_width", 1e-8)),
    "friction of 1 N m, width zero, from rest": both(
        leaf("coulomb_friction", 1.0, ELBOW_U), leaf("friction_width", 0.0, ELBOW_U), speed(0.0)
    ),
    "speed of 1e3 rad/s": speed(1e3),
    "speed of 1e5 rad/s": speed(1e5),
    "speed of 1e8 rad/s": speed(1e8),
    "speed of 1e200 rad/s (float32: infinity)": speed(1e200),
    "coordinate of 1e6 rad": coordinate(1e6),
    "coordinate of 1e10 rad": coordinate(1e10),
    "coordinate of 1e15 rad": coordinate(1e15),
    "coordinate of 1e300 rad (float32: infinity)": coordinate(1e300),
    "NaN in q0": coordinate(np.nan),
    "infinity in q0": coordinate(np.inf),
    "NaN in u0": speed(np.nan),
    "infinity in u0": speed(np.inf),
    "quaternion of length zero": quaternion_length(0.0),
    "quaternion of length 5": quaternion_length(5.0),
    "quaternion of length 1e-30": quaternion_length(1e-30),
    "quaternion of length 1e-200 (float32: zero)": quaternion_length(1e-200),
    "quaternion of length 1e30": quaternion_length(1e30),
    "control returns NaN from 0.3 s on": control(value=np.nan, start=0.3),
    "control returns infinity from 0.3 s on": control(value=np.inf, start=0.3),
    "control returns NaN above a coordinate": both(control(value=np.nan, above=1.0), coordinate(0.5), speed(3.0)),
    "control jumps by 100 N m at 0.3 s": control(value=100.0, start=0.3),
    "control of unstable feedback": control(gain=5.0),
    "control with the sign of the speed": control(chatter=5.0),
}
