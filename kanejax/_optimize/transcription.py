"""A motion task as a problem of optimal control in discrete time.

The state of a node is the displacement of the coordinates from those of the guess, the speeds, what is remembered of the step
before, and the duration where it is sought. What is sought at each stage are accelerations or forces, constant during the step.
"""

from typing import Any, final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._optimal_control.composition import chained_expansion, composed_expansion
from kanejax._optimal_control.stages import AbstractStages, Bounds, Expansion, FinalValues, Path, StageValues
from kanejax._optimize.curvature import forward_curvature, forward_jacobian
from kanejax._optimize.displacement import displaced, displacement
from kanejax._optimize.moment import Constraint, Cost, Moment
from kanejax._optimize.runge_kutta import Linear, runge_kutta
from kanejax._optimize.state import State, Step
from kanejax._optimize.steps import DYNAMICS, scheme, step, step_with
from kanejax._optimize.task import MotionTask


@final
class MotionStages(AbstractStages):
    """The stages of a motion task.

    Attributes:
        task: what is asked for.
        reference: coordinates from which displacements are counted, those of the guess.
    """

    task: MotionTask
    reference: Float[Array, "nodes nq"]

    def state(self, k: jax.Array, x: Float[Array, " nx"]) -> State:
        """What the numbers of node k stand for."""
        task, nv = self.task, self.task.model.nv
        parts = list(jnp.split(x[: nv * (2 + len(self.task.remembers))], 2 + len(self.task.remembers)))
        q = displaced(task.model.tree, self.reference[k], parts.pop(0))
        u = parts.pop(0)
        known = dict(zip(self.task.remembers, parts, strict=True))
        return State(q, u, known.get("tau"), known.get("u_dot"), x[-1] if self.task.is_free_in_time else task.duration[0])

    def numbers(self, k: jax.Array, state: State) -> Float[Array, " nx"]:
        """The numbers that stand for a state at node k."""
        parts = [displacement(self.task.model.tree, self.reference[k], state.q), state.u]
        parts += [getattr(state, what) for what in self.task.remembers]
        return jnp.concatenate((*parts, state.duration[None]) if self.task.is_free_in_time else parts)

    def stage(self, k: jax.Array, x: jax.Array, w: jax.Array) -> StageValues:
        """One step."""
        before, h = self._start(k, x)
        return self._values(k, before, step(self.task, before, w, k.astype(h.dtype) * h, h), h)

    def expansion(self, k: jax.Array, v: jax.Array, weights: StageValues) -> Expansion:
        """By the derivatives of the dynamics, where coordinates change by their speeds or a step asks for them once."""
        if scheme(self.task) is not None:
            return self._composed_expansion(k, v, weights)
        if self.task.model.nq == self.task.model.nv:
            return self._chained_expansion(k, v, weights)
        return super().expansion(k, v, weights)

    def _composed_expansion(self, k: jax.Array, v: jax.Array, weights: StageValues) -> Expansion:
        task, nx, way = self.task, len(weights.next), scheme(self.task)
        assert way is not None

        def place(v: jax.Array) -> tuple[jax.Array, jax.Array]:
            before, h = self._start(k, v[:nx])
            return way.place(task, before, v[nx:], h)

        def arguments(v: jax.Array) -> jax.Array:
            there, u = place(v)
            return jnp.concatenate((displacement(task.model.tree, q, there), u, v[nx:]))

        def outer(v: jax.Array, found: jax.Array) -> StageValues:
            before, h = self._start(k, v[:nx])
            return self._values(k, before, step_with(task, before, v[nx:], found, k.astype(h.dtype) * h, h), h)

        q, u = place(v)
        curved = DYNAMICS[task.dynamics][1]
        return composed_expansion(outer, arguments, lambda weigh: curved(task.model, q, u, v[nx:], weigh), v, weights)

    def _chained_expansion(self, k: jax.Array, v: jax.Array, weights: StageValues) -> Expansion:
        task, nx = self.task, len(weights.next)
        before, h = self._start(k, v[:nx])
        moments = step(task, before, v[nx:], k.astype(h.dtype) * h, h).moments
        z = jnp.concatenate((moments.q, moments.u, moments.tau), 1)

        def inner(each: tuple, weights: jax.Array) -> jax.Array:
            z, u_dot, jacobian = each
            q, u, _ = jnp.split(z, 3)
            return forward_curvature(task.model, q, u, u_dot, jacobian, weights)

        jacobian = jax.vmap(lambda q, u, u_dot: forward_jacobian(task.model, q, u, u_dot))(moments.q, moments.u, moments.u_dot)

        def chain(v: jax.Array, added: jax.Array) -> tuple[StageValues, jax.Array]:
            before, h = self._start(k, v[:nx])
            linear = Linear(z, moments.u_dot + added, jacobian)
            taken = runge_kutta(task, before, v[nx:], k.astype(h.dtype) * h, h, linear)
            return self._values(k, before, taken, h), jnp.concatenate((taken.moments.q, taken.moments.u, taken.moments.tau), 1)

        return chained_expansion(chain, (z, moments.u_dot, jacobian), inner, v, moments.u_dot.shape, weights)

    def _start(self, k: jax.Array, x: jax.Array) -> tuple[State, jax.Array]:
        """State k, and the length of the step."""
        before = self.state(k, x)
        return before, before.duration / self.task.steps

    def _values(self, k: jax.Array, before: State, step: Step, h: jax.Array) -> StageValues:
        rates = _rates(before, step.moment, h)
        moment = step.moment._replace(**rates)
        after = State(step.q, step.u, moment.tau, moment.u_dot, before.duration)
        cost = sum(self._cost_along(step, rates, h).values(), jnp.zeros((), h.dtype))
        rows = [*self._limited(moment), *(_array(one, self.task.model, moment) for one in self._along())]
        return StageValues(self.numbers(k + 1, after), cost, _joined(rows, h.dtype))

    def final(self, x: jax.Array) -> FinalValues:
        """The last node."""
        task = self.task
        state = self.state(jnp.asarray(task.steps), x)
        moment = Moment(state.duration, state.q, state.u)
        cost = sum(self._cost_at_end(moment).values(), jnp.zeros((), x.dtype))
        rows = [_array(one, task.model, moment) for one in self._at_end()]
        return FinalValues(cost, _joined(rows, x.dtype))

    def bounds(self) -> Bounds:
        """Limits, and boundary values in place of them at the first and the last node."""
        task, dtype = self.task, self.task.model.dtype
        limits, nv = task.limits, task.model.nv
        anything = jnp.stack((jnp.full(nv, -jnp.inf, dtype), jnp.full(nv, jnp.inf, dtype)))
        own = [anything] * len(task.remembers) + ([task.duration[:, None]] if task.is_free_in_time else [])
        sought, speeds = limits.u_dot if task.dynamics == "inverse" else limits.tau, limits.u
        sought, speeds = (anything if each is None else each for each in (sought, speeds))
        other = [*self._limits_of_rows(), *(_limits(one, self._size(one, final=False)) for one in self._along())]
        offset = self.offset()
        nodes = [jnp.concatenate((limits.q - offset[k][None], speeds, *own), 1) for k in (0, task.steps)]
        middle = jnp.broadcast_to(limits.q[:, None] - offset[None], (2, task.steps + 1, nv))[:, :-1]
        rest = jnp.concatenate((speeds, *own, sought, *other), 1)
        stage = jnp.concatenate((middle, jnp.broadcast_to(rest[:, None], (2, task.steps, rest.shape[1]))), 2)
        stage = stage.at[:, 0, : 2 * nv].set(self._boundary(0, task.start, nodes[0])[:, : 2 * nv])
        final = [self._boundary(task.steps, task.goal, nodes[1])]
        final += [_limits(one, self._size(one, final=True)) for one in self._at_end()]
        return Bounds(stage, jnp.concatenate(final, 1))

    def row_names(self) -> tuple[list[str], list[str]]:
        """What has bounds at a stage and at the last node, in words."""
        task, tree = self.task, self.task.model.tree
        joints = tree.speed_names
        of_nodes = [f"{what} of {joint}" for what in ("coordinate", "speed", *self.task.remembers) for joint in joints]
        of_nodes += ["duration"] * self.task.is_free_in_time
        sought = "acceleration" if task.dynamics == "inverse" else "force"
        stage = of_nodes + [f"{sought} of {joint}" for joint in joints]
        stage += [f"{_WORDS[what]} of {joint}" for what in self._rows_of_limits() for joint in joints]
        stage += [f"{one.name}[{i}]" for one in self._along() for i in range(self._size(one, final=False))]
        final = of_nodes + [f"{one.name}[{i}]" for one in self._at_end() for i in range(self._size(one, final=True))]
        return stage, final

    def costs(self, path: Path) -> dict[str, jax.Array]:
        """Each term over the whole motion."""

        def along(k: jax.Array, x: jax.Array, w: jax.Array) -> dict[str, jax.Array]:
            before, h = self._start(k, x)
            taken = step(self.task, before, w, k.astype(h.dtype) * h, h)
            return self._cost_along(taken, _rates(before, taken.moment, h), h)

        last = self.state(jnp.asarray(self.task.steps), path.x[-1])
        found = jax.vmap(along)(jnp.arange(self.task.steps), path.x[:-1], path.w)
        return jax.tree.map(jnp.sum, found) | self._cost_at_end(Moment(last.duration, last.q, last.u))

    def _cost_along(self, step: Step, rates: dict[str, jax.Array], h: jax.Array) -> dict[str, jax.Array]:
        return {
            term.name: term.weight * h * _mean(term, self.task.model, step, rates) for term in self.task.costs if not term.at_end
        }

    def _cost_at_end(self, moment: Moment) -> dict[str, jax.Array]:
        model, terms = self.task.model, [term for term in self.task.costs if term.at_end]
        return {term.name: term.weight * _number(term, term.function(model, moment)) for term in terms}

    def _along(self) -> list[Constraint]:
        return [one for one in self.task.constraints if not one.at_end]

    def _at_end(self) -> list[Constraint]:
        """Those of the last node: of the goal, of the end, and of the whole motion where they look at the state alone."""
        everywhere = [one for one in self._along() if self._is_of_state(one)]
        return [*self.task.goal.constraints, *(one for one in self.task.constraints if one.at_end), *everywhere]

    def _is_of_state(self, constraint: Constraint) -> bool:
        try:
            self._size(constraint, final=True)
        except (TypeError, AttributeError):
            return False
        return True

    def _size(self, constraint: Constraint, *, final: bool) -> int:
        model = self.task.model
        u = jnp.zeros(model.nv, model.dtype)
        moving = {} if final else {"u_dot": u, "tau": u, "tau_rate": u, "jerk": u}
        moment = Moment(jnp.zeros((), model.dtype), jnp.asarray(self.reference[0]), u, **moving)
        return jax.eval_shape(lambda: _array(constraint, model, moment)).shape[0]

    def _rows_of_limits(self) -> list[str]:
        """Limits that are neither those of a node nor of what is sought."""
        of_forces = "tau" if self.task.dynamics == "inverse" else "u_dot"
        return [what for what in (of_forces, "tau_rate", "jerk", "power") if getattr(self.task.limits, what) is not None]

    def _limits_of_rows(self) -> list[jax.Array]:
        return [getattr(self.task.limits, what) for what in self._rows_of_limits()]

    def _limited(self, moment: Moment) -> list[jax.Array]:
        return [moment.tau * moment.u if what == "power" else getattr(moment, what) for what in self._rows_of_limits()]

    def offset(self) -> Float[Array, "nodes nv"]:
        """Coordinates at the reference by their speeds; zero where limits are not of a coordinate."""
        (plain_v, plain_q), nv = self.task.model.tree.plain_speeds, self.task.model.nv
        return jnp.zeros((len(self.reference), nv), self.reference.dtype).at[:, plain_v].set(self.reference[:, plain_q])

    def _boundary(self, k: int, state: Any, limits: jax.Array) -> jax.Array:
        nv = self.task.model.nv
        if state.q is not None:
            limits = limits.at[:, :nv].set(displacement(self.task.model.tree, self.reference[k], state.q)[None])
        return limits if state.u is None else limits.at[:, nv : 2 * nv].set(state.u[None])


