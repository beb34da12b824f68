import contextlib
import threading
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax import _lanes as lanes
from kanejax._simulate import batch

TS = np.linspace(0, 0.4, 3)


def states(count, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (count, 2)), rng.uniform(-1, 1, (count, 2))


def test_pieces_agree_with_vmap_and_failures_stay_alone(pendulum, capsys):
    q0, u0 = states(7)
    u0[3] = np.nan
    found = kj.simulate_batch(pendulum, q0, u0, TS, batch_size=3, dt0=0.02, progress=True)
    expected = jax.vmap(lambda q, u: kj.simulate(pendulum, q, u, TS, dt0=0.02))(jnp.asarray(q0), jnp.asarray(u0))
    assert isinstance(found.q, np.ndarray)
    np.testing.assert_allclose(found.q, expected.q, atol=1e-12)
    np.testing.assert_array_equal(found.ok, np.arange(7) != 3)
    assert found.status[3] == kj.Status.NON_FINITE
    assert "7/7" in capsys.readouterr().out


def hard_and_easy():
    """States of which every other takes many steps."""
    q0, u0 = states(6)
    u0[::2] *= 30.0
    return q0, u0


HOLD = kj.TorqueTable(np.array([0.0, 0.11, 0.25]), np.array([[2.0, 0], [-1, 1], [0, -1]]), "hold")


@pytest.mark.parametrize(
    "options",
    [{"joint_limits": True, "max_steps": 60}, {"control": HOLD}],
    ids=["events", "jumps"],
)
def test_segments_agree_with_whole_trajectories(pendulum, monkeypatch, options):
    monkeypatch.setattr(batch, "SEGMENT", 5)
    q0, u0 = hard_and_easy()
    found = kj.simulate_batch(pendulum, q0, u0, TS, batch_size=4, **options)
    expected = jax.vmap(lambda q, u: kj.simulate(pendulum, q, u, TS, **options))(jnp.asarray(q0), jnp.asarray(u0))
    assert found.interpolation is None
    if "max_steps" in options:
        assert set(found.status) == {kj.Status.SUCCESSFUL, kj.Status.EVENT, kj.Status.MAX_STEPS}
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-12)


def test_easy_trajectories_do_not_wait_for_hard_ones(pendulum, monkeypatch):
    run, calls = batch._run, []
    monkeypatch.setattr(batch, "SEGMENT", 5)
    monkeypatch.setattr(batch, "_run", lambda *args: calls.append(1) or run(*args))
    q0, u0 = hard_and_easy()
    steps = kj.simulate_batch(pendulum, q0, u0, TS, batch_size=2).stats["num_steps"]
    assert 3 < len(calls) < np.sum(np.max(steps.reshape(3, 2), axis=1)) / 5


def test_leaves_and_controls_can_be_batched(pendulum):
    q0, u0 = states(5)
    mass = pendulum.mass[None] * jnp.linspace(0.8, 1.2, 5)[:, None]
    values = jnp.asarray(np.random.default_rng(1).normal(size=(5, 2, 2)))
    leaves = eqx.tree_at(lambda m: m.mass, pendulum, mass)
    control = (lambda t, q, u, tau: tau[0] + t * tau[1], values)
    found = kj.simulate_batch(leaves, q0, u0, TS, control=control, control_axis=0, batch_size=2, dt0=0.02)
    for i in (0, 4):
        model = type(pendulum)(**{**vars(pendulum), "mass": mass[i]})
        alone = kj.simulate(model, q0[i], u0[i], TS, control=(control[0], values[i]), dt0=0.02)
        np.testing.assert_allclose(found.q[i], alone.q, atol=1e-12)
    with pytest.raises(ValueError, match=r"model.mass has shape \(3, 2\), but this batch needs \(2,\) or \(5, 2\)"):
        kj.simulate_batch(eqx.tree_at(lambda m: m.mass, pendulum, mass[:3]), q0, u0, TS)


