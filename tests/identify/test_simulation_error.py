"""The simulation stage: parameters from motion alone, against finite differences and against what made the motion."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from helpers.mechanisms import random_tree

import kanejax as kj
from kanejax._checkpoint import CheckpointError
from kanejax._errors import UnknownNameError, UnsupportedModelError
from kanejax._logs.motion import Motion
from kanejax._model.prepared import prepare
from kanejax._parameters.joint_force import Mechanism, joint_force
from kanejax._parameters.parameterization import parameterization
from kanejax._parameters.plant import Drives, Plant, drive_force
from kanejax._parameters.unknowns import Unknown
from kanejax._simulation_fit.levenberg_marquardt import limited
from kanejax._simulation_fit.recorded import recorded
from kanejax._simulation_fit.runge_kutta import RungeKutta4
from kanejax._simulation_fit.shooting import Shooting, linearized, shifted
from kanejax._simulation_fit.simulation_error import fit_simulation
from kanejax._simulation_fit.simulation_fit import FitInterrupted
from kanejax._simulation_fit.windows import cut

ARM = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.1"/>
    <inertial pos="0.02 0 -0.3" mass="1.2" diaginertia="0.02 0.03 0.01"/>
    <body name="lower" pos="0 0 -0.5"><joint name="elbow" axis="0 1 0.3" damping="0.05"/>
      <inertial pos="0.05 0 -0.2" mass="0.7" diaginertia="0.01 0.015 0.005"/></body></body>
</worldbody></mujoco>"""
TS = np.arange(101) * 0.01
SIGMA = 1e-3


@pytest.fixture(scope="module")
def arm() -> kj.Model:
    return kj.load(ARM)


linearized_at = jax.jit(linearized)


def effort(ts):
    return np.stack([3.0 * np.sin(5.0 * ts), 1.5 * np.cos(7.0 * ts)], -1)


def moved(model, noise=0.0, seed=0, ts=TS, control=None):
    """Motion by kanejax.simulate with steps of a tenth of the sampling period, and what drives it."""
    table = kj.TorqueTable(ts, effort(ts)) if control is None else control
    trajectory = kj.simulate(model, np.array([0.3, -0.5]), np.zeros(2), ts, control=table, dt0=1e-3)
    rng = np.random.default_rng(seed)
    q = np.asarray(trajectory.q) + noise * rng.normal(size=trajectory.q.shape)
    given = effort(ts) if control is None else np.asarray(jax.vmap(control)(jnp.asarray(ts), trajectory.q, trajectory.u))
    return Motion(ts, q, np.gradient(q, ts, axis=0), np.zeros_like(q), given)


def sought(model, *unknowns, factor: Any = 1.3, **leaves):
    """What is sought of a plant whose masses are wrong by a factor."""
    wrong = model.replace(mass=np.asarray(model.mass) * factor, **leaves)
    return parameterization(Plant(wrong, Drives.ideal(wrong)), unknowns or ("mass",))


def deviations(fit):
    """Standard deviations of phi, from the triangular factor."""
    inverse = np.linalg.inv(np.asarray(fit.factor)[:-1, :-1])
    return np.linalg.norm(inverse, axis=1)


@pytest.fixture(scope="module")
def exact(arm):
    return fit_simulation(sought(arm), [moved(arm)], substeps=4)


@pytest.fixture(scope="module")
def noisy(arm):
    return fit_simulation(sought(arm), [moved(arm, SIGMA)], substeps=4)


def test_masses_from_motion_without_noise(arm, exact):
    assert exact.converged, exact.message
    np.testing.assert_allclose(exact.phi, arm.mass, rtol=1e-6)
    np.testing.assert_allclose(exact.predicted[0].q, moved(arm).q, atol=1e-7)
    assert exact.predicted[0].effort is None


def test_masses_within_their_standard_deviations(arm, noisy):
    assert noisy.converged, noisy.message
    errors = np.abs(np.asarray(noisy.phi - arm.mass)) / deviations(noisy)
    assert errors.max() < 3.0
    assert errors.min() > 1e-3
    # The errors are estimated too, and the cost is the sum of as many squares as there are residuals.
    np.testing.assert_allclose(noisy.sigma["q"], SIGMA, rtol=0.2)
    np.testing.assert_allclose(noisy.rms["q"], SIGMA, rtol=0.2)
    assert noisy.count == 2 * len(TS) - 4
    np.testing.assert_allclose(noisy.cost, noisy.count, rtol=0.15)
    np.testing.assert_allclose(noisy.factor[-1, -1] ** 2, noisy.cost, rtol=0.05)


