"""Rigid-body dynamics of a task's model for the peers: Pinocchio's model, and CasADi's expressions, for its wheel has no CasADi.

Joint k moves body k, and is revolute or prismatic. Runs with the peers' interpreter; imports nothing of kanejax.
"""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pinocchio as pin

AGREE = 1e-10


class Mechanism(NamedTuple):
    """Bodies in frames at their joints: parents, joints, places in the parent's frame, and inertias; numbers or expressions.

    The frames are `anchors` away from those of the task.
    """

    parents: list[int]
    kinds: list[str]
    axes: np.ndarray
    rotations: np.ndarray
    places: np.ndarray
    anchors: np.ndarray
    masses: Any
    centers: Any
    inertias: np.ndarray
    armature: np.ndarray
    damping: np.ndarray
    gravity: np.ndarray


def mechanism(task: dict[str, Any]) -> Mechanism:
    """Of a task as `exported` writes it."""
    axes = np.array(task["joint_axis"])
    rotations = np.array([pin.Quaternion(*each).normalized().toRotationMatrix() for each in task["body_quaternion"]])
    rotations = np.where(np.abs(rotations) < 1e-15, 0.0, rotations)
    anchors, parents = np.array(task["joint_anchor"]), task["parents"]
    places = np.array(task["body_position"]) + np.einsum("bij,bj->bi", rotations, anchors)
    places -= np.array([anchors[parent] if parent >= 0 else np.zeros(3) for parent in parents])
    numbers = (np.array(task[name]) for name in ("central_inertia", "armature", "damping", "gravity"))
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    centers = np.array(task["com"]) - anchors
    return Mechanism(parents, task["kinds"], axes, rotations, places, anchors, np.array(task["mass"]), centers, *numbers)


def pinocchio_model(of: Mechanism) -> pin.Model:
    """With the joint models that are fastest, and without armature, which its Python bindings leave unset."""
    model = pin.Model()
    model.gravity.linear = of.gravity
    aligned = {"revolute": (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)}
    aligned["prismatic"] = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ)
    other = {"revolute": pin.JointModelRevoluteUnaligned, "prismatic": pin.JointModelPrismaticUnaligned}
    for k, (parent, kind, axis) in enumerate(zip(of.parents, of.kinds, of.axes, strict=True)):
        along = np.flatnonzero(axis == 1.0)
        joint = aligned[kind][along[0]]() if len(along) else other[kind](axis)
        index = model.addJoint(parent + 1, joint, pin.SE3(of.rotations[k], of.places[k]), f"joint{k}")
        model.appendBodyToJoint(index, pin.Inertia(of.masses[k], of.centers[k], of.inertias[k]), pin.SE3.Identity())
    model.armature = of.armature
    return model


def inverse_dynamics(of: Mechanism, q: ca.SX, u: ca.SX, a: ca.SX) -> ca.SX:
    """The recursive Newton-Euler algorithm."""
    turns, shifts = _poses(of, q)
    w, alpha, acc, forces, moments = [], [], [], [], []
    for k, parent in enumerate(of.parents):
        axis, back, still = ca.SX(of.axes[k]), turns[k].T, ca.SX.zeros(3)
        w0, alpha0, acc0 = (w[parent], alpha[parent], acc[parent]) if parent >= 0 else (still, still, ca.SX(-of.gravity))
        arm = acc0 + ca.cross(alpha0, shifts[k]) + ca.cross(w0, ca.cross(w0, shifts[k]))
        spin = back @ w0
        if of.kinds[k] == "revolute":
            w.append(spin + axis * u[k])
            alpha.append(back @ alpha0 + axis * a[k] + ca.cross(spin, axis * u[k]))
            acc.append(back @ arm)
        else:
            w.append(spin)
            alpha.append(back @ alpha0)
            acc.append(back @ arm + axis * a[k] + 2.0 * ca.cross(spin, axis * u[k]))
        center, inertia = ca.SX(of.centers[k]), ca.SX(of.inertias[k])
        force = of.masses[k] * (acc[k] + ca.cross(alpha[k], center) + ca.cross(w[k], ca.cross(w[k], center)))
        forces.append(force)
        moments.append(inertia @ alpha[k] + ca.cross(w[k], inertia @ w[k]) + ca.cross(center, force))
    tau = [ca.SX(0)] * len(of.parents)
    for k in reversed(range(len(of.parents))):
        part = moments[k] if of.kinds[k] == "revolute" else forces[k]
        tau[k] = ca.SX(of.axes[k]).T @ part + of.armature[k] * a[k] + of.damping[k] * u[k]
        if (parent := of.parents[k]) >= 0:
            force = turns[k] @ forces[k]
            forces[parent] = forces[parent] + force
            moments[parent] = moments[parent] + turns[k] @ moments[k] + ca.cross(shifts[k], force)
    return ca.vertcat(*tau)


