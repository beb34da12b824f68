"""IPOPT itself (Waechter and Biegler 2006) on the same stages, by cyipopt: for single problems.

It gets exact first and second derivatives, of each stage as one block of a sparse matrix. With the cost scaled as in
`interior_point`, nothing else scaled, and exact bounds, its errors are those of `Errors`.
"""

import importlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from kanejax._optimal_control import barrier
from kanejax._optimal_control.barrier import Slacks
from kanejax._optimal_control.search import Here, Point, Result, Search, errors_at
from kanejax._optimal_control.sparse import Layout
from kanejax._optimal_control.stages import AbstractStages, Bounds, Derivatives, Path, bounded, derivatives, values

_OPTIONS = {"print_level": 0, "sb": "yes", "nlp_scaling_method": "user-scaling", "bound_relax_factor": 0.0}
_ARGUMENTS = {"tol": "tolerance", "max_iter": "max_iterations"}
# IPOPT tells one multiplier of a row for both of its bounds: the error of a multiplier that vanishes counts in `Errors` times the
# distance to the bound. Where IPOPT has converged, they may be above the tolerance by this factor.
_AGREEMENT = 100.0
# Of its return codes (IpReturnCodes_inc.h); those below the last are of faults, such as too little memory.
_SOLVED, _INFEASIBLE, _USED_UP, _INVALID_OPTION, _LAST_OF_SEARCHES = 0, 2, (-1, -4, -5), -12, -13

Watch = Callable[[Search], None]


class SearchInterrupted(KeyboardInterrupt):
    """Ctrl-C; `search` is where IPOPT was."""

    def __init__(self, search: Search) -> None:
        """Keep the search."""
        super().__init__("interrupted; the attribute `search` is where it was")
        self.search = search


def searched_by_ipopt(
    stages: AbstractStages,
    search: Search,
    iterations: int,
    tolerance: float | jax.Array,
    *,
    options: Mapping[str, Any] | None = None,
    watch: Watch | None = None,
    every: int = 10,
) -> Search:
    """IPOPT's search from a path to its end.

    Args:
        stages: the problem.
        search: whose path is the guess, and whose scale is that of the cost.
        iterations: at most.
        tolerance: to which the conditions of optimality hold in the end.
        options: IPOPT's own.
        watch: called with the search so far.
        every: after so many iterations.

    Raises:
        ImportError: cyipopt is not installed.
        SearchInterrupted: on Ctrl-C.
        ValueError: IPOPT does not take an option.
        RuntimeError: IPOPT failed for another reason than the problem.
    """
    cyipopt: Any = importlib.import_module("cyipopt")
    run, options = _Run(stages, search, watch, every), options or {}
    # Compiled before IPOPT's clock runs.
    run.search()
    run.objective(run.reached.v)
    layout, bounds = run.layout, run.bounds
    limits = *layout.of_variables(*bounds), *layout.of_constraints(0.0, *bounds)
    run.problem = cyipopt.Problem(layout.variables, layout.constraints, run, *limits)
    run.problem.set_problem_scaling(run.scale)
    own = {"tol": float(tolerance), "max_iter": int(iterations)}
    _set_options(run.problem, own, _warm(search) | dict(options))
    v, info = run.problem.solve(run.reached.v, run.reached.of_constraints, *run.reached.of_bounds)
    if isinstance(run.error, KeyboardInterrupt):
        raise SearchInterrupted(run.search()) from run.error
    if run.error is not None:
        raise run.error
    if info["status"] == _INVALID_OPTION:
        raise ValueError(f"IPOPT does not take these options together, or lacks what they ask for: {dict(options)}")
    if info["status"] < _LAST_OF_SEARCHES:
        raise RuntimeError(f"IPOPT failed: {info['status_msg'].decode()}")
    run.reached = _Iterate(v, info["mult_g"], np.stack((info["mult_x_L"], info["mult_x_U"])))
    found = run.search()
    return found._replace(result=jnp.asarray(int(_result(info["status"], found, float(tolerance))), jnp.int32))


def _warm(search: Search) -> dict[str, Any]:
    """Options by which IPOPT goes on where another search ended."""
    pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
    near = {f"warm_start_{each}": 1e-9 for each in pushes}
    return {"warm_start_init_point": "yes", "mu_init": float(search.mu)} | near if int(search.iterations) > 0 else {}


