"""Logs from arrays, and what they refuse."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax._errors import LogError
from kanejax._logs.log import Log, Run

TS = np.array([0.0, 0.1, 0.25, 0.3])
Q = np.arange(8.0).reshape(4, 2)


def run(name="run", **changed):
    return Run(name, **{"ts": TS, "q": Q, "effort": -Q, **changed})


def test_arrays_become_float64_copies_that_cannot_be_written_to():
    q = Q.astype(np.float32)
    made = run(ts=list(TS), q=q, effort=jnp.asarray(-Q), u=[[1, 2]] * 4)
    q[0] = 7.0
    for array in (made.ts, made.q, made.effort, made.u):
        assert array is not None
        assert array.dtype == np.float64
        assert not array.flags.writeable
    np.testing.assert_array_equal(made.q, Q)
    assert made.u_dot is None
    assert made.notes == ()
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(made, "q", Q)  # noqa: B010


def test_sizes_and_texts():
    made = run()
    assert len(made) == 4
    assert made.duration == 0.3
    assert made.period == pytest.approx(0.1)
    assert repr(made) == "<run 'run': 4 samples of 2 joints in 0.3 s>"
    log = Log(["a", "b"], [run("first", notes=["one"]), run("second", notes=["two", "three"])])
    assert log.joints == ("a", "b")
    assert repr(log) == f"<log of a, b: {log.runs[0]!r}, {log.runs[1]!r}>"
    assert log.notes == ("first: one", "second: two", "second: three")
    assert Log(("a", "b"), made).runs == (made,)


def test_an_effort_without_weight_may_be_missing():
    effort, weight = -Q.copy(), np.ones_like(Q)
    effort[2, 1] = np.nan
    with pytest.raises(LogError, match=r"run 'run': effort\[2, 1\] is nan; give it weight 0, or remove the sample"):
        run(effort=effort)
    weight[2, 1] = 0.0
    assert np.isnan(run(effort=effort, weight=weight).effort[2, 1])
    q = Q.copy()
    q[2, 1] = np.inf
    with pytest.raises(LogError, match=r"q\[2, 1\] is inf; remove the sample"):
        run(q=q, weight=weight)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"ts": TS[:1]}, r"run 'run': ts has shape \(1,\), but needs \(n,\) with n of at least 2"),
        ({"ts": Q}, r"ts has shape \(4, 2\)"),
        ({"q": Q[:3]}, r"q has shape \(3, 2\), but needs \(4, njoint\)"),
        ({"q": TS}, r"q has shape \(4,\), but needs \(4, njoint\)"),
        ({"effort": Q[:, :1]}, r"effort has shape \(4, 1\), but q has \(4, 2\)"),
        ({"u": Q[:3]}, r"u has shape \(3, 2\), but q has \(4, 2\)"),
        ({"ts": [0.0, 0.1, 0.1, 0.05]}, r"ts\[2\] = 0.1 follows 0.1, and so 2 times in all; remove these samples"),
        ({"ts": [0.0, np.nan, 0.1, 0.2]}, r"ts\[1\] is not finite"),
        ({"u": np.where(Q == 3.0, np.nan, Q)}, r"u\[1, 1\] is nan; remove the sample"),
        ({"weight": -Q}, r"weight must be finite and not negative"),
        ({"q": [["a", "b"]] * 4}, r"run 'run': q is no array of numbers"),
    ],
)
def test_bad_runs_are_refused(changed, message):
    with pytest.raises(LogError, match=message):
        run(**changed)


@pytest.mark.parametrize(
    ("joints", "runs", "message"),
    [
        (("a", "a"), run(), "joint names must differ, but 'a' occur more than once"),
        (("a", "b"), [run(), run()], "run names must differ, but 'run' occur more than once"),
        (("a", "b"), [], "a log needs at least one run"),
        ((), run(), "a log needs at least one joint"),
        (("a",), run(), "run 'run' has 2 columns, but the log's joints are a"),
        ("ab", run(), r"joints is the text 'ab'; give a sequence of names, such as \('ab',\)"),
    ],
)
def test_bad_logs_are_refused(joints, runs, message):
    with pytest.raises(LogError, match=message):
        Log(joints, runs)


def test_the_error_is_the_library_s_and_a_value_error():
    assert issubclass(LogError, kj.KanejaxError)
    assert issubclass(LogError, ValueError)
