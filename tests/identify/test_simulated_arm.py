"""The simulated study, with few recordings: that it measures what it says."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.identification import simulated_arm
from experiments.identification.simulated_arm_picture import Errors, Masses, Shown, Values, picture
from kanejax import identify

RUNS = 3


@functools.cache
def study() -> simulated_arm.Study:
    return simulated_arm.study()


@functools.cache
def white() -> Errors:
    return simulated_arm.errors(study(), RUNS)


def test_motion_is_within_the_limits():
    arm, exact = study().arm, study().exact
    q, u, effort = (np.asarray(x) for x in (exact.q, exact.u, exact.effort))
    low, high = np.asarray(arm.model.joint_range).T
    assert np.all((low < q) & (q < high))
    assert np.all(np.abs(u) < arm.speed)
    assert np.all(np.abs(effort) < arm.torque)


def test_nominal_arm_is_wrong_by_10_to_30_percent():
    truth, nominal = study().truth.model, study().nominal
    rows = np.array([nominal.tree.body(name) for name in simulated_arm.LINKS])
    for leaf in ("mass", "com", "central_inertia"):
        true, said = np.asarray(getattr(truth, leaf))[rows], np.asarray(getattr(nominal, leaf))[rows]
        there = true != 0
        wrong = np.abs(said[there] / true[there] - 1.0)
        assert np.all((wrong > 0.0999) & (wrong < 0.3001))


def test_recordings_have_the_noise_that_is_said():
    exact = study().exact
    size = simulated_arm.TORQUE_NOISE * np.sqrt(np.mean(np.asarray(exact.effort) ** 2, 0))
    for correlation in (0.0, 0.9):
        run = simulated_arm.recording(study(), 1, correlation).runs[0]
        noise = (run.effort - np.asarray(exact.effort)) / size
        assert noise.std(0) == pytest.approx(1.0, abs=0.35 if correlation else 0.08)
        assert np.mean(noise[1:] * noise[:-1]) / np.mean(noise**2) == pytest.approx(correlation, abs=0.05)
        assert (run.q - np.asarray(exact.q)).std() == pytest.approx(1e-4, rel=0.05)
        assert run.u is None


def test_estimates_are_what_identify_returns():
    options = {"cutoff": simulated_arm.CUTOFF}
    recording, unknowns = simulated_arm.recording(study(), 0), study().sought.unknowns
    found = identify(study().nominal, recording, unknowns, friction_width=None, motion_options=options)
    assert found.base.value == pytest.approx(study().value + white().fit[0], rel=1e-6, abs=1e-9)
    assert found.base.std == pytest.approx(white().fit_std[0], rel=1e-3)


def test_errors_are_as_large_as_their_standard_deviations():
    for error, std in ((white().linear, white().std), (white().linear, white().white), (white().fit, white().fit_std)):
        assert 0.5 < np.sqrt(np.mean((error / std) ** 2)) < 1.3


def test_coloured_noise_makes_intervals_for_white_noise_too_narrow():
    coloured = simulated_arm.errors(study(), RUNS, correlation=0.9, fitted=False)
    assert np.sqrt(np.mean((coloured.linear / coloured.std) ** 2)) < 1.3
    assert np.sqrt(np.mean((coloured.linear / coloured.white) ** 2)) > 2.0


def test_exact_data_give_exact_base_parameters():
    _, worst = simulated_arm.exactness(study())
    assert worst["linear"] < 1e-8
    assert worst["fit"] < 1e-8


def test_masses_of_the_outer_links_are_found():
    found = simulated_arm.masses(study(), RUNS)
    assert np.abs(found.errors[:, 2:]).mean() < 0.02
    assert np.all(np.median(found.std, axis=0)[2:] < simulated_arm.WORST)


@pytest.mark.parametrize(
    ("shift", "size", "unbiased", "covered"), [(0, 1, True, True), (0.5, 1, False, False), (0, 1.5, True, False)]
)
def test_verdicts(shift: float, size: float, unbiased: bool, covered: bool):
    error = shift + size * np.random.default_rng(0).normal(size=(200, 64))
    assert simulated_arm.bias("these", error, expected=True)[0].holds is unbiased
    claim, numbers = simulated_arm.coverage("these", error, np.ones_like(error), (0.93, 0.97))
    assert claim.holds is covered
    assert len(numbers["each"]) == 64


def test_random_starts_are_physical():
    least = jax.vmap(lambda theta: jnp.min(simulated_arm.smallest_eigenvalues(study(), theta)))
    assert np.all(np.asarray(least(study().sought.starts(jax.random.key(1), 20))) > 0)


def test_picture(tmp_path):
    masses = Masses(simulated_arm.LINKS, np.random.default_rng(0).normal(size=(RUNS, 7)), np.ones((RUNS, 7)))
    values = Values(study().value, study().value, study().value, white().std[0])
    figure = picture(Shown(study().base), white(), white(), values, masses)
    figure.savefig(tmp_path / "picture.png", dpi=40)
    assert (tmp_path / "picture.png").stat().st_size > 10_000