_WORDS = {
    "tau": "force",
    "u_dot": "acceleration",
    "tau_rate": "rate of the force",
    "jerk": "jerk",
    "power": "power",
}


def _mean(term: Cost, model: Any, step: Step, rates: dict) -> jax.Array:
    """Of a cost over a step."""
    found = jax.vmap(lambda at: _number(term, term.function(model, at._replace(**rates))))(step.moments)
    return jnp.sum(step.shares * found)


def _rates(before: State, moment: Moment, h: jax.Array) -> dict[str, jax.Array]:
    """Changes of what is remembered, a unit of time."""
    pairs = (("tau_rate", moment.tau, before.tau), ("jerk", moment.u_dot, before.u_dot))
    return {name: (now - then) / h for name, now, then in pairs if then is not None}


def _number(term: Cost, value: Any) -> jax.Array:
    """The value of a cost, which has to be one number.

    Raises:
        ValueError: it is not.
    """
    if jnp.shape(value) != ():
        raise ValueError(f"cost {term.name!r} returns shape {jnp.shape(value)}; it has to return one number")
    return jnp.asarray(value)


def _joined(parts: list[jax.Array], dtype: jnp.dtype) -> jax.Array:
    return jnp.concatenate(parts) if parts else jnp.zeros(0, dtype)


def _array(constraint: Constraint, model: Any, moment: Moment) -> jax.Array:
    """The values of a constraint, which have one axis."""
    value = jnp.asarray(constraint.function(model, moment))
    if value.ndim > 1:
        raise ValueError(f"constraint {constraint.name!r} returns shape {value.shape}; it has to return a number or one axis")
    return jnp.atleast_1d(value)


def _limits(constraint: Constraint, size: int) -> jax.Array:
    for name, value in (("lower", constraint.lower), ("upper", constraint.upper)):
        if value.shape not in ((), (size,)):
            shapes = f"has shape {value.shape}, but its function returns ({size},)"
            raise ValueError(f"{name} of constraint {constraint.name!r} {shapes}")
    return jnp.stack([jnp.broadcast_to(value, (size,)) for value in (constraint.lower, constraint.upper)])
