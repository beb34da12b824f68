"""Many tasks in lanes: each as if alone, failures apart, interrupts and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax import costs
from kanejax._checkpoint import CheckpointError
from kanejax._optimal_control.search import Result
from kanejax._optimize import many

PENDULUM = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping=".1"/>
  <inertial pos="0 0 -1" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body></worldbody></mujoco>"""
# The last cannot be reached.
ROWS = {"mass": np.array([0.9, 1.0, 1.1, 1.2, 1.0]), "goal": np.array([[0.5], [1.0], [0.2], [-0.7], [90.0]])}


@pytest.fixture(scope="module")
def task():
    model = kj.load(PENDULUM)

    def of(row):
        heavier = model.replace(mass=model.mass * row["mass"])
        limits = kj.Limits(heavier, u=4.0, tau=12.0)
        return kj.MotionTask(heavier, [0.0], row["goal"], 1.0, costs.torque(), limits=limits, steps=8)

    return of


@pytest.mark.parametrize(("size", "threads"), [(1, 2), (2, 1)])
def test_each_is_as_if_alone(task, size, threads):
    found = kj.optimize_batch(task, ROWS, batch_size=size, threads=threads)
    assert found.q.shape == (5, 9, 1)
    assert isinstance(found.q, np.ndarray)
    np.testing.assert_array_equal(found.converged, [True] * 4 + [False])
    assert found.result[-1] == Result.INFEASIBLE
    alone = jax.jit(lambda row: kj.optimal_motion(task(row)))
    for i in range(4):
        one = alone(jax.tree.map(lambda x, i=i: jnp.asarray(x[i]), ROWS))
        assert one.iterations == found.iterations[i]
        np.testing.assert_allclose(found.tau[i], one.tau, rtol=0, atol=1e-9 * np.abs(one.tau).max())


def test_a_guess_beside_each_task(task):
    straight = kj.optimize_batch(task, ROWS, threads=1)
    rows = ROWS | {"guess": jax.tree.map(np.asarray, straight)}
    warm = kj.optimize_batch(lambda row: (task(row), row["guess"]), jax.tree.map(lambda x: x[:4], rows), threads=1)
    assert warm.converged.all()
    np.testing.assert_allclose(warm.cost, straight.cost[:4], rtol=1e-8)


@pytest.mark.parametrize("size", [1, 2])
def test_interrupted_and_gone_on_with(task, monkeypatch, tmp_path, size):
    options = {"threads": 1, "batch_size": size}
    whole, calls, run, path = kj.optimize_batch(task, ROWS, **options), [], many._run, tmp_path / "motions.npz"

    def interrupted(*arguments):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return run(*arguments)

    monkeypatch.setattr(many, "_run", interrupted)
    with pytest.raises(kj.OptimizationInterrupted, match="`motion` has what is finished") as caught:
        kj.optimize_batch(task, ROWS, checkpoint=path, **options)
    part = caught.value.motion
    done = int(np.sum(part.result != Result.NOT_RUN))
    assert 0 < done < 5
    calls.extend([1] * 9)
    rest = kj.optimize_batch(task, ROWS, checkpoint=path, progress=True, **options)
    for one, other in zip(jax.tree.leaves(rest), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(one, other)
    del calls[:]
    again = kj.optimize_batch(task, ROWS, checkpoint=path, **options)
    assert len(calls) == size, "to know the shapes, and nothing else"
    np.testing.assert_array_equal(again.q, whole.q)
    with pytest.raises(CheckpointError, match="belongs to other inputs"):
        kj.optimize_batch(task, ROWS | {"mass": np.ones(5)}, checkpoint=path, **options)


@pytest.mark.parametrize(
    ("rows", "options", "message"),
    [
        ({"mass": np.ones(2), "goal": np.ones((3, 1))}, {}, r"one leading axis.*'goal'\]: \(3,\)"),
        ({"mass": np.float64(1.0)}, {}, "one leading axis"),
        (ROWS, {"batch_size": 0}, "batch_size"),
        (ROWS, {"threads": 0}, "threads"),
    ],
)
def test_refused(task, rows, options, message):
    with pytest.raises(ValueError, match=message):
        kj.optimize_batch(task, rows, **options)
