"""Pseudo-inertias, log-Cholesky coordinates and divergences, against numpy, scipy and MuJoCo."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from helpers.mechanisms import random_tree, relative

import kanejax as kj
from kanejax._parameters.matrix_logarithm import _second_difference, matrix_logarithm
from kanejax._parameters.nominal_body import Size, default_size, nominal_body
from kanejax._parameters.pseudo_inertia import (
    consistency,
    entropic_residuals,
    geodesic_residuals,
    inertia_parameters_of,
    matrix_from_coordinates,
    nearest_coordinates,
    pseudo_inertia,
    upper_triangle,
)

DTYPES = pytest.mark.parametrize(("dtype", "tolerance"), [(jnp.float64, 1e-10), (jnp.float32, 1e-4)])
SIZE = Size(0.5, 0.1)


def bodies(count: int, seed: int = 0) -> np.ndarray:
    """Inertia parameters of clouds of points."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(count):
        m, r = rng.uniform(0.1, 1, 8), rng.normal(size=(8, 3)) * [0.3, 0.1, 0.2] + rng.normal(size=3) * 0.3
        second = (r.T * m) @ r
        inertia = np.trace(second) * np.eye(3) - second
        rows.append([m.sum(), *(m @ r), *np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]])
    return np.array(rows)


def pseudo_inertia_by_hand(p: np.ndarray) -> np.ndarray:
    inertia = np.array([[p[4], p[7], p[8]], [p[7], p[5], p[9]], [p[8], p[9], p[6]]])
    second = np.trace(inertia) / 2 * np.eye(3) - inertia
    return np.block([[second, p[1:4, None]], [p[None, 1:4], p[:1, None]]])


def factors(parameters: np.ndarray) -> np.ndarray:
    """Upper triangular factors, by an RQ decomposition of the symmetric root."""
    result = []
    for p in parameters:
        upper = scipy.linalg.rq(np.real(scipy.linalg.sqrtm(pseudo_inertia_by_hand(p))))[0]
        result.append(upper * np.sign(np.diag(upper)))
    return np.array(result)


def coordinates(count: int, spread: float = 1.0, seed: int = 1) -> np.ndarray:
    return spread * np.random.default_rng(seed).normal(size=(count, 10))


@DTYPES
def test_pseudo_inertias(dtype, tolerance):
    parameters = bodies(5)
    matrices = pseudo_inertia(jnp.asarray(parameters, dtype))
    assert matrices.dtype == dtype
    assert relative(matrices, [pseudo_inertia_by_hand(p) for p in parameters]) < tolerance
    assert relative(inertia_parameters_of(matrices), parameters) < tolerance
    assert relative(pseudo_inertia(jnp.asarray(parameters[0], dtype)), matrices[0]) < tolerance


def test_all_coordinates_are_bodies_that_exist():
    """Of a thousand, by numpy's eigenvalues of the pseudo-inertia, of the central inertia, and their triangle inequality."""
    factor = factors(bodies(10)).repeat(100, 0)
    matrices = matrix_from_coordinates(jnp.asarray(coordinates(1000)), jnp.asarray(factor))
    assert (np.linalg.eigvalsh(matrices)[:, 0] > 0).all()
    for p in np.asarray(inertia_parameters_of(matrices)):
        com = p[1:4] / p[0]
        inertia = np.array([[p[4], p[7], p[8]], [p[7], p[5], p[9]], [p[8], p[9], p[6]]])
        moments = np.linalg.eigvalsh(inertia - p[0] * (com @ com * np.eye(3) - np.outer(com, com)))
        assert p[0] > 0
        assert moments[0] > 0
        assert moments[0] + moments[1] > moments[2]


def test_mujoco_accepts_the_bodies():
    """Without balancing: it compiles to the same numbers."""
    model = kj.load(random_tree(1, 6))
    factor = jnp.asarray(factors(np.asarray(kj.inertia_parameters(model))))
    for seed in range(3):
        matrices = matrix_from_coordinates(jnp.asarray(coordinates(6, 0.7, seed)), factor)
        changed = kj.with_inertia_parameters(model, inertia_parameters_of(matrices))
        mj = kj.to_mujoco(changed).compile()
        assert relative(mj.body_mass[1:], changed.mass) < 1e-12
        assert relative(kj.inertia_parameters(kj.from_mujoco(mj)), kj.inertia_parameters(changed)) < 1e-10


