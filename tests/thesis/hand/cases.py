"""Arms and states at which the derivation by hand and the library are compared."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import kanejax as kj
from kanejax.robots import intelledex_605
from tests.thesis.hand.arm import OMITTED, Symbols, parameters

# L33, L43, L52 and L63 [m], which Table 3 leaves out, each of a size that matters.
LENGTHS = (0.05, 0.08, 0.03, 0.12)


class Arm(NamedTuple):
    """The same arm for both: parameters by the thesis's names, and a model."""

    symbols: Symbols
    model: kj.Model


class States(NamedTuple):
    """Coordinates [rad] with two derivatives, (n, 6) each."""

    q: np.ndarray
    q_dot: np.ndarray
    q_ddot: np.ndarray


def table_3(omitted: Any = (0.0, 0.0, 0.0, 0.0)) -> Arm:
    """The arm of Table 3, with the lengths that it leaves out."""
    lengths = {name.lower(): length for name, length in zip(OMITTED, omitted, strict=True)}
    return Arm(parameters(omitted), intelledex_605(**lengths))


def random_arm(seed: int = 0) -> Arm:
    """An arm with all lengths and no two equal moments of inertia: those of Table 3 would hide an exchange of two axes."""
    rng = np.random.default_rng(seed)
    mass, second = rng.uniform(0.5, 5, 6), rng.uniform(0.01, 0.2, (6, 3))
    inertia = second.sum(1, keepdims=True) - second
    leaves = {"mass": jnp.asarray(mass), "central_inertia": jnp.asarray(inertia[:, :, None] * np.eye(3))}
    return Arm(parameters(LENGTHS, mass, inertia), table_3(LENGTHS).model.replace(**leaves))


def random_states(count: int, seed: int = 0) -> States:
    """States all around, with q2 at least 0.3 rad from 0 and pi, where the generalized speeds of (2.18) determine nothing."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-np.pi, np.pi, (count, 6))
    q[:, 1] = rng.choice([-1, 1], count) * rng.uniform(0.3, np.pi - 0.3, count)
    return States(q, *rng.uniform(-3, 3, (2, count, 6)))
