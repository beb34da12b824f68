"""Equations generated for any base link, and what the choice of speeds costs in operations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from experiments.thesis import generalized_speeds as experiment, speed_program as program
from kanejax import robots
from tests.helpers.mechanisms import random_tree

JOINTS = ("hinge", "hinge", "slide", "hinge", "hinge")
# States at once: one program of the library serves all tests.
COUNT = 20


@pytest.fixture(scope="module")
def skew():
    """A chain whose axes and places are no special ones, in which no zero hides an error."""
    rng = np.random.default_rng(5)

    def numbers(scale, size=3):
        return " ".join(map(str, rng.normal(size=size) * scale))

    bodies = "".join(
        f'<body name="b{k}" pos="{numbers(0.3)}" quat="{numbers(1, 4)}">'
        f'<joint type="{kind}" axis="{numbers(1)}" pos="{numbers(0.1)}"/>'
        f'<inertial pos="{numbers(0.2)}" quat="{numbers(1, 4)}" mass="{1 + k}" diaginertia="0.1 0.12 0.15"/>'
        for k, kind in enumerate(JOINTS)
    )
    return kj.load(f"<mujoco><worldbody>{bodies}{'</body>' * len(JOINTS)}</worldbody></mujoco>")


@pytest.mark.parametrize(
    "base",
    [None, program.Base(1, (0, 1)), program.Base(1, (0, 1), 1), program.Base(3, (0, 1, 3)), program.Base(4, (0, 3, 4))],
    ids=str,
)
def test_generated_equations_are_those_of_the_library(skew, base):
    assert experiment.disagreement(skew, base, count=COUNT) < 1e-13


def test_another_choice_is_noticed(skew):
    states = experiment.random_states(skew, COUNT)
    found = experiment.generated_equations(skew, program.Base(4, (0, 1, 3)), *states)
    other = experiment.library_equations(experiment.in_speeds(skew, program.Base(3, (0, 1, 3))), *states)
    assert float(jnp.abs(found.X - other.X).max((1, 2)).min()) > 1e-2
    assert float(jnp.abs(found.Y - other.Y).max(1).min()) > 1e-2


def test_what_a_simulation_needs(skew):
    """The library's torques for the accelerations that follow are the given ones."""
    base, chain = program.Base(3, (0, 1, 3)), program.chain_of(skew)
    q, u, tau = experiment.random_states(skew, COUNT)
    X, right, rates = jax.vmap(lambda *x: program.equations_of_simulation(chain, base, *x))(q, u, tau)
    u_dot = np.linalg.solve(X, right[..., None])[..., 0]
    expected = experiment.library_equations(experiment.in_speeds(skew, base), q, u, jnp.asarray(u_dot))
    # Random states may be near singular ones.
    assert float(jnp.median(jnp.abs(expected.torques - tau).max(1) / jnp.abs(tau).max(1))) < 1e-12
    assert float(jnp.median(jnp.abs(rates - expected.rates).max(1))) < 1e-12


def test_the_speeds_of_the_thesis_are_generated():
    """(2.18): the matrix of link C's choice is the one of `link_speeds`, and angular velocities start from the speeds."""
    model = robots.intelledex_605()
    chain, base = program.chain_of(model), program.Base(2, (0, 1, 2))
    q, u, _ = (x[0] for x in experiment.random_states(model, 1))
    arm = kj.with_speeds(model, kj.link_speeds(model))
    identity = jnp.eye(6)
    expected = jax.vmap(kj.speeds_from_rates, (None, None, 0), 1)(arm, q, identity)
    assert float(jnp.abs(program.speed_matrix(chain, base, q) - expected).max()) < 1e-14
    assert program.angular_velocities(chain, base, q, u)[2].tolist() == u[:3].tolist()


def test_choices_are_those_that_are_not_singular():
    labels = set(experiment.choices(robots.three_revolute_arm()))
    assert labels == {"joint rates", "link B for q12", "link B for q12 by y", "link C for q123"}
    of_intelledex = experiment.choices(robots.intelledex_605())
    # The second, third and fourth joints are parallel.
    assert "link D for q123" in of_intelledex
    assert "link D for q234" not in of_intelledex


def test_the_choice_matters_in_the_explicit_form_alone():
    model = robots.intelledex_605(**experiment.LENGTHS)
    plain, advised = (experiment.operations(model, base) for base in (None, program.Base(2, (0, 1, 2))))
    total = experiment.total
    assert total(advised["X_and_Y"]) < 0.92 * total(plain["X_and_Y"])
    assert abs(total(advised["torques_by_recursion"]) - total(plain["torques_by_recursion"])) <= 2
    # Fewer than the thesis's by hand, which has the same speeds and the same lengths.
    found = advised["torques_by_X_and_Y"]
    assert found["multiplications"] + found["divisions"] < experiment.BY_HAND[0]
    assert found["additions"] < experiment.BY_HAND[1]


def test_other_mechanisms_are_refused():
    with pytest.raises(ValueError, match="no serial chain of revolute and prismatic joints"):
        program.chain_of(kj.load(random_tree(2, 4)))
    with pytest.raises(ValueError, match="the model has armature, which the generated equations leave out"):
        program.chain_of(robots.three_revolute_arm().replace(armature=jnp.ones(3)))