@DTYPES
def test_coordinates_round_trip(dtype, tolerance):
    factor, theta = jnp.asarray(factors(bodies(4)), dtype), jnp.asarray(coordinates(4, 0.5), dtype)
    matrices = matrix_from_coordinates(theta, factor)
    assert relative(nearest_coordinates(matrices, factor), theta) < 20 * tolerance
    nominal = matrix_from_coordinates(jnp.zeros_like(theta), factor)
    assert relative(nominal, [pseudo_inertia_by_hand(p) for p in bodies(4)]) < tolerance
    assert np.abs(nearest_coordinates(nominal, factor)).max() < 100 * tolerance


@DTYPES
def test_what_cannot_exist_gets_the_nearest_coordinates(dtype, tolerance):
    """Eigenvalues relative to the nominal body that are negative are raised; the others stay."""
    factor = factors(bodies(1))[0]
    basis = np.linalg.qr(np.random.default_rng(3).normal(size=(4, 4)))[0]
    matrix = factor @ basis @ np.diag([-0.5, 0.5, 1.0, 2.0]) @ basis.T @ factor.T
    theta = nearest_coordinates(jnp.asarray(matrix, dtype), jnp.asarray(factor, dtype))
    found = np.asarray(matrix_from_coordinates(theta.astype(jnp.float64), jnp.asarray(factor)))
    np.testing.assert_allclose(scipy.linalg.eigvals(found, factor @ factor.T).real.min(), 1e-6, rtol=0, atol=20 * tolerance)
    kept = factor @ basis @ np.diag([1e-6, 0.5, 1.0, 2.0]) @ basis.T @ factor.T
    assert relative(found, kept) < 20 * tolerance


def test_nearest_coordinates_have_derivatives_also_at_the_nominal_body():
    factor = jnp.asarray(factors(bodies(1))[0])
    for theta in (jnp.zeros(10), jnp.asarray(coordinates(1, 0.3)[0])):
        there_and_back = jax.jacfwd(lambda x: nearest_coordinates(matrix_from_coordinates(x, factor), factor))(theta)
        np.testing.assert_allclose(there_and_back, np.eye(10), rtol=0, atol=1e-9)
    # Two equal eigenvalues are raised, and the raised ones stay as they are.
    basis = jnp.asarray(np.linalg.qr(np.random.default_rng(3).normal(size=(4, 4)))[0])
    outside = factor @ basis @ jnp.diag(jnp.array([-0.5, -0.5, 1.0, 2.0])) @ basis.T @ factor.T
    direction = factor @ pseudo_inertia(jnp.asarray(coordinates(1)[0])) @ factor.T

    def raised(step: float) -> jax.Array:
        return matrix_from_coordinates(nearest_coordinates(outside + step * direction, factor), factor)

    slope, h = jax.jacfwd(raised)(0.0), 1e-5
    assert relative(slope, (raised(h) - raised(-h)) / (2 * h)) < 1e-6


@DTYPES
def test_entropic_residuals(dtype, tolerance):
    theta = np.concatenate((coordinates(5), coordinates(5, 1e-3), coordinates(5, 3.0)))
    squares = np.sum(np.asarray(entropic_residuals(jnp.asarray(theta, dtype)), float) ** 2, -1)
    for row, square in zip(theta, squares, strict=True):
        u = np.asarray(upper_triangle(jnp.asarray(row), 4))
        # The direct formula loses digits for small changes, so compare with that relative to the terms it is made of.
        direct = np.trace(u @ u.T) - np.log(np.linalg.det(u @ u.T)) - 4
        assert abs(square - direct) < tolerance * (square + 1e-5 * np.trace(u @ u.T))


@pytest.mark.parametrize("residuals", [entropic_residuals, geodesic_residuals])
def test_divergences_do_not_depend_on_the_frame(residuals):
    """From the bodies themselves, moved and measured in other units."""
    nominal, other = (pseudo_inertia_by_hand(bodies(1, seed)[0]) for seed in (1, 2))
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = 30.0 * np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0], [1, 2, 3]
    sizes = []
    for frame in (np.eye(4), move):
        upper = np.linalg.cholesky((frame @ nominal @ frame.T)[::-1, ::-1])[::-1, ::-1]
        theta = nearest_coordinates(jnp.asarray(frame @ other @ frame.T), jnp.asarray(upper))
        sizes.append(float(np.sum(residuals(theta) ** 2)))
    assert relative(sizes[1], sizes[0]) < 1e-8
    values = scipy.linalg.eigvals(np.linalg.solve(nominal, other)).real
    entropic = residuals is entropic_residuals
    expected = np.sum(values - np.log(values) - 1) if entropic else 0.5 * np.sum(np.log(values) ** 2)
    assert relative(sizes[0], expected) < 1e-9


