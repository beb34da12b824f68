"""What drives do to a mechanism: force at the joints from the motors' signal, the inverse of `signal`."""

import equinox as eqx
import jax
import jax.numpy as jnp

from kanejax._dynamics.active_force import passive_force
from kanejax._dynamics.equations_of_motion import _forward_dynamics
from kanejax._evaluate import evaluate_prepared
from kanejax._model.prepared import Prepared
from kanejax._model.tree import Tree
from kanejax._parameters.plant import Drives
from kanejax._types import Coordinates, Forces, Speeds


class Mechanism(eqx.Module):
    """What the force at the joints depends on besides state and signal.

    Attributes:
        prepared: parameters of the mechanism.
        drives: between the signal and its joints.
        tree: of the mechanism; static.
        has_load_friction: whether `drives.load_friction` counts, which takes two more solutions of the equations of motion; static.
    """

    prepared: Prepared
    drives: Drives
    tree: Tree = eqx.field(static=True)
    has_load_friction: bool = eqx.field(static=True)


def joint_force(mechanism: Mechanism, signal: Forces, q: Coordinates, u: Speeds) -> Forces:
    """Force [N] or torque [N m] that is left for the joints of gain * signal after offset and friction of the gears.

    Friction in proportion to the load depends on the acceleration, which depends on it. With the sign of the load known, the
    equations of motion are linear in both: those of a mechanism with other rotors. The sign is that without this friction.
    """
    drives, prepared = mechanism.drives, mechanism.prepared
    width = prepared.friction_width
    sense = u * jax.lax.rsqrt(u * u + width * width)
    faded = drives.stribeck_friction * jnp.exp(-jnp.square(u / drives.stribeck_speed))
    force = drives.gain * signal - drives.offset - faded * sense
    if not mechanism.has_load_friction:
        return force
    passive = evaluate_prepared(_passive, mechanism.tree, prepared, q, u)
    # load + armature * u_dot - passive = force - share * load, where the load is what the gear transmits.
    u_dot = evaluate_prepared(_forward_dynamics, mechanism.tree, prepared, q, u, force)
    free = force + passive - prepared.armature * u_dot
    share = drives.load_friction * jnp.where(free < 0, -sense, sense)
    taken = prepared._replace(armature=prepared.armature / (1.0 + share))
    driving = (force - share * passive) / (1.0 + share)
    u_dot = evaluate_prepared(_forward_dynamics, mechanism.tree, taken, q, u, driving)
    load = (force + passive - prepared.armature * u_dot) / (1.0 + share)
    return force - share * load


def _passive(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array) -> jax.Array:
    return jnp.broadcast_to(jnp.asarray(passive_force(tree, prepared, q, u), u.dtype), u.shape)
