"""AUTOTF's motion and torques, and the file of numbers that every experiment writes."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.thesis import autotf, record
from experiments.thesis.__main__ import attempt, found, headline
from experiments.thesis.motion import DURATION, motion, motions


def test_motion_is_that_of_the_program():
    """Against AUTOTF's subroutine GCRO, line by line."""
    t, span = np.linspace(0, DURATION, 9), DURATION
    angle = t - span * np.sin(2 * np.pi * t / span) / (2 * np.pi)
    q, u, u_dot = motions(jnp.asarray(t))
    np.testing.assert_allclose(q[:, 0], angle * np.pi / (3 * span), atol=1e-15)
    np.testing.assert_allclose(q[:, 1], np.pi / 2 - angle * np.pi / (6 * span), atol=1e-15)
    np.testing.assert_allclose(u[:, 3], np.pi * (1 - np.cos(2 * np.pi * t / span)) / (span * 3), atol=1e-15)
    np.testing.assert_allclose(u_dot[:, 1], -(np.pi**2) / (3 * span**2) * np.sin(2 * np.pi * t / span), atol=1e-15)
    np.testing.assert_array_equal(q[:, 5], q[:, 0])


def test_speeds_are_rates():
    t = jnp.asarray(0.73)
    _, rate = jax.jvp(motion, (t,), (jnp.ones_like(t),))
    np.testing.assert_allclose(rate.q, motion(t).u, atol=1e-15)
    np.testing.assert_allclose(rate.u, motion(t).u_dot, atol=1e-14)


def test_torques(tmp_path):
    numbers = autotf.run(tmp_path)
    assert numbers["largest_deviation_from_reference_Nm"] < 5.1e-9
    assert numbers["largest_deviation_from_explicit_equations_Nm"] < 1e-12
    np.testing.assert_allclose(numbers["least_torques_Nm"][2], -51.41806886, atol=1e-8)
    stored = json.loads((tmp_path / "autotf.json").read_text())
    assert stored["numbers"] == numbers
    assert {"experiment", "seed", "versions", "device"} <= set(stored)
    assert (tmp_path / "autotf.png").stat().st_size > 10_000


def test_a_wrong_torque_fails_the_experiment(tmp_path, monkeypatch):
    wrong = np.array(autotf.REFERENCE)
    wrong[1, 4] += 1e-6
    monkeypatch.setattr(autotf, "REFERENCE", wrong)
    with pytest.raises(AssertionError, match="the torques are the reference ones"):
        autotf.run(tmp_path)
    # The numbers are there to be looked at.
    assert (tmp_path / "autotf.json").exists()
    outcome = attempt("autotf", tmp_path)
    assert "does not hold" in outcome.error
    assert not attempt("motion_of_another_name", tmp_path).numbers


def test_record_refuses_what_is_not_a_number(tmp_path):
    with pytest.raises(ValueError, match="NaN or infinity in bad"):
        record.write(tmp_path, "name", {"good": 1.0, "bad": [float("nan")]})


def test_experiments_are_found():
    names = found()
    assert {"autotf", "autoq", "claims"} <= set(names)
    assert not {"motion", "record", "__main__"} & set(names)
    assert headline({"a_b": 1.5, "text": "no", "flag": True, "c": 2}) == "a b 1.5\nc 2"
