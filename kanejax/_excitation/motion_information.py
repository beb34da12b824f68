"""What a motion would tell of the parameters: its regressor, and the precision to expect before anything is measured."""

import dataclasses
from collections.abc import Sequence
from typing import Literal, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._dynamics.equations_of_motion import inverse_dynamics_kernel
from kanejax._dynamics.regressor import prepare_with, regressor
from kanejax._errors import UnknownNameError
from kanejax._evaluate import evaluate_prepared
from kanejax._excitation.fourier_motion import Numbers, one_coordinate_joints
from kanejax._model.inertia import NAMES, inertia_parameters
from kanejax._model.model import Model
from kanejax._regression.base_parameters import ORDER, TOLERANCE, BaseParameters, enough_states, grouped, random_states
from kanejax._types import Coordinates, Speeds

Scaling = Literal["length", "nominal"]
SOUGHT = ("inertia", "armature", "damping", "coulomb_friction", "stiffness", "offset")
DEFAULT = ("inertia", "armature", "damping", "coulomb_friction", "offset")
_PASSIVE = ("armature", "damping", "coulomb_friction", "stiffness")


@final
@dataclasses.dataclass(frozen=True, eq=False)
class MotionInformation:
    """What forces that are measured during a motion tell of the base parameters, if their errors are independent.

    Rows of the regressor are divided by the standard deviations of their forces' errors. Its columns are those of the base
    parameters in SI units.

    Attributes:
        base: the base parameters, with formulas.
        factor: triangular, with factor^T factor the mean information (Fisher's) of one sample of all forces.
        size: what each column is multiplied by for the condition number: one over its own length, or the nominal size of its
            base parameter.
    """

    base: BaseParameters
    factor: Float[np.ndarray, "nbase nbase"]
    size: Float[np.ndarray, " nbase"]

    @property
    def log_det(self) -> float:
        """Logarithm of the determinant of the mean information of one sample; minus infinity if some parameter is not excited.

        Columns are not scaled: scaling them by constants adds a constant. One more unit, shared by all n base parameters, is a
        standard deviation smaller by the factor exp(-1 / (2 n)).
        """
        lengths = np.linalg.norm(self.factor, axis=0)
        if not np.all(lengths > 0):
            return -np.inf
        sizes = np.linalg.svd(self.factor / lengths, compute_uv=False)
        lost = sizes.min() <= TOLERANCE * sizes.max()
        return -np.inf if lost else float(2.0 * np.sum(np.log(sizes)) + 2.0 * np.sum(np.log(lengths)))

    @property
    def condition_number(self) -> float:
        """Largest over smallest singular value of the regressor with scaled columns; infinite if some parameter is not excited."""
        sizes = np.linalg.svd(self.factor * self.size, compute_uv=False)
        return float(sizes.max() / sizes.min()) if sizes.min() > TOLERANCE * sizes.max() else np.inf

    def std(self, samples: int) -> Float[np.ndarray, " nbase"]:
        """Standard deviations of the base parameters after so many samples; infinite for those that are not determined."""
        lengths = np.linalg.norm(self.factor, axis=0)
        scale = np.where(lengths > 0, lengths, 1.0)
        _, sizes, right = np.linalg.svd(self.factor / scale)
        kept = sizes > TOLERANCE * sizes.max()
        found = np.linalg.norm(right[kept].T / sizes[kept], axis=1) / scale / np.sqrt(samples)
        # In a combination that is not excited, no parameter with a share is determined.
        return np.where(np.any(np.abs(right[~kept]) > 1e-6, axis=0), np.inf, found)


