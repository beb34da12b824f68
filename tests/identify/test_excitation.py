"""Excitation design, against numpy, finite differences, random and hand-made motions, and simulated measurements."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax._excitation import excitation as module, motion_information as information_module
from kanejax._excitation.excitation import excitation
from kanejax._excitation.fourier_motion import FourierMotion, motion_table, rest_directions, write_csv
from kanejax._excitation.motion_information import base_of_unknowns, force_columns, motion_information
from kanejax._excitation.motion_search import CHECKED, SAMPLES, between_times
from kanejax._logs.columns import Columns
from kanejax._logs.read_log import read_log
from kanejax._model.inertia import inertia_parameters

PERIOD, HARMONICS = 6.0, 4
SPEED, ACCELERATION = np.array([1.5, 1.0, 0.4]), np.array([6.0, 4.0, 1.5])
TORQUE, SIGMA = np.array([5.0, 22.0, 26.0]), np.array([0.1, 0.2, 0.4])
ARM = """
<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="turret"><joint name="yaw" axis="0 0 1" range="-2 2"
damping="0.3" armature="0.1"/><inertial pos="0.02 0.01 0.1" mass="2" diaginertia="0.03 0.02 0.04"/><body name="arm" pos="0 0.1 0.4">
<joint name="pitch" axis="0 1 0" range="-1.2 1" frictionloss="0.4"/>
<inertial pos="0.2 0.03 -0.02" mass="3" diaginertia="0.02 0.06 0.05"/>
<body name="rod" pos="0.3 0 0"><joint name="slide" type="slide" axis="1 0.2 0" range="-0.1 0.5" damping="2"/><inertial
pos="0.05 -0.02 0.04" mass="1.5" diaginertia="0.01 0.02 0.03"/></body></body></body></worldbody></mujoco>"""
# Samples of a period that a design is checked at.
WHOLE = CHECKED * HARMONICS
OPTIONS = {
    "period": PERIOD,
    "harmonics": HARMONICS,
    "speed": SPEED,
    "acceleration": ACCELERATION,
    "torque": TORQUE,
    "sigma": SIGMA,
    "starts": 6,
    "max_steps": 150,
}


@pytest.fixture(scope="module")
def model():
    return kj.load(ARM)


@pytest.fixture(scope="module")
def design(model):
    return excitation(model, **OPTIONS, margin=0.0)


def motion_of(seed, nv=3, harmonics=HARMONICS):
    random = np.random.default_rng(seed)
    a, b = random.normal(size=(2, nv, harmonics))
    joints = ("yaw", "pitch", "slide")[:nv]
    return FourierMotion(joints, jnp.asarray(PERIOD), jnp.asarray(random.normal(size=nv)), jnp.asarray(a), jnp.asarray(b))


def evaluated(motion, ts):
    """States by the formulas of Swevers et al., in numpy."""
    a, b, offset = (np.asarray(x) for x in (motion.a, motion.b, motion.offset))
    k = 2 * np.pi * np.arange(1, a.shape[1] + 1) / float(motion.period)
    c, s = np.cos(np.outer(ts, k)), np.sin(np.outer(ts, k))
    return offset + s @ (a / k).T - c @ (b / k).T, c @ a.T + s @ b.T, c @ (b * k).T - s @ (a * k).T


def columns_of(model, unknowns, *state):
    """`force_columns` of many samples, always as many at a time as a design is checked at, so that one program does for all."""
    count, spare = len(state[0]), -len(state[0]) % WHOLE
    full = [np.concatenate((x, np.repeat(x[-1:], spare, 0))) for x in state]
    pieces = [tuple(jnp.asarray(x[first : first + WHOLE]) for x in full) for first in range(0, count + spare, WHOLE)]
    columns = [information_module._columns_of_samples(model, unknowns, *piece) for piece in pieces]
    return np.concatenate(columns)[:count]


def rows_of(model, base, q, u, u_dot):
    """The weighted regressor of the base parameters."""
    rows = columns_of(model, module.DEFAULT, q, u, u_dot)[:, :, base.independent]
    return (rows / SIGMA[None, :, None]).reshape(-1, len(base))


def scaled(rows):
    return rows / np.linalg.norm(rows, axis=0)


# The motion


def test_states_are_the_series_and_its_derivatives():
    motion = motion_of(0)
    ts = np.linspace(-3.0, 20.0, 17)
    for t, *expected in zip(ts, *evaluated(motion, ts), strict=True):
        q, u = jax.jvp(motion.q, (jnp.asarray(t),), (jnp.asarray(1.0),))
        speed, u_dot = jax.jvp(motion.u, (jnp.asarray(t),), (jnp.asarray(1.0),))
        np.testing.assert_allclose(np.stack((q, u, u_dot)), np.stack(expected), atol=1e-12)
        np.testing.assert_allclose(np.stack((speed, motion.u_dot(t))), np.stack((u, u_dot)), atol=1e-12)


def test_repeats_after_its_period():
    motion = motion_of(1)
    for t in (0.0, 0.7, 5.9):
        for function in (motion.q, motion.u, motion.u_dot):
            np.testing.assert_allclose(function(t + 3 * PERIOD), function(t), atol=1e-11)


def test_rest_directions_span_all_motions_that_start_at_rest():
    for harmonics in (2, 5):
        for basis, condition in zip(rest_directions(harmonics), (np.ones(harmonics), np.arange(1, harmonics + 1)), strict=True):
            np.testing.assert_allclose(basis.T @ basis, np.eye(harmonics - 1), atol=1e-14)
            np.testing.assert_allclose(condition @ basis, 0, atol=1e-13)


def test_motion_refuses_shapes_and_periods():
    good = motion_of(0)
    with pytest.raises(ValueError, match=r"offset has shape \(2,\), but 3 joints need \(3,\)"):
        FourierMotion(good.joints, good.period, good.offset[:2], good.a, good.b)
    with pytest.raises(ValueError, match=r"a and b have shapes \(3, 4\) and \(3, 3\)"):
        FourierMotion(good.joints, good.period, good.offset, good.a, good.b[:, 1:])
    with pytest.raises(ValueError, match=r"period is -1\.0; it must be positive"):
        FourierMotion(good.joints, jnp.asarray(-1.0), good.offset, good.a, good.b)


# The information


def test_columns_are_what_forces_are_made_of(model):
    random = np.random.default_rng(0)
    q, u, u_dot = (jnp.asarray(x) for x in random.normal(size=(3, 3)))
    sprung = model.replace(stiffness=[3.0, 4.0, 5.0], spring_reference=[0.1, -0.2, 0.3])
    unknowns = ("inertia", "armature", "damping", "coulomb_friction", "stiffness", "offset")
    offset = jnp.asarray(random.normal(size=3))
    values = [getattr(sprung, name) for name in unknowns[1:-1]]
    phi = jnp.concatenate((inertia_parameters(sprung).ravel(), *values, offset))
    expected = kj.inverse_dynamics(sprung, q, u, u_dot) + offset
    columns = jax.jit(force_columns, static_argnums=1)(sprung, unknowns, q, u, u_dot)
    np.testing.assert_allclose(columns @ phi, expected, rtol=1e-12)


def test_columns_have_right_derivatives(model):
    random = np.random.default_rng(1)
    weights = jnp.asarray(random.normal(size=(3, 42)))
    states, change = (tuple(jnp.asarray(x) for x in random.normal(size=(3, 3))) for _ in range(2))
    function = jax.jit(
        jax.value_and_grad(lambda *state: jnp.sum(weights * force_columns(model, module.DEFAULT, *state)), (0, 1, 2))
    )
    gradient = function(*states)[1]
    step = 1e-6
    ends = [function(*(x + sign * step * d for x, d in zip(states, change, strict=True)))[0] for sign in (1, -1)]
    expected = (ends[0] - ends[1]) / (2 * step)
    np.testing.assert_allclose(sum(jnp.sum(g * d) for g, d in zip(gradient, change, strict=True)), expected, rtol=1e-7)


def test_information_is_that_of_least_squares(model):
    q, u, u_dot = evaluated(motion_of(2), np.arange(WHOLE) * PERIOD / WHOLE)
    found = motion_information(model, q, u, u_dot, sigma=SIGMA)
    rows = rows_of(model, found.base, q, u, u_dot)
    gram = rows.T @ rows
    np.testing.assert_allclose(found.std(WHOLE), np.sqrt(np.diag(np.linalg.inv(gram))), rtol=1e-8)
    np.testing.assert_allclose(found.std(4 * WHOLE), found.std(WHOLE) / 2, rtol=1e-12)
    np.testing.assert_allclose(found.log_det, np.linalg.slogdet(gram / WHOLE)[1], rtol=1e-8)
    np.testing.assert_allclose(found.condition_number, np.linalg.cond(scaled(rows)), rtol=1e-8)


def test_nominal_scaling_uses_the_sizes_of_parameters(model):
    q, u, u_dot = evaluated(motion_of(2), np.arange(WHOLE) * PERIOD / WHOLE)
    unknowns = ("inertia",)
    found = motion_information(model, q, u, u_dot, unknowns=unknowns, scaling="nominal")
    phi = np.abs(np.asarray(inertia_parameters(model)).ravel())
    rows = columns_of(model, unknowns, q, u, u_dot)[:, :, found.base.independent].reshape(-1, len(found.base))
    np.testing.assert_allclose(found.condition_number, np.linalg.cond(rows * (np.abs(found.base.matrix) @ phi)), rtol=1e-8)
    with pytest.raises(ValueError, match=r"nominal size of .*pitch\.armature.* is zero"):
        motion_information(model, q, u, u_dot, unknowns=("armature",), scaling="nominal")


def test_what_is_not_excited_has_no_precision(model):
    q, u, u_dot = evaluated(motion_of(2), np.arange(WHOLE) * PERIOD / WHOLE)
    still = np.array([1.0, 1.0, 0.0])
    found = motion_information(model, q * still, u * still, u_dot * still, sigma=SIGMA)
    assert found.log_det == -np.inf
    assert found.condition_number == np.inf
    # What the two joints that move tell is the same as without the third.
    lost = np.array([np.isinf(std) for std in found.std(100)])
    named = {found.base.names[i] for i, none in zip(found.base.independent, lost, strict=True) if none}
    assert {"slide.damping", "slide.coulomb_friction"} <= named
    assert {"yaw.damping", "pitch.coulomb_friction", "turret.Izz"}.isdisjoint(named)
    rows = rows_of(model, found.base, q * still, u * still, u_dot * still)
    lengths = np.linalg.norm(rows, axis=0)
    inverse = np.linalg.pinv(rows / np.where(lengths > 0, lengths, 1.0), rcond=1e-9)
    expected = np.linalg.norm(inverse, axis=1)[~lost] / lengths[~lost]
    np.testing.assert_allclose(found.std(WHOLE)[~lost], expected, rtol=1e-5)


def test_predicted_precision_is_that_of_estimates(model, design):
    """Least squares on simulated torques with noise, five hundred times."""
    q, u, u_dot = evaluated(design.motion, np.arange(WHOLE) * PERIOD / WHOLE)
    rows = rows_of(model, design.information.base, q, u, u_dot)
    noise = np.random.default_rng(0).normal(size=(len(rows), 500))
    errors = np.linalg.lstsq(rows, noise, rcond=None)[0]
    np.testing.assert_allclose(errors.std(axis=1), design.information.std(WHOLE), rtol=0.12)


# The design


def test_starts_and_ends_at_rest(design):
    for t in (0.0, PERIOD):
        np.testing.assert_allclose(design.motion.u(t), 0, atol=1e-12)
        np.testing.assert_allclose(design.motion.u_dot(t), 0, atol=1e-12)


def test_keeps_limits_between_the_times_that_were_checked(model, design):
    ts = (np.arange(11 * CHECKED * HARMONICS) + 0.5) * PERIOD / (11 * CHECKED * HARMONICS)
    q, u, u_dot = evaluated(design.motion, ts)
    low, high = np.asarray(model.joint_range).T
    inverse = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))
    torque = np.abs(inverse(model, *(jnp.asarray(x) for x in (q, u, u_dot)))).max(0)
    left = [np.minimum(q - low, high - q).min(0), SPEED - np.abs(u).max(0), ACCELERATION - np.abs(u_dot).max(0)]
    assert design.feasible
    for name, found, scale in zip(("position", "speed", "acceleration"), left, (1.0, SPEED, ACCELERATION), strict=True):
        assert np.all(found >= 0)
        # What is reported holds at all times, and is not much too careful.
        reported = np.asarray(getattr(design.margins, name))
        assert np.all(reported <= found + 1e-12)
        np.testing.assert_allclose(reported, found, atol=1e-3 * np.max(scale))
    np.testing.assert_allclose(design.margins.torque, TORQUE - torque, atol=1e-3 * TORQUE.max())
    assert np.all(TORQUE - torque > -1e-4 * TORQUE)
    # Limits are used: some limit of each joint is nearly reached.
    nearest = np.min([left[0] / (high - low), left[1] / SPEED, left[2] / ACCELERATION, 1 - torque / TORQUE], axis=0)
    assert np.all(nearest < 0.05)


def test_a_grid_bounds_what_is_between_its_times():
    ts = np.linspace(0, PERIOD, 20001)
    for seed in range(5):
        motion = motion_of(seed)
        coarse = evaluated(motion, np.arange(8 * HARMONICS) * PERIOD / (8 * HARMONICS))[1]
        assert np.all(np.abs(evaluated(motion, ts)[1]).max(0) <= np.abs(coarse).max(0) * between_times(8))


def test_beats_random_motions_and_sweeps_of_single_joints(model, design):
    # As many starts at once as the design has, so that nothing compiles again: 204 random motions.
    options = {**OPTIONS, "max_steps": 0, "margin": 0.0}
    random = [excitation(model, **options, seed=seed) for seed in range(34)]
    assert all(np.isfinite(some.random_values).all() for some in random)
    best = max(some.log_det for some in random)
    assert design.log_det > best + 5
    assert best == pytest.approx(np.max([some.values for some in random]), abs=0.1)
    base = design.information.base
    conditions, sums = [], []
    for rows in random_rows(model, base, 200):
        conditions.append(np.linalg.cond(scaled(rows)))
        sums.append(np.linalg.slogdet(rows.T @ rows * 3 / len(rows))[1])
    assert design.log_det > max(sums) + 5
    assert design.condition_number < min(conditions)
    by_hand = motion_information(model, *sweeps(model), sigma=SIGMA)
    assert design.log_det > by_hand.log_det + 5
    assert design.condition_number < by_hand.condition_number
    assert np.isfinite(by_hand.log_det)
    assert np.median(by_hand.std(1000) / design.information.std(1000)) > 1.5


def random_rows(model, base, count):
    """Regressors of random motions that are scaled into the limits of speed, acceleration and position, without those of torque."""
    ts = np.arange(60) * PERIOD / 60
    low, high = np.asarray(model.joint_range).T
    random = np.random.default_rng(3)
    moved = []
    for seed in range(count):
        motion = motion_of(1000 + seed)
        q, u, u_dot = evaluated(motion, ts)
        way = q - np.asarray(motion.offset)
        middle = low + (high - low) * random.uniform(0.2, 0.8, 3)
        room = np.minimum(high - middle, middle - low)
        factor = 1 / np.max([np.abs(way).max(0) / room, np.abs(u).max(0) / SPEED, np.abs(u_dot).max(0) / ACCELERATION], axis=0)
        moved.append((middle + factor * way, factor * u, factor * u_dot))
    rows = rows_of(model, base, *(np.concatenate(x) for x in zip(*moved, strict=True)))
    return rows.reshape(count, -1, len(base))


def sweeps(model):
    """In two postures one joint after another to and fro, as far as its limits allow."""
    low, high = np.asarray(model.joint_range).T
    rate = 2 * np.pi / 3
    angle = 2 * np.pi * np.arange(WHOLE // 6)[:, None] / (WHOLE // 6)
    pieces = []
    for place in (0.35, 0.65):
        posture = low + place * (high - low)
        size = np.min([0.35 * (high - low), SPEED / rate, ACCELERATION / rate**2], axis=0)
        for moved in np.diag(size):
            pieces.append((posture + np.sin(angle) * moved, rate * np.cos(angle) * moved, -(rate**2) * np.sin(angle) * moved))
    return [np.concatenate(part) for part in zip(*pieces, strict=True)]


def problem_of(model, objective, size=None):
    limits = module.motion_limits(model, None, SPEED, ACCELERATION, TORQUE)
    base = base_of_unknowns(model, module.DEFAULT)
    options = SIGMA, base, size, module.DEFAULT, objective, None
    return module._problem(model, limits, PERIOD, rest_directions(HARMONICS), *options)


@eqx.filter_jit
def cost_and_gradient(problem, x):
    return jax.value_and_grad(lambda x: problem.cost(problem.motion(x)))(x)


@eqx.filter_jit
def excess_and_gradient(problem, x):
    def excess(x):
        return jnp.sum(jnp.maximum(problem.constraints(problem.motion(x), SAMPLES) + 1.0, 0.0) ** 2)

    return jax.value_and_grad(excess)(x)


def has_right_derivatives(function, problem):
    """At a random point in a random direction, against differences of fourth order; the point and the value there."""
    x, change = (jnp.asarray(part) for part in np.random.default_rng(5).normal(size=(2, 3, 2 * HARMONICS - 1)))
    step = 1e-5
    once, twice = (function(problem, x + n * step * change)[0] - function(problem, x - n * step * change)[0] for n in (1, 2))
    value, gradient = function(problem, x)
    np.testing.assert_allclose(jnp.sum(gradient * change), (8 * once - twice) / (12 * step), rtol=1e-6)
    return x, value


@pytest.mark.parametrize("objective", ["log det", "condition number"])
def test_the_cost_is_the_objective_and_has_right_derivatives(model, objective):
    problem = problem_of(model, objective)
    x, cost = has_right_derivatives(cost_and_gradient, problem)
    # The same samples again and again have the same information.
    ts = np.tile(np.asarray(problem.times(SAMPLES)), CHECKED // SAMPLES)
    information = motion_information(model, *evaluated(problem.motion(x), ts), sigma=SIGMA)
    expected = -information.log_det if objective == "log det" else np.log(information.condition_number)
    np.testing.assert_allclose(cost, expected, rtol=1e-8)


def test_constraints_have_right_derivatives(model):
    has_right_derivatives(excess_and_gradient, problem_of(model, "log det"))


def height(model, q):
    """Of the rod's tip."""
    pose = kj.poses(model, q)
    return (pose.origin[2] + pose.rotation[2] @ jnp.asarray([0.2, 0.0, 0.0], q.dtype))[2]


