"""What is deterministic about speed: the compiled programs do not grow or duplicate work in ways that were measured to be slow."""

import functools
import re

import jax
import jax.numpy as jnp
import mujoco
import pytest

import kanejax as kj
from tests.helpers.mechanisms import random_tree

BATCH = 32


def chain(bodies: int, kind: str = "hinge") -> kj.Model:
    return kj.from_mujoco(mujoco.MjModel.from_xml_string(random_tree(0, bodies, (kind,), chain=True)))


def compiled(function, model, states: int = 3):
    state = [jnp.zeros((BATCH, model.nq)), *[jnp.zeros((BATCH, model.nv))] * (states - 1)]
    return jax.jit(jax.vmap(function, (None,) + (0,) * states)).lower(model, *state).compile()


def text_of(function, model) -> str:
    return compiled(function, model).as_text() or ""


def computations(text: str) -> dict[str, list[str]]:
    """Lines of each computation of an HLO module, by name."""
    found: dict[str, list[str]] = {}
    name = None
    for line in text.splitlines():
        start = re.match(r"^(?:ENTRY )?%?([\w.\-]+) \(.*\{$", line)
        if start:
            name = start.group(1)
            found[name] = []
        elif line.startswith("}"):
            name = None
        elif name is not None:
            found[name].append(line)
    return found


def arithmetic(lines: list[str]) -> int:
    return sum(bool(re.search(r" (multiply|add|subtract|divide|sqrt|sine|cosine)\(", line)) for line in lines)


@pytest.mark.parametrize("kind", ["hinge", "ball"])
@pytest.mark.parametrize("function", [kj.inverse_dynamics, kj.forward_dynamics])
def test_one_program_whatever_the_number_of_bodies(function, kind):
    short, long = (text_of(function, chain(bodies, kind)) for bodies in (4, 9))
    assert short.count(" while(") == long.count(" while(") >= 2
    assert arithmetic(short.splitlines()) == pytest.approx(arithmetic(long.splitlines()), rel=0.02)


@pytest.mark.parametrize("function", [kj.inverse_dynamics, kj.forward_dynamics])
def test_a_branching_tree_is_no_more_loops_than_a_chain(function):
    tree = kj.from_mujoco(mujoco.MjModel.from_xml_string(random_tree(2, 9, ("hinge",))))
    assert text_of(function, tree).count(" while(") == text_of(function, chain(9)).count(" while(")


@pytest.mark.parametrize(("function", "growth"), [(kj.inverse_dynamics, 1.15), (kj.forward_dynamics, 1.3)])
def test_the_work_of_the_unrolled_program_grows_with_the_bodies_or_their_pairs(function, growth):
    """Without barriers XLA copies producers into consumers, and the work grows exponentially."""
    work = [dict(compiled(function, kj.specialize(chain(bodies))).cost_analysis() or {})["flops"] for bodies in (2, 4, 6)]
    assert 0.85 < (work[2] - work[1]) / (work[1] - work[0]) < growth


@pytest.mark.parametrize("specialized", [False, True])
def test_nothing_is_computed_inside_a_concatenation(specialized):
    """XLA evaluates what is fused into a concatenation once for every row of it."""
    model = chain(4)
    text = text_of(kj.inverse_dynamics, kj.specialize(model) if specialized else model)
    blocks = [lines for lines in computations(text).values() if any(" concatenate(" in line for line in lines)]
    for lines in blocks:
        if not any("while(" in line or " fusion(" in line for line in lines):
            assert arithmetic([line for line in lines if f"{BATCH}]" in line]) <= 2


@pytest.mark.parametrize("function", [kj.inverse_dynamics, kj.forward_dynamics])
def test_parameters_that_do_not_change_are_prepared_before_the_program_runs(function):
    model = chain(5)
    state = [jnp.zeros(5)] * 3
    texts = (
        jax.jit(function).lower(model, *state).compile().as_text() or "",
        jax.jit(functools.partial(function, model)).lower(*state).compile().as_text() or "",
    )
    as_argument, closed_over = (text[text.index("\nENTRY") :].count(" fusion(") for text in texts)
    assert closed_over <= as_argument / 2