@DTYPES
def test_geodesic_residuals(dtype, tolerance):
    for theta in np.concatenate((coordinates(5), coordinates(5, 1e-3))):
        u = np.asarray(upper_triangle(jnp.asarray(theta), 4))
        logarithm = np.real(scipy.linalg.logm(u @ u.T))
        residuals = geodesic_residuals(jnp.asarray(theta, dtype))
        distance, expected = np.linalg.norm(np.asarray(residuals, float)), np.linalg.norm(logarithm) / np.sqrt(2)
        assert abs(distance - expected) < tolerance * max(1.0, expected)
        assert residuals.dtype == dtype


def test_residuals_are_zero_and_like_each_other_at_the_nominal_body():
    """First and second derivatives there: twice the squares of the logarithms, once those of the other coordinates."""
    weight = np.diag([4.0] * 4 + [2.0] * 6)
    for residuals in (entropic_residuals, geodesic_residuals):
        np.testing.assert_allclose(residuals(jnp.zeros(10)), 0.0, rtol=0, atol=1e-15)
        square = lambda theta, residuals=residuals: jnp.sum(residuals(theta) ** 2)  # noqa: E731
        np.testing.assert_allclose(jax.grad(square)(jnp.zeros(10)), 0.0, rtol=0, atol=1e-14)
        for hessian in (jax.hessian(square), jax.jacrev(jax.jacrev(square))):
            np.testing.assert_allclose(jax.jit(hessian)(jnp.zeros(10)), weight, rtol=0, atol=1e-12)


EQUAL = {"nominal": np.zeros(10), "scaled": np.array([0.3] * 4 + [0.0] * 6), "pairs": np.array([0.2, 0.2, -0.4, -0.4] + [0.0] * 6)}
EQUAL |= {"nearly": 1e-4 * coordinates(1)[0], "random": coordinates(1, 0.7)[0], "close": EQUAL["pairs"] + 3e-3 * coordinates(1)[0]}


@pytest.mark.parametrize("name", EQUAL)
@pytest.mark.parametrize("residuals", [entropic_residuals, geodesic_residuals])
def test_derivatives_of_residuals_agree_with_differences(residuals, name):
    theta, direction = jnp.asarray(EQUAL[name]), jnp.asarray(coordinates(1, seed=5)[0])

    def along(step: float) -> np.ndarray:
        return np.asarray(residuals(theta + step * direction))

    slope = jax.jvp(residuals, (theta,), (direction,))[1]
    h = 1e-4
    difference = (8 * (along(h) - along(-h)) - (along(2 * h) - along(-2 * h))) / (12 * h)
    assert relative(slope, difference) < 1e-9
    np.testing.assert_allclose(jax.jacrev(residuals)(theta) @ direction, slope, rtol=0, atol=1e-11)
    rate = lambda theta: jax.jvp(residuals, (theta,), (direction,))[1]  # noqa: E731
    bend = jax.jvp(rate, (theta,), (direction,))[1]
    second = (np.asarray(rate(theta + h * direction)) - np.asarray(rate(theta - h * direction))) / (2 * h)
    assert relative(bend, second) < 1e-5 * (1 + np.abs(slope).max() / np.abs(second).max())


@pytest.mark.parametrize("spread", [0.5, 0.02, 0.009, 0.004, 1e-3])
def test_second_divided_differences_of_the_logarithm(spread):
    """Against the formula in extended precision."""
    a, b, c = (np.longdouble(x) for x in (3.0, 3.0 + 0.3 * spread, 3.0 + 3.0 * spread))
    slopes = [(np.log(x) - np.log(y)) / (x - y) for x, y in ((c, b), (b, a))]
    expected = float((slopes[0] - slopes[1]) / (c - a))
    for x, y, z in ((a, b, c), (c, a, b), (b, c, a)):
        assert relative(_second_difference(*(jnp.asarray(float(value)) for value in (x, y, z))), expected) < 1e-11
    np.testing.assert_allclose(_second_difference(*jnp.full(3, 3.0)), -0.5 / 9.0, rtol=1e-15)


