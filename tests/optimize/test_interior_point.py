"""The interior-point method on swing-ups whose optima IPOPT and Crocoddyl know, and on problems without a solution."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from kanejax._optimal_control.interior_point import first_search, searched
from kanejax._optimal_control.search import Result
from kanejax._optimal_control.stages import AbstractStages, Bounds, FinalValues, Path, StageValues, values
from tests.helpers.stages import cart_pole, pendulum

solved = eqx.filter_jit(lambda stages, guess, tolerance: searched(stages, first_search(stages, guess), 300, tolerance))


def replayed(stages, controls):
    """The motion that the controls make, stage by stage."""
    step = jax.jit(lambda x, w: stages.stage(jnp.asarray(0), x, w).next)
    x = [stages.start]
    for w in controls:
        x.append(step(x[-1], w))
    return np.array(x)


@pytest.mark.parametrize(("problem", "ipopt"), [(pendulum, 41.142), (cart_pole, 59.130)])
def test_same_optimum_as_ipopt_from_the_same_guess(problem, ipopt):
    """CasADi with IPOPT on the same transcription, from states on a straight line and no forces."""
    stages = problem()
    found = solved(stages, stages.straight(), 1e-8)
    path = found.point.path
    assert int(found.result) == Result.CONVERGED
    assert int(found.iterations) < 30
    assert float(found.cost) == pytest.approx(ipopt, abs=1e-3)
    assert np.abs(replayed(stages, path.w) - np.asarray(path.x)).max() < 1e-6
    assert np.abs(path.x[-1] - stages.goal).max() < 1e-8
    both = np.concatenate((path.x[:-1], path.w), 1)
    assert np.all((both > np.asarray(stages.lower) - 1e-7) & (both < np.asarray(stages.upper) + 1e-7))


def test_some_of_many_starts_find_the_best_known():
    """Crocoddyl with penalties finds 29.408, CasADi with IPOPT at best 29.409."""
    stages, count = pendulum(), 12
    line = stages.straight()
    rng = np.random.default_rng(0)
    bends = rng.normal(size=(count, 3, 2, 1)) * np.sin(np.pi * np.arange(1, 4)[:, None] * np.linspace(0, 1, 51))[None, :, None]
    guesses = Path(line.x[None] + jnp.asarray(bends.sum(1).swapaxes(1, 2)), jnp.broadcast_to(line.w, (count, *line.w.shape)))
    found = jax.jit(jax.vmap(lambda guess: searched(stages, first_search(stages, guess), 300, 1e-8)))(guesses)
    ended = np.asarray(found.result) == Result.CONVERGED
    assert ended.mean() > 0.5
    costs = np.asarray(found.cost)[ended]
    assert costs.min() < 29.42
    assert np.all(costs > 29.40)
    # Some get stuck where the force is at its limit and the pendulum turns back; they do not pass for motions.
    assert np.all(np.asarray(found.result)[~ended] == Result.INFEASIBLE)
    assert np.all(np.asarray(found.errors.violation)[~ended] > 0.1)


def test_float32():
    stages = pendulum(jnp.float32)
    found = solved(stages, stages.straight(), jnp.asarray(1e-3, jnp.float32))
    assert int(found.result) == Result.CONVERGED
    assert found.cost.dtype == found.point.path.x.dtype == jnp.float32
    assert float(found.cost) == pytest.approx(41.142, rel=1e-3)


class Bounded(AbstractStages):
    """Squared states and controls of a double integrator, with all kinds of bounds."""

    start: jax.Array
    least: jax.Array

    def stage(self, k, x, w):
        after = jnp.stack((x[0] + 0.2 * x[1], x[1] + 0.2 * w[0]))
        return StageValues(after, jnp.sum(x**2) + 0.1 * jnp.sum(w**2), jnp.stack((x[0] + x[1], x[0] * w[0])))

    def final(self, x):
        return FinalValues(10.0 * jnp.sum(x**2), x[:1] * x[1:])

    def bounds(self):
        inf = jnp.inf
        lower, upper = jnp.array([-inf, -0.8, -3.0, 0.0, -inf]), jnp.array([inf, inf, 2.0, inf, 5.0])
        stage = jnp.broadcast_to(jnp.stack((lower, upper))[:, None], (2, 20, 5)).at[0, :, 3].set(self.least)
        final = jnp.array([[-inf, -inf, -0.001], [inf, inf, 0.0]])
        return Bounds(stage.at[:, 0, :2].set(self.start), final)


def test_bounds_against_another_solver():
    stages = Bounded(jnp.array([1.5, 0.0]), jnp.asarray(-0.1))
    guess = Path(jnp.zeros((21, 2)), jnp.zeros((20, 1)))
    found = solved(stages, guess, 1e-9)
    assert int(found.result) == Result.CONVERGED

    def states(w):
        x = [np.array([1.5, 0.0])]
        for each in w:
            x.append(np.array([x[-1][0] + 0.2 * x[-1][1], x[-1][1] + 0.2 * each]))
        return np.array(x)

    def cost(w):
        x = states(w)
        return np.sum(x[:-1] ** 2) + 0.1 * np.sum(w**2) + 10.0 * np.sum(x[-1] ** 2)

    def rooms(w):
        x = states(w)
        own = (x[1:-1, 1] + 0.8, x[:-1].sum(1) + 0.1, 5.0 - x[:-1, 0] * w, [-x[-1, 0] * x[-1, 1], x[-1, 0] * x[-1, 1] + 0.001])
        return np.concatenate([np.ravel(each) for each in own])

    options = {"maxiter": 500, "ftol": 1e-14}
    constraints = {"type": "ineq", "fun": rooms}
    start = np.asarray(found.point.path.w[:, 0]) + 0.05 * np.random.default_rng(0).normal(size=20)
    best = scipy.optimize.minimize(cost, start, bounds=[(-3.0, 2.0)] * 20, constraints=constraints, options=options)
    assert float(found.cost) == pytest.approx(best.fun, rel=1e-7)
    assert np.abs(np.asarray(found.point.path.w[:, 0]) - best.x).max() < 1e-4
    assert rooms(np.asarray(found.point.path.w[:, 0])).min() > -1e-8


def test_what_no_path_fulfils_is_told():
    stages = Bounded(jnp.array([1.5, 0.0]), jnp.asarray(8.0))
    found = solved(stages, Path(jnp.zeros((21, 2)), jnp.zeros((20, 1))), 1e-9)
    assert int(found.result) != Result.CONVERGED
    assert float(found.errors.violation) > 1e-2


def test_what_is_not_finite_is_told():
    stages = Bounded(jnp.array([jnp.nan, 0.0]), jnp.asarray(-0.1))
    assert not np.isfinite(values(stages, Path(jnp.full((21, 2), jnp.inf), jnp.zeros((20, 1))))[0].cost).all()
    found = solved(stages, Path(jnp.full((21, 2), jnp.inf), jnp.zeros((20, 1))), 1e-9)
    assert int(found.result) == Result.NON_FINITE
