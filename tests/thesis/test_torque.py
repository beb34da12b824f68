"""Nie's equations of motion of the Intelledex 605, derived by hand, against the library; and what each misprint would cost."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from tests.thesis.hand import chapter_three, inertia_coefficients, misprints
from tests.thesis.hand.angle import coefficients
from tests.thesis.hand.cases import LENGTHS, Arm, random_arm, random_states, table_3
from tests.thesis.hand.equations import evaluate, instead, names_in, parse, unused
from tests.thesis.hand.errata import ERRATA, stated
from tests.thesis.hand.torque import TORQUE, motion, speed_matrix, torque, variables

STATED = stated()
STATES = random_states(1500)
# The thesis's motion, II.5.
MOTION = motion(np.linspace(0, 2, 201))
ARMS = {"Table 3": table_3(), "Table 3 and all lengths": table_3(LENGTHS), "random masses and inertias": random_arm()}


@pytest.fixture(params=ARMS, ids=str)
def arm(request: pytest.FixtureRequest) -> Arm:
    return ARMS[request.param]


inverse_dynamics = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))


def test_torques(arm):
    actual = inverse_dynamics(arm.model, *STATES)
    expected = torque(arm.symbols, *STATES)
    for joint in range(6):
        scale = np.abs(expected[:, joint]).max()
        np.testing.assert_allclose(actual[:, joint], expected[:, joint], rtol=0, atol=1e-12 * scale, err_msg=f"joint {joint + 1}")


def test_inertia_coefficients(arm):
    """X is minus the mass matrix for the generalized speeds of (2.18)."""
    q = STATES.q
    per_speed = np.linalg.inv(speed_matrix(q))
    mass = np.asarray(jax.jit(jax.vmap(kj.mass_matrix, (None, 0)))(arm.model, q))
    expected = -np.swapaxes(per_speed, 1, 2) @ mass @ per_speed
    actual = coefficients(variables(arm.symbols, *STATES))
    # Each row and column by its own size: six speeds move links of very different weight.
    size = np.sqrt(np.einsum("nrr,nss->nrs", expected, expected))
    assert (np.abs(actual - expected) / size).max() < 1e-12


def test_bias_and_gravity(arm):
    """Z243 to Z248 are the generalized inertia forces at u' = 0, and Z281 to Z285 the generalized active forces of gravity."""
    q, q_dot, _ = STATES
    per_speed = np.linalg.inv(speed_matrix(q))
    at_rest = variables(arm.symbols, q, q_dot, np.zeros_like(q))
    # The rates of the speeds where those of the coordinates' rates are zero; the other way round they are minus that.
    drift = np.stack([at_rest[f"UP{r}"] for r in range(1, 7)], -1)
    q_ddot = -np.einsum("nrs,ns->nr", per_speed, drift)
    values = variables(arm.symbols, q, q_dot, q_ddot)
    inertia = jax.jit(jax.vmap(kj.generalized_inertia_force, (None, 0, 0, 0)))(arm.model, q, q_dot, q_ddot)
    gravity = jax.jit(jax.vmap(kj.gravity_force, (None, 0)))(arm.model, q)
    for first, count, force in ((243, 6, inertia), (281, 5, gravity)):
        expected = np.einsum("nrs,nr->ns", per_speed, np.asarray(force))
        actual = np.stack([values[f"Z{first + r}"] for r in range(count)], -1)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(actual, expected[:, :count], rtol=0, atol=1e-13 * scale)
        # There is no Z286: gravity has no moment about the last axis.
        assert np.abs(expected[:, count:]).max(initial=0) < 1e-13 * scale


def test_reference_torques():
    """Torques at 0, 1 and 2 s of the thesis's motion, to the decimals that the tests of the tables of links have."""
    expected = [
        [0, 0, -51.41806886, -15.63086866, 0, 0],
        [-3.65240562, 23.80108726, -29.90338861, -4.44952941, 0.00752381, -0.00450906],
        [10.24418406, 7.55862433, 14.24269294, 9.76929291, 0, 0],
    ]
    np.testing.assert_allclose(torque(ARMS["Table 3"].symbols, *motion(np.array([0.0, 1.0, 2.0]))), expected, rtol=0, atol=6e-9)


def test_every_variable_of_the_appendix_is_there():
    missing = {123, 124, *range(138, 152), 233, 249, 250}
    expected = {f"Z{number}" for number in range(1, 286) if number not in missing} | {"Z189A"}
    expected |= {f"X{r}{s}" for r in range(1, 7) for s in range(1, 7)}
    assert {name for name in TORQUE if name[0] in "ZX"} == expected


def test_variables_without_influence():
    """Z1, Z29 only serve Z95; Z95 and Z101 are accelerations along directions in which no speed moves the mass centre."""
    assert unused(TORQUE, [f"T{joint}" for joint in range(1, 7)]) == ["Z1", "Z29", "Z95", "Z101", "Z177"]
    assert {name for name in TORQUE if "Z29" in names_in(TORQUE[name])} == {"Z95"}
    assert TORQUE["Z177"] == TORQUE["Z178"]
    assert TORQUE["Z93"] == TORQUE["Z86"]


def test_the_symmetric_list_of_appendix_1_is_the_same():
    symmetric = instead(TORQUE, parse(inertia_coefficients.APPENDIX_1))
    assert set(unused(symmetric, [f"T{r}" for r in range(1, 7)])) >= {"Z159", "Z168", "Z180"}
    arm = random_arm()
    difference = torque(arm.symbols, *STATES, printed=parse(inertia_coefficients.APPENDIX_1)) - torque(arm.symbols, *STATES)
    assert np.abs(difference).max() < 1e-12
    # X63 = X63, as printed, defines nothing.
    with pytest.raises(NameError, match="X63"):
        evaluate({"X63": "X63"}, {})


@pytest.mark.parametrize("name", misprints.PROGRAMS)
def test_each_correction_is_needed(name):
    """With one item as printed and all others corrected, torques differ from the library's by what experiments/errata.md says."""
    errors, printed = [], misprints.PROGRAMS[name]
    for arm, states in ((ARMS["Table 3"], MOTION), (ARMS["random masses and inertias"], STATES)):
        expected = inverse_dynamics(arm.model, *map(jnp.asarray, states))
        errors.append(np.abs(torque(arm.symbols, *states, printed=printed) - expected).max())
    np.testing.assert_allclose(errors, STATED[name], rtol=0.01, atol=1e-10)
    assert max(errors) > 1


def test_the_errata_have_what_is_measured():
    assert set(STATED) == {*misprints.PROGRAMS, *misprints.TEXT, *chapter_three.PRINTED, chapter_three.PRINTED_MATRIX}
    text = ERRATA.read_text().replace(" ", "")
    for equations in misprints.PROGRAMS.values():
        for name, printed in equations.items():
            assert f"`{printed}`|`{TORQUE[name]}`".replace(" ", "") in text