@pytest.fixture(scope="module")
def above_plane(model):
    """A design in single precision by condition number, the tip above 0.3 m, twice; and the reports of both."""
    small, reports = model.astype(jnp.float32), []

    def below(q):
        return 0.3 - height(small, q)

    options = {**OPTIONS, "starts": 3, "torque": None, "objective": "condition number", "path_constraint": below}
    designs = [excitation(small, **options, progress=reports.append) for _ in range(2)]
    return *designs, reports


def test_condition_number_can_be_the_objective(above_plane):
    found, _, reports = above_plane
    assert found.value == found.condition_number < 0.5 * np.nanmin(found.random_values)
    assert found.value == pytest.approx(np.nanmin(found.values), rel=0.02)
    assert [report.step for report in reports[:6]] == list(range(25, 151, 25))
    assert all(report.steps == 150 for report in reports)
    assert reports[5].value == pytest.approx(found.value, rel=0.2)
    assert found.message.startswith(f"all limits are kept; condition number {found.value:.4g}, log det")


def test_keeps_above_a_plane_in_single_precision(model, design, above_plane):
    found = above_plane[0]
    ts = np.arange(1000) * PERIOD / 1000
    heights = jax.jit(jax.vmap(lambda q: height(model, q)))
    lowest = np.min(heights(jnp.asarray(evaluated(found.motion, ts)[0])))
    assert found.feasible
    assert found.motion.a.dtype == jnp.float32
    assert lowest > 0.3 - 1e-4
    np.testing.assert_allclose(found.margins.path, lowest - 0.3, atol=1e-3)
    # Without the plane, the tip goes below it.
    assert np.min(heights(jnp.asarray(evaluated(design.motion, ts)[0]))) < 0.3