def test_standard_deviations_agree_with_many_fits(arm, noisy):
    found = [fit_simulation(sought(arm), [moved(arm, SIGMA, seed)], substeps=4).phi for seed in range(1, 13)]
    # The standard deviation of twelve has a standard deviation of a fifth.
    np.testing.assert_allclose(np.std(found, axis=0), deviations(noisy), rtol=0.6)


def with_outliers(motion, seed):
    """One of twelve samples far off."""
    rng = np.random.default_rng(100 + seed)
    far = rng.uniform(size=motion.q.shape) < 1 / 12
    return Motion(
        motion.ts, np.asarray(motion.q) + far * rng.uniform(-0.2, 0.2, motion.q.shape), motion.u, motion.u_dot, motion.effort
    )


def test_robust_fits_do_not_mind_outliers_and_know_their_precision(arm):
    fits = [
        fit_simulation(sought(arm, factor=1.1), [with_outliers(moved(arm, SIGMA, seed), seed)], substeps=4, robust=True)
        for seed in range(10)
    ]
    assert all(fit.converged for fit in fits), [fit.message for fit in fits]
    np.testing.assert_allclose([fit.sigma["q"] for fit in fits], SIGMA, rtol=0.4)
    errors = np.array([fit.phi - arm.mass for fit in fits]) / deviations(fits[0])
    assert np.abs(errors).max() < 4.0
    # Twenty errors, of which the two of a fit are correlated.
    assert 0.5 < np.sqrt(np.mean(errors**2)) < 1.6
    plain = fit_simulation(sought(arm, factor=1.1), [with_outliers(moved(arm, SIGMA), 0)], substeps=4)
    assert np.abs((plain.phi - arm.mass) / deviations(fits[0])).max() > 5.0


def test_robust_fits_that_run_out_of_iterations_keep_the_last_motion_without_gaps(arm):
    def fit(iterations):
        what, motion, seen = sought(arm, factor=1.1), with_outliers(moved(arm, SIGMA), 0), []
        found = fit_simulation(what, [motion], substeps=4, robust=True, max_iterations=iterations, progress=seen.append)
        return found, seen

    gaps = [step.gap for step in fit(50)[1]]
    # Where standard deviations were estimated anew, gaps opened again.
    opened = next(i for i in range(1, len(gaps)) if gaps[i] > 1e3 * gaps[i - 1])
    before, after = fit(opened)[0], fit(opened + 1)[0]
    assert before.converged
    assert not after.converged
    np.testing.assert_array_equal(after.phi, before.phi)
    np.testing.assert_array_equal(after.predicted[0].q, before.predicted[0].q)


def test_pieces_give_the_fit_of_one_piece(arm, noisy):
    whole = fit_simulation(sought(arm, factor=1.1), [moved(arm, SIGMA)], piece=None, substeps=4)
    assert whole.converged, whole.message
    np.testing.assert_allclose(whole.phi, noisy.phi, rtol=1e-5)
    np.testing.assert_allclose(whole.cost, noisy.cost, rtol=0.01)
    np.testing.assert_allclose(deviations(whole), deviations(noisy), rtol=0.05)


def test_windows_first_and_then_the_whole_run(arm, noisy):
    fit = fit_simulation(sought(arm), [moved(arm, SIGMA)], windows=(0.2, None), substeps=4)
    assert fit.converged, fit.message
    assert (fit.history[0].window, fit.history[-1].window) == (0.2, None)
    np.testing.assert_allclose(fit.phi, noisy.phi, rtol=1e-5)
    # Short windows alone say less, but the same within their standard deviations.
    alone = fit_simulation(sought(arm), [moved(arm, SIGMA)], windows=(0.2,), substeps=4)
    assert alone.count == 2 * len(TS) - 5 * 4
    assert np.all(deviations(alone) > 1.5 * deviations(noisy))
    assert np.all(np.abs(np.asarray(alone.phi - arm.mass)) < 3.0 * deviations(alone))