def test_an_interrupted_batch_is_resumed(pendulum, monkeypatch):
    q0, u0 = states(5)
    run, calls = batch._run, []

    def interrupted(*args):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return run(*args)

    monkeypatch.setattr(batch, "_run", interrupted)
    with pytest.raises(kj.SimulationInterrupted, match="1 of 5 trajectories were not run") as caught:
        kj.simulate_batch(pendulum, q0, u0, TS, batch_size=2, threads=1, dt0=0.02)
    partial = caught.value.trajectory
    assert list(partial.status) == [0, 0, 0, 0, kj.Status.NOT_RUN]
    assert np.isnan(partial.q[4]).all()
    whole = kj.simulate_batch(pendulum, q0, u0, TS, batch_size=2, threads=1, dt0=0.02, resume=partial)
    assert len(calls) == 4
    assert whole.ok.all()
    np.testing.assert_array_equal(whole.q[:4], partial.q[:4])


def test_threads_share_the_trajectories(pendulum):
    q0, u0 = states(23)
    one, three = (kj.simulate_batch(pendulum, q0, u0, TS, batch_size=3, threads=threads) for threads in (1, 3))
    assert three.ok.all()
    np.testing.assert_allclose(three.q, one.q, rtol=1e-12)


def bar_of(advance):
    """A progress bar that calls this."""

    @contextlib.contextmanager
    def bar(what, total, show):
        yield advance

    return bar


def test_an_interrupt_stops_all_threads(pendulum, monkeypatch):
    q0, u0 = states(40)

    def interrupt(count):
        raise KeyboardInterrupt

    monkeypatch.setattr(batch, "progress_bar", bar_of(interrupt))
    with pytest.raises(kj.SimulationInterrupted) as caught:
        kj.simulate_batch(pendulum, q0, u0, TS, batch_size=2, threads=2)
    monkeypatch.undo()
    partial = caught.value.trajectory
    assert 0 < np.sum(partial.status == kj.Status.NOT_RUN) < 40
    assert kj.simulate_batch(pendulum, q0, u0, TS, batch_size=2, threads=2, resume=partial).ok.all()


def test_what_finished_before_an_interrupt_is_not_run_again(pendulum, monkeypatch):
    """The interrupt comes at the first report, when the threads are many pieces further."""
    q0, u0 = states(40)
    run, hold, calls, rows = batch._run, threading.Event(), [], []
    store = lanes.Results.store

    def held(*args):
        calls.append(1)
        if len(calls) > 12:
            # What is under way at the interrupt.
            assert hold.wait(60)
        return run(*args)

    def recorded(self, some, piece):
        store(self, some, piece)
        rows.extend(some)

    def interrupt(count):
        while len(calls) < 14:
            time.sleep(0.01)
        hold.set()
        raise KeyboardInterrupt

    monkeypatch.setattr(batch, "_run", held)
    monkeypatch.setattr(lanes.Results, "store", recorded)
    monkeypatch.setattr(batch, "progress_bar", bar_of(interrupt))
    with pytest.raises(kj.SimulationInterrupted, match="12 of 40 trajectories were not run") as caught:
        kj.simulate_batch(pendulum, q0, u0, TS, batch_size=2, threads=2, dt0=0.02)
    partial = caught.value.trajectory
    assert sorted(rows) == sorted(np.flatnonzero(partial.status != kj.Status.NOT_RUN))
    monkeypatch.undo()
    before = np.copy(partial.q)
    whole = kj.simulate_batch(pendulum, q0, u0, TS, batch_size=2, threads=2, dt0=0.02, resume=partial)
    assert whole.ok.all()
    done = partial.status != kj.Status.NOT_RUN
    np.testing.assert_array_equal(whole.q[done], before[done])
    np.testing.assert_allclose(whole.q, kj.simulate_batch(pendulum, q0, u0, TS, threads=1, dt0=0.02).q, rtol=1e-12)


class Interrupting:
    """An array for which an interrupt comes while one waits for it."""

    def __init__(self, values):
        self.values, self.waited = values, False

    def __array__(self, dtype=None, copy=None):
        if not self.waited:
            self.waited = True
            raise KeyboardInterrupt
        return np.asarray(self.values, dtype)