def test_same_seed_gives_the_same_design(above_plane):
    first, second, _ = above_plane
    for one, other in zip(jax.tree.leaves(first.motion), jax.tree.leaves(second.motion), strict=True):
        np.testing.assert_array_equal(one, other)


def test_says_what_cannot_be_kept(model):
    found = excitation(model, **{**OPTIONS, "max_steps": 0, "torque": [np.inf, 0.5, np.inf], "margin": 0.1})
    assert not found.feasible
    assert np.all(np.isnan(found.values))
    assert found.margins.torque[1] < 0
    assert found.message.startswith("no motion was found that keeps all limits with a reserve of 0.1; ")
    assert "torque of joint 'pitch' by" in found.message


def test_refuses_what_makes_no_sense(model):
    def refused(match: str, error: type[Exception] = ValueError, of=model, **changes):
        with pytest.raises(error, match=match):
            excitation(of, **{**OPTIONS, "max_steps": 0, **changes})

    refused(r"speed has shape \(2,\), but this model needs \(3,\)", speed=[1.0, 1.0])
    refused(r"torque of joint 'pitch' is -1\.0; a limit must be positive", torque=[1.0, -1.0, 1.0])
    refused(r"position has shape \(2, 2\), but this model needs \(3, 2\)", position=[[0, 1], [0, 1]])
    refused(r"joint 'yaw' is left no position: .* 3 to 2", position=[[3, 4], [-1, 1], [0, 0.5]])
    refused(r"sigma has shape \(1,\)", sigma=[1.0])
    refused(r"sigma of joint 'slide' is 0\.0", sigma=[1.0, 1.0, 0.0])
    refused(r"period is 0\.0; it must be positive", period=0.0)
    refused(r"harmonics is 0; it must be a whole number of at least 2", harmonics=0)
    refused(r"harmonics is 1; .* starts at rest", harmonics=1)
    refused(r"starts is 0; it must be a whole number of at least 1", starts=0)
    refused(r"max_steps is -1; it must be a whole number of at least 0", max_steps=-1)
    refused(r"margin is 1\.0; it must be at least 0 and less than 1", margin=1.0)
    with pytest.raises(ValueError, match=r"objective is 'trace'; use 'log det' or 'condition number'"):
        module._check_options("trace", "length", 1, 1, 0.0)
    with pytest.raises(ValueError, match=r"scaling is 'unit'; use 'length' or 'nominal'"):
        module._check_options("log det", "unit", 1, 1, 0.0)
    refused(r"nominal size of .* is zero", scaling="nominal")
    refused(r"no unknown that forces are linear in is named 'mass'", kj.UnknownNameError, unknowns=("inertia", "mass"))
    refused(r"name at least one of inertia, .* and each once", unknowns=("inertia", "inertia"))
    endless = model.replace(joint_range=[[-1, 1], [-np.inf, np.inf], [0, 1]])
    refused(r"joint 'pitch' has no limit at all", of=endless, speed=None, acceleration=None, torque=None)
    refused(r"joint 'pitch' has a position limit on one side only", of=model.replace(joint_range=[[-1, 1], [0, np.inf], [0, 1]]))