def test_runs_of_other_lengths_and_samples_that_do_not_count(arm):
    first, second = moved(arm, SIGMA), moved(arm, SIGMA, 1)[:47]
    spoilt = np.array(first.q)
    spoilt[50:60, 1] += 1.0
    weight = np.where(spoilt == np.asarray(first.q), 1.0, 0.0)
    motion = Motion(TS, spoilt, first.u, first.u_dot, first.effort, weight)
    fit = fit_simulation(sought(arm), [motion, second], substeps=4)
    assert fit.converged, fit.message
    assert np.all(np.abs(np.asarray(fit.phi - arm.mass)) < 3.0 * deviations(fit))
    assert fit.count == 2 * (len(TS) + 47) - 10 - 2 * 4
    assert [len(run.ts) for run in fit.predicted] == [len(TS), 47]
    np.testing.assert_allclose(fit.predicted[1].q, second.q, atol=5 * SIGMA)


@pytest.mark.parametrize("factor", [(3.0, 0.02), (0.01, 0.01), (30.0, 30.0)])
def test_far_starts_end_where_near_ones_do(arm, noisy, factor):
    """On the word of the first derivatives, masses would go to zero, where nothing says that they should come back."""
    fit = fit_simulation(sought(arm, factor=np.array(factor)), [moved(arm, SIGMA)], substeps=4)
    assert fit.converged, fit.message
    assert fit.iterations < 30
    np.testing.assert_allclose(fit.phi, noisy.phi, rtol=0, atol=1e-3 * deviations(noisy).min())


def test_what_would_go_beyond_a_limit_stays_there_and_the_rest_makes_the_best_of_it():
    rng = np.random.default_rng(0)
    columns, target = jnp.asarray(rng.normal(size=(8, 3))), jnp.asarray(rng.normal(size=8))
    best = np.linalg.lstsq(columns, -target)[0]
    far = np.full(3, np.inf)
    np.testing.assert_allclose(limited(columns, target, jnp.asarray(-far), jnp.asarray(far)), best, rtol=0, atol=1e-14)
    for i, low, high in ((0, -1.0, 0.5), (1, 0.5, 2.0)):
        bounds = [-far, far.copy()]
        bounds[0][i], bounds[1][i] = sorted((low * best[i], high * best[i]))
        expected = scipy.optimize.lsq_linear(columns, -target, (bounds[0], bounds[1]), tol=1e-14).x
        np.testing.assert_allclose(limited(columns, target, *map(jnp.asarray, bounds)), expected, rtol=0, atol=1e-9)


def test_a_start_from_which_the_simulation_diverges(arm):
    """One piece, from masses so wrong that whole steps would leave all that is sensible."""
    far = sought(arm, factor=np.array([0.7, 1.3]))
    fit = fit_simulation(far, [moved(arm, SIGMA)], piece=None, substeps=4)
    assert fit.converged, fit.message
    assert np.all(np.abs(np.asarray(fit.phi - arm.mass)) < 3.0 * deviations(fit))


def test_steps_that_fail_are_not_taken(arm):
    """Where dampers stop all motion, linear equations ask for far less than none, with which the simulation explodes."""
    steps = []
    what = sought(arm, Unknown("damping", bounds=(None, None)), factor=1.0, damping=np.array([5.0, 3.0]))
    # Three times the same start: the program of three starts is that of the next test too.
    starts = jnp.tile(what.theta0[None], (3, 1))
    fit = fit_simulation(what, [moved(arm, SIGMA)], starts=starts, substeps=4, progress=steps.append)
    assert fit.converged, fit.message
    assert not all(step.accepted for step in steps)
    assert np.all(np.isfinite([step.cost for step in steps]))
    assert np.all(np.abs(np.asarray(fit.phi - arm.damping)) < 4.0 * deviations(fit))
    assert tuple(steps) == fit.history


def test_many_starts_and_one_that_comes_to_nothing(arm):
    what = sought(arm, Unknown("damping", bounds=(None, None)), factor=1.0)
    starts = what.theta0[None] + jnp.array([[0.3, 0.1], [-0.05, 0.2], [-1e6, 0.0]])
    fit = fit_simulation(what, [moved(arm, SIGMA)], starts=starts, substeps=4)
    assert fit.converged, fit.message
    assert fit.agreeing == (2, 3)
    assert "2 of 3 starts agree" in fit.message
    assert np.isinf(fit.starts[2])
    assert np.all(np.abs(np.asarray(fit.phi - arm.damping)) < 4.0 * deviations(fit))
    alone = fit_simulation(what, [moved(arm, SIGMA)], starts=jnp.tile(starts[2:], (3, 1)), substeps=4)
    assert not alone.converged
    assert "comes to nothing" in alone.message