def _result(status: int, search: Search, tolerance: float) -> Result:
    """By the errors at the end, and IPOPT's word on why it ended."""
    if float(search.errors.greatest) <= tolerance * (_AGREEMENT if status == _SOLVED else 1.0):
        return Result.CONVERGED
    if status in _USED_UP:
        return Result.RUNNING
    is_violated = float(search.errors.violation) > tolerance
    return Result.INFEASIBLE if status == _INFEASIBLE or is_violated else Result.STALLED


def _set_options(problem: Any, own: dict[str, Any], options: dict[str, Any]) -> None:
    for name, value in (_OPTIONS | options | own).items():
        if name in options and name in own:
            raise ValueError(f"IPOPT's option {name!r} is the argument `{_ARGUMENTS[name]}`")
        if not _is_set(problem, name, value):
            where = "see https://coin-or.github.io/Ipopt/OPTIONS.html"
            raise ValueError(f"IPOPT has no option {name!r}, or it cannot be {value!r}; {where}")


def _is_set(problem: Any, name: str, value: Any) -> bool:
    """Whether IPOPT takes an option, which is a word, a whole number, or a number."""
    if isinstance(value, bool):
        value = "yes" if value else "no"
    kinds = (str,) if isinstance(value, str) else (float,) if isinstance(value, float) else (int, float)
    for kind in kinds:
        try:
            problem.add_option(name, kind(value))
        except (TypeError, ValueError):
            continue
        return True
    return False


class _Iterate(NamedTuple):
    """Variables, and multipliers of the constraints and of the variables' lower and upper bounds, of the cost without scale."""

    v: np.ndarray
    of_constraints: np.ndarray
    of_bounds: np.ndarray