def test_refuses_joints_of_several_coordinates_and_none():
    ball = '<body name="bob"><joint name="hip" type="ball"/><geom size="0.1" mass="1"/></body>'
    fixed = '<body name="post"><geom size="0.1" mass="1"/></body>'
    with pytest.raises(kj.UnsupportedModelError, match=r"joint 'hip' is ball; .* one coordinate each"):
        excitation(kj.load(f"<mujoco><worldbody>{ball}</worldbody></mujoco>"), period=1.0, speed=1.0)
    with pytest.raises(ValueError, match="the model has no joints that could move"):
        excitation(kj.load(f"<mujoco><worldbody>{fixed}</worldbody></mujoco>"), period=1.0, speed=1.0)


def test_information_refuses_wrong_states(model):
    good = np.zeros((5, 3))
    with pytest.raises(ValueError, match=r"u has shape \(5, 2\), but this model needs \(samples, 3\)"):
        motion_information(model, good, good[:, 1:], good)
    with pytest.raises(ValueError, match=r"q, u and u_dot have 5, 5, 4 rows"):
        motion_information(model, good, good, good[1:])
    with pytest.raises(ValueError, match=r"q\[0\] of joint 'pitch' is nan"):
        motion_information(model, good * [0, np.nan, 0], good, good)


