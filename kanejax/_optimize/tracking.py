"""Following an optimal motion: forces with feedback, and what becomes of them in a simulation."""

from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from kanejax._dynamics.equations_of_motion import forward_dynamics
from kanejax._model.model import Model
from kanejax._model.tree import Tree
from kanejax._optimal_control.riccati import Quadratic, Slopes, minimizer
from kanejax._optimize.displacement import displaced, displacement
from kanejax._optimize.motion import OptimalMotion


@final
class Tracking(eqx.Module):
    """Forces of a motion, held during each step, and feedback of what differs from it: a `control` for `kanejax.simulate`.

    Attributes:
        motion: to follow.
        gains: of the forces by the deviations of coordinates and speeds, those of the coordinates by their speeds.
        tree: of the model; static.
    """

    motion: OptimalMotion
    gains: Float[Array, "steps nv 2*nv"]
    tree: Tree = eqx.field(static=True)

    def __call__(self, t: Float[ArrayLike, ""], q: Float[Array, " nq"], u: Float[Array, " nv"]) -> Float[Array, " nv"]:
        """Forces at time t [s] in a state; after the end those of the last step, about the last node."""
        motion = self.motion
        steps = len(motion.tau)
        h = motion.duration / steps
        place = jnp.clip(jnp.asarray(t, h.dtype) / h, 0.0, steps)
        k = jnp.clip(jnp.floor(place * (1.0 + 4.0 * jnp.finfo(h.dtype).eps)).astype(int), 0, steps - 1)
        s = (place - k.astype(h.dtype)) * h
        wanted = displaced(self.tree, motion.q[k], s * (motion.u[k] + 0.5 * s * motion.u_dot[k]))
        error = jnp.concatenate((displacement(self.tree, wanted, q), u - motion.u[k] - s * motion.u_dot[k]))
        return motion.tau[k] + jnp.sum(self.gains[k] * error[None], 1)


def tracking(
    model: Model,
    motion: OptimalMotion,
    *,
    q_error: Float[ArrayLike, " *nv"] = 0.01,
    u_error: Float[ArrayLike, " *nv"] = 0.1,
    tau_error: Float[ArrayLike, " *nv"] | None = None,
) -> Tracking:
    """Feedback that brings a robot back to a motion: the linear-quadratic regulator along it, in discrete time.

    Args:
        model: of the robot.
        motion: to follow.
        q_error: deviations of the coordinates that count as much as `tau_error` does, one for all or by speeds.
        u_error: deviations of the speeds, likewise.
        tau_error: changes of the forces, likewise; by default a tenth of each joint's greatest force.

    Returns:
        The control.
    """
    nv = model.nv
    greatest = jnp.max(jnp.abs(motion.tau), 0)
    allowed = 0.1 * jnp.maximum(greatest, 0.01 * jnp.max(greatest)) if tau_error is None else jnp.asarray(tau_error)
    sizes = [jnp.broadcast_to(jnp.asarray(each, model.dtype), (nv,)) for each in (q_error, u_error, allowed)]
    weights = 1.0 / jnp.concatenate(sizes) ** 2
    return Tracking(motion, _gains(model, motion, weights), model.tree)


@eqx.filter_jit
def _gains(model: Model, motion: OptimalMotion, weights: jax.Array) -> Float[Array, "steps nv 2*nv"]:
    nv, steps, tree = model.nv, len(motion.tau), model.tree
    h = motion.duration / steps

    def after(q: jax.Array, q_after: jax.Array, v: jax.Array) -> jax.Array:
        """Deviations at the next node from those at this, and the forces, by a step to the middle and one across."""
        place, u, tau = displaced(tree, q, v[:nv]), v[nv : 2 * nv], v[2 * nv :]
        middle = u + 0.5 * h * forward_dynamics(model, place, u, tau)
        rates = forward_dynamics(model, displaced(tree, place, 0.5 * h * u), middle, tau)
        return jnp.concatenate((displacement(tree, q_after, displaced(tree, place, h * middle)), u + h * rates))

    at = jnp.concatenate((jnp.zeros_like(motion.tau), motion.u[:-1], motion.tau), 1)
    jacobian = jax.vmap(jax.jacfwd(after, 2))(motion.q[:-1], motion.q[1:], at)
    each = jnp.diag(weights)
    curvature = Quadratic(jnp.broadcast_to(each[None], (steps, *each.shape)), each[: 2 * nv, : 2 * nv], jacobian)
    slopes = (jnp.zeros(shape, weights.dtype) for shape in ((steps, 3 * nv), (2 * nv,), (steps, 2 * nv)))
    return minimizer(curvature, Slopes(*slopes)).gains