def motion_information(
    model: Model,
    q: Numbers,
    u: Numbers,
    u_dot: Numbers,
    *,
    unknowns: Sequence[str] = DEFAULT,
    sigma: Numbers | None = None,
    scaling: Scaling = "length",
    base: BaseParameters | None = None,
) -> MotionInformation:
    """Information of a motion on base parameters, in float64 whatever JAX's settings.

    Args:
        model: the mechanism, whose joints have one coordinate each; what it has for the unknowns matters to `scaling` alone.
        q: coordinates at equally spaced times, (samples, nq).
        u: speeds, (samples, nv).
        u_dot: their rates.
        unknowns: what is to be identified: "inertia" of all bodies, and "armature", "damping", "coulomb_friction", "stiffness" and
            "offset" of all joints.
        sigma: standard deviation of the errors of each measured force [N or N m]; 1 by default.
        scaling: of the columns for the condition number: "length", each by its own; or "nominal", each by the size of its base
            parameter, the sum of its members' nominal sizes (Presse and Gautier 1993).
        base: what `base_of_unknowns` returns, if it is known.

    Raises:
        ValueError: a shape does not fit, a joint has several coordinates, sigma is not positive, or a nominal size is zero.
        UnknownNameError: an unknown is none of these.
    """
    one_coordinate_joints(model)
    base = base_of_unknowns(model, unknowns) if base is None else base
    weight = 1.0 / checked_sigma(model, sigma)
    states = [_checked(model, name, x) for name, x in (("q", q), ("u", u), ("u_dot", u_dot))]
    if len({len(x) for x in states}) > 1:
        raise ValueError(f"q, u and u_dot have {', '.join(str(len(x)) for x in states)} rows; they need the same number")
    with jax.enable_x64(True):
        rows = _columns_of_samples(model.astype(jnp.float64), tuple(unknowns), *(jnp.asarray(x) for x in states))
    rows = np.asarray(rows)[:, :, base.independent] * weight[None, :, None]
    factor = np.linalg.qr(rows.reshape(-1, len(base)) / np.sqrt(len(rows)), mode="r")
    factor = np.concatenate((factor, np.zeros((len(base) - len(factor), len(base)))))
    lengths = np.linalg.norm(factor, axis=0)
    size = 1.0 / np.where(lengths > 0, lengths, 1.0) if scaling == "length" else nominal_sizes(model, unknowns, base)
    return MotionInformation(base, factor, size)


def force_columns(model: Model, unknowns: tuple[str, ...], q: Coordinates, u: Speeds, u_dot: Speeds) -> Float[Array, "nv unknowns"]:
    """Derivative of the forces at the joints with respect to what is sought; first order derivatives of it are in reverse mode."""
    sense = u * jax.lax.rsqrt(u * u + model.friction_width * model.friction_width)
    diagonals = {
        "armature": u_dot,
        "damping": u,
        "coulomb_friction": sense,
        "stiffness": q - model.spring_reference,
        "offset": jnp.ones_like(u),
    }
    parts = [
        _inertia_columns(model, q, u, u_dot).reshape(model.nv, -1) if name == "inertia" else jnp.diag(diagonals[name])
        for name in unknowns
    ]
    return jnp.concatenate(parts, 1)


_columns_of_samples = jax.jit(jax.vmap(force_columns, (None, None, 0, 0, 0)), static_argnums=1)


def base_of_unknowns(model: Model, unknowns: Sequence[str]) -> BaseParameters:
    """Group what is sought into what forces at the joints can tell apart, at random states: see `base_parameters`.

    Raises:
        ValueError: nothing is sought, or something twice.
        UnknownNameError: the forces are not linear in something that is sought, or it is unknown.
    """
    for name in unknowns:
        if name not in SOUGHT:
            raise UnknownNameError("unknown that forces are linear in", name, SOUGHT)
    if not unknowns or len(set(unknowns)) < len(unknowns):
        raise ValueError(f"unknowns are {tuple(unknowns)}; name at least one of {', '.join(SOUGHT)}, and each once")
    names, places = [], {}
    for unknown in unknowns:
        places[unknown] = len(names)
        names += _names(model, unknown)
    # Rotors, springs and friction are rather counted with the bodies they move than the other way.
    own = {unknown: range(model.nv) for unknown in unknowns} | {
        "inertia": [10 * body + i for body in range(model.nbody) for i in ORDER]
    }
    order = [places[unknown] + i for unknown in SOUGHT if unknown in places for i in own[unknown]]
    with jax.enable_x64(True):
        wide = model.astype(jnp.float64)
        states = random_states(wide, enough_states(len(names), wide), 0)
        rows = _columns_of_samples(wide, tuple(unknowns), *states)
    return grouped(np.asarray(rows).reshape(-1, len(names)), names, order)