# The file for the robot


def test_csv_comes_back(model, design, tmp_path):
    path, start = tmp_path / "motion.csv", [0.1, -0.3, 0.2]
    write_csv(design.motion, path, rate=50.0, periods=2, start=start, blend=2.0, model=model)
    header = path.read_text().splitlines()[0].split(",")
    quantities = ("position", "velocity", "acceleration", "effort")
    names = [f"{name}_{joint}" for name in quantities for joint in ("yaw", "pitch", "slide")]
    assert header == ["time", *names]
    data = np.genfromtxt(path, delimiter=",", skip_header=1)
    assert len(data) == 50 * 16 + 1
    np.testing.assert_array_equal(data[:, 0], np.arange(801) / 50)
    q, u, u_dot, tau = (data[:, i : i + 3] for i in (1, 4, 7, 10))
    ts = np.arange(601) / 50
    for found, expected in zip((q, u, u_dot), evaluated(design.motion, ts), strict=True):
        np.testing.assert_allclose(found[100:701], expected, atol=1e-11)
    for row in (0, -1):
        np.testing.assert_array_equal(q[row], start)
        np.testing.assert_array_equal(np.stack((u[row], u_dot[row])), 0)
    expected = jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0))(model, *(jnp.asarray(x) for x in (q, u, u_dot)))
    np.testing.assert_allclose(tau, expected, rtol=1e-9, atol=1e-9)
    columns = Columns(velocity="velocity_{joint}", acceleration="acceleration_{joint}")
    log = read_log(path, model.tree.joint_names, columns=columns)
    np.testing.assert_array_equal(log.runs[0].q, q)
    np.testing.assert_array_equal(log.runs[0].effort, tau)


