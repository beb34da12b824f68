"""Kane and Levinson's arm: the library against the printed equations, each misprint's effect, and the closed loop."""

import functools
import json
import pathlib
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest

import kanejax as kj
from experiments.thesis import rrp_arm as experiment
from kanejax.robots import rrp_arm
from tests.thesis import hand_rrp

# Angles all around, the slide out to 1 m, speeds up to 2 rad/s and 2 m/s, torques up to 2 kN m and a force up to 2 kN.
STATES = 2000
# The largest error over these states of every row that a misprint changes: rows of X in kg m^2, kg m or kg; of Y, and of F in
# (1.54), in N m, N m and N; and the velocities v of C2, C3 and C_R in m/s.
ERRORS = {
    "Z3": {"Y": {0: 99.504}},
    "Z10": {"X": {0: 701.46}, "Y": {0: 1694.6, 1: 572.04, 2: 682.73}},
    "Y2 Z42": {"Y": {1: 34.211}},
    "Y2 gravity": {"Y": {1: 88.100}},
    "Y3 s2": {"Y": {2: 1647.9}},
    "c2": {"Y": {0: 22.446}},
    "k2": {"v": {0: 3.0431, 1: 6.9371, 2: 6.9371}},
    "F1": {"F": {0: 3982.0}},
}


class Library(NamedTuple):
    """What the library says, in the text's order of speeds; the state axis is last."""

    q: np.ndarray
    u: np.ndarray
    tau: np.ndarray
    mass_matrix: np.ndarray
    needed: np.ndarray
    active: np.ndarray
    velocities: np.ndarray


@pytest.fixture(scope="module")
def library() -> Library:
    with pytest.warns(kj.UnphysicalInertiaWarning):
        model = rrp_arm()
    random = np.random.default_rng(1)
    q = random.uniform((-np.pi, -np.pi, 0.0), (np.pi, np.pi, 1.0), (STATES, 3))
    u, tau = random.uniform(-2.0, 2.0, (STATES, 3)), random.uniform(-2000.0, 2000.0, (STATES, 4))

    def velocities(q: jax.Array, u: jax.Array) -> jax.Array:
        """Of C2, C3 and C_R, from world components to those along the axes of the bodies, i2, j2 and k2."""
        places, moving = jax.jvp(lambda q: kj.poses(model, q), (q,), (u,))
        return jax.numpy.einsum("kij,ki->kj", places.rotation, moving.com)[1:]

    def batch(function: Callable[..., Any], *arguments: np.ndarray) -> np.ndarray:
        return np.moveaxis(np.asarray(jax.jit(jax.vmap(function))(*arguments)), 0, -1)

    return Library(
        # The model's coordinates are q3, q1, q2.
        q=q[:, [1, 2, 0]].T,
        u=u.T,
        tau=tau.T,
        mass_matrix=batch(functools.partial(kj.mass_matrix, model), q),
        needed=batch(functools.partial(kj.bias_force, model), q, u) - tau[:, :3].T,
        active=batch(functools.partial(kj.generalized_active_force, model), q, u, tau[:, :3]),
        velocities=batch(velocities, q, u),
    )


def errors(library: Library, printed: set[str]) -> dict[str, np.ndarray]:
    """Largest error of each row over the states; the scales are those of `scales`."""
    x, y = hand_rrp.equations(library.q, library.u, library.tau[:3], printed)
    return {
        "X": np.abs(-x - library.mass_matrix).max(axis=(1, 2)),
        "Y": np.abs(y - library.needed).max(axis=1),
        "F": np.abs(hand_rrp.active_force(library.q, library.tau, printed) - library.active).max(axis=1),
        "v": np.abs(hand_rrp.velocities(library.q, library.u, printed) - library.velocities).max(axis=(1, 2)),
    }


def scales(library: Library) -> dict[str, float]:
    return {
        name: float(np.abs(values).max())
        for name, values in zip("XYFv", (library.mass_matrix, library.needed, library.active, library.velocities), strict=True)
    }


def test_corrected_equations_are_the_librarys(library: Library) -> None:
    scale = scales(library)
    for name, found in errors(library, set()).items():
        assert found.max() < 1e-11 * scale[name], name


@pytest.mark.parametrize("name", hand_rrp.PRINTED)
def test_each_misprint_is_wrong_by_this_much(library: Library, name: str) -> None:
    scale = scales(library)
    for where, rows in errors(library, {name}).items():
        for row, found in enumerate(rows):
            amount = ERRORS[name].get(where, {}).get(row)
            if amount is None:
                assert found < 1e-11 * scale[where], (where, row)
            else:
                assert found == pytest.approx(amount, rel=1e-4), (where, row)


@pytest.fixture(scope="module")
def numbers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    directory = tmp_path_factory.mktemp("rrp_arm")
    numbers = experiment.run(directory)
    assert (directory / "rrp_arm.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads(pathlib.Path(directory / "rrp_arm.json").read_text())["numbers"] == numbers
    return numbers


def test_closed_loop_ends_where_two_integrators_agree(numbers: dict[str, Any]) -> None:
    np.testing.assert_allclose(numbers["at_10_s"], (1.04691486, 0.40821948, 1.21741975), rtol=0, atol=5e-9)
    np.testing.assert_allclose(numbers["at_30_s"], (1.04719757, 0.40000144, 1.22173043), rtol=0, atol=5e-9)
    assert numbers["two_integrators"] < 1e-12


def test_closed_loop_of_the_printed_equations(numbers: dict[str, Any]) -> None:
    """The corrected equations in NumPy by the classical Runge-Kutta scheme, and q2 under the printed force law."""
    for printed, expected in ((False, numbers["at_10_s"]), (True, numbers["at_10_s_force_law_as_printed"])):
        np.testing.assert_allclose(_integrated(printed, duration=10.0, steps=800), expected, rtol=0, atol=1e-8)
    assert numbers["at_30_s_force_law_as_printed"][1] == pytest.approx(1.587, abs=5e-4)


def _integrated(printed: bool, duration: float, steps: int) -> np.ndarray:
    """The text's q1, q2, q3 at the end."""
    gains = [np.array(values) for values in (experiment.DAMPING, experiment.STIFFNESS)]

    def rates(y: np.ndarray) -> np.ndarray:
        q, u = y[:3], y[3:]
        # (1.54) without forces at the joints is minus the weight that the law holds.
        tau = -hand_rrp.active_force(q, np.zeros(4))
        tau[2] *= np.sin(q[2]) / np.sin(q[0]) if printed else 1.0
        tau -= gains[0] * u + gains[1] * (q[[2, 0, 1]] - experiment.TARGET)
        x, right = hand_rrp.equations(q, u, tau)
        return np.concatenate((u[[1, 2, 0]], np.linalg.solve(x, right)))

    h = duration / steps
    y = np.array([*np.array(experiment.START)[[1, 2, 0]], 0.0, 0.0, 0.0])
    for _ in range(steps):
        k1 = rates(y)
        k2 = rates(y + h / 2 * k1)
        k3 = rates(y + h / 2 * k2)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(y + h * k3))
    return y[:3]


def test_kinetic_energy_of_the_text_along_the_motion(numbers: dict[str, Any]) -> None:
    assert numbers["kinetic_energy"] < 1e-13


def test_lagranges_form(numbers: dict[str, Any]) -> None:
    assert numbers["lagrange_accelerations"] < 1e-11
    assert numbers["lagrange_inertia_forces"] < 1e-11
    # (1.60) without its minus gives the opposite of the generalized inertia forces.
    assert numbers["lagrange_inertia_forces_as_printed"] == pytest.approx(2.0, abs=1e-11)
