"""The mechanisms that are timed, and random states of them."""

import importlib.metadata
import importlib.util
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import kanejax as kj

COORDINATES = {"revolute": 1, "prismatic": 1, "ball": 4, "free": 7}


@dataclass(frozen=True)
class Robot:
    """A model in float64 without springs, damping and friction, and where it comes from: a path, or MJCF text."""

    name: str
    source: Path | str
    model: kj.Model


class States(NamedTuple):
    """Random states: each (batch, nq) or (batch, nv), float64, NumPy."""

    q: np.ndarray
    u: np.ndarray
    u_dot: np.ndarray
    tau: np.ndarray

    def arrays(self, dtype: str) -> "States":
        """The same on the device."""
        return States(*(jnp.asarray(x, dtype) for x in self))


def iiwa14() -> Robot:
    """KUKA iiwa 14, 7 joints: the robot of the peers' figures."""
    found = importlib.util.find_spec("frax")
    if found is None or not found.submodule_search_locations:
        raise ModuleNotFoundError("the model of the iiwa comes with the package frax")
    return load("iiwa14", Path(found.submodule_search_locations[0]) / "assets/iiwa/iiwa14.urdf")


def talos() -> Robot:
    """TALOS, a humanoid of 32 joints, fixed at its base as in its URDF."""
    return load("talos", kj.robots.example_file("talos_data/robots/talos_reduced.urdf"))


def chain(nbody: int, seed: int = 0) -> Robot:
    """A chain of random bodies on revolute joints."""
    return load(f"chain{nbody}", random_mjcf([body - 1 for body in range(nbody)], ["hinge"] * nbody, seed))


def tree(nbody: int, seed: int = 0) -> Robot:
    """A random tree on revolute and prismatic joints."""
    rng = np.random.default_rng(seed)
    kinds = [str(kind) for kind in rng.choice(["hinge", "slide"], nbody, p=[0.8, 0.2])]
    return load(f"tree{nbody}", random_mjcf(_parents(nbody, rng), kinds, seed))


def mixed_tree(nbody: int, seed: int = 0) -> Robot:
    """A random tree with every joint type, on a free joint."""
    rng = np.random.default_rng(seed)
    kinds = ["free", *(str(kind) for kind in rng.choice(["hinge", "slide", "ball"], nbody - 1, p=[0.6, 0.2, 0.2]))]
    return load(f"mixed{nbody}", random_mjcf(_parents(nbody, rng), kinds, seed))


def _parents(nbody: int, rng: np.random.Generator) -> list[int]:
    return [-1, *(int(rng.integers(0, body)) for body in range(1, nbody))]


def load(name: str, source: Path | str) -> Robot:
    """Load a model and take out of it what some peers do not have."""
    with jax.enable_x64(True):
        report = kj.load_report(source, strict=False)
        # The URDF's damping and friction are left out of every competitor.
        absent = ("damping", "coulomb_friction", "stiffness", "armature")
        none = {field: jnp.zeros_like(getattr(report.model, field)) for field in absent}
        return Robot(name, source, replace(report.model, **none))


def states(robot: Robot, batch: int, seed: int = 0) -> States:
    """Random states with unit quaternions."""
    rng = np.random.default_rng(seed)
    tree = robot.model.tree
    q = rng.uniform(-1.5, 1.5, (batch, tree.nq))
    for kind, start in zip(tree.joint_types, tree.q_start, strict=True):
        if COORDINATES[kind] >= 4:
            end = start + COORDINATES[kind]
            quaternion = rng.normal(size=(batch, 4))
            q[:, end - 4 : end] = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    return States(q, *(rng.normal(size=(batch, tree.nv)) for _ in range(3)))


def random_mjcf(parents: list[int], kinds: list[str], seed: int) -> str:
    """Bodies of random shape and mass as MJCF; `parents` are indices, -1 for the world."""
    rng = np.random.default_rng(seed)

    def numbers(*values: float) -> str:
        return " ".join(f"{value:.6f}" for value in values)

    def body(index: int) -> str:
        axis, offset = rng.normal(size=3), rng.uniform(-0.3, 0.3, 3)
        quaternion, com = rng.normal(size=4), rng.uniform(-0.1, 0.1, 3)
        x, y, z = rng.uniform(0.05, 0.2, 3)
        mass = rng.uniform(0.5, 3.0)
        inertia = numbers(*(mass / 3 * sides for sides in (y * y + z * z, x * x + z * z, x * x + y * y)))
        turned = "" if kinds[index] in ("free", "ball") else f' axis="{numbers(*axis)}"'
        joint = "<freejoint/>" if kinds[index] == "free" else f'<joint type="{kinds[index]}"{turned}/>'
        placed = f'pos="{numbers(*offset)}" quat="{numbers(*quaternion)}"'
        inertial = f'<inertial pos="{numbers(*com)}" mass="{mass:.6f}" diaginertia="{inertia}"/>'
        children = "".join(body(child) for child, parent in enumerate(parents) if parent == index)
        return f"<body {placed}>{joint}{inertial}{children}</body>"

    roots = "".join(body(index) for index, parent in enumerate(parents) if parent == -1)
    return f"<mujoco><worldbody>{roots}</worldbody></mujoco>"