def test_ways_to_and_from_a_motion_are_smooth():
    """Also to one that does not start at rest: speeds and accelerations are derivatives, without jumps."""
    motion, rate = motion_of(4), 400.0
    table = motion_table(motion, rate, start=[0.5, 0.0, -1.0], blend=1.5)
    for value, derivative in ((table.q, table.u), (table.u, table.u_dot)):
        differences = (value[2:] - value[:-2]) * (rate / 2)
        np.testing.assert_allclose(differences, derivative[1:-1], atol=1e-2 * np.abs(derivative).max())
    assert np.abs(np.diff(table.u_dot, axis=0)).max() < 0.05 * np.abs(table.u_dot).max()
    with pytest.raises(ValueError, match=r"the motion starts with speed .* of joint 'yaw'; give start and blend"):
        motion_table(motion, rate)


def test_table_refuses_what_makes_no_sense(model, design, tmp_path):
    motion = design.motion
    with pytest.raises(ValueError, match="give both for a way from rest to the motion, or none"):
        motion_table(motion, 100.0, blend=1.0)
    with pytest.raises(ValueError, match=r"periods \* period is 6\.0 s, 4\.2 samples at 0\.7 Hz"):
        motion_table(motion, 0.7)
    with pytest.raises(ValueError, match=r"rate is 0\.0; it must be positive"):
        motion_table(motion, 0.0)
    with pytest.raises(ValueError, match=r"periods is 0; it must be a whole number of at least 1"):
        motion_table(motion, 100.0, periods=0)
    with pytest.raises(ValueError, match=r"start has shape \(2,\), but this motion needs \(3,\)"):
        motion_table(motion, 100.0, start=[0, 0], blend=1.0)
    other = FourierMotion(("a", "b", "c"), motion.period, motion.offset, motion.a, motion.b)
    with pytest.raises(ValueError, match=r"the model's joints are yaw, pitch, slide, the motion's a, b, c"):
        write_csv(other, tmp_path / "motion.csv", rate=100.0, model=model)
