"""Claims of chapter IV: symmetry, cancelling reactions, and those that are brought into evidence."""

import dataclasses

import jax
import numpy as np
import pytest

from experiments.thesis import claims


@pytest.mark.parametrize("name", ["intelledex_605", "stanford_arm"])
def test_mass_matrix_is_symmetric_and_positive_definite(name):
    numbers = claims.symmetry(claims.ROBOTS[name](), count=200)
    assert max(numbers["asymmetry_by_column"], numbers["asymmetry_by_body"], numbers["difference_of_both"]) < 1e-14
    assert numbers["least_eigenvalue"] > 1e-4


def test_a_negative_mass_is_noticed():
    model = claims.ROBOTS["three_revolute_arm"]()
    wrong = dataclasses.replace(model, mass=-model.mass, central_inertia=-model.central_inertia)
    assert claims.symmetry(wrong, count=20)["least_eigenvalue"] < 0


@pytest.mark.parametrize("name", ["stanford_arm", "rrp_arm"])
def test_non_working_forces_cancel(name):
    numbers = claims.cancellation(claims.ROBOTS[name](), count=200)
    assert numbers["non_working"] < 1e-13
    assert numbers["working_less_torque"] < 1e-13


def test_they_do_not_cancel_on_one_link_alone():
    model = claims.ROBOTS["stanford_arm"]()
    # The program of the test before.
    forces = jax.jit(jax.vmap(lambda *state: claims.reaction_forces(model, *state)))
    net, on_link = (np.asarray(each) for each in forces(*claims.random_states(model, 200)))
    below = np.tril_indices(model.nv, -1)
    assert np.median(np.abs(on_link[:, *below])) > 1e-2
    assert (np.abs(net[:, *below]).max(1) < 1e-12 * np.abs(on_link).max((1, 2))).all()


@pytest.mark.parametrize("joint", [2, 4])
def test_extra_speeds_bring_reactions_into_evidence(joint):
    assert claims.evidence(claims.ROBOTS["stanford_arm"](), joint, count=8) < 1e-13


def test_timing_waits_and_takes_the_median():
    calls = []
    seconds = claims.seconds(lambda: calls.append(sum(range(20_000))), least=0.002, rounds=5)
    assert 0 < seconds < 0.1
    assert len(calls) >= 7
