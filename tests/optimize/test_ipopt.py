"""IPOPT against the library's own interior-point method, and what it does where there is no optimum."""

import importlib.util
import signal
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse

import kanejax as kj
from kanejax import constraints, costs
from kanejax._optimal_control.interior_point import first_search
from kanejax._optimal_control.ipopt import searched_by_ipopt
from kanejax._optimal_control.search import Result
from kanejax._optimal_control.sparse import Layout
from kanejax._optimal_control.stages import AbstractStages, Bounds, FinalValues, Path, StageValues, derivatives, values
from kanejax._optimize.optimize import SolverNotInstalledError
from tests.helpers.mechanisms import relative
from tests.helpers.stages import cart_pole, pendulum

ARM = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" damping=".1" range="-3 3" limited="true"/>
    <inertial pos="0 0 -.25" mass="2" diaginertia=".05 .05 .01"/>
    <body name="fore" pos="0 0 -.5"><joint name="elbow" axis="0 1 0" damping=".05" range="-2.5 2.5" limited="true"/>
      <inertial pos="0 0 -.2" mass="1" diaginertia=".02 .02 .005"/><body name="tool" pos="0 0 -.4"/></body></body>
</worldbody></mujoco>"""
START, GOAL, STEPS = [-1.0, 0.5], jnp.array([0.8, -0.6]), 20


class Traced:
    """How often the cost was traced; of a class the fingerprint of a checkpoint takes the name alone."""

    times = 0


needs_ipopt = pytest.mark.skipif(
    importlib.util.find_spec("cyipopt") is None, reason="cyipopt is not installed (kanejax[ipopt]): IPOPT was not run"
)


@pytest.fixture(scope="module")
def arm():
    return kj.load(ARM)


def squares(model, at):
    Traced.times += 1
    return jnp.sum(jnp.square(at.tau))


def reach(arm, tau=(3.5, 5.0), duration=(0.3, 3.0), weight=40.0, goal=GOAL):
    """Bring the tool to a place; with these numbers limits of a speed and a force hold on the way."""
    there = kj.Boundary(constraints=constraints.position("tool", kj.poses(arm, goal).origin[arm.tree.body("tool")]))
    terms = kj.Cost(squares, name="squares"), costs.duration(weight)
    return kj.MotionTask(arm, START, there, duration, terms, limits=kj.Limits(arm, u=3.0, tau=list(tau)), steps=STEPS)


def by_ipopt(task, **options):
    return kj.optimize(task, solver="ipopt", **options)


@needs_ipopt
@pytest.mark.parametrize(("problem", "optimum"), [(pendulum, 41.142), (cart_pole, 59.130)])
def test_same_optimum_as_by_casadi_from_the_same_guess(problem, optimum):
    """CasADi with IPOPT on the same transcription, from states on a straight line and no forces."""
    stages = problem()
    search = searched_by_ipopt(stages, first_search(stages, stages.straight()), 300, 1e-8)
    assert int(search.result) == Result.CONVERGED
    assert float(search.errors.greatest) < 1e-8
    assert float(search.cost) == pytest.approx(optimum, abs=6e-4)


@needs_ipopt
def test_limits_a_place_and_a_free_duration_have_the_same_optimum_and_multipliers(arm, tmp_path):
    paths = {solver: tmp_path / f"{solver}.npz" for solver in ("interior_point", "ipopt")}
    own, motion = (kj.optimize(reach(arm), solver=solver, checkpoint=path) for solver, path in paths.items())
    own_search, search = (np.load(path) for path in paths.values())
    assert bool(motion.converged)
    assert float(motion.errors.greatest) < 1e-7
    assert float(np.abs(motion.u).max()) == pytest.approx(3.0, rel=1e-6)
    assert float(np.abs(motion.tau[:, 0]).max()) == pytest.approx(3.5, rel=1e-6)
    assert float(motion.cost) == pytest.approx(float(own.cost), rel=1e-7)
    assert float(motion.duration) == pytest.approx(float(own.duration), rel=1e-6)
    for field in ("q", "u", "tau"):
        assert relative(getattr(motion, field), getattr(own, field)) < 1e-4
    assert relative(search["|point.multiplier"], own_search["|point.multiplier"]) < 1e-4
    mine, others = ([one[f"|point.{part}.z"] for part in ("stage", "final")] for one in (search, own_search))
    joined = [np.concatenate([np.ravel(each[1] - each[0]) for each in pair]) for pair in (mine, others)]
    assert relative(*joined) < 1e-4
    assert relative(search["|point.final.nu"], own_search["|point.final.nu"]) < 1e-4


@needs_ipopt
def test_what_stands_in_the_way_is_named(arm):
    with pytest.raises(
        kj.OptimizationError, match=r"no step brings it nearer to all limits; the .* at t = .* s is .*, but has to be|jumps"
    ) as caught:
        by_ipopt(reach(arm, tau=(1.0, 5.0), duration=(0.61, 0.65)))
    motion = caught.value.motion
    assert int(motion.result) == Result.INFEASIBLE
    assert float(motion.errors.violation) > 1e-3


@needs_ipopt
def test_iterations_are_used_up(arm):
    with pytest.raises(kj.OptimizationError, match="the iterations are used up"):
        by_ipopt(reach(arm), max_iterations=3)
    motion = by_ipopt(reach(arm), max_iterations=3, throw=False)
    assert int(motion.iterations) == 3
    assert int(motion.result) == Result.RUNNING


@needs_ipopt
def test_an_interrupt_keeps_the_motion_from_which_it_goes_on(arm, tmp_path):
    whole, seen, path = by_ipopt(reach(arm)), [], tmp_path / "search.npz"
    assert int(whole.iterations) > 30

    def stop(motion):
        seen.append(int(motion.iterations))
        if seen[-1] == 30:
            signal.raise_signal(signal.SIGINT)

    # Processes that were started in the background ignore it.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(kj.OptimizationInterrupted) as caught:
            by_ipopt(reach(arm), progress=stop, checkpoint=path)
    finally:
        signal.signal(signal.SIGINT, before)
    assert seen == [10, 20, 30]
    assert int(caught.value.motion.iterations) == 30
    assert 1e-8 < float(caught.value.motion.errors.greatest) < 1.0
    again = by_ipopt(reach(arm), checkpoint=path)
    assert float(again.cost) == pytest.approx(float(whole.cost), rel=1e-7)
    assert 30 < int(again.iterations) < 5 + int(whole.iterations)


@needs_ipopt
def test_exceptions_of_callbacks_come_out(arm):
    def fail(motion):
        raise LookupError(f"at {int(motion.iterations)}")

    with pytest.raises(LookupError, match="at 10"):
        by_ipopt(reach(arm), progress=fail)


@needs_ipopt
def test_options_of_ipopt_are_its_own(arm, capfd):
    by_ipopt(reach(arm), ipopt_options={"print_level": 3, "mu_strategy": "adaptive", "max_wall_time": 60})
    assert "EXIT: Optimal Solution Found." in capfd.readouterr().out
    for options, message in (
        ({"colour": "red"}, "IPOPT has no option 'colour', or it cannot be 'red'"),
        ({"mu_strategy": "bold"}, "IPOPT has no option 'mu_strategy', or it cannot be 'bold'"),
        ({"tol": 1e-3}, "IPOPT's option 'tol' is the argument `tolerance`"),
        ({"max_iter": 10}, "IPOPT's option 'max_iter' is the argument `max_iterations`"),
    ):
        with pytest.raises(ValueError, match=message):
            by_ipopt(reach(arm), ipopt_options=options)


@needs_ipopt
def test_nothing_is_compiled_again_for_other_numbers(arm):
    first = by_ipopt(reach(arm))
    count = Traced.times
    assert count > 0
    other = by_ipopt(reach(arm.replace(mass=1.1 * arm.mass), weight=50.0, goal=GOAL + 0.1))
    assert Traced.times == count
    assert float(other.cost) != pytest.approx(float(first.cost), rel=1e-3)


def test_what_no_solver_takes_is_refused(arm, monkeypatch):
    with pytest.raises(ValueError, match="solver is 'snopt'; use 'interior_point' or 'ipopt'"):
        kj.optimize(reach(arm), solver="snopt")
    with pytest.raises(ValueError, match="ipopt_options are given, but solver is 'interior_point'"):
        kj.optimize(reach(arm), ipopt_options={"print_level": 5})
    monkeypatch.setitem(sys.modules, "cyipopt", None)
    with pytest.raises(SolverNotInstalledError, match=r"needs the package cyipopt: pip install 'kanejax\[ipopt\]'"):
        by_ipopt(reach(arm))


class Bent(AbstractStages):
    """Three stages in which everything depends on everything."""

    def stage(self, k, x, w):
        v = jnp.concatenate((x, w)) + 0.1 * k.astype(x.dtype)
        return StageValues(jnp.sin(v[:2] * v[2]), jnp.sum(v**4), jnp.stack((v[0] * v[2], v[1] ** 3, v[0] * v[1])))

    def final(self, x):
        return FinalValues(x[0] ** 3 * x[1], jnp.exp(x[:1]) * x[1:])

    def bounds(self):
        return Bounds(jnp.zeros((2, 3, 6)), jnp.zeros((2, 3)))


def test_places_and_values_of_derivatives_against_differences():
    rng, stages = np.random.default_rng(0), Bent()
    path = Path(jnp.asarray(rng.normal(size=(4, 2))), jnp.asarray(rng.normal(size=(3, 1))))
    layout = Layout.of(path, stages.bounds())
    v, weights, of_cost = layout.flat(path), rng.normal(size=layout.constraints), 0.7
    assert (len(v), len(weights)) == (11, 16)
    parts = [jnp.asarray(each) for each in layout.by_kind(weights)]
    found, all_of = eqx.filter_jit(values), eqx.filter_jit(derivatives)

    def constraint_values(v):
        path = layout.path(v, v.dtype)
        return layout.constraint_values(path, *found(stages, path))

    def slopes(v):
        """Of cost and Lagrangian, and the Jacobian."""
        at = jax.device_get(all_of(stages, layout.path(v, v.dtype), jnp.ones(()), *parts))
        gradient, jacobian = layout.gradient(at), scipy.sparse.coo_array((layout.jacobian(at), layout.jacobian_places()), (16, 11))
        return gradient, jacobian.toarray()

    def difference(function):
        return np.stack([(function(v + e) - function(v - e)) / 2e-6 for e in 1e-6 * np.eye(11)], -1)

    def cost(v):
        stage, final = found(stages, layout.path(v, v.dtype))
        return np.sum(stage.cost) + np.asarray(final.cost)

    def lagrangian_slope(v):
        gradient, jacobian = slopes(v)
        return of_cost * gradient + weights @ jacobian

    gradient, jacobian = slopes(v)
    at = jax.device_get(all_of(stages, path, jnp.asarray(of_cost), *parts))
    rows, columns = layout.hessian_places()
    assert np.all(rows >= columns)
    lower = scipy.sparse.coo_array((layout.hessian(at), (rows, columns)), (11, 11)).toarray()
    assert relative(gradient, difference(cost)) < 1e-8
    assert relative(jacobian, difference(constraint_values)) < 1e-8
    assert relative(lower + np.tril(lower, -1).T, difference(lagrangian_slope)) < 1e-8
