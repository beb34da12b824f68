"""A plant: a mechanism, and the drives that stand between the motor's signal and its joints."""

import dataclasses
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._dynamics.active_force import passive_force
from kanejax._dynamics.inertia_force import inertia_force
from kanejax._dynamics.regressor import prepare_with
from kanejax._errors import UnknownNameError
from kanejax._evaluate import check_state, evaluate_prepared, prepare_once
from kanejax._model.model import Model
from kanejax._model.prepared import Prepared, displacement
from kanejax._model.tree import Tree
from kanejax._scalar import add, mul, sub
from kanejax._types import Coordinates, Forces, Speeds


@final
class Drives(eqx.Module):
    """What turns a motor's signal into force at the joint, and what its gear takes, for each generalized speed.

    Viscous damping, Coulomb friction and the inertia of the rotors are leaves of `Model`; these come on top.

    Attributes:
        gain: force [N] or torque [N m] a unit of signal; 1 where the signal is the force.
        offset: force [N] or torque [N m] that the signal shows at rest without load.
        stribeck_friction: friction force [N] or torque [N m] above Coulomb's that fades with speed.
        stribeck_speed: speed [rad/s or m/s] at which it has faded to 1/e; greater than zero.
        load_friction: friction a unit of the force that the gear transmits; no unit.
        delay: time [s] by which the signal lags the motion, ().
    """

    gain: Float[Array, " nv"]
    offset: Float[Array, " nv"]
    stribeck_friction: Float[Array, " nv"]
    stribeck_speed: Float[Array, " nv"]
    load_friction: Float[Array, " nv"]
    delay: Float[Array, ""]

    @staticmethod
    def ideal(model: Model) -> "Drives":
        """Drives whose signal is the force at the joint: gain 1, stribeck_speed 0.1, and all else 0."""
        one = jnp.ones(model.nv, model.dtype)
        zero = jnp.zeros_like(one)
        return Drives(one, zero, zero, 0.1 * one, zero, jnp.zeros((), model.dtype))

    def replace(self, **leaves: Any) -> "Drives":
        """The same drives with other leaves, converted to their data type; one number may stand for all speeds.

        Raises:
            UnknownNameError: drives have no such leaf; the message lists those they have.
            ValueError: a shape does not fit.
        """
        own = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        for name, value in leaves.items():
            if name not in own:
                raise UnknownNameError("leaf of drives", name, own)
            array = jnp.asarray(value).astype(own[name].dtype)
            if array.ndim and array.shape != own[name].shape:
                raise ValueError(f"drives.{name} has shape {array.shape}, but needs {own[name].shape}")
            leaves[name] = jnp.broadcast_to(array, own[name].shape)
        return dataclasses.replace(self, **leaves)


@final
class Plant(eqx.Module):
    """A mechanism with its drives: `Plant(model, Drives.ideal(model))` measures forces at the joints.

    Attributes:
        model: the mechanism.
        drives: between the signal and its joints.
    """

    model: Model
    drives: Drives

    def __check_init__(self) -> None:
        """Compare the shapes and data types of the drives with those of the model."""
        for field in dataclasses.fields(self.drives):
            leaf, shape = getattr(self.drives, field.name), () if field.name == "delay" else (self.model.nv,)
            if jnp.shape(leaf) != shape:
                raise ValueError(f"drives.{field.name} has shape {jnp.shape(leaf)}, but this model needs {shape}")
            if leaf.dtype != self.model.dtype:
                raise ValueError(f"drives.{field.name} has dtype {leaf.dtype}, but the model has {self.model.dtype}")


def drive_force(
    plant: Plant, q: Coordinates, u: Speeds, u_dot: Speeds, parameters: Float[Array, "nbody 10"] | None = None
) -> Forces:
    """Forces of the drives, before their gears take their part, that make the mechanism move with the given accelerations.

    `inverse_dynamics`, which includes damping, Coulomb friction, springs and rotors, plus the friction of the gears,
    (stribeck_friction exp(-(u / stribeck_speed)^2) + load_friction |tau_load|) u / sqrt(u^2 + friction_width^2), plus the offset.
    tau_load is what the mechanism takes without rotors, springs, dampers and friction: what the gear transmits. Stribeck's curve
    as in Armstrong-Helouvry, Dupont and Canudas de Wit (1994), friction in proportion to the load, and both smoothed at rest.

    Args:
        plant: mechanism and drives.
        q: generalized coordinates.
        u: generalized speeds.
        u_dot: their rates.
        parameters: inertia parameters of the bodies, see `inertia_parameters`, in place of the model's mass, com and
            central_inertia; the result is linear in them where load_friction is zero.

    Returns:
        Force [N] or torque [N m] on each generalized speed.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    model = plant.model
    check_state(model, q=q, u=u, u_dot=u_dot)
    prepared = prepare_once(model) if parameters is None else prepare_with(model, parameters)
    force, load = evaluate_prepared(force_and_load, model.tree, prepared, q, u, u_dot)
    return _force_of_drives(plant.drives, model.friction_width, force, load, u)


def signal(
    plant: Plant, q: Coordinates, u: Speeds, u_dot: Speeds, parameters: Float[Array, "nbody 10"] | None = None
) -> Float[Array, " nv"]:
    """Signal of each motor during the given motion, in its own unit: `drive_force` over the gain. The delay is left out.

    Args:
        plant: the model and its drives.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds.
        u_dot: their rates.
        parameters: `inertia_parameters` to put in place of the model's.

    Returns:
        One number a speed, in the unit of the motors' signals.
    """
    return drive_force(plant, q, u, u_dot, parameters) / plant.drives.gain


def motor_signal(drives: Drives, friction_width: Speeds, force: Forces, load: Forces, u: Speeds) -> Float[Array, " nv"]:
    """Signal of each motor, from the forces at the joints and what of them the gears transmit: see `force_and_load`."""
    return _force_of_drives(drives, friction_width, force, load, u) / drives.gain


def force_and_load(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array, u_dot: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Kernel: what `inverse_dynamics` returns, and the part of it without rotors, springs, dampers and friction."""
    load = inertia_force(tree, prepared.links, prepared.gravity, displacement(tree, prepared, q), u, u_dot)
    force = sub(add(load, mul(prepared.armature, u_dot)), passive_force(tree, prepared, q, u))
    return jnp.asarray(force), jnp.asarray(load)


def _force_of_drives(drives: Drives, friction_width: Speeds, force: Forces, load: Forces, u: Speeds) -> Forces:
    faded = drives.stribeck_friction * jnp.exp(-jnp.square(u / drives.stribeck_speed))
    sense = u * jax.lax.rsqrt(u * u + friction_width * friction_width)
    return force + (faded + drives.load_friction * jnp.abs(load)) * sense + drives.offset
