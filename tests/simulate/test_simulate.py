import itertools
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj

Q0, U0 = np.array([0.3, -0.8]), np.array([0.5, 1.0])
TIGHT: dict[str, Any] = {"rtol": 1e-11, "atol": 1e-12}


def test_a_floating_tree_moves_as_in_mujoco(floating, floating_xml):
    mj_model = mujoco.MjModel.from_xml_string(floating_xml)
    mj_model.opt.integrator, mj_model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 5e-4
    data = mujoco.MjData(mj_model)
    data.qvel[:] = np.random.default_rng(0).normal(size=mj_model.nv)
    trajectory = kj.simulate(floating, data.qpos.copy(), data.qvel.copy(), np.linspace(0, 1, 3), rtol=1e-10, atol=1e-12)
    for _ in range(2000):
        mujoco.mj_step(mj_model, data)
    np.testing.assert_allclose(trajectory.q[-1], data.qpos, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(trajectory.u[-1], data.qvel, rtol=1e-8, atol=1e-8)
    assert trajectory.stats["num_steps"] == trajectory.stats["num_accepted_steps"] + trajectory.stats["num_rejected_steps"]


def test_energy_is_conserved(pendulum):
    trajectory = kj.simulate(pendulum, Q0, U0, np.linspace(0, 5, 6), **TIGHT)
    energies = jax.jit(jax.vmap(lambda q, u: kj.kinetic_energy(pendulum, q, u) + kj.potential_energy(pendulum, q)))
    energy = energies(trajectory.q, trajectory.u)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-8)
    assert trajectory.ok
    assert trajectory.t_end == 5
    np.testing.assert_allclose(trajectory.q[-1], trajectory.q_end, rtol=1e-14)


@pytest.mark.parametrize(
    ("solver", "order"),
    [
        (kj.BetaScheme(0.0), 1),
        (kj.BetaScheme(0.5), 2),
        (kj.BetaScheme(1.0), 1),
        (kj.BetaScheme(1.0, three_point=True), 2),
    ],
    ids=["explicit", "midpoint", "implicit", "backward difference"],
)
def test_order_of_convergence(pendulum, solver, order):
    exact = kj.simulate(pendulum, Q0, U0, np.linspace(0, 0.5, 6), **TIGHT).q_end
    # The shorter steps of a one-step method can be taken in two pieces with as many steps as the longer ones: one program.
    pieces = 1 if solver.three_point else 2

    def error(dt0, pieces):
        q, u, ends = Q0, U0, np.linspace(0, 0.5, pieces + 1)
        for ts in itertools.pairwise(ends):
            piece = kj.simulate(pendulum, q, u, np.array(ts), solver=solver, dt0=np.asarray(dt0), rtol=1e-10, atol=1e-11)
            assert piece.stats["num_steps"] == round((ts[1] - ts[0]) / dt0)
            q, u = piece.q_end, piece.u_end
        return np.linalg.norm(q - exact)

    coarse, fine = error(2.5e-3, 1), error(1.25e-3, pieces)
    np.testing.assert_allclose(np.log2(coarse / fine), order, atol=0.1)
    assert solver.order(None) == order


def test_beta_is_checked():
    with pytest.raises(ValueError, match=r"beta is 1.5; it must be from 0 to 1"):
        kj.BetaScheme(1.5)


def test_stiff_joints_take_few_steps_of_an_implicit_solver(pendulum):
    stiff = type(pendulum)(**{**vars(pendulum), "damping": jnp.array([3e3, 3e3])})
    ts = np.array([0.0, 10.0])
    implicit = kj.simulate(stiff, Q0, U0, ts, solver=diffrax.Kvaerno3(), rtol=1e-5, atol=1e-7)
    explicit = kj.simulate(stiff, Q0, U0, np.linspace(0, 10, 3))
    assert implicit.ok
    assert implicit.stats["num_steps"] < 300
    assert explicit.status == kj.Status.MAX_STEPS
    assert np.isnan(explicit.q[-1]).all()
    assert np.isfinite(explicit.q_end).all()


def test_dense_output_equal_steps_and_unknown_times_agree(pendulum):
    ts = np.linspace(0, 1, 5)
    dense = kj.simulate(pendulum, Q0, U0, ts, dense=True, rtol=1e-9, atol=1e-10, max_steps=200)
    q, u = jax.vmap(dense.evaluate)(jnp.asarray(ts))
    np.testing.assert_allclose(q, dense.q, atol=1e-12)
    np.testing.assert_allclose(u, dense.u, atol=1e-12)
    known = kj.simulate(pendulum, Q0, U0, ts, dt0=0.0125)
    unknown = jax.jit(lambda ts: kj.simulate(pendulum, Q0, U0, ts, dt0=0.0125))(ts)
    np.testing.assert_allclose(known.q, dense.q, atol=1e-6)
    np.testing.assert_allclose(known.q, unknown.q, atol=1e-12)
    assert known.stats["num_steps"] == unknown.stats["num_steps"] == 80
    with pytest.raises(ValueError, match="dense=True"):
        known.evaluate(0.5)


