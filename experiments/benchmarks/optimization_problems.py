"""Reference problems of optimal motions, for kanejax and as plain numbers for its peers.

Swing-ups hold the force during each of 50 steps and take four steps of Runge and Kutta's method in it; arms take steps of the
semi-implicit method of Euler, or of the midpoint method. Costs are h times the sum of the squared forces, or the duration.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import kanejax as kj
from experiments.benchmarks.identification import panda
from experiments.benchmarks.robots import load
from kanejax.robots import intelledex_605, rrp_arm

PENDULUM = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping=".1"/>
  <inertial pos="0 0 -1" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body></worldbody></mujoco>"""
# Kelly 2017.
CART_POLE = """<mujoco><worldbody><body><joint name="slide" type="slide" axis="1 0 0" range="-2 2" limited="true"/>
  <inertial pos="0 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/>
  <body><joint name="hinge" axis="0 -1 0"/><inertial pos="0 0 -.5" mass=".3" diaginertia="1e-9 1e-9 1e-9"/></body>
  </body></worldbody></mujoco>"""
# Sutton and Barto's, as in Gymnasium.
ACROBOT = """<mujoco><option gravity="0 0 -9.8"/><worldbody><body><joint name="shoulder" axis="0 -1 0"/>
  <inertial pos="0 0 -.5" mass="1" diaginertia="1 1 1"/>
  <body pos="0 0 -1"><joint name="elbow" axis="0 -1 0"/><inertial pos="0 0 -.5" mass="1" diaginertia="1 1 1"/></body>
  </body></worldbody></mujoco>"""
UR10 = "ur_description/urdf/ur10_joint_limited_robot.urdf"
PANDA_START, PANDA_GOAL = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785), (1.2, 0.4, -0.6, -1.4, 0.5, 2.2, -0.5)
PANDA_SPEEDS, PANDA_TORQUES = np.array([2.175] * 4 + [2.61] * 3), np.array([87.0] * 4 + [12.0] * 3)
SWING: dict[str, Any] = {"dynamics": "forward", "substeps": 4}
BATCH = 1024


class Problem(NamedTuple):
    """A task, the cost that CasADi and IPOPT find from the straight guess, and the best one known, if others find a better one."""

    name: str
    task: kj.MotionTask
    reference: float
    best: float | None = None


class Batch(NamedTuple):
    """Tasks that differ in numbers: `task` of one row of each of the arrays, also under `jax.vmap`."""

    name: str
    task: Callable[..., kj.MotionTask]
    arrays: tuple[np.ndarray, ...]

    def rows(self, count: int) -> list[kj.MotionTask]:
        """The first tasks."""
        return [self.task(*(each[i] for each in self.arrays)) for i in range(count)]


def problems() -> list[Problem]:
    """All of them, in float64."""
    return [*swing_ups(), *panda_problems(), *arm_problems()]


def swing_ups() -> list[Problem]:
    """From hanging to standing, of which the last two have one motor."""
    pendulum, cart, acrobot = kj.load(PENDULUM), kj.load(CART_POLE), kj.load(ACROBOT)
    torque = kj.costs.torque()
    of_pendulum = kj.Limits(pendulum, q=10.0, u=20.0, tau=5.0)
    of_cart = kj.Limits(cart, tau=20.0, passive=("hinge",))
    of_acrobot = kj.Limits(acrobot, u=10.0, tau=20.0, passive=("shoulder",))
    return [
        Problem("pendulum", kj.MotionTask(pendulum, [0.0], [np.pi], 4.0, torque, limits=of_pendulum, **SWING), 41.142, 29.409),
        Problem("cart-pole", kj.MotionTask(cart, [0.0, 0.0], [1.0, np.pi], 2.0, torque, limits=of_cart, **SWING), 59.130, 58.339),
        Problem("acrobot", kj.MotionTask(acrobot, [0.0, 0.0], [np.pi, 0.0], 4.0, torque, limits=of_acrobot, **SWING), 123.091),
    ]


def panda_problems() -> list[Problem]:
    """The Panda from rest to rest."""
    reach = functools.partial(_panda_task, panda().model, np.array(PANDA_START), np.array(PANDA_GOAL))
    torque = kj.costs.torque()
    return [
        Problem("Panda, 1 s", reach(1.0, torque, integrator="euler"), 903.698),
        Problem("Panda, 1 s, forward dynamics", reach(1.0, torque, dynamics="forward", integrator="euler"), 903.698),
        Problem("Panda, 1 s, midpoint", reach(1.0, torque), 891.167),
        Problem("Panda, least time", reach((0.2, 3.0), kj.costs.duration()), 0.566648),
    ]


