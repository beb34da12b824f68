"""From logs to motions: derivatives, phase, aliasing, gaps, and what is refused."""

import os
import pathlib
from typing import cast

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

import kanejax as kj
from kanejax._errors import LogError
from kanejax._logs.columns import Columns
from kanejax._logs.log import Log, Run
from kanejax._logs.processing import motions
from kanejax._logs.read_log import read_log

UR10E = pathlib.Path(os.environ.get("KANEJAX_DATA", pathlib.Path(__file__).parents[2].parent / "shared/data")) / "ur10e"
ARM = """
<mujoco>
  <worldbody>
    <body name="upper"><joint name="shoulder"/><geom size="0.1"/>
      <body name="lower" pos="0 0 1"><joint name="elbow" axis="0 1 0"/><geom size="0.1"/>
        <body name="tip" pos="0 0 1"><joint name="finger" type="slide"/><geom size="0.1"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
BALL = '<mujoco><worldbody><body><joint name="hip" type="ball"/><geom size="0.1"/></body></worldbody></mujoco>'
FASTEST = 1.0


@pytest.fixture(scope="module")
def model():
    return kj.load(ARM)


def signal(t, rate=0):
    """Harmonics of 0.2 Hz up to 1 Hz and their derivatives; a column for each of two joints."""
    random = np.random.default_rng(5)
    omega = 0.4 * np.pi * np.arange(1, 6)
    a, phase = random.uniform(0.2, 0.6, (2, 5)), random.uniform(0.0, 6.0, (2, 5))
    return np.sum(a * omega**rate * np.sin(omega * np.asarray(t)[:, None, None] + phase + rate * np.pi / 2), axis=-1)


def effort(t):
    return 10.0 * signal(t) - 3.0


def times(rate, duration=24.0, start=1000.0):
    return start + np.arange(round(duration * rate) + 1) / rate


def log_of(ts, q=None, measured=None, name="run", joints=("elbow", "shoulder"), **others):
    return Log(joints, Run(name, ts, signal(ts) if q is None else q, effort(ts) if measured is None else measured, **others))


def one(log, model, **options):
    """The only motion, with the finger held still."""
    (motion,) = motions(log, model, **{"locked": {"finger": 0.04}, **options})
    return motion


def errors(motion, start=1000.0):
    """Errors of q, u, u_dot and effort over their size; the log's first joint is the model's second."""
    ts = np.asarray(motion.ts) + start
    exact = (signal(ts), signal(ts, 1), signal(ts, 2), effort(ts))
    arrays = (motion.q, motion.u, motion.u_dot, motion.effort)
    return np.array([np.abs(np.asarray(x)[:, [1, 0]] - y).max() / np.abs(y).max() for x, y in zip(arrays, exact, strict=True)])


@pytest.mark.parametrize("rate", [100.0, 1000.0])
@pytest.mark.parametrize("measured", [False, True])
def test_derivatives_of_an_analytic_motion(model, rate, measured):
    ts = times(rate)
    log = log_of(ts, u=signal(ts, 1) if measured else None)
    # w dt = 0.063 at 100 Hz: errors of second order are 1.3e-3, of sixth 1e-8.
    for options, bound in (({"accuracy": 2}, 1.5e-3), ({"accuracy": 4}, 2e-6), ({}, 3e-9), ({"accuracy": 8}, 3e-10)):
        found = errors(one(log, model, cutoff=None, trim=1.0, **options))
        # Besides rounding errors of the samples over dt^2.
        assert np.all(found < bound * (100.0 / rate) ** 2 + 1e-13 * rate**2), (options, found)
    # Ten times above the motion the filter leaves (1/10)^10 of an error, and the cut ends what is left of its start.
    assert np.all(errors(one(log, model, trim=4.0)) < 1e-6)
    assert np.all(errors(one(log, model)) < 0.01)
    assert np.all(errors(one(log, model, cutoff=10.0, effort_cutoff=10.0, trim=4.0)) < 1e-6)


def test_measured_accelerations_are_filtered_only(model):
    ts = times(100.0)
    noise = np.sin(2 * np.pi * 40.0 * ts)[:, None]
    log = log_of(ts, u=signal(ts, 1), u_dot=signal(ts, 2) + noise)
    assert errors(one(log, model, cutoff=10.0, trim=4.0))[2] < 1e-6
    np.testing.assert_allclose(errors(one(log, model, cutoff=None))[2], 1.0 / np.abs(signal(ts, 2)).max(), rtol=0.1)


@pytest.mark.parametrize("order", [2, 5])
@pytest.mark.parametrize("frequency", [3.0, 7.0, 10.0, 14.0])
def test_filters_have_butterworth_s_gain_twice_and_no_phase(model, frequency, order):
    ts = times(100.0, start=0.0)
    wave = np.sin(2 * np.pi * frequency * ts)[:, None] * [1.0, 2.0]
    motion = one(log_of(ts, measured=wave), model, effort_cutoff=10.0, order=order, trim=5.0)
    angle = 2 * np.pi * frequency * np.asarray(motion.ts)
    shares = np.linalg.lstsq(np.column_stack((np.sin(angle), np.cos(angle))), np.asarray(motion.effort[:, 0]), rcond=None)[0]
    # The bilinear transform maps frequencies to tangents.
    warped = np.tan(np.pi * frequency / 100.0) / np.tan(np.pi * 10.0 / 100.0)
    np.testing.assert_allclose(shares, [2.0 / (1.0 + warped ** (2 * order)), 0.0], atol=1e-6)


def test_cutoffs_as_fractions_of_nyquist(model):
    log = log_of(times(250.0), u=signal(times(250.0), 1))
    by_hertz = one(log, model, cutoff=0.15 * 125.0, effort_cutoff=0.2 * 125.0)
    by_fraction = one(log, model, cutoff=0.15, effort_cutoff=0.2, cutoff_unit="Nyquist")
    np.testing.assert_allclose(by_fraction.u_dot, by_hertz.u_dot, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(by_fraction.effort, by_hertz.effort, rtol=1e-12)
    assert by_hertz.notes == by_fraction.notes
    assert by_hertz.notes[:2] == ("motion low-passed at 18.75 Hz", "effort low-passed at 25 Hz")


@pytest.mark.parametrize("rate", [100.0, 1000.0, 5000.0])
def test_the_automatic_cutoff_suits_motion_and_noise(model, rate):
    ts = times(rate)
    # As of an encoder with 17 bits.
    step = 2 * np.pi / 2**17
    motion = one(log_of(ts, q=np.round(signal(ts) / step) * step), model)
    (note,) = (note for note in motion.notes if "automatic" in note)
    assert 5.0 * FASTEST < float(note.split()[3]) < 15.0 * FASTEST
    assert np.all(errors(motion)[:3] < [1e-4, 1e-3, 0.01])
    noisy = signal(ts) + 1e-3 * np.random.default_rng(0).normal(size=(len(ts), 2))
    coarse = one(log_of(ts, q=noisy), model)
    assert np.all(errors(coarse)[:2] < [0.003, 0.06])


def test_the_automatic_cutoff_where_nothing_moves(model):
    ts = times(100.0)
    for noise in (0.0, 1e-5):
        still = np.full((len(ts), 2), 0.3) + noise * np.random.default_rng(0).normal(size=(len(ts), 2))
        assert one(log_of(ts, q=still), model).notes[0] == "motion low-passed at 20 Hz (automatic)"


def test_one_automatic_cutoff_for_all_runs(model):
    ts = times(200.0)
    slow = Run("slow", ts, signal(0.2 * ts), effort(ts))
    first, second = motions(Log(("elbow", "shoulder"), [slow, log_of(ts).runs[0]]), model, locked={"finger": 0.0})
    assert first.notes == second.notes
    assert first.name == "slow"
    alone = one(Log(("elbow", "shoulder"), slow), model)
    assert float(alone.notes[0].split()[3]) < 0.5 * float(first.notes[0].split()[3])


def test_irregular_stamps_are_resampled(model):
    random = np.random.default_rng(1)
    ts = 1000.0 + np.cumsum(random.uniform(0.008, 0.012, 2400))
    log = log_of(ts)
    motion = one(log, model, trim=2.0)
    np.testing.assert_allclose(np.diff(motion.ts), np.median(np.diff(ts)), rtol=1e-9)
    assert motion.notes[0].startswith("steps of 0.008 to 0.012 s, resampled (cubic) every 0.00997")
    # (w dt)^4 / 384 of the spline and (w dt)^2 / 8 of straight lines, less what the filter removes.
    assert np.all(errors(motion, ts[0]) < [1e-6, 1e-5, 1e-4, 1e-6])
    linear = errors(one(log, model, trim=2.0, resampling="linear"), ts[0])
    assert np.all(linear < [2e-3, 1e-2, 0.05, 2e-3])
    assert linear[3] > 1e-4
    nearly = times(100.0) + random.uniform(-4e-5, 4e-5, 2401)
    assert "resampled" not in one(log_of(nearly), model).notes[0]


def test_irregular_stamps_can_be_left(model):
    ts = 1000.0 + np.cumsum(np.random.default_rng(1).uniform(0.009, 0.011, 2400))
    log = log_of(ts, u=signal(ts, 1))
    motion = one(log, model, cutoff=None, trim=0.0, resampling=None, accuracy=2)
    np.testing.assert_allclose(motion.ts, ts - ts[0], atol=1e-9)
    u = signal(ts, 1)
    np.testing.assert_array_equal(motion.u[:, [1, 0]], u)
    slopes = (u[2:] - u[:-2]) / (ts[2:] - ts[:-2])[:, None]
    np.testing.assert_allclose(motion.u_dot[1:-1, [1, 0]], slopes, rtol=1e-12)
    assert motion.notes == ("the stamps are irregular, and filtered as if they were uniform",)
    with pytest.raises(LogError, match=r"run 'run': irregular samples that are not resampled need accuracy=2, not 6"):
        one(log, model, resampling=None)


def test_gaps_part_a_run(model):
    ts = np.delete(times(100.0, 40.0), [*range(1000, 1003), *range(2000, 2100), *range(2101, 2110)])
    log = log_of(ts)
    parts = motions(log, model, locked={"finger": 0.0}, cutoff=10.0)
    assert [motion.name for motion in parts] == ["run, part 1", "run, part 2", "run, part 3"]
    first, second = motions(log, model, locked={"finger": 0.0}, cutoff=10.0, longest_gap=5.0)
    note = "parted at 2 gaps of up to 1.01 s, where the median step is 0.01 s"
    assert first.notes[:2] == second.notes[:2] == (note, "1 single samples between two gaps were left out")
    assert "steps of 0.01 to 0.04 s, resampled (cubic) every 0.01 s" in first.notes
    for motion in (*parts, first, second):
        assert np.all(errors(motion) < 0.02)
        assert np.all(np.diff(motion.ts) < 0.0101)
    assert second.ts[0] == pytest.approx(21.1 + 0.24, abs=0.02)


def test_parts_that_are_too_short_are_told(model):
    ts = np.delete(times(100.0, 20.0), range(100, 110))
    (motion,) = motions(log_of(ts), model, locked={"finger": 0.0}, cutoff=2.0)
    assert motion.name == "run, part 2"
    assert "too short for the filter, and left out: run, part 1 of 0.99 s" in motion.notes
    with pytest.raises(
        LogError, match=r"run 'run' is too short: of 1 s, 1.19 s are cut off at each end, where the filter settles; choose"
    ):
        one(log_of(times(100.0, 1.0)), model, cutoff=2.0)
    assert len(one(log_of(times(100.0, 1.0)), model, cutoff=2.0, trim=0.0)) == 101


@pytest.mark.parametrize("options", [{"decimation": 20}, {"rate": 50.0}, {"rate": 51.0}])
def test_decimation_does_not_fold_noise_into_the_band(model, options):
    ts = times(1000.0)
    # At 50 samples a second, 49 Hz would look like 1 Hz.
    hum = np.sin(2 * np.pi * 49.0 * ts)[:, None]
    log = log_of(ts, q=signal(ts) + 0.1 * hum, measured=effort(ts) + 5.0 * hum, u=signal(ts, 1) + hum)
    plain = errors(one(log, model, cutoff=None, trim=4.0))
    assert np.all(plain > [0.02, 0.1, 1.0, 0.1])
    motion = one(log, model, trim=4.0, **options)
    np.testing.assert_allclose(np.diff(motion.ts), 0.02, rtol=1e-9)
    assert np.all(errors(motion) < 2e-4)
    assert "one of 20 samples kept, 50 a second" in motion.notes
    assert "what else was not low-passed was at 17.5 Hz, for the decimation" in motion.notes
    none = one(log, model, trim=4.0, cutoff=None, **options)
    assert np.all(errors(none) < 2e-4)


def test_cutoffs_must_suit_the_rate(model):
    log = log_of(times(100.0))
    with pytest.raises(LogError, match=r"run 'run': cutoff is 50 Hz, but must be below 50 Hz, half the sampling rate"):
        one(log, model, cutoff=50.0)
    with pytest.raises(LogError, match=r"effort_cutoff is 60 Hz, but must be below 50 Hz"):
        one(log, model, effort_cutoff=1.2, cutoff_unit="Nyquist")
    with pytest.raises(
        LogError, match=r"cutoff is 12 Hz, but the 25 samples a second to be kept can follow 10 Hz; lower it, or keep more"
    ):
        one(log, model, cutoff=12.0, decimation=4)


def test_efforts_without_weight_do_not_spread(model):
    ts = times(100.0)
    measured, weight = effort(ts), np.ones((len(ts), 2))
    measured[500:505, 0], weight[500:505, 0] = np.nan, 0.0
    measured[:, 1], weight[:, 1] = np.nan, 0.0
    motion = one(log_of(ts, measured=measured, weight=weight), model, trim=0.0, effort_cutoff=20.0)
    np.testing.assert_array_equal(motion.weight[:, 1], weight[:, 0])
    np.testing.assert_array_equal(motion.weight[:, 0], 0.0)
    assert np.all(np.isfinite(motion.effort))
    counts = weight[:, 0] > 0
    assert np.abs(np.asarray(motion.effort)[counts, 1] - effort(ts)[counts, 0]).max() < 0.01 * np.abs(effort(ts)).max()
    shifted = np.sort(ts + np.random.default_rng(2).uniform(-1e-3, 1e-3, len(ts)))
    motion = one(log_of(shifted, measured=measured, weight=weight), model, trim=0.0)
    lost = int(np.sum(motion.weight[:, 1] == 0))
    assert 5 <= lost <= 7


def test_joints_are_put_where_the_model_has_them(model):
    motion = one(log_of(times(100.0)), model, locked={"finger": 0.04}, cutoff=None, trim=0.0)
    assert motion.q.shape == motion.u.shape == motion.weight.shape == (2401, 3)
    np.testing.assert_array_equal(motion.q[:, 2], 0.04)
    for array in (motion.u, motion.u_dot, motion.effort, motion.weight):
        np.testing.assert_array_equal(array[:, 2], 0.0)
    np.testing.assert_array_equal(motion.weight[:, :2], 1.0)
    np.testing.assert_array_equal(motion.q[:, [1, 0]], signal(times(100.0)))
    narrow = one(log_of(times(100.0)), model.astype(jnp.float32), cutoff=None, trim=0.0)
    assert narrow.q.dtype == narrow.ts.dtype == narrow.weight.dtype == jnp.float32
    # Times count from the start, so that float32 has room for them.
    np.testing.assert_allclose(np.diff(narrow.ts), 0.01, rtol=3e-4)


def test_joints_that_do_not_match(model):
    log = log_of(times(100.0, 1.0))
    with pytest.raises(
        LogError, match=r"the log lacks joints of the model: finger; if they were held .* say where: locked={'finger': 0.0}"
    ):
        motions(log, model)
    with pytest.raises(
        LogError, match=r"the argument locked has joints that the model has not: thumb; the model's joints are: shoulder, "
    ):
        motions(log, model, locked={"finger": 0.0, "thumb": 0.0})
    with pytest.raises(LogError, match=r"joints elbow are in the log, and cannot be locked too"):
        motions(log, model, locked={"finger": 0.0, "elbow": 0.0})
    with pytest.raises(LogError, match=r"locked joint 'finger' is at nan; it must be finite"):
        motions(log, model, locked={"finger": np.nan})
    other = log_of(times(100.0, 1.0), joints=("elbow", "hip"))
    with pytest.raises(
        LogError, match=r"the log has joints that the model has not: hip; the model's joints are: shoulder, elbow, finger"
    ):
        motions(other, model)
    with pytest.raises(kj.UnsupportedModelError, match=r"joint 'hip' is ball; logs are of revolute and prismatic joints"):
        motions(other, kj.load(BALL))


@pytest.mark.parametrize("factor", [-1.0, 57.3])
def test_speeds_that_contradict_the_positions(model, factor):
    ts = times(100.0)
    u = signal(ts, 1) * [1.0, factor]
    with pytest.raises(
        LogError, match=rf"run 'run': the speeds of column 1 are {factor:.4g}.* times the slopes of its positions; check"
    ):
        one(log_of(ts, u=u), model)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cutoff": -1.0}, r"cutoff is -1.0; it must be positive and finite"),
        ({"effort_cutoff": np.inf}, r"effort_cutoff is inf; it must be positive and finite"),
        ({"order": 0}, r"order is 0; it must be positive"),
        ({"decimation": 0}, r"decimation is 0; it must be positive"),
        ({"rate": 10.0, "decimation": 2}, r"give decimation \(2\) or rate \(10.0\), not both"),
        ({"trim": -1.0}, r"trim is -1.0; it must be finite and not negative"),
    ],
)
def test_options_without_meaning(model, options, message):
    with pytest.raises(ValueError, match=message):
        one(log_of(times(100.0)), model, **options)


def reference_filter(samples, cutoff):
    numerator, denominator = cast(tuple, scipy.signal.butter(5, cutoff))
    return scipy.signal.filtfilt(numerator, denominator, samples, axis=0, padlen=500)


def test_the_reference_protocol_on_a_real_log():
    path = UR10E / "ur-20_02_10-30sec_12harm.csv"
    if not path.exists():
        pytest.skip(f"{path} is absent: the protocol was not tried on the log of a real UR10e")
    model = kj.load(UR10E / "ur10e.urdf", strict=False)
    columns = Columns(0, range(1, 7), range(7, 13), None, range(13, 19))
    log = read_log(path, model.tree.joint_names, columns=columns, rows=(635, 3510))
    protocol = {"cutoff": 0.15, "effort_cutoff": 0.2, "cutoff_unit": "Nyquist", "accuracy": 2, "resampling": None}
    (motion,) = motions(log, model, **protocol, trim=0.5)
    data = np.loadtxt(path, delimiter=",")[634:3510]
    ts, u = data[:, 0], data[:, 7:13]
    u = reference_filter(u, 0.15)
    u_dot = np.zeros_like(u)
    u_dot[1:-1] = (u[2:] - u[:-2]) / (ts[2:] - ts[:-2])[:, None]
    u_dot = reference_filter(u_dot, 0.15)
    current = reference_filter(data[:, 13:19], 0.2)
    cut = (len(ts) - len(motion)) // 2
    assert cut == 47
    inner = slice(cut, -cut)
    np.testing.assert_allclose(motion.ts, ts[inner] - ts[0], atol=1e-9)
    np.testing.assert_array_equal(motion.q, data[inner, 1:7])
    for array, expected in ((motion.u, u), (motion.u_dot, u_dot), (motion.effort, current)):
        scale = np.abs(expected[inner]).max()
        deep = slice(200, -200)
        np.testing.assert_allclose(np.asarray(array)[deep], expected[inner][deep], atol=1e-9 * scale)
        np.testing.assert_allclose(np.asarray(array), expected[inner], atol=1e-3 * scale)
    # Without measured speeds, and resampled: the same motion but for noise.
    log = read_log(path, model.tree.joint_names, columns=Columns(0, range(1, 7), None, None, range(13, 19)), rows=(635, 3510))
    (derived,) = motions(log, model, cutoff=7.0, trim=0.5)
    again = derived.at(motion.ts)
    inside = np.asarray(again.weight[:, 0]) > 0
    error = np.sqrt(np.mean((np.asarray(again.u) - np.asarray(motion.u))[inside] ** 2, axis=0))
    assert np.all(error < 0.02 * np.sqrt(np.mean(np.asarray(motion.u) ** 2, axis=0)))