def test_single_precision_stays_single(pendulum):
    single = pendulum.astype(jnp.float32)
    q0, u0, ts = Q0.astype(np.float32), U0.astype(np.float32), np.linspace(0, 1, 3)
    trajectory = kj.simulate(single, q0, u0, ts)
    floats = [x for x in jax.tree.leaves(trajectory) if jnp.issubdtype(x.dtype, jnp.floating)]
    assert {x.dtype for x in floats} == {jnp.dtype("float32")}
    np.testing.assert_allclose(trajectory.q, kj.simulate(pendulum, Q0, U0, ts).q, atol=2e-3)


def test_a_specialized_model_moves_alike_and_has_no_joint_limits(pendulum):
    frozen, ts = kj.specialize(pendulum), np.linspace(0, 0.3, 3)
    a, b = (kj.simulate(model, Q0, U0, ts, control=lambda t, q, u: -u) for model in (pendulum, frozen))
    np.testing.assert_allclose(a.q, b.q, rtol=1e-12)
    np.testing.assert_allclose(a.u, b.u, rtol=1e-12)
    q0, u0 = np.stack((Q0, -Q0, U0)), np.stack((U0, U0, Q0))
    a, b = (kj.simulate_batch(model, q0, u0, ts, batch_size=2, dt0=0.02) for model in (pendulum, frozen))
    np.testing.assert_allclose(a.q, b.q, rtol=1e-12)
    np.testing.assert_allclose(a.u, b.u, rtol=1e-12)
    with pytest.raises(ValueError, match="a specialized model has no joint ranges; give the model itself"):
        kj.simulate(frozen, Q0, U0, ts, joint_limits=True)


def kernels(jaxpr):
    """How many times a program has the dynamics."""

    def is_program(x):
        return hasattr(x, "eqns") or hasattr(x, "jaxpr")

    inner = [x for eqn in jaxpr.eqns for x in jax.tree.leaves(eqn.params, is_leaf=is_program) if is_program(x)]
    own = sum(eqn.primitive.name == "kanejax_kernel" for eqn in jaxpr.eqns)
    return own + sum(kernels(getattr(x, "jaxpr", x)) for x in inner)


@pytest.mark.parametrize(("options", "most"), [({}, 2), ({"dt0": 0.1}, 1), ({"joint_limits": True}, 2)])
def test_the_program_has_the_dynamics_once(pendulum, options, most):
    run = jax.make_jaxpr(lambda q: kj.simulate(pendulum, q, U0, np.linspace(0, 1, 3), **options).q)
    assert kernels(run(Q0).jaxpr) <= most


def test_failures_are_statuses_or_exceptions(pendulum):
    ts = np.linspace(0, 1, 3)

    def breaks(t, q, u):
        return jnp.where(t > 0.3, jnp.nan, 0.0) * u

    adaptive = kj.simulate(pendulum, Q0, U0, ts, control=breaks)
    assert adaptive.status == kj.Status.MIN_STEP
    np.testing.assert_allclose(adaptive.t_end, 0.3, atol=1e-3)
    assert not adaptive.ok
    np.testing.assert_array_equal(adaptive.reached, [True, False, False])
    equal = kj.simulate(pendulum, Q0, U0, ts, control=breaks, dt0=0.1)
    assert equal.status == kj.Status.NON_FINITE
    assert equal.t_end == 0
    with pytest.raises(kj.SimulationError, match=r"NON_FINITE at t = 0 s"):
        kj.simulate(pendulum, Q0, U0, ts, control=breaks, dt0=0.1, throw=True)


def test_one_failure_in_a_batch_leaves_the_others(pendulum):
    q0 = jnp.stack((jnp.asarray(Q0), jnp.array([jnp.nan, 0.0]), jnp.asarray(Q0)))
    batch = jax.vmap(lambda q: kj.simulate(pendulum, q, U0, np.linspace(0, 1, 3)))(q0)
    assert list(batch.ok) == [True, False, True]
    alone = kj.simulate(pendulum, Q0, U0, np.linspace(0, 1, 3))
    np.testing.assert_allclose(batch.q[2], alone.q, atol=1e-12)