def forward_dynamics(of: Mechanism, q: ca.SX, u: ca.SX, tau: ca.SX) -> ca.SX:
    """The articulated-body algorithm, with articulated inertias ((A, B), (B', C)) as three blocks."""
    turns, shifts = _poses(of, q)
    count = len(of.parents)
    speeds, drifts, inertias, biases, projected = [], [], [], [], [None] * count
    for k, parent in enumerate(of.parents):
        still = ca.SX.zeros(3)
        w0, v0 = speeds[parent] if parent >= 0 else (still, still)
        axis = ca.SX(of.axes[k])
        w, v, turning = turns[k].T @ w0, turns[k].T @ (v0 + ca.cross(w0, shifts[k])), of.kinds[k] == "revolute"
        w, v = (w + axis * u[k], v) if turning else (w, v + axis * u[k])
        speeds.append((w, v))
        drifts.append((ca.cross(w, axis * u[k]), ca.cross(v, axis * u[k])) if turning else (still, ca.cross(w, axis * u[k])))
        mass, lever = of.masses[k], ca.skew(ca.SX(of.centers[k]))
        a, b, c = ca.SX(of.inertias[k]) - mass * lever @ lever, mass * lever, mass * ca.SX(np.eye(3))
        inertias.append((a, b, c))
        angular, linear = a @ w + b @ v, b.T @ w + c @ v
        biases.append((ca.cross(w, angular) + ca.cross(v, linear), ca.cross(w, linear)))
    for k in reversed(range(count)):
        (a, b, c), (n, f), axis = inertias[k], biases[k], ca.SX(of.axes[k])
        turning = of.kinds[k] == "revolute"
        along = (a @ axis, b.T @ axis) if turning else (b @ axis, c @ axis)
        inverse = 1.0 / (axis.T @ along[0 if turning else 1] + of.armature[k])
        rest = tau[k] - of.damping[k] * u[k] - axis.T @ (n if turning else f)
        projected[k] = along, inverse, rest
        if (parent := of.parents[k]) < 0:
            continue
        a, b, c = (x - y @ z.T * inverse for x, y, z in ((a, along[0], along[0]), (b, *along), (c, along[1], along[1])))
        d_w, d_v = drifts[k]
        n, f = n + a @ d_w + b @ d_v + along[0] * (inverse * rest), f + b.T @ d_w + c @ d_v + along[1] * (inverse * rest)
        turn, shift = turns[k], ca.skew(shifts[k])
        a, b, c = (turn @ each @ turn.T for each in (a, b, c))
        n, f = turn @ n, turn @ f
        moved = a - b @ shift + shift @ (b.T - c @ shift), b + shift @ c, c
        inertias[parent] = tuple(x + y for x, y in zip(inertias[parent], moved, strict=True))
        biases[parent] = biases[parent][0] + n + ca.cross(shifts[k], f), biases[parent][1] + f
    rates, found = [], []
    for k, parent in enumerate(of.parents):
        d_w, d_v = rates[parent] if parent >= 0 else (ca.SX.zeros(3), ca.SX(-of.gravity))
        along, inverse, rest = projected[k]
        axis = ca.SX(of.axes[k])
        d_w, d_v = turns[k].T @ d_w + drifts[k][0], turns[k].T @ (d_v + ca.cross(d_w, shifts[k])) + drifts[k][1]
        found.append((rest - along[0].T @ d_w - along[1].T @ d_v) * inverse)
        rates.append((d_w + axis * found[k], d_v) if of.kinds[k] == "revolute" else (d_w, d_v + axis * found[k]))
    return ca.vertcat(*found)


def _poses(of: Mechanism, q: ca.SX) -> tuple[list[ca.SX], list[ca.SX]]:
    """Rotations and places of the bodies in their parents' frames."""
    turns, shifts = [], []
    for k, kind in enumerate(of.kinds):
        axis, turn, shift = of.axes[k], ca.SX(of.rotations[k]), ca.SX(of.places[k])
        turns.append(turn @ _rotation(axis, q[k]) if kind == "revolute" else turn)
        shifts.append(shift if kind == "revolute" else shift + turn @ ca.SX(axis) * q[k])
    return turns, shifts


def _rotation(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    """Rodrigues' formula, where 1 stays 1."""
    along = np.outer(axis, axis)
    across = np.where(np.abs(np.eye(3) - along) < 1e-15, 0.0, np.eye(3) - along)
    return ca.SX(along) + ca.SX(across) * ca.cos(angle) + ca.SX(ca.skew(axis)) * ca.sin(angle)


def check(of: Mechanism) -> float:
    """Largest difference of both from Pinocchio's at random states, relative to the largest number."""
    model, size = pinocchio_model(of._replace(armature=np.zeros(len(of.parents)))), len(of.parents)
    data, rng = model.createData(), np.random.default_rng(0)
    q, u, a = (ca.SX.sym(name, size) for name in "qua")
    ours = ca.Function("dynamics", [q, u, a], [inverse_dynamics(of, q, u, a), forward_dynamics(of, q, u, a)])
    worst = 0.0
    for _ in range(10):
        at, speed, rate = rng.uniform(-1.5, 1.5, size), *rng.normal(size=(2, size))
        torque = pin.rnea(model, data, at, speed, rate) + of.armature * rate + of.damping * speed
        pin.crba(model, data, at)
        mass = np.triu(data.M) + np.triu(data.M, 1).T + np.diag(of.armature)
        plain = rate - of.damping * speed - pin.nonLinearEffects(model, data, at, speed)
        for found, wanted in zip(ours(at, speed, rate), (torque, np.linalg.solve(mass, plain)), strict=True):
            worst = max(worst, np.max(np.abs(np.array(found)[:, 0] - wanted)) / max(1.0, np.max(np.abs(wanted))))
    if not worst < AGREE:
        raise ArithmeticError(f"dynamics in CasADi differ from Pinocchio's by {worst:.1e}")
    return worst