@pytest.mark.parametrize("where", ["unfinished", "trajectories", "store"])
def test_an_interrupt_takes_effect_when_a_segment_is_stored(where):
    """On one thread, where Ctrl-C comes while it waits for the device or stores."""
    calls, tries, found = [], [], []

    def run(rows, before, fresh):
        calls.append(rows)
        unfinished, trajectories = np.zeros(len(rows), bool), rows.astype(float)
        second = len(calls) == 2
        return (
            None,
            Interrupting(unfinished) if second and where == "unfinished" else unfinished,
            Interrupting(trajectories) if second and where == "trajectories" else trajectories,
        )

    def store(rows, trajectories):
        tries.append(1)
        if where == "store" and len(tries) == 2:
            raise KeyboardInterrupt
        np.testing.assert_array_equal(rows, trajectories)
        found.extend(rows)

    counts = lanes.run_lanes(run, lanes.Listed(np.arange(6)), 2, 1, store)
    assert next(counts) == 2
    with pytest.raises(KeyboardInterrupt):
        next(counts)
    assert found == [0, 1, 2, 3]


def test_an_error_in_a_thread_is_raised(pendulum, monkeypatch):
    def fail(*args):
        raise RuntimeError("out of memory")

    monkeypatch.setattr(batch, "_run", fail)
    with pytest.raises(RuntimeError, match="out of memory"):
        kj.simulate_batch(pendulum, *states(8), TS, batch_size=2, threads=2, dt0=0.02)


def test_one_compilation_serves_every_piece(pendulum):
    q0, u0 = states(4)
    traced = []

    def control(t, q, u):
        traced.append(1)
        return -u

    kj.simulate_batch(pendulum, q0, u0, TS, control=control, batch_size=2, dt0=0.02)
    count = len(traced)
    kj.simulate_batch(pendulum, q0[:3], u0[:3], TS, control=control, batch_size=2, dt0=0.02)
    assert len(traced) == count


def test_other_tolerances_do_not_compile_again(pendulum):
    traced = []

    def control(t, q, u):
        traced.append(1)
        return -u

    def steps(rtol, atol):
        return kj.simulate_batch(pendulum, *states(4), TS, control=control, rtol=rtol, atol=atol).stats["num_steps"]

    rough = steps(1e-3, 1e-3)
    count = len(traced)
    assert (steps(np.float32(1e-9), jnp.asarray(1e-9)) > rough).all()
    assert len(traced) == count
    with pytest.raises(ValueError, match="rtol is 0"):
        steps(0, 1e-3)


def test_bad_batches_are_refused(pendulum):
    q0, u0 = states(3)
    with pytest.raises(ValueError, match=r"q0 has shape \(3, 1\), but this model needs \(batch, 2\)"):
        kj.simulate_batch(pendulum, q0[:, :1], u0, TS)
    with pytest.raises(ValueError, match="q0 has 3 rows, but u0 has 2"):
        kj.simulate_batch(pendulum, q0, u0[:2], TS)
    with pytest.raises(ValueError, match="batch_size is 0"):
        kj.simulate_batch(pendulum, q0, u0, TS, batch_size=0)
    with pytest.raises(ValueError, match="does not take throw"):
        kj.simulate_batch(pendulum, q0, u0, TS, throw=True)


def test_counts_of_numpy_are_counts(pendulum):
    q0, u0 = states(3)
    found = kj.simulate_batch(pendulum, q0, u0, TS, batch_size=2, max_steps=np.int64(100))
    assert kj.simulate_batch(pendulum, q0, u0, TS).ok.all()
    np.testing.assert_allclose(found.q, kj.simulate_batch(pendulum, q0, u0, TS, max_steps=None).q, rtol=1e-12)


def test_what_is_resumed_must_be_of_this_batch(pendulum):
    q0, u0 = states(3)
    before = kj.simulate_batch(pendulum, q0, u0, TS)
    with pytest.raises(ValueError, match="resume has 3 trajectories, but q0 has 2"):
        kj.simulate_batch(pendulum, q0[:2], u0[:2], TS, resume=before)


def test_only_the_first_call_is_alone():
    meeting = threading.Barrier(2, timeout=20)
    calls = []

    def run(rows, before, fresh):
        calls.append(rows)
        if len(calls) > 1:
            # Two calls at the same time, or a timeout.
            meeting.wait()
        return None, np.zeros(len(rows), bool), np.asarray(rows)

    found = []
    assert sum(lanes.run_lanes(run, lanes.Listed(np.arange(5)), 1, 2, lambda rows, _: found.extend(rows.tolist()))) == 5
    assert sorted(found) == list(range(5))