def test_interruption_keeps_the_best_and_goes_on(arm, noisy, tmp_path):
    def interrupt(step):
        if step.iteration == 6:
            raise KeyboardInterrupt

    path, motion = tmp_path / "fit.npz", moved(arm, SIGMA)
    with pytest.raises(FitInterrupted, match="interrupted after 6 iterations") as caught:
        fit_simulation(sought(arm), [motion], substeps=4, progress=interrupt, checkpoint=path)
    fit = caught.value.fit
    assert not fit.converged
    assert fit.message == "interrupted"
    assert len(fit.history) == 6
    assert np.isfinite(fit.cost)
    assert np.all(np.abs(fit.phi / noisy.phi - 1) < np.abs(1.3 * arm.mass / noisy.phi - 1))
    whole, seen = fit_simulation(sought(arm), [motion], substeps=4), []
    rest = fit_simulation(sought(arm), [motion], substeps=4, progress=seen.append, checkpoint=path)
    assert [step.iteration for step in seen] == list(range(7, whole.iterations + 1))
    assert rest.history == whole.history
    np.testing.assert_array_equal(rest.theta, whole.theta)
    np.testing.assert_array_equal(rest.factor, whole.factor)
    with pytest.raises(CheckpointError, match=r"fit\.npz belongs to other inputs"):
        fit_simulation(sought(arm), [motion], substeps=5, checkpoint=path)


def test_iterations_that_do_not_suffice(arm):
    fit = fit_simulation(sought(arm), [moved(arm, SIGMA)], substeps=4, max_iterations=1)
    assert not fit.converged
    assert "iterations" in fit.message
    assert fit.iterations == 1


def test_nothing_compiles_again_for_other_data(arm, noisy, monkeypatch):
    monkeypatch.setattr("kanejax._simulation_fit.search.linearized", None)
    fit = fit_simulation(sought(arm, factor=0.9), [moved(arm, SIGMA, 5)], substeps=4, sigma={"q": 2e-3})
    assert fit.converged
    np.testing.assert_allclose(fit.sigma["q"], 2e-3)


def test_closed_loop_with_a_torque_sensor(arm):
    gains = jnp.array([20.0, 8.0]), jnp.array([2.0, 0.6])

    def controller(t, q, u):
        goal = jnp.stack([jnp.sin(4.0 * t), 0.7 * jnp.cos(6.0 * t)])
        return gains[0] * (goal - q) - gains[1] * u

    motion = moved(arm, SIGMA, control=controller)
    sensed = np.asarray(motion.effort) + 0.02 * np.random.default_rng(3).normal(size=motion.effort.shape)
    motion = Motion(TS, motion.q, motion.u, motion.u_dot, sensed)
    fit = fit_simulation(sought(arm), [motion], control=controller, substeps=4)
    assert fit.converged, fit.message
    assert np.all(np.abs(np.asarray(fit.phi - arm.mass)) < 3.0 * deviations(fit))
    np.testing.assert_allclose(fit.sigma["effort"], 0.02, rtol=0.25)
    found = fit.predicted[0].effort
    assert found is not None
    np.testing.assert_allclose(found, sensed, atol=0.12)


def test_gain_offset_and_delay_of_the_drives(arm):
    """The recorded signal is that of the force, in another unit, and late."""
    ts = np.arange(201) * 0.005
    wide = np.arange(-100, 301) * 0.005
    motion = moved(arm, ts=ts)
    late, gain, offset = 0.0123, np.array([2.0, 0.5]), np.array([0.4, -0.1])
    recorded = np.stack([np.interp(ts - late, wide, column) for column in ((effort(wide) + offset) / gain).T], -1)
    motion = Motion(ts, motion.q, motion.u, motion.u_dot, recorded)
    plant = Plant(arm, Drives.ideal(arm).replace(gain=np.array([1.8, 0.55])))
    what = parameterization(plant, ["gain", "offset", "delay"])
    fit = fit_simulation(what, [motion], piece=0.2)
    assert fit.converged, fit.message
    np.testing.assert_allclose(fit.phi, [*gain, *offset, late], rtol=5e-3, atol=2e-3)


def test_given_initial_states_and_single_precision(arm):
    narrow = arm.astype(jnp.float32)
    motion = moved(arm)
    exact = Motion(TS, motion.q, np.vstack([np.zeros(2), motion.u[1:]]), motion.u_dot, motion.effort)
    wrong = narrow.replace(mass=1.2 * narrow.mass)
    what = parameterization(Plant(wrong, Drives.ideal(wrong)), ["mass"])
    fit = fit_simulation(what, [exact], initial_state="given", substeps=4)
    assert fit.theta.dtype == jnp.float32
    assert fit.converged, fit.message
    np.testing.assert_allclose(fit.phi, arm.mass, rtol=1e-3)
    np.testing.assert_allclose(fit.predicted[0].q[0], motion.q[0], rtol=1e-6)
    np.testing.assert_array_equal(fit.predicted[0].u[0], 0.0)