class _Run:
    """What cyipopt calls during one search.

    An exception in it is kept, and all numbers after it are not numbers, until IPOPT can be told to stop.

    Attributes:
        problem: cyipopt's.
        error: the exception.
        reached: where it is.
    """

    problem: Any
    error: BaseException | None

    def __init__(self, stages: AbstractStages, search: Search, watch: Watch | None, every: int) -> None:
        path = search.point.path
        self.stages, self.first, self.watch, self.every = stages, search, watch, every
        self.bounds, self.scale, self.dtype = stages.bounds(), float(search.scale), path.x.dtype
        self.layout = Layout.of(path, self.bounds)
        self.places = self.layout.jacobian_places(), self.layout.hessian_places()
        self.error, self.mu, self.iterations = None, float(search.mu), 0
        self.reached = self._iterate(search.point)
        self._values_at = _kept(self._values)
        self._slopes_at = _kept(lambda v: self._derivatives(v, np.zeros(self.layout.constraints), 1.0))

    def objective(self, v: np.ndarray) -> float:
        """The cost."""

        def found() -> Any:
            stage, final = self._values_at(v)
            return np.sum(stage.cost) + final.cost

        return float(self._unless_stopped(found, ()))

    def constraints(self, v: np.ndarray) -> np.ndarray:
        """Gaps between the stages, and rows."""
        found = lambda: self.layout.constraint_values(self._path(v), *self._values_at(v))  # noqa: E731
        return self._unless_stopped(found, self.layout.constraints)

    def gradient(self, v: np.ndarray) -> np.ndarray:
        """Of the cost."""
        return self._unless_stopped(lambda: self.layout.gradient(self._slopes_at(v)), self.layout.variables)

    def jacobianstructure(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the constraints' derivatives."""
        return self.places[0]

    def jacobian(self, v: np.ndarray) -> np.ndarray:
        """Derivatives of the constraints."""
        return self._unless_stopped(lambda: self.layout.jacobian(self._slopes_at(v)), self.places[0][0].shape)

    def hessianstructure(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the Lagrangian's second derivatives."""
        return self.places[1]

    def hessian(self, v: np.ndarray, of_constraints: np.ndarray, of_cost: float) -> np.ndarray:
        """Second derivatives of the Lagrangian."""
        found = lambda: self.layout.hessian(self._derivatives(v, of_constraints, of_cost))  # noqa: E731
        return self._unless_stopped(found, self.places[1][0].shape)

    def intermediate(self, _mode: int, iteration: int, _cost: float, _violation: float, _slope: float, mu: float, *_: Any) -> bool:
        """After each iteration: whether to go on."""

        def found() -> bool:
            now = self.problem.get_current_iterate()
            if now is not None:
                self.reached = _Iterate(now["x"], now["mult_g"], np.stack((now["mult_x_L"], now["mult_x_U"])))
            self.mu, self.iterations = mu, iteration
            if self.watch is not None and iteration > 0 and iteration % self.every == 0:
                self.watch(self.search())
            return True

        self._unless_stopped(found, ())
        return self.error is None

    def search(self) -> Search:
        """Where it is."""
        now, layout, first = self.reached, self.layout, self.first
        at = self._derivatives(now.v, self.scale * now.of_constraints, self.scale)
        multipliers = *layout.by_kind(now.of_constraints), *layout.by_stage(now.of_bounds)
        scaled = [jnp.asarray(self.scale * each, self.dtype) for each in multipliers]
        iterations = first.iterations + jnp.asarray(self.iterations, first.iterations.dtype)
        first = first._replace(mu=jnp.asarray(self.mu, self.dtype), iterations=iterations)
        return _measured(first, at, self._path(now.v), self.bounds, *scaled)

    def _iterate(self, point: Point) -> _Iterate:
        multipliers = barrier.multiplier(point.stage), barrier.multiplier(point.final)
        of_constraints = self.layout.of_constraints(point.multiplier, *multipliers)
        of_bounds = self.layout.of_variables(point.stage.z, point.final.z)
        return _Iterate(self.layout.flat(point.path), of_constraints / self.scale, of_bounds / self.scale)

    def _path(self, v: np.ndarray) -> Path:
        return self.layout.path(v, self.dtype)

    def _values(self, v: np.ndarray) -> tuple:
        return jax.device_get(_values(self.stages, self._path(v)))

    def _derivatives(self, v: np.ndarray, of_constraints: np.ndarray, of_cost: float) -> Derivatives:
        weights = [jnp.asarray(each, self.dtype) for each in (of_cost, *self.layout.by_kind(of_constraints))]
        return jax.device_get(_derivatives(self.stages, self._path(v), *weights))

    def _unless_stopped(self, found: Callable[[], Any], shape: tuple | int) -> np.ndarray:
        if self.error is None:
            try:
                return np.asarray(found(), float)
            except BaseException as error:
                self.error = error
        return np.full(shape, np.nan)


def _kept(function: Callable[[np.ndarray], Any]) -> Callable[[np.ndarray], Any]:
    """With its last value, for IPOPT asks for one thing after another at the same variables."""
    last: list = [None, None]

    def found(v: np.ndarray) -> Any:
        if not np.array_equal(last[0], v):
            last[:] = v.copy(), function(v)
        return last[1]

    return found


@eqx.filter_jit
def _measured(
    search: Search,
    at: Derivatives,
    path: Path,
    bounds: Bounds,
    multiplier: jax.Array,
    of_rows: jax.Array,
    of_final: jax.Array,
    of_stages: jax.Array,
    of_last: jax.Array,
) -> Search:
    """A search that has come to a path and these multipliers: of gaps, rows, and the variables' bounds."""
    y, final_y = bounded(path, at.values.rows, at.final.rows)
    slacks = _slacks(y, bounds.stage, of_stages, of_rows), _slacks(final_y, bounds.final, of_last, of_final)
    point = Point(path, multiplier, *slacks)
    errors = errors_at(Here(at, y, final_y, bounds), point)
    return search._replace(point=point, errors=errors, cost=(jnp.sum(at.values.cost) + at.final.cost) / search.scale)


def _slacks(y: jax.Array, bounds: jax.Array, of_bounds: jax.Array, of_rows: jax.Array) -> Slacks:
    """Positive ones, with the multipliers of the variables' lower and upper bounds and those of the rows."""
    limit = barrier.is_limit(bounds)
    s = jnp.where(limit, jnp.maximum(barrier.room(y, bounds), jnp.finfo(y.dtype).eps), jnp.ones_like(bounds))
    z = jnp.concatenate((of_bounds, jnp.maximum(jnp.stack((-of_rows, of_rows)), 0.0)), -1)
    nu = jnp.concatenate((of_bounds[1] - of_bounds[0], of_rows), -1)
    is_equation = barrier.is_equation(bounds)
    return Slacks(s, jnp.where(limit, z, jnp.zeros_like(z)), jnp.where(is_equation, nu, jnp.zeros_like(nu)))


_values = eqx.filter_jit(values)
_derivatives = eqx.filter_jit(derivatives)