def test_logarithm_far_from_one_and_of_the_smallest_in_single_precision():
    theta = jnp.asarray([6.0, -6.0, 3.0, 0.0, *np.zeros(6)])
    u = upper_triangle(theta, 4)
    np.testing.assert_allclose(np.diag(matrix_logarithm(u @ u.T)), 2 * theta[:4], rtol=0, atol=1e-8)
    wide = jnp.asarray([9.0, -9.0, 0.0, 0.0, *np.ones(6)], jnp.float32)
    assert np.isfinite(jax.jacfwd(geodesic_residuals)(wide)).all()


def test_consistency():
    parameters = bodies(3)
    expected = [np.linalg.eigvalsh(p)[0] / np.trace(p) for p in map(pseudo_inertia_by_hand, parameters)]
    np.testing.assert_allclose(consistency(jnp.asarray(parameters)), expected, rtol=1e-9)
    broken = parameters[0] - np.eye(10)[4] * parameters[0, 4]
    assert consistency(jnp.asarray(broken)) < 0
    assert consistency(jnp.zeros(10)) == 0


def test_bodies_that_can_exist_are_nominal_as_they_are():
    inertia, com = np.diag([0.02, 0.03, 0.04]), np.array([0.1, 0.2, 0.3])
    body = nominal_body(2.0, com, inertia, SIZE)
    assert body.changes == ()
    parameters = inertia_parameters_of(jnp.asarray(body.factor @ body.factor.T))
    shift = 2.0 * (com @ com * np.eye(3) - np.outer(com, com)) + inertia
    expected = [2.0, *(2 * com), *np.diag(shift), shift[0, 1], shift[0, 2], shift[1, 2]]
    np.testing.assert_allclose(parameters, expected, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(body.factor, np.triu(body.factor))


@pytest.mark.parametrize(
    ("mass", "moments", "says"),
    [
        (0.0, (0.0, 0.0, 0.0), ("a mass of 0.5 kg in place of 0 kg", "ball with a radius of gyration of 0.1 m")),
        (2.0, (0.0, 0.0, 0.0), ("ball with a radius of gyration of 0.1 m",)),
        (-1.0, (0.1, 0.1, 0.1), ("a mass of 0.5 kg in place of -1 kg",)),
        (2.0, (0.1, 0.1, 0.0), ("second moments of at least 0.0001 of the largest",)),
        (2.0, (0.1, 0.1, 0.3), ("second moments of at least 0.0001 of the largest",)),
    ],
    ids=["massless", "point", "negative", "rod", "triangle"],
)
def test_the_nearest_body_stands_in_for_others(mass, moments, says):
    axes = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    com, inertia = np.array([0.1, 0.0, -0.2]), axes @ np.diag(moments) @ axes.T
    body = nominal_body(mass, com, inertia, SIZE)
    assert len(body.changes) == len(says)
    assert all(part in change for part, change in zip(says, body.changes, strict=True))
    matrix = body.factor @ body.factor.T
    assert np.linalg.eigvalsh(matrix)[0] > 0
    used = mass if mass > 0 else SIZE.mass
    np.testing.assert_allclose(matrix[3], [*(used * com), used], rtol=1e-14)
    second = matrix[:3, :3] - used * np.outer(com, com)
    given = np.sum(moments) / 2 - np.array(moments)
    expected = np.full(3, used * SIZE.radius**2 / 2) if not any(moments) else np.maximum(given, 1e-4 * given.max())
    np.testing.assert_allclose(second, axes @ np.diag(expected) @ axes.T, rtol=0, atol=1e-14)


def test_default_sizes_come_from_the_other_bodies():
    model = kj.load(random_tree(1, 3))
    model = model.replace(mass=[0.0, 2.0, 4.0], central_inertia=np.eye(3)[None] * np.array([0, 2, 16])[:, None, None])
    np.testing.assert_allclose(default_size(model), (0.01 * 3.0, 0.1 * 1.5), rtol=1e-14)
    np.testing.assert_allclose(default_size(model.replace(mass=np.zeros(3))), (0.01, 0.01), rtol=1e-14)