def simulated(model, phi, start, control_ts, signal, what):
    """Coordinates at all samples by kanejax.simulate, with the numbers phi."""
    plant = what.assemble(phi)[0]
    table = kj.TorqueTable(control_ts, signal)
    return kj.simulate(plant.model, start[:2], start[2:], control_ts, control=table, dt0=0.0025, solver=RungeKutta4()).q


@pytest.mark.parametrize("at_rest", [False, True])
def test_derivatives_agree_with_central_differences(arm, at_rest):
    """Of the whole run to parameters and first state; at rest with Coulomb friction, without torque, and hanging down."""
    rough = arm.replace(coulomb_friction=np.array([0.3, 0.2]), friction_width=np.array([0.05, 0.05]))
    ts = TS[:21]
    signal = np.zeros((21, 2)) if at_rest else effort(ts)
    what = sought(rough, "mass", "coulomb_friction", factor=1.0)
    start = np.zeros(4) if at_rest else np.array([0.3, -0.5, 0.2, 0.4])
    shape = Motion(ts, np.zeros((21, 2)), np.zeros((21, 2)), np.zeros((21, 2)), signal)
    point = jnp.concatenate((what.phi0, jnp.asarray(start)))
    data = recorded(what.tree, [shape], ("q",), {"q": 1.0}, point.dtype)
    pieces = cut(data.times, None, None)
    shooting = Shooting(
        what, data.measured, jax.tree.map(jnp.asarray, pieces), jnp.asarray(pieces.counts), jnp.zeros(1, bool), None, RungeKutta4(),
        data.lengths, ("q",), 4, "linear", False, False, False,
    )  # fmt: skip

    def q(point):
        return np.asarray(simulated(rough, point[:4], point[4:], ts, jnp.asarray(signal), what))

    at = linearized_at(shooting, point[:4], point[None, 4:], data.sigma, jnp.ones(()))
    np.testing.assert_allclose(at.states[0, :, :2], q(point), atol=1e-12)
    # One triangle, of the state, phi and the residuals.
    found = np.zeros((9, 9))
    found[:4], found[4:, 4:] = np.asarray(at.back[0])[:, [0, 1, 2, 3, 8, 9, 10, 11, 12]], at.factor
    h = 1e-5
    columns = [(q(point + h * e) - q(point - h * e)).ravel() / (2 * h) for e in np.eye(8)]
    expected = np.stack([*columns[4:], *columns[:4], q(point).ravel()], 1)
    size = np.linalg.norm(expected, axis=0)
    assert np.all(np.isfinite(found))
    assert np.all((size > 1e-3) | at_rest)
    # Products of the triangle's columns are those of the columns that it was made from, and of what holds the state.
    size = np.where(size > 1e-9, size, 1.0)
    held = np.diag([1e-6] * 4 + [0.0] * 5)
    products, wanted = ((x.T @ x + more) / np.outer(size, size) for x, more in ((found, 0.0), (expected, held)))
    np.testing.assert_allclose(products, wanted, rtol=1e-6, atol=1e-7)


def test_joint_force_inverts_the_drives():
    model = kj.load(random_tree(4, 4, ("hinge", "slide")))
    nv, rng = model.nv, np.random.default_rng(2)
    model = model.replace(coulomb_friction=rng.uniform(0, 1, nv), friction_width=np.full(nv, 0.1))
    drives = Drives.ideal(model).replace(
        gain=rng.uniform(0.5, 2.0, nv),
        offset=rng.normal(size=nv),
        stribeck_friction=rng.uniform(0, 2, nv),
        load_friction=rng.uniform(0, 0.3, nv),
    )
    plant = Plant(model, drives)
    mechanism = Mechanism(prepare(model), drives, model.tree, True)

    @jax.jit
    @jax.vmap
    def forces(q, u, u_dot):
        signal = drive_force(plant, q, u, u_dot) / drives.gain
        return joint_force(mechanism, signal, q, u), kj.inverse_dynamics(model, q, u, u_dot)

    found, expected = forces(*jnp.asarray(rng.normal(size=(3, 20, nv))))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_cut_takes_every_sample_once():
    runs = [0.01 * np.arange(103), 5.0 + 0.02 * np.arange(17)]
    for window, piece in ((None, 0.1), (0.2, 0.1), (0.05, 0.1), (None, None), (0.3, None)):
        pieces = cut(runs, window, piece)
        assert sorted(pieces.index[:, :-1][pieces.counts]) == list(range(120))
        assert list(np.flatnonzero(pieces.opening)) == [0, int(np.sum(np.cumsum(pieces.count) < 103)) + 1]
        steps = np.diff(pieces.ts, axis=1)
        assert np.all(steps > 0.0099)
        # Each piece ends where the next one starts, also where a piece is shorter than others.
        for k in np.flatnonzero(pieces.joined):
            assert pieces.index[k, pieces.count[k]] == pieces.index[k + 1, 0]
    assert list(cut(runs, None, 0.1).joined) == [True] * 9 + [False] + [True] * 2 + [False]
    assert list(cut(runs, 0.2, 0.1).joined[:4]) == [True, False, True, False]
    np.testing.assert_array_equal(cut(runs, None, 0.1).index, cut(runs, 0.2, 0.1).index)


