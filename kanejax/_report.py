"""What the command line prints and writes: a model as a tree and as dictionaries, and a batch of random trajectories."""

import dataclasses
import math
import time
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.text import Text
from rich.tree import Tree as RichTree

from kanejax._dynamics.energy import kinetic_energy, potential_energy
from kanejax._errors import UnsupportedModelError
from kanejax._model.model import Model
from kanejax._model.tree import COORDINATES, SPEEDS, WORLD
from kanejax._validate.states import sample_coordinates

if TYPE_CHECKING:
    from kanejax._simulate.trajectory import Trajectory

# Parameters of a joint's speeds, and their units for rotations and translations.
_UNITS = {
    "armature": ("kg m^2", "kg"),
    "damping": ("N m s/rad", "N s/m"),
    "coulomb_friction": ("N m", "N"),
    "stiffness": ("N m/rad", "N/m"),
}


def model_dict(model: Model) -> dict[str, Any]:
    """Bodies and joints of a model as lists of dictionaries, in SI units and radians; None for ranges without an end."""
    return {
        "nbody": model.nbody,
        "nq": model.nq,
        "nv": model.nv,
        "gravity": _list(model.gravity),
        "bodies": [_body(model, body) for body in range(model.nbody)],
        "joints": [_joint(model, joint) for joint in range(model.njoint)],
    }


def model_tree(model: Model, title: str) -> RichTree:
    """Bodies and joints of a model as a tree for `rich.print`."""
    label = Text.assemble(
        (title, "bold"), f"\n{model.nbody} bodies, {model.njoint} joints, {model.nq} coordinates, {model.nv} speeds"
    )
    root = RichTree(label.append(f"\ngravity {_vector(model.gravity)} m/s^2"))
    branches: dict[int, RichTree] = {WORLD: root}
    for body, parent in enumerate(model.tree.body_parents):
        branches[body] = branches[parent].add(_body_label(model, body))
    return root


def _body(model: Model, body: int) -> dict[str, Any]:
    tree, parent = model.tree, model.tree.body_parents[body]
    return {
        "name": tree.body_names[body],
        "parent": None if parent == WORLD else tree.body_names[parent],
        "joints": [tree.joint_names[joint] for joint, moved in enumerate(tree.joint_bodies) if moved == body],
        "mass": float(model.mass[body]),
        "com": _list(model.com[body]),
        "central_inertia": _list(model.central_inertia[body]),
        "principal_moments": _list(_principal_moments(model, body)),
    }


def _joint(model: Model, joint: int) -> dict[str, Any]:
    tree, kind = model.tree, model.tree.joint_types[joint]
    speeds = slice(tree.v_start[joint], tree.v_start[joint] + SPEEDS[kind])
    axial = COORDINATES[kind] == 1
    return {
        "name": tree.joint_names[joint],
        "type": kind,
        "body": tree.body_names[tree.joint_bodies[joint]],
        "axis": _list(model.joint_axis[joint]) if axial else None,
        "range": [bound if math.isfinite(bound) else None for bound in _list(model.joint_range[joint])] if axial else None,
        "stiffness": float(model.stiffness[joint]),
        **{name: _list(getattr(model, name)[speeds]) for name in ("armature", "damping", "coulomb_friction")},
    }


def _body_label(model: Model, body: int) -> Text:
    values = _body(model, body)
    label = Text(values["name"], style="bold")
    joints = [joint for joint, moved in enumerate(model.tree.joint_bodies) if moved == body]
    if not joints:
        label.append(" welded", style="not bold dim")
    for joint in joints:
        label.append(f"\n{_joint_sentence(_joint(model, joint))}", style="not bold cyan")
    if values["mass"] or any(values["principal_moments"]):
        moments = ", ".join(f"{moment:.4g}" for moment in values["principal_moments"])
        text = f"\n{values['mass']:.4g} kg, mass centre {_vector(model.com[body])} m, principal moments {moments} kg m^2"
        label.append(text, style="not bold")
    return label


def _joint_sentence(values: dict[str, Any]) -> str:
    sentence = f"{values['name']}: {values['type']}"
    turns = 1 if values["type"] == "prismatic" else 0
    if values["axis"] is not None:
        sentence += f" along {_vector(values['axis'])}" if turns else f" about {_vector(values['axis'])}"
        low, high = values["range"]
        if low is not None or high is not None:
            ends = f"{-math.inf if low is None else low:.4g} to {math.inf if high is None else high:.4g}"
            sentence += f", {ends} {('rad', 'm')[turns]}"
    for name, units in _UNITS.items():
        numbers = np.ravel(values[name])
        if numbers.any():
            shown = f"{numbers[0]:.4g}" if np.all(numbers == numbers[0]) else _vector(numbers)
            unit = f" {units[turns]}" if values["axis"] is not None else ""
            sentence += f", {name.replace('_', ' ')} {shown}{unit}"
    return sentence


