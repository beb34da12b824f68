"""What is drawn for a trajectory: it belongs to the trajectory, follows its distribution, and fits the model."""

import dataclasses

import jax
import numpy as np
import pytest
from scipy import stats

import kanejax as kj
from kanejax import distributions
from kanejax._dataset.random_numbers import uniform_numbers
from tests.helpers.mechanisms import random_tree

TS = np.linspace(0.0, 1.0, 3)


@pytest.fixture(scope="module")
def arm():
    return kj.robots.intelledex_605()


def study(model, **fields):
    return kj.Study(model, TS, 1000, **fields)


def test_a_row_of_numbers_belongs_to_its_trajectory():
    for width in (1, 4, 6, 9):
        together = uniform_numbers(3, "q0", 0, 50, width)
        assert together.shape == (50, width)
        np.testing.assert_array_equal(uniform_numbers(3, "q0", 17, 5, width), together[17:22])
    numbers = uniform_numbers(3, "q0", 0, 20000, 3)
    assert 0 < numbers.min() < numbers.max() < 1
    assert stats.kstest(numbers.ravel(), "uniform").pvalue > 1e-3
    for other in (uniform_numbers(4, "q0", 0, 20000, 3), uniform_numbers(3, "u0", 0, 20000, 3)):
        assert abs(np.corrcoef(numbers.ravel(), other.ravel())[0, 1]) < 0.02
    assert np.abs(np.corrcoef(numbers.T) - np.eye(3)).max() < 0.03


@pytest.mark.parametrize(
    ("distribution", "expected"),
    [
        (distributions.Uniform(-1.0, 3.0), stats.uniform(-1, 4)),
        (distributions.LogUniform(0.1, 10.0), stats.loguniform(0.1, 10)),
        (distributions.Normal(2.0, 0.5), stats.norm(2, 0.5)),
        (distributions.LogNormal(2.0, 0.3), stats.lognorm(0.3, scale=2)),
    ],
)
def test_distributions(distribution, expected):
    values = distribution.of(uniform_numbers(0, "x", 0, 5000, 2))
    assert stats.kstest(values.ravel(), expected.cdf).pvalue > 1e-3
    assert values.min() >= distribution.least


def test_draws_do_not_depend_on_what_is_drawn_together(arm):
    made = study(
        arm,
        parameters={"density": kj.Randomized(), "damping": kj.Randomized(distributions.Uniform(0.0, 0.5), "added")},
        control=kj.RandomForces(distributions.Normal(0.0, 5.0), 0.3),
    )
    together, some = made.rows(0, 40), made.rows(13, 7)
    for part, whole in zip(jax.tree.leaves(some), jax.tree.leaves(together), strict=True):
        np.testing.assert_array_equal(part, whole[13:20])
    assert not np.any(dataclasses.replace(made, seed=1).rows(0, 40).q0 == together.q0)


def test_leaves_are_randomised_as_a_body_can_be(arm):
    rows = study(arm, parameters={"density": kj.Randomized(distributions.LogUniform(0.5, 2.0))}).rows(0, 200)
    factors = rows.leaves["mass"] / np.asarray(arm.mass)
    assert 0.5 <= factors.min() < 0.6 < 1.8 < factors.max() <= 2.0
    np.testing.assert_allclose(
        rows.leaves["central_inertia"], factors[..., None, None] * np.asarray(arm.central_inertia), rtol=1e-14
    )
    added = study(arm, parameters={"com": kj.Randomized(distributions.Normal(0.0, 0.01), "added")}).rows(0, 200).leaves["com"]
    assert np.std(added - np.asarray(arm.com)) == pytest.approx(0.01, rel=0.05)


def test_mass_and_density_together_are_both_applied(arm):
    half = kj.Randomized(distributions.Fixed(0.5))
    rows = study(arm, parameters={"density": half, "mass": half}).rows(0, 2)
    np.testing.assert_allclose(rows.leaves["mass"], 0.25 * np.broadcast_to(arm.mass, (2, arm.nbody)))
    np.testing.assert_allclose(rows.leaves["central_inertia"][0], 0.5 * np.asarray(arm.central_inertia))


def test_coordinates_lie_within_ranges_and_quaternions_are_uniform():
    model = kj.load(random_tree(2, 4, ("ball", "hinge", "free")))
    q = study(model).rows(0, 1000).q0
    for start, kind in zip(model.tree.q_start, model.tree.joint_types, strict=True):
        if kind in ("ball", "free"):
            turn = q[:, start + 3 :][:, :4] if kind == "free" else q[:, start : start + 4]
            np.testing.assert_allclose(np.linalg.norm(turn, axis=1), 1, rtol=1e-12)
            assert np.abs(turn.T @ turn / len(turn) - np.eye(4) / 4).max() < 0.04


def test_data_type_is_the_models(arm):
    double, single = study(arm).rows(0, 3), study(arm.astype("float32")).rows(0, 3)
    assert single.q0.dtype == single.u0.dtype == np.float32
    np.testing.assert_array_equal(double.q0.astype(np.float32), single.q0)


def test_states_and_forces_can_be_given(arm):
    random = np.random.default_rng(0)
    q, u, tau = random.normal(size=(5, 6)), random.normal(size=(5, 6)), random.normal(size=(5, 3, 6))
    made = kj.Study(arm, TS, 5, q0=q, u0=u, control=kj.GivenForces(TS, tau))
    rows = made.rows(2, 2)
    for found, given in ((rows.q0, q), (rows.u0, u), (rows.forces, tau)):
        np.testing.assert_array_equal(found, given[2:4])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"parameters": {"mass": kj.Randomized(distributions.Normal(1.0, 0.1))}}, "mass must not become negative"),
        ({"parameters": {"damping": kj.Randomized(distributions.Uniform(-1.0, 1.0), "added")}}, "damping must not become negative"),
        ({"parameters": {"weight": kj.Randomized()}}, "no leaf 'weight' to randomise; the names are: density, gravity"),
        ({"parameters": {"density": kj.Randomized(how="added")}}, "cannot be added"),
        ({"u0": distributions.Normal(0.0, [1.0, 2.0])}, "u0's distribution, .* is for 6 numbers"),
        ({"q0": np.zeros((3, 6))}, r"q0 has shape \(3, 6\), but this study needs \(1000, 6\)"),
        ({"control": kj.RandomForces(distributions.Normal(), 0.0)}, "period of the forces is 0.0"),
        ({"control": kj.GivenForces(TS, np.zeros((1000, 2, 6)))}, "the forces has shape"),
        ({"options": {"throw": True}}, "no option throw; the options are: solver"),
    ],
)
def test_what_does_not_fit_is_refused(arm, fields, message):
    with pytest.raises(ValueError, match=message):
        study(arm, **fields)


def test_quaternions_are_not_drawn_number_by_number():
    with pytest.raises(ValueError, match="is a quaternion, which is not drawn"):
        study(kj.load(random_tree(2, 1, ("ball",))), q0=distributions.Normal())


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: distributions.Uniform(1.0, 0.0), "low must not be greater"),
        (lambda: distributions.LogUniform(0.0, 1.0), "low must be positive"),
        (lambda: distributions.Normal(0.0, -1.0), "must not be negative"),
        (lambda: distributions.LogNormal(0.0, 1.0), "must be positive"),
    ],
)
def test_distributions_refuse_what_has_no_meaning(made, message):
    with pytest.raises(ValueError, match=message):
        made()
