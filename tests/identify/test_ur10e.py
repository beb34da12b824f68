"""A real UR10e: the experiment's protocol, its baselines, and what the library makes of the same data."""

import os
import pathlib

import numpy as np
import pytest

import kanejax as kj
from experiments.identification import ur10e

FOLDER = pathlib.Path(os.environ.get("KANEJAX_DATA", pathlib.Path(__file__).parents[2].parent / "shared/data")) / "ur10e"
FILES = ("ur10e.urdf", ur10e.TRAINING.file, *(recording.file for recording in ur10e.HELD_OUT.values()))
needs_data = pytest.mark.skipif(
    not all((FOLDER / name).is_file() for name in FILES),
    reason=f"{FOLDER} lacks recordings from {ur10e.SOURCE}: NOTHING was tried on a real robot (set KANEJAX_DATA)",
)


@pytest.fixture(scope="module")
def found():
    return ur10e.identified(FOLDER, ur10e.REFERENCE)


@needs_data
def test_the_real_robot_is_predicted_better_than_by_the_baselines(found):
    assert found.converged
    errors = np.array(ur10e.errors(found)[ur10e.POINT_TO_POINT])
    for method in ("ordinary least squares", "weighted least squares", "SDP, consistent", "nominal inertias, friction fitted"):
        assert np.all(errors[:-1] < np.array(ur10e.BASELINES[method])[:-1]), method
    # No friction model, no torque: the URDF alone leaves nearly all of what the first joint's and the wrist's motors do.
    (nominal, *_) = (100 * kj.relative_error(run, run.nominal) for run in found.validation)
    assert np.all(nominal > 2 * errors)


@needs_data
def test_the_real_robot_is_physical(found):
    for name, mass, eigenvalue in zip(found.model.tree.body_names, found.model.mass, found.consistency, strict=True):
        assert (mass > 0 and eigenvalue > 0) or name in ("ee_link", "tool0", "base")
    assert np.all(found.model.damping > 0)
    assert np.all(found.model.coulomb_friction > 0)
    assert len(found.base.formulas) == 58


@needs_data
def test_the_baselines_are_reproduced():
    for method, runs in ur10e.least_squares(FOLDER).items():
        np.testing.assert_allclose(runs[ur10e.POINT_TO_POINT], ur10e.BASELINES[method], atol=0.06)


def test_absent_recordings_are_told_of(monkeypatch, tmp_path):
    monkeypatch.setenv("KANEJAX_DATA", str(tmp_path))
    with pytest.raises(
        SystemExit, match=r"lacks ur10e.urdf, ur-20_02_10.*github.com/shamilmamedov/dynamic_calibration.*KANEJAX_DATA"
    ):
        ur10e.run(quick=True)
