"""The vectors and tables of Nie 1988, chapter II, against the library's partial velocities and their rates."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest

import kanejax as kj
from tests.thesis.hand import contributions, misprints, torque, vectors
from tests.thesis.hand.arm import LINKS, Symbols
from tests.thesis.hand.cases import Arm, States, random_arm, random_states
from tests.thesis.hand.equations import evaluate, instead, parse
from tests.thesis.hand.errata import stated
from tests.thesis.hand.torque import speed_matrix

CHAPTER_2 = parse(
    vectors.PARTIAL_ANGULAR,
    vectors.PARTIAL_LINEAR,
    vectors.VELOCITIES,
    vectors.ANGULAR_ACCELERATIONS,
    vectors.ACCELERATIONS,
    vectors.WEIGHTS,
    vectors.OTHER_SPEEDS,
    contributions.LINKS,
    contributions.RIGHT_SIDES,
)
STATED = stated()
ARM, STATES = random_arm(), random_states(300)


class Motion(NamedTuple):
    """What the library says of the links in world components: rotations, partial velocities, their rates; mass matrix."""

    rotation: Any
    partial: kj.PartialVelocities
    rates: kj.PartialVelocities
    mass: Any


def motion(arm: Arm, states: States) -> Motion:
    @jax.jit
    @jax.vmap
    def at(q: jax.Array, u: jax.Array) -> Motion:
        return Motion(
            kj.poses(arm.model, q).rotation,
            kj.partial_velocities(arm.model, q),
            kj.partial_velocity_rates(arm.model, q, u),
            kj.mass_matrix(arm.model, q),
        )

    return jax.tree.map(np.asarray, at(states.q, states.q_dot))


def columns(pattern: str, values: np.ndarray) -> Symbols:
    """Components of the links' vectors, (n, 6, 3), by name; `pattern` has * for the link and the component."""
    return {pattern.replace("*", f"{link}{i + 1}"): values[:, k, i] for k, link in enumerate(LINKS) for i in range(3)}


def library(arm: Arm, states: States) -> Symbols:
    """What the equations of chapter II should give, by their names."""
    at = motion(arm, states)
    of_mass_centre = at.rotation[:, [0, 1, 2, 3, 4, 4]]
    into = {"w": at.rotation, "v": of_mass_centre}
    # Partial velocities for the speeds of (2.18), and accelerations, in world components.
    per_speed = np.linalg.inv(speed_matrix(states.q))
    w, v = (np.einsum("nkrc,nrs->nksc", partial, per_speed) for partial in at.partial)
    velocity = np.einsum("nkrc,nr->nkc", at.partial.linear, states.q_dot)
    alpha, a = (
        np.einsum("nkrc,nr->nkc", partial, states.q_ddot) + np.einsum("nkrc,nr->nkc", rate, states.q_dot)
        for partial, rate in zip(at.partial, at.rates, strict=True)
    )
    values: Symbols = {}
    for r in range(6):
        for symbol, partial in (("w", w), ("v", v)):
            values |= columns(f"{symbol}{r + 1}_*", np.einsum("nkji,nkj->nki", into[symbol], partial[:, :, r]))
    weight = np.asarray(arm.model.mass)[:, None] * np.asarray(arm.model.gravity)
    for symbol, vector, turn in (("v", velocity, "v"), ("alpha", alpha, "w"), ("a", a, "v")):
        values |= columns(f"{symbol}_*", np.einsum("nkji,nkj->nki", into[turn], vector))
    values |= columns("G_*", np.einsum("nkji,kj->nki", of_mass_centre, weight))
    values |= inertia_forces(arm, states, at, w, v, alpha, a) | left_sides(states, at, alpha)
    return values | other(arm, states, at)


def inertia_forces(arm: Arm, states: States, at: Motion, w: np.ndarray, v: np.ndarray, alpha: np.ndarray, a: np.ndarray) -> Symbols:
    """Contributions of the links to the generalized inertia forces by their definition, (2.47) to (2.49)."""
    inertia = np.einsum("nkij,kjl,nkml->nkim", at.rotation, arm.model.central_inertia, at.rotation)
    angular = np.einsum("nkrc,nr->nkc", at.partial.angular, states.q_dot)
    moment = np.einsum("nkij,nkj->nki", inertia, alpha) + np.cross(angular, np.einsum("nkij,nkj->nki", inertia, angular))
    force = np.asarray(arm.model.mass)[:, None] * a
    contribution = -np.einsum("nkrc,nkc->nrk", w, moment) - np.einsum("nkrc,nkc->nrk", v, force)
    return {f"KI{r + 1}_{link}": contribution[:, r, k] for r in range(6) for k, link in enumerate(LINKS)}


def left_sides(states: States, at: Motion, alpha: np.ndarray) -> Symbols:
    """Sums of X_rs u_s' in (2.58), from the mass matrix. The rates of u1 to u3, components of w^C in C, are those of alpha^C."""
    rates = np.concatenate((np.einsum("nji,nj->ni", at.rotation[:, 2], alpha[:, 2]), states.q_ddot[:, 3:]), -1)
    per_speed = np.linalg.inv(speed_matrix(states.q))
    total = -np.einsum("nrs,nrt,ntx,nx->ns", per_speed, at.mass, per_speed, rates)
    return {f"RHS{r + 1}": total[:, r] for r in range(6)}


def other(arm: Arm, states: States, at: Motion) -> Symbols:
    """The velocity of the point P, and angular velocities for other generalized speeds."""
    angular = np.einsum("nkji,nkrj,nr->nki", at.rotation, at.partial.angular, states.q_dot)
    point = np.cross(angular[:, 2], np.array([arm.symbols["L1"], 0, arm.symbols["L33"]]))
    components = {"first_B1": (1, 0), "second_A2": (0, 1), "second_B3": (1, 2), "second_C3": (2, 2), "third_B3": (1, 2)}
    return {f"v_P{i + 1}": point[:, i] for i in range(3)} | {name: angular[:, k, i] for name, (k, i) in components.items()}


@pytest.fixture(scope="module")
def expected() -> Symbols:
    return library(ARM, STATES)


def by_hand(printed: Mapping[str, str]) -> Symbols:
    known = torque.variables(ARM.symbols, *STATES)
    return evaluate(instead(CHAPTER_2, printed), known)


def deviation(values: Symbols, expected: Symbols, name: str) -> float:
    """Largest difference over the largest magnitude of the vector, or of the scalar."""
    stem = name.rstrip("123") if "_" in name else name
    scale = max(np.abs(value).max() for key, value in expected.items() if key.startswith(stem))
    return float(np.abs(values[name] - expected[name]).max() / scale)


def test_all_components(expected):
    values = by_hand({})
    deviations = {name: deviation(values, expected, name) for name in CHAPTER_2}
    assert max(deviations.values()) < 1e-12, max(deviations.items(), key=lambda item: item[1])
    # What is not listed is zero; in the chapter's terms, no speed moves the point in that direction.
    for name in set(expected) - set(CHAPTER_2):
        assert np.abs(expected[name]).max() < 1e-12, name


@pytest.mark.parametrize("name", misprints.TEXT)
def test_each_correction_is_needed(name, expected):
    """As printed, each differs by what experiments/errata.md says."""
    printed = misprints.TEXT[name]
    values = by_hand(printed)
    worst = max(deviation(values, expected, component) for component in printed)
    np.testing.assert_allclose(worst, STATED[name], rtol=0.01)
    assert worst > 0.01