def _principal_moments(model: Model, body: int) -> np.ndarray:
    inertia = np.asarray(model.central_inertia[body], float)
    return np.linalg.eigvalsh(0.5 * (inertia + inertia.T))


def _vector(values: Any) -> str:
    # Adding zero makes a negative zero positive.
    return "(" + ", ".join(f"{float(value) + 0.0:.4g}" for value in np.ravel(values)) + ")"


def _list(values: Any) -> list:
    return np.asarray(values, float).tolist()


@dataclasses.dataclass(frozen=True)
class Simulated:
    """Trajectories as arrays by name, and how they were made and how well their energy was kept."""

    arrays: dict[str, Any]
    details: dict[str, Any]


def simulated(
    model: Model,
    *,
    trajectories: int,
    duration: float,
    times: int,
    speed: float,
    damping: float,
    seed: int,
    dtype: str,
    max_steps: int,
    progress: bool,
) -> Simulated:
    """Simulate a model from random states without forces at its joints, whether or not `jax_enable_x64` is set.

    Raises:
        UnsupportedModelError: the model has no joints.
    """
    # Only here, as `kanejax info` needs no diffrax.
    from kanejax._simulate.batch import simulate_batch

    if not model.nv:
        raise UnsupportedModelError("the robot has no joints, so nothing moves")
    random = np.random.default_rng(seed)
    q0 = sample_coordinates(model, trajectories, random)
    u0 = speed * random.normal(size=(trajectories, model.nv))
    with jax.enable_x64(True):
        model = dataclasses.replace(model, damping=model.damping + damping).astype(dtype)
        start = time.perf_counter()
        ts = np.linspace(0.0, duration, times)
        result = simulate_batch(model, q0.astype(dtype), u0.astype(dtype), ts, max_steps=max_steps, progress=progress)
        seconds = time.perf_counter() - start
        median, worst = _energy_change(model, q0.astype(dtype), u0.astype(dtype), result)
    conservative = not any(np.any(np.asarray(leaf)) for leaf in (model.damping, model.coulomb_friction))
    arrays = {
        "ts": ts,
        "q": result.q,
        "u": result.u,
        "status": result.status,
        "t_end": result.t_end,
        "joint_names": np.array(model.tree.joint_names),
    }
    details = {
        "dtype": dtype,
        "speed": speed,
        "damping": damping,
        "seconds": seconds,
        "steps": int(np.sum(result.stats["num_steps"])),
        "conservative": conservative,
        "energy_change_median": median,
        "energy_change_worst": worst,
    }
    return Simulated(arrays, details)


def _energy_change(model: Model, q0: np.ndarray, u0: np.ndarray, result: "Trajectory") -> tuple[float | None, float | None]:
    """Median and greatest change of energy among the trajectories that reached their end, relative to what is large in each."""
    ok = np.asarray(result.ok)
    if not ok.any():
        return None, None
    energies = jax.jit(jax.vmap(lambda q, u: (kinetic_energy(model, q, u), potential_energy(model, q))))
    states = ((q0, u0), (result.q_end, result.u_end))
    begin, end = (np.asarray(energies(*map(jnp.asarray, state)))[:, ok] for state in states)
    change = np.abs(end.sum(0) - begin.sum(0))
    # What moved between the two kinds of energy, or was there to begin with, says what is large.
    size = np.maximum(np.maximum(begin[0], end[0]), np.abs(end[1] - begin[1]))
    relative = np.divide(change, size, out=np.zeros_like(change), where=size > 0)
    return float(np.median(relative)), float(np.max(relative))


def energies_line(details: dict[str, Any]) -> str:
    """A sentence on the change of energy."""
    if details["energy_change_worst"] is None:
        return "energy: no trajectory reached its end"
    name = "energy drift" if details["conservative"] else "energy lost to damping and friction"
    return (
        f"{name}, relative to the energy that moves: median {details['energy_change_median']:.1e}, "
        f"worst {details['energy_change_worst']:.1e}; {details['steps']} steps"
    )