def test_shifted_is_linear_interpolation():
    rng = np.random.default_rng(0)
    ts = np.cumsum(rng.uniform(0.5, 1.5, 30))
    table = rng.normal(size=(30, 2))
    both, twice = np.concatenate((ts, ts)), np.concatenate((table, -table))
    for delay in (0.3, -0.7):
        value, rate = shifted(jnp.asarray(both), jnp.asarray(twice), jnp.asarray(delay), (30, 30))
        expected = np.stack([np.interp(ts + delay, ts, column) for column in table.T], -1)
        ahead = np.stack([np.interp(ts + delay + 1e-6, ts, column) for column in table.T], -1)
        np.testing.assert_allclose(value, np.concatenate((expected, -expected)), atol=1e-12)
        np.testing.assert_allclose(rate[:30], (ahead - expected) / 1e-6, atol=1e-6)


def test_what_is_refused(arm):
    what, motion = sought(arm), moved(arm)
    refused: tuple[tuple[dict[str, Any], str], ...] = (
        ({"windows": ()}, "windows is empty"),
        ({"windows": (-1.0,)}, "window is -1.0; it must be positive"),
        ({"piece": 0.0}, "piece is 0.0; it must be positive"),
        ({"substeps": 0}, "substeps is 0; it must be positive"),
        ({"max_iterations": -2}, "max_iterations is -2; it must be positive"),
        ({"outputs": ("q", "q")}, "at most once"),
        ({"outputs": ("x",)}, "give each of q, u, effort"),
        ({"outputs": ("q", "effort")}, "the effort drives the simulation, so it is no output"),
        ({"initial_state": "known"}, "initial_state is 'known'; use 'estimated' or 'given'"),
        ({"interpolation": "cubic"}, "interpolation is 'cubic'; use 'linear' or 'hold'"),
        ({"sigma": {"q": -1.0}}, "sigma of q is -1.0; it must be a positive number"),
        ({"sigma": {"q": np.ones(3)}}, "or one for each of the 2 speeds"),
        ({"starts": jnp.zeros((2, 5))}, r"starts has shape \(2, 5\), but needs \(starts, 2\)"),
    )
    for options, message in refused:
        with pytest.raises(ValueError, match=message):
            fit_simulation(what, [motion], **options)
    with pytest.raises(UnknownNameError, match="no output with a standard deviation is named 'effort'; the names are: 'q'"):
        fit_simulation(what, [motion], sigma={"effort": 1.0})
    with pytest.raises(ValueError, match="there is no motion to fit"):
        fit_simulation(what, [])
    spoilt = Motion(TS, np.where(TS == 0.5, np.nan, np.asarray(motion.q).T).T, motion.u, motion.u_dot, motion.effort)
    with pytest.raises(ValueError, match=r"q of joint 'shoulder' at 0\.5 s is not finite"):
        fit_simulation(what, [spoilt])
    with pytest.raises(ValueError, match="motion 'motion' has 1 joints, but the model has 2"):
        fit_simulation(what, [Motion(TS, *(np.asarray(x)[:, :1] for x in (motion.q, motion.u, motion.u_dot, motion.effort)))])
    loose = kj.load(random_tree(0, 1, ("free",)))
    with pytest.raises(UnsupportedModelError, match="is of type 'free'; a simulation is fitted to revolute and prismatic joints"):
        fit_simulation(sought(loose, "mass", factor=1.0), [motion])