def arm_problems() -> list[Problem]:
    """Other arms, with the default transcription."""
    torque, ur, intelledex, rrp = kj.costs.torque(), ur10(), intelledex_605(), rrp_arm(load="fused")
    of_ur = kj.Limits(ur, u=np.array([2.16] * 2 + [3.15] * 4), tau=np.array([330.0] * 2 + [150.0] + [54.0] * 3))
    ends = [0.0, -1.5, 1.2, -0.8, -1.5, 0.0], [1.5, -0.8, 0.6, -1.8, -0.8, 1.2]
    of_intelledex = kj.Limits(intelledex, q=np.pi, u=3.0, tau=np.array([60.0, 150.0, 120.0, 60.0, 10.0, 10.0]))
    bent = [0.0, 0.3, -0.4, 0.5, 0.2, 0.0], [1.2, -0.5, 0.6, -0.4, -0.8, 1.0]
    reach = [0.0, 0.6, 0.1], [1.4, -0.7, 0.5]
    shortest: dict[str, Any] = {"duration": (0.2, 6.0), "costs": kj.costs.duration()}
    of_rrp = kj.Limits(rrp, q=([-3.0, -1.2, 0.0], [3.0, 1.2, 0.8]), u=[2.0, 1.5, 0.6], tau=[1000.0, 2500.0, 2500.0])
    return [
        Problem("UR10, 1.2 s", kj.MotionTask(ur, *ends, 1.2, torque, limits=of_ur), 5061.05),
        Problem("UR10, least time", kj.MotionTask(ur, *ends, (0.2, 3.0), kj.costs.duration(), limits=of_ur), 0.722194),
        Problem("Intelledex 605, 1 s", kj.MotionTask(intelledex, *bent, 1.0, torque, limits=of_intelledex), 1007.854),
        Problem("Intelledex 605, least time", kj.MotionTask(intelledex, *bent, limits=of_intelledex, **shortest), 0.554674),
        Problem("RRP arm, 2 s", kj.MotionTask(rrp, *reach, 2.0, torque, limits=of_rrp), 3.23405e6),
        Problem("RRP arm, least time", kj.MotionTask(rrp, *reach, limits=of_rrp, **shortest), 1.663335),
    ]


def ur10() -> kj.Model:
    """The UR10 of example-robot-data."""
    # Without the frames of tools, which are bodies of their own.
    spec = kj.to_mujoco(load("ur10", kj.robots.example_file(UR10)).model)
    spec.compiler.fusestatic = True
    return kj.from_mujoco(spec.compile())


def batches() -> list[Batch]:
    """Many tasks of the Panda, and many pendulums."""
    return [panda_batch(), pendulum_batch()]


def panda_batch(count: int = BATCH, seed: int = 0) -> Batch:
    """Starts and goals in the middle halves of the joint ranges, at rest, with at least 1.5 times the time that the speeds need."""
    model, rng = panda().model, np.random.default_rng(seed)
    middle, half = np.asarray(model.joint_range).mean(1), 0.5 * np.ptp(np.asarray(model.joint_range), axis=1)
    starts, goals = (middle + 0.5 * half * rng.uniform(-1.0, 1.0, (count, model.nv)) for _ in range(2))
    durations = rng.uniform(1.0, 1.5, count)
    # A goal that is too far is moved towards its start.
    needed = 1.5 * np.max(np.abs(goals - starts) / PANDA_SPEEDS, axis=1)
    goals = starts + np.minimum(1.0, durations / needed)[:, None] * (goals - starts)

    def task(start: Any, goal: Any, duration: Any) -> kj.MotionTask:
        return _panda_task(model, start, goal, duration, kj.costs.torque(), integrator="euler")

    return Batch("Panda, 1 to 1.5 s", task, (starts, goals, durations))


def pendulum_batch(count: int = BATCH, seed: int = 0) -> Batch:
    """Swing-ups of pendulums whose masses, lengths and first angles differ by 20 %, 20 % and up to half a radian."""
    model, rng = kj.load(PENDULUM), np.random.default_rng(seed)
    limits = kj.Limits(model, q=10.0, u=20.0, tau=5.0)
    masses, lengths = (rng.uniform(0.8, 1.2, count) for _ in range(2))

    def task(mass: Any, length: Any, start: Any) -> kj.MotionTask:
        other = model.replace(mass=jnp.asarray(mass)[None], com=jnp.array([[0.0, 0.0, -1.0]]) * length)
        return kj.MotionTask(other, start, [np.pi], 4.0, kj.costs.torque(), limits=limits, **SWING)

    return Batch("pendulum", task, (masses, lengths, rng.uniform(-0.5, 0.5, (count, 1))))


def _panda_task(model: kj.Model, start: Any, goal: Any, duration: Any, cost: kj.Cost, **options: Any) -> kj.MotionTask:
    limits = kj.Limits(model, u=PANDA_SPEEDS, tau=PANDA_TORQUES)
    return kj.MotionTask(model, start, goal, duration, cost, limits=limits, **options)


def exported(task: kj.MotionTask) -> dict[str, Any]:
    """A task in numbers and lists. Infinite limits are very large."""
    model, nv = task.model, task.model.nv
    tree, (cost,) = model.tree, task.costs
    plain = tree.joint_bodies == tuple(range(tree.nbody)) and set(tree.joint_types) <= {"revolute", "prismatic"}
    others = (model.stiffness, model.coordinate_reference, model.coulomb_friction)
    if not plain or cost.name not in ("torque", "duration") or task.constraints or any(np.any(each) for each in others):
        raise ValueError("the peers have one joint a body, no springs and no friction, and squared torques or the duration as cost")
    names = ("gravity", "body_position", "body_quaternion", "joint_axis", "joint_anchor", "mass", "com", "central_inertia")
    leaves = {name: getattr(model, name) for name in (*names, "armature", "damping")}
    anything = np.array([[-np.inf], [np.inf]]) * np.ones((1, nv))
    limits = {name: anything if (pair := getattr(task.limits, name)) is None else pair for name in ("q", "u", "tau")}
    if any(getattr(task.limits, name) is not None for name in ("u_dot", "tau_rate", "jerk", "power")):
        raise ValueError("the peers have limits of q, u and tau only")
    options = {name: getattr(task, name) for name in ("steps", "substeps", "dynamics", "integrator", "is_free_in_time")}
    ends = {"start": task.start.q, "goal": task.goal.q, "duration": task.duration}
    tree_ = {"parents": tree.body_parents, "kinds": tree.joint_types, "cost": cost.name}
    return jax.tree.map(_plain, {**leaves, **ends, "limits": limits}) | options | tree_


def _plain(array: Any) -> list:
    return np.clip(np.asarray(array, float), -1e20, 1e20).tolist()
