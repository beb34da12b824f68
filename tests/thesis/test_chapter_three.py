"""The recursion of Nie 1988, chapter III, as printed, against the library; and what its misprints would cost."""

import jax
import numpy as np
import pytest

import kanejax as kj
from tests.thesis.hand.arm import INERTIA, LENGTH, MASS
from tests.thesis.hand.cases import LENGTHS, table_3
from tests.thesis.hand.chapter_three import PRINTED, PRINTED_MATRIX, Chain, forces
from tests.thesis.hand.errata import stated
from tests.thesis.hand.torque import motion

STATED = stated()
inverse_dynamics = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))
# Joints from the base outwards, revolute or prismatic.
JOINTS = ("RRPRRR", "PRPR")


def random_chain(joints: str, seed: int = 2) -> Chain:
    rng, n = np.random.default_rng(seed), len(joints)
    rotation = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))[:, None, None]
    second = rng.uniform(0.02, 0.2, (n, 3))
    D, L = rng.normal(size=(2, n, 3)) * 0.3
    inertia = second.sum(1, keepdims=True) - second
    revolute = tuple(joint == "R" for joint in joints)
    return Chain(revolute, rotation, D, L, rng.uniform(0.5, 3, n), inertia, np.array([0, 9.81, 0]))


def intelledex(omitted: tuple[float, ...]) -> Chain:
    """The arm of chapter II in the terms of chapter III, from Figures 2.1 and 3.2."""
    l33, l43, l52, l63 = omitted
    turn, back, same = [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.eye(3)
    D = [
        [0, -LENGTH["L12"], LENGTH["L13"]],
        [0, -LENGTH["L22"], 0],
        [LENGTH["L31"], 0, l33],
        [LENGTH["L41"], 0, l43],
        [0, l33 + l43 - l52, 0],
        [0, 0, l63],
    ]
    L = [[0, 0, 0], [0, 0, 0], [LENGTH["L1"], 0, l33], [LENGTH["L2"], 0, l43], [0, l33 + l43, 0], [0, 0, 0]]
    rotation = np.array([turn, back, same, same, back, same], float)
    weight = np.array([0, 9.81, 0])
    return Chain((True,) * 6, rotation, np.array(D), np.array(L), np.array(MASS), np.array(INERTIA), weight)


def model_of(chain: Chain) -> kj.Model:
    rows = zip(chain.revolute, chain.mass, chain.D, chain.inertia, chain.rotation, chain.L, strict=True)
    links = [
        kj.DHLink(float(m), D, inertia, joint="revolute" if turns else "prismatic", rotation=A, next_origin=L)
        for turns, m, D, inertia, A, L in rows
    ]
    return kj.from_dh(links, convention="nie", gravity=chain.weight)


def deviation(chain: Chain, states: np.ndarray, printed: frozenset[str] = frozenset()) -> float:
    """Largest difference of the forces at the joints over the largest force."""
    actual = np.array([forces(chain, state[0], state[1], state[2], printed) for state in np.swapaxes(states, 0, 1)])
    expected = np.asarray(inverse_dynamics(model_of(chain), *states))
    return float(np.abs(actual - expected).max() / np.abs(expected).max())


def random_states(joints: str) -> np.ndarray:
    return np.random.default_rng(3).uniform(-2, 2, (3, 100, len(joints)))


@pytest.mark.parametrize("joints", JOINTS)
def test_random_chains(joints):
    assert deviation(random_chain(joints), random_states(joints)) < 1e-12


def test_intelledex():
    states = np.stack(motion(np.linspace(0, 2, 51)))
    for omitted in ((0.0, 0.0, 0.0, 0.0), LENGTHS):
        chain = intelledex(omitted)
        actual = np.array([forces(chain, state[0], state[1], state[2]) for state in np.swapaxes(states, 0, 1)])
        np.testing.assert_allclose(actual, inverse_dynamics(table_3(omitted).model, *states), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", PRINTED)
def test_each_correction_is_needed(name):
    """As printed, the forces differ by what experiments/errata.md says, for both chains."""
    errors = [deviation(random_chain(joints), random_states(joints), frozenset({name})) for joints in JOINTS]
    np.testing.assert_allclose(errors, STATED[name], rtol=0.01)
    assert max(errors) > 0.01


def test_sign_in_autotf():
    """A(2,1,3) as in Appendix 4, in N m along the thesis's motion."""
    q, u, u_dot = motion(np.linspace(0, 2, 51))
    chain = intelledex((0.0, 0.0, 0.0, 0.0))
    printed = np.array([forces(chain, q[i], u[i], u_dot[i], frozenset({PRINTED_MATRIX})) for i in range(len(q))])
    error = np.abs(printed - inverse_dynamics(table_3().model, q, u, u_dot)).max()
    np.testing.assert_allclose(error, STATED[PRINTED_MATRIX], rtol=0.01)
