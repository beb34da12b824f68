"""The linear and the inverse-dynamics stage, and what they say of their uncertainty, on an arm whose parameters are known."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.robot_logs import OFFSETS, arm, efforts, motion_of_arm, recorded_arm

import kanejax as kj
from kanejax._parameters.parameterization import Parameterization, parameterization
from kanejax._parameters.plant import Drives, Plant, signal
from kanejax._parameters.pseudo_inertia import consistency
from kanejax._parameters.unknowns import Unknown
from kanejax._regression.compress import CHUNK, compress, residuals, sums_of_squares
from kanejax._regression.fit import fit_inverse_dynamics
from kanejax._regression.information import information
from kanejax._regression.linear_estimate import identifiable, linear_estimate
from kanejax._regression.linearization import linearization, predicted_with_derivative
from kanejax._regression.samples import samples_of

# Of all recordings, so that all fits share their compiled programs [s]: eleven blocks of `information` and a little.
DURATION = 28.2
SOUGHT = (Unknown("inertia", prior=kj.Entropic(3.0)), "damping", "coulomb_friction", "offset")


@functools.cache
def recorded(noise: float = 0.0) -> kj.Motion:
    return recorded_arm(noise, duration=DURATION)


def start() -> Plant:
    """An arm that is known badly."""
    model = arm()
    wrong = model.replace(mass=model.mass * jnp.array([1.3, 0.7, 1.2]), damping=jnp.full(3, 0.1), coulomb_friction=jnp.full(3, 0.1))
    return Plant(wrong, Drives.ideal(wrong))


def true_phi(sought: Parameterization) -> np.ndarray:
    return np.concatenate((np.asarray(kj.inertia_parameters(arm())).ravel(), arm().damping, arm().coulomb_friction, OFFSETS))


@pytest.fixture(scope="module")
def sought():
    return parameterization(start(), SOUGHT)


@pytest.fixture(scope="module")
def base(sought):
    return identifiable(sought)


def starts(sought: Parameterization) -> jax.Array:
    """The same number for all fits; the first is the nominal plant."""
    return sought.starts(jax.random.key(1), 16, spread=1.0)


@pytest.fixture(scope="module")
def regressor(sought):
    """Columns of all parameters, for the linear methods in numpy."""

    @jax.jit
    def rows(samples):
        at = linearization(sought, sought.phi0)
        return jax.vmap(lambda sample: predicted_with_derivative(sought.tree, at, sample, None)[1])(samples)

    return np.asarray(rows(samples_of([recorded()])))


@pytest.mark.parametrize(
    "unknowns",
    [
        ("inertia", "armature", "damping", "coulomb_friction", "offset"),
        ("mass", "gain", "load_friction", "stribeck_friction", "stribeck_speed", "friction_width"),
        ("com", "body_position", "body_quaternion", "joint_axis", "gravity"),
    ],
)
def test_derivatives_are_those_of_the_signals(unknowns):
    plant = start()
    drives = plant.drives.replace(load_friction=0.1, stribeck_friction=0.2, gain=jnp.array([2.0, 3.0, 0.5]))
    problem = parameterization(Plant(plant.model, drives), unknowns)
    sample = jax.tree.map(lambda x: x[7], samples_of([recorded()]))

    @jax.jit
    def linearized(phi):
        return predicted_with_derivative(problem.tree, linearization(problem, phi), sample, None)

    @jax.jit
    def by_forward_mode(phi):
        def predicted(phi):
            plant, parameters = problem.assemble(phi)
            return signal(plant, sample.q, sample.u, sample.u_dot, parameters)

        return predicted(phi), jax.jacfwd(predicted)(phi)

    phi = problem.phi(problem.theta0 + 0.1)
    value, derivative = linearized(phi)
    right, expected = by_forward_mode(phi)
    np.testing.assert_allclose(value, right, rtol=1e-12)
    np.testing.assert_allclose(derivative, expected, atol=1e-11 * float(jnp.abs(expected).max()))


def test_compression_keeps_the_sum_of_squares(sought):
    samples = samples_of([recorded(0.1)])
    left_out = samples._replace(weight=samples.weight.at[10:40, 1].set(0.0), effort=samples.effort.at[12, 1].set(jnp.nan))
    phi = sought.phi(sought.theta0 + 0.2)
    # The last of the chunks is not full.
    assert len(samples.q) % CHUNK > 0
    compressed = compress(sought, sought.phi0, left_out)
    expected = jnp.sum(residuals(sought, phi, left_out) ** 2, 0)
    np.testing.assert_allclose(sums_of_squares(compressed, phi), expected, rtol=1e-10)
    np.testing.assert_allclose(compressed.count, [2820, 2790, 2820])


def test_exact_data_give_exact_base_parameters(sought, base):
    samples = samples_of([recorded()])
    expected = base.matrix @ true_phi(sought)
    linear = linear_estimate(sought, samples, base=base)
    np.testing.assert_allclose(linear.value, expected, atol=1e-11 * np.abs(expected).max())
    fit = fit_inverse_dynamics(sought, samples, starts=starts(sought))
    assert fit.converged, fit.message
    np.testing.assert_allclose(base.matrix @ np.asarray(fit.phi), expected, rtol=1e-8, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("method", ["ordinary", "weighted", "huber"])
def test_linear_methods_against_numpy(sought, base, regressor, method):
    motion = recorded(0.05)
    samples = samples_of([motion])
    found = linear_estimate(sought, samples, base=base, method=method)
    columns, y = regressor[..., base.independent], np.asarray(motion.effort)
    weight = np.ones_like(y)
    for _ in range(60 if method != "ordinary" else 1):
        flat = np.sqrt(weight).reshape(-1)
        beta = np.linalg.lstsq(flat[:, None] * columns.reshape(-1, len(base)), flat * y.reshape(-1), rcond=None)[0]
        error = y - columns @ beta
        if method == "weighted":
            weight = np.broadcast_to(1 / np.var(error, axis=0), y.shape)
        else:
            sigma = 1.4826 * np.median(np.abs(error), axis=0)
            weight = np.minimum(1, 1.345 * sigma / np.abs(error)) / sigma**2
    np.testing.assert_allclose(found.value, beta, atol=2e-3 * np.sqrt(np.diag(found.covariance)).min())
    scaled = columns / np.asarray(found.sigma)[:, None]
    if method != "huber":
        inverse = np.linalg.inv(np.einsum("nri,nrj->ij", scaled, scaled))
        np.testing.assert_allclose(found.covariance, inverse, rtol=1e-5)


def test_robust_fits_do_not_mind_outliers(sought, base):
    motion = recorded(0.02)
    effort = np.array(motion.effort)
    effort[::20] += 50.0
    samples = samples_of([motion])._replace(effort=jnp.asarray(effort))
    expected = base.matrix @ true_phi(sought)

    def distance(fit):
        return float(np.linalg.norm(base.matrix @ np.asarray(fit.phi) - expected))

    plain, robust = (fit_inverse_dynamics(sought, samples, starts=starts(sought), robust=robust) for robust in (False, True))
    assert distance(robust) < 0.1 * distance(plain)


def test_every_start_is_consistent_and_comes_to_the_same_fit(sought):
    samples = samples_of([recorded(0.05)])
    thetas = starts(sought)
    for theta in thetas:
        assert float(consistency(kj.inertia_parameters(sought.plant(theta).model)).min()) > 0
    fit = fit_inverse_dynamics(sought, samples, starts=thetas)
    assert fit.converged
    assert fit.agreeing[1] == 16
    assert fit.agreeing[0] >= 15, fit.message
    assert float(consistency(kj.inertia_parameters(sought.plant(fit.theta).model)).min()) > 0


def test_nonlinear_unknowns_are_found():
    """Gains are no linear parameters of the signals; with the masses given they are determined."""
    model = arm()
    gain = jnp.array([2.0, 4.0, 0.5])
    motion = recorded()
    motion = kj.Motion(motion.ts, motion.q, motion.u, motion.u_dot, motion.effort / gain[None])
    wide = model.replace(friction_width=jnp.full(3, 0.05))
    problem = parameterization(Plant(wide, Drives.ideal(wide)), ("gain", "offset", "damping", "friction_width"))
    assert not problem.linear
    fit = fit_inverse_dynamics(problem, samples_of([motion]))
    assert fit.converged, fit.message
    plant = problem.plant(fit.theta)
    np.testing.assert_allclose(plant.drives.gain, gain, rtol=1e-6)
    np.testing.assert_allclose(plant.drives.offset, OFFSETS, rtol=1e-5)
    np.testing.assert_allclose(plant.model.friction_width, model.friction_width, rtol=1e-5)


def test_the_linear_stage_refuses_what_is_not_linear():
    with pytest.raises(ValueError, match="not linear in what is sought"):
        linear_estimate(parameterization(start(), ["gain"]), samples_of([recorded()]))


def correlated(rng, shape, memory):
    """Noise of size one in which each sample remembers the last."""
    white, found = rng.normal(size=shape), np.zeros(shape)
    for k in range(1, len(white)):
        found[k] = memory * found[k - 1] + np.sqrt(1 - memory**2) * white[k]
    return found


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_intervals_cover_what_they_promise(sought, base, memory):
    """Over many recordings with white or coloured noise; with the latter, intervals for white noise cover far too little."""
    # Errors that last for a fifth of a second need more time to be known than independent ones.
    ts, q, u, u_dot = motion_of_arm(100.0, DURATION)
    torque = efforts(arm(), q, u, u_dot)
    size = 0.05 * np.sqrt(np.mean(torque**2, 0))
    expected, rng = base.matrix @ true_phi(sought), np.random.default_rng(5)
    inside, white = [], []
    for _ in range(60):
        motion = kj.Motion(ts, q, u, u_dot, torque + size * correlated(rng, torque.shape, memory))
        samples = samples_of([motion])
        linear = linear_estimate(sought, samples, base=base)
        errors = [residuals(sought, linear.phi, samples)]
        said = information(sought, linear.phi, linear.sigma, base, [samples], errors, 0.01)
        error = np.abs(linear.value - expected)
        inside.append(error < 1.96 * np.sqrt(np.diag(said.covariance)))
        white.append(error < 1.96 * np.sqrt(np.diag(said.white)))
    # 60 recordings of some 24 parameters that are correlated: the standard deviation of the share is about 1 %.
    assert 0.92 < np.mean(inside) < 0.98
    assert (np.mean(white) < 0.75) if memory else (0.92 < np.mean(white) < 0.98)


def test_information_is_that_of_numpy(sought, base):
    motion = recorded(0.05)
    samples = samples_of([motion])
    linear = linear_estimate(sought, samples, base=base)
    said = information(sought, linear.phi, linear.sigma, base, [samples], [residuals(sought, linear.phi, samples)], 0.01)
    np.testing.assert_allclose(np.sqrt(np.diag(said.white)), np.sqrt(np.diag(linear.covariance)), rtol=0.02)
    assert said.weak == ()
    # The density of white noise is flat, and its integral is the variance.
    power = np.trapezoid(said.spectrum.density, said.spectrum.frequency, axis=0)
    np.testing.assert_allclose(power, np.asarray(linear.sigma) ** 2, rtol=0.15)


def test_a_motion_of_one_joint_leaves_the_others_unknown(sought, base):
    ts, q, u, u_dot = motion_of_arm(100.0, DURATION)
    still = np.array([0.0, 1.0, 0.0])
    q, u, u_dot = q * still + 0.3, u * still, u_dot * still
    torque = efforts(arm(), q, u, u_dot)
    samples = samples_of([kj.Motion(ts, q, u, u_dot, torque)])
    linear = linear_estimate(sought, samples, base=base)
    said = information(sought, linear.phi, linear.sigma, base, [samples], [residuals(sought, linear.phi, samples)], 0.01)
    assert len(said.weak) > 5
    assert said.unexcited.sum() > 10
    assert np.all(np.isfinite(linear.value))


def test_missing_signals_do_not_narrow_the_intervals(sought, base):
    """Nor does one short run among long ones."""
    motion = recorded(0.05)
    rng = np.random.default_rng(2)
    counts = jnp.asarray(rng.uniform(size=motion.effort.shape) < 0.4, float)
    samples = samples_of([motion])._replace(weight=counts)
    linear = linear_estimate(sought, samples, base=base)
    left = residuals(sought, linear.phi, samples)
    said = information(sought, linear.phi, linear.sigma, base, [samples], [left], 0.01)
    ratio = np.median(np.sqrt(np.diag(said.covariance) / np.diag(said.white)))
    assert 0.9 < ratio < 1.5
    # As many blocks as before: eleven full ones, and one for the short run.
    long, short = (jax.tree.map(lambda x, count=count: x[:count], samples) for count in (2816, 5))
    again = information(sought, linear.phi, linear.sigma, base, [long, short], [left[:2816], left[:5]], 0.01)
    np.testing.assert_allclose(np.diag(again.covariance), np.diag(said.covariance), rtol=0.2)
