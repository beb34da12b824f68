"""Where the search of the simulation stage is: all that goes from iteration to iteration, for many starts side by side."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from kanejax._simulation_fit.levenberg_marquardt import FIRST_DAMPING
from kanejax._simulation_fit.simulation_fit import Iteration

# The weight of gaps [s/rad], relative to that of one standard deviation, at first, and by how much it grows.
LOOSE, TIGHTEN = 1.0, 30.0


class Place(NamedTuple):
    """What the residuals are functions of: everything but numbers that stay the same.

    Attributes:
        thetas: free coordinates.
        states: of the pieces.
        tightness: weight of the gaps.
        sigma: standard deviations of the outputs.
    """

    thetas: Float[Array, "starts m"]
    states: Float[Array, "starts pieces nx"]
    tightness: Float[np.ndarray, " starts"]
    sigma: Float[Array, "noutput nv"]


class State(NamedTuple):
    """All that goes from iteration to iteration.

    Attributes:
        window: number of the length of the windows, from 0 on; -1 before the first.
        round: of standard deviations, with windows of this length.
        used: iterations with windows of this length.
        place: where it is.
        dampings: of the next step.
        factors: by which gaps are to weigh more in the next step.
        failures: steps in a row that were not taken.
        is_over: which starts have come to an end in this round.
        converged: which of them have come to a minimum.
        reasons: for their end, in words.
        settled: where a round ended at a minimum.
        has_settled: whether one did.
        samples: states at all samples, from which the pieces of the next windows start; none with the last windows.
        history: of the iterations; not a number stands for windows as long as the runs.
    """

    window: int
    round: int
    used: int
    place: Place
    dampings: Float[np.ndarray, " starts"]
    factors: Float[np.ndarray, " starts"]
    failures: Int[np.ndarray, " starts"]
    is_over: Bool[np.ndarray, " starts"]
    converged: Bool[np.ndarray, " starts"]
    reasons: np.ndarray
    settled: Place
    has_settled: bool
    samples: Float[np.ndarray, "starts n nx"]
    history: Float[np.ndarray, "iterations 6"]

    @property
    def iterations(self) -> tuple[Iteration, ...]:
        """The history, one by one."""
        rows = self.history.tolist()
        return tuple(
            Iteration(None if np.isnan(window) else window, int(number), cost, gap, damping, bool(taken))
            for window, number, cost, gap, damping, taken in rows
        )


def first_state(thetas: Float[Array, "starts m"], states: Float[np.ndarray, "n nx"], sigma: Float[Array, "noutput nv"]) -> State:
    """Before the first windows, with recorded states at all samples."""
    count = len(thetas)
    place = Place(thetas, jnp.zeros((count, 0, states.shape[1]), thetas.dtype), np.full(count, LOOSE), sigma)
    return State(
        window=-1,
        round=0,
        used=0,
        place=place,
        **_at_begin(count),
        settled=place,
        has_settled=False,
        samples=np.repeat(states[None], count, 0),
        history=np.zeros((0, 6)),
    )


def in_round(state: State, place: Place) -> State:
    """At the beginning of a round, at this place."""
    return state._replace(place=place, **_at_begin(len(place.thetas)))


def _at_begin(count: int) -> dict[str, np.ndarray]:
    return {
        "dampings": np.full(count, FIRST_DAMPING),
        "factors": np.full(count, TIGHTEN),
        "failures": np.zeros(count, int),
        "is_over": np.zeros(count, bool),
        "converged": np.zeros(count, bool),
        "reasons": np.full(count, "not begun"),
    }


def with_ends(state: State, ends: dict[int, tuple[bool, str]]) -> State:
    """With starts that have come to an end: whether at a minimum, and why."""
    is_over, converged, reasons = state.is_over.copy(), state.converged.copy(), state.reasons.tolist()
    for start, (at_minimum, reason) in ends.items():
        is_over[start], converged[start], reasons[start] = True, at_minimum, reason
    return state._replace(is_over=is_over, converged=converged, reasons=np.array(reasons))


def on_device(place: Place) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """The arguments of the simulation."""
    return place.thetas, place.states, place.sigma, jnp.asarray(place.tightness, place.thetas.dtype)
