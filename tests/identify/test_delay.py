"""Delays of efforts, to a fraction of a sample."""

import numpy as np
import pytest

from kanejax._errors import LogError
from kanejax._logs.delay import estimated_delay
from kanejax._logs.motion import Motion

RATE = 200.0
TS = np.arange(0.0, 12.0, 1.0 / RATE)


def effort(t, slowest=0.1):
    """Three channels of harmonics, as excitations have them."""
    random = np.random.default_rng(1)
    k = np.arange(1, 9)
    a, b = random.normal(size=(2, 3, 8)) * 0.9**k
    phase = 2.0 * np.pi * slowest * k * np.asarray(t)[:, None, None]
    return np.sum(a * np.sin(phase) + b * np.cos(phase), axis=-1)


def motion(measured, **others):
    zero = np.zeros_like(measured)
    return Motion(TS, zero, zero, zero, measured, **others)


@pytest.mark.parametrize("delay", [0.0, 0.0137, -0.0262, 0.0951])
@pytest.mark.parametrize("slowest", [0.1, 1.0])
def test_known_delays(delay, slowest):
    # Another scale and offset, as of a model that is not fitted yet.
    made = motion(3.0 * effort(TS - delay, slowest) + 5.0)
    found = estimated_delay(made, effort(TS, slowest))
    np.testing.assert_allclose(found.channels, delay, atol=1e-6)
    assert found.common == pytest.approx(delay, abs=1e-6)


def test_noise_and_channels_that_tell_nothing():
    random = np.random.default_rng(2)
    measured = effort(TS - 0.0137) + 0.3 * random.normal(size=(len(TS), 3))
    measured[:, 1] = random.normal(size=len(TS))
    found = estimated_delay(motion(measured), effort(TS))
    assert np.isnan(found.channels[1])
    # The least standard deviation that is possible: of the noise over the root of the sum of the squared slopes.
    slopes = np.gradient(effort(TS), TS, axis=0)[:, [0, 2]]
    assert np.all(np.abs(found.channels[[0, 2]] - 0.0137) < 4.0 * 0.3 / np.sqrt(np.sum(slopes**2, axis=0)))
    assert abs(found.common - 0.0137) < 4.0 * 0.3 / np.sqrt(np.sum(slopes**2))
    assert min(found.channels[[0, 2]]) <= found.common <= max(found.channels[[0, 2]])


def test_of_the_minima_of_a_periodic_motion_the_nearest_counts():
    sine = np.sin(2.0 * np.pi * 12.5 * TS)[:, None]
    made = motion(np.sin(2.0 * np.pi * 12.5 * (TS - 0.0123))[:, None])
    assert estimated_delay(made, sine).common == pytest.approx(0.0123, abs=1e-4)
    made = motion(np.sin(2.0 * np.pi * 12.5 * (TS + 0.0321))[:, None])
    assert estimated_delay(made, sine).common == pytest.approx(-0.0321, abs=1e-4)


def test_samples_without_weight_do_not_count():
    measured, weight = effort(TS - 0.0137), np.ones((len(TS), 3))
    bad = np.random.default_rng(3).random(measured.shape) < 0.3
    measured[bad], weight[bad] = np.nan, 0.0
    assert estimated_delay(motion(measured, weight=weight), effort(TS)).common == pytest.approx(0.0137, abs=1e-6)


def test_what_is_refused():
    made = motion(effort(TS - 0.3))
    with pytest.raises(LogError, match=r"predicted has \(10, 3\), but needs the shape of the effort, \(2400, 3\)"):
        estimated_delay(made, effort(TS)[:10])
    with pytest.raises(LogError, match=r"predicted has numbers that are not finite, but needs"):
        estimated_delay(made, np.full((len(TS), 3), np.nan))
    with pytest.raises(LogError, match=r"motion 'motion' of 12 s is too short for delays of up to 4.0 s; four times is needed"):
        estimated_delay(made, effort(TS), longest=4.0)
    with pytest.raises(
        LogError, match=r"no channel follows its prediction closely enough to tell a delay within 0.1 s; try a greater"
    ):
        estimated_delay(made, effort(TS))
    assert estimated_delay(made, effort(TS), longest=0.5).common == pytest.approx(0.3, abs=1e-6)
    with pytest.raises(LogError, match="no channel follows its prediction"):
        estimated_delay(made, np.ones((len(TS), 3)))