class Deviation(NamedTuple):
    """How a simulation differs from a motion, at its nodes.

    Attributes:
        q: of the coordinates, by their speeds.
        u: of the speeds.
    """

    q: Float[np.ndarray, "nodes nv"]
    u: Float[np.ndarray, "nodes nv"]


def replayed(
    model: Model, motion: OptimalMotion, control: Any = None, *, rtol: float | None = None, atol: float | None = None
) -> Deviation:
    """Simulate a motion's forces by diffrax, with tight tolerances, from its first state.

    Args:
        model: of the robot, which may differ from the one that the motion was made for.
        motion: whose forces are applied, each during its step.
        control: such as `tracking(model, motion)`, in place of the forces alone.
        rtol: relative tolerance, by default 1e-8 (float32: 1e-5).
        atol: absolute tolerance, by default a tenth of it.

    Raises:
        SimulationError: it does not reach its end.
    """
    import diffrax

    from kanejax._simulate.control import TorqueTable
    from kanejax._simulate.simulate import simulate

    values = jnp.concatenate((motion.tau, motion.tau[-1:]))
    control = TorqueTable(motion.ts, values, "hold") if control is None else control
    rtol = (1e-8 if motion.q.dtype == jnp.float64 else 1e-5) if rtol is None else rtol
    atol = 0.1 * rtol if atol is None else atol
    # Forces jump at the nodes.
    controller = diffrax.ClipStepSizeController(diffrax.PIDController(rtol=rtol, atol=atol), jump_ts=motion.ts)
    options = {"control": control, "stepsize_controller": controller, "max_steps": 100_000, "throw": True}
    path = simulate(model, motion.q[0], motion.u[0], motion.ts, **options)
    return _deviation(model.tree, motion, np.array(path.q), np.array(path.u))


def replayed_by_mujoco(model: Model, motion: OptimalMotion, control: Any = None, *, substeps: int = 20) -> Deviation:
    """The same by MuJoCo's mj_step with its method of Runge and Kutta, without contacts, limits and constraints.

    Args:
        model: of the robot.
        motion: whose forces are applied, each during its step.
        control: in place of the forces alone, evaluated before every step of MuJoCo.
        substeps: of MuJoCo in each step of the motion.
    """
    import mujoco

    from kanejax._io.export import to_mujoco

    mj = to_mujoco(model).compile()
    mj.opt.timestep = float(motion.duration) / len(motion.tau) / substeps
    mj.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    mj.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(mj)
    data.qpos[:], data.qvel[:] = motion.q[0], motion.u[0]
    forces = None if control is None else eqx.filter_jit(control)
    states = [(data.qpos.copy(), data.qvel.copy())]
    for k, tau in enumerate(np.asarray(motion.tau)):
        for i in range(substeps):
            if forces is None:
                data.qfrc_applied[:] = tau
            else:
                t = (k + i / substeps) * float(motion.duration) / len(motion.tau)
                # A Python number would compile again at every step.
                data.qfrc_applied[:] = forces(*(jnp.asarray(each, motion.q.dtype) for each in (t, data.qpos, data.qvel)))
            mujoco.mj_step(mj, data)
        states.append((data.qpos.copy(), data.qvel.copy()))
    q, u = (np.array(each) for each in zip(*states, strict=True))
    return _deviation(model.tree, motion, q, u)


def _deviation(tree: Tree, motion: OptimalMotion, q: np.ndarray, u: np.ndarray) -> Deviation:
    off = jax.vmap(lambda wanted, q: displacement(tree, wanted, q))(motion.q, jnp.asarray(q, motion.q.dtype))
    return Deviation(np.asarray(off), u - np.asarray(motion.u))