def nominal_sizes(model: Model, unknowns: Sequence[str], base: BaseParameters) -> Float[np.ndarray, " nbase"]:
    """Sizes of the base parameters, if no two of their members cancelled each other.

    Raises:
        ValueError: naming the first that is zero.
    """
    own = {name: np.abs(np.asarray(getattr(model, name), float)) for name in _PASSIVE}
    own |= {"inertia": np.abs(np.asarray(inertia_parameters(model), float)).ravel(), "offset": np.zeros(model.nv)}
    sizes = np.abs(base.matrix) @ np.concatenate([own[name] for name in unknowns])
    for formula, size in zip(base.formulas, sizes, strict=True):
        if size == 0:
            raise ValueError(
                f"the nominal size of {formula} is zero, so nothing can be scaled by it; give the model a typical value, "
                "leave that unknown out, or use scaling='length'"
            )
    return sizes


def checked_sigma(model: Model, sigma: Numbers | None) -> Float[np.ndarray, " nv"]:
    """Standard deviations of the errors of each force, 1 by default.

    Raises:
        ValueError: the shape does not fit, or one is not positive.
    """
    values = np.ones(model.nv) if sigma is None else np.asarray(sigma, float)
    if values.shape != (model.nv,):
        raise ValueError(f"sigma has shape {values.shape}, but this model needs ({model.nv},) = (nv,)")
    for joint, value in zip(model.tree.joint_names, values, strict=True):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"sigma of joint {joint!r} is {value}; it must be positive and finite")
    return values


@jax.custom_vjp
def _inertia_columns(model: Model, q: jax.Array, u: jax.Array, u_dot: jax.Array) -> jax.Array:
    return regressor(model, q, u, u_dot)


def _forward(model: Model, *state: jax.Array) -> tuple[jax.Array, tuple]:
    return _inertia_columns(model, *state), (model, state)


def _backward(kept: tuple, cotangent: Float[Array, "nv nbody 10"]) -> tuple:
    """The product with a row of the regressor is a force at a joint of bodies that have the other factor as parameters."""
    model, state = kept
    model = model.replace(**{name: jnp.zeros_like(getattr(model, name)) for name in _PASSIVE})

    def product(*state: jax.Array) -> jax.Array:
        def forces(parameters: jax.Array) -> jax.Array:
            return evaluate_prepared(inverse_dynamics_kernel, model.tree, prepare_with(model, parameters), *state)

        return jnp.trace(jax.vmap(forces)(cotangent))

    return (None, *jax.grad(product, (0, 1, 2))(*state))


_inertia_columns.defvjp(_forward, _backward)


def _names(model: Model, unknown: str) -> list[str]:
    if unknown == "inertia":
        return [f"{body}.{name}" for body in model.tree.body_names for name in NAMES]
    return [f"{joint}.{unknown}" for joint in model.tree.joint_names]


def _checked(model: Model, name: str, value: Numbers) -> Float[np.ndarray, "samples nv"]:
    value = np.asarray(value, float)
    if value.ndim != 2 or value.shape[1] != model.nv or len(value) == 0:
        label = "nq" if name == "q" else "nv"
        raise ValueError(f"{name} has shape {value.shape}, but this model needs (samples, {model.nv}) = (samples, {label})")
    if not np.all(np.isfinite(value)):
        row, column = np.argwhere(~np.isfinite(value))[0]
        raise ValueError(f"{name}[{row}] of joint {model.tree.joint_names[column]!r} is {value[row, column]}")
    return value
