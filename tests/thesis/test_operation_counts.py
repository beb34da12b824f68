"""Counts of operations beside those of the thesis, and the programs that are timed."""

import ast
import collections
import itertools

import jax
import numpy as np
import pytest

import kanejax as kj
from experiments.benchmarks.harness import Effort
from experiments.thesis import claims, operation_counts
from kanejax.robots import intelledex_605, stanford_arm, three_revolute_arm
from tests.thesis.hand.torque import TORQUE

GROUPS = {"Mult": "multiplications", "Pow": "multiplications", "Add": "additions", "Sub": "additions", "Div": "divisions"}


def test_count_of_the_printed_program():
    nodes = [node for expression in TORQUE.values() for node in ast.walk(ast.parse(expression))]
    operations = [node for node in nodes if isinstance(node, ast.BinOp)]
    powers = [node.right for node in operations if isinstance(node.op, ast.Pow)]
    assert all(isinstance(power, ast.Constant) and power.value == 2 for power in powers)
    counts = collections.Counter(GROUPS[type(node.op).__name__] for node in operations)
    assert (counts["multiplications"], counts["additions"]) == operation_counts.TORQUE
    assert counts["divisions"] == 9


@pytest.mark.parametrize("make", [intelledex_605, stanford_arm])
def test_each_step_saves_operations(make):
    found = operation_counts.steps(make())
    assert tuple(found) == operation_counts.STEPS
    counts = list(found.values())
    assert all(after[i] < 0.9 * before[i] for before, after in itertools.pairwise(counts) for i in (0, 1))
    assert counts[-1] == kj.operation_count(kj.inverse_dynamics, make())[:2]


def test_loops_count_as_often_as_they_run():
    short, long = (np.array(operation_counts.as_coded(make())) for make in (three_revolute_arm, intelledex_605))
    assert (long == 2 * short).all()


def test_generic_inertias_take_more():
    for make in (intelledex_605, stanford_arm):
        model = operation_counts.generic(make())
        moments = np.diagonal(np.asarray(model.central_inertia), axis1=1, axis2=2)
        assert np.abs(moments - np.roll(moments, 1, axis=1)).min() > 1e-4
        plain, generic = (kj.operation_count(kj.inverse_dynamics, each) for each in (make(), model))
        assert generic.multiplications > plain.multiplications
        assert generic.additions > plain.additions


def test_a_program_that_computes_each_value_once_gives_the_same_torques():
    model = operation_counts.generic(intelledex_605())
    states = claims.random_states(model, 300)
    found = jax.jit(jax.vmap(operation_counts.merged(model)))(*states)
    expected = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))(model, *states)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * float(abs(expected).max()))


def test_all_programs_are_timed():
    timing = operation_counts.times(Effort(1, 1e-3))
    others = ("loop", "not_regrouped", "merged")
    assert set(timing) == {f"time_{name}_over_compiled" for name in others} | {f"nanoseconds_{x}" for x in (*others, "compiled")}
    assert all(value > 0 for value in timing.values())
    assert timing["time_merged_over_compiled"] == pytest.approx(timing["nanoseconds_merged"] / timing["nanoseconds_compiled"])
