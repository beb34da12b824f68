"""The peers' batched inverse and forward dynamics, each checked against kanejax before it is timed.

All have the same states and the same mechanism: no damping, friction, armature, contacts or limits.
"""

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from experiments.benchmarks.robots import Robot, States
from kanejax._io.source import compile_source

THREADS = 2


class Peer(NamedTuple):
    """Functions of no arguments that return torques or accelerations (batch, nv); None where the peer has no such function."""

    name: str
    inverse: Callable[[], Any] | None
    forward: Callable[[], Any] | None


def pinocchio(robot: Robot, at: States, threads: int = THREADS) -> Peer:
    """Pinocchio's parallel algorithms in C++, float64, on states in its own layout, into arrays that exist already."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(robot.source))
    model.armature = np.zeros(model.nv)
    pool = pin.ModelPool(model, threads)
    q, u, u_dot, tau = (np.asfortranarray(x.T) for x in at)
    torque, rate = np.empty_like(u, order="F"), np.empty_like(u, order="F")

    def inverse() -> np.ndarray:
        pin.rneaInParallel(threads, pool, q, u, u_dot, torque)
        return torque.T

    def forward() -> np.ndarray:
        pin.abaInParallel(threads, pool, q, u, tau, rate)
        return rate.T

    return Peer(f"Pinocchio C++, {threads} threads, float64", inverse, forward)


def bare_mujoco(robot: Robot, limits: bool = False) -> mujoco.MjModel:
    """MuJoCo's model with nothing but bodies and joints, and the joints' limits if wanted."""
    compiled = compile_source(robot.source, strict=False).mj_model
    for field in (compiled.dof_damping, compiled.dof_frictionloss, compiled.dof_armature, compiled.jnt_stiffness):
        field[:] = 0
    flags = mujoco.mjtDisableBit
    compiled.opt.disableflags |= flags.mjDSBL_CONTACT | flags.mjDSBL_SENSOR | (0 if limits else flags.mjDSBL_CONSTRAINT)
    return compiled


def mujoco_batch(robot: Robot, at: States, threads: int = THREADS) -> Peer:
    """MuJoCo's own threads in C, float64: `mj_forward` for every state."""
    from mujoco.batch import Batch

    batch = Batch(bare_mujoco(robot), len(at.q), threads)
    batch.bind("qpos")[:] = at.q
    batch.bind("qvel")[:] = at.u
    batch.bind("qfrc_applied")[:] = at.tau
    rates = batch.bind("qacc")

    def forward() -> np.ndarray:
        batch.forward()
        return rates

    return Peer(f"MuJoCo C, {threads} threads, float64", None, forward)


def mjx(robot: Robot, at: States, dtype: str, limits: bool = False) -> Peer:
    """MJX under vmap; `limits` leaves the joint limits of the file in, which none of the states reaches."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from mujoco import mjx

    model = mjx.put_model(bare_mujoco(robot, limits))
    data = mjx.make_data(model)

    def inverse(q: jax.Array, u: jax.Array, u_dot: jax.Array) -> jax.Array:
        return mjx.inverse(model, data.replace(qpos=q, qvel=u, qacc=u_dot)).qfrc_inverse

    def forward(q: jax.Array, u: jax.Array, tau: jax.Array) -> jax.Array:
        return mjx.forward(model, data.replace(qpos=q, qvel=u, qfrc_applied=tau)).qacc

    return _of_jax(f"MJX, {dtype}" if not limits else f"with joint limits: MJX, {dtype}", inverse, forward, at.arrays(dtype))


def frax(at: States, dtype: str) -> Peer:
    """The iiwa of frax under vmap."""
    robot = frax_iiwa()

    def inverse(q: jax.Array, u: jax.Array, u_dot: jax.Array) -> jax.Array:
        return robot.rnea(q, u, u_dot, jnp.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0], dtype), None)

    def forward(q: jax.Array, u: jax.Array, tau: jax.Array) -> jax.Array:
        return robot.forward_dynamics(q, u, tau, None)

    return _of_jax(f"frax, {dtype}", inverse, forward, at.arrays(dtype))


def frax_iiwa() -> Any:
    """The robot of the package frax, whose parameters are constants."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import frax

        return frax.load_iiwa()


def _of_jax(name: str, inverse: Callable, forward: Callable, at: States) -> Peer:
    compiled_inverse, compiled_forward = jax.jit(jax.vmap(inverse)), jax.jit(jax.vmap(forward))
    return Peer(name, lambda: compiled_inverse(at.q, at.u, at.u_dot), lambda: compiled_forward(at.q, at.u, at.tau))


def verify(name: str, found: Any, reference: np.ndarray, tolerance: float) -> None:
    """Stop unless a peer computes the same.

    Raises:
        AssertionError: the numbers differ by more than `tolerance` of the largest.
    """
    difference = float(np.max(np.abs(np.asarray(found, float) - reference)) / np.max(np.abs(reference)))
    assert difference <= tolerance, f"{name} differs from kanejax by {difference:.1e}, more than {tolerance:.0e}"
