"""Coordinates as displacements, against MuJoCo's."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj
from kanejax._optimize.displacement import displaced, displacement
from tests.helpers.mechanisms import random_states, random_tree, relative


@pytest.fixture(scope="module")
def case():
    mj = mujoco.MjModel.from_xml_string(random_tree(3, 4, ("free", "ball", "hinge")))
    tree = kj.from_mujoco(mj).tree
    there = jax.jit(jax.vmap(lambda q, v: displaced(tree, q, v)))
    back = jax.jit(jax.vmap(lambda a, b: displacement(tree, a, b)))
    return mj, tree, there, back


def test_as_mujoco_does(case):
    mj, _, there, back = case
    q, v, _ = random_states(mj, 20)
    v = 0.9 * np.clip(v, -1.5, 1.5)
    v[0], v[1] = 0.0, 1e-7 * v[1]
    expected, difference = q.copy(), np.zeros_like(v)
    for i in range(len(q)):
        mujoco.mj_integratePos(mj, expected[i], v[i], 1.0)
        mujoco.mj_differentiatePos(mj, difference[i], 1.0, q[i], expected[i])
    assert relative(there(jnp.asarray(q), jnp.asarray(v)), expected) < 1e-14
    assert relative(back(jnp.asarray(q), jnp.asarray(expected)), difference) < 1e-12
    assert relative(difference, v) < 1e-12


def test_either_sign_of_a_quaternion_and_any_length_is_the_same_place(case):
    mj, tree, _, back = case
    (q, _, _), (other, _, _) = random_states(mj, 5), random_states(mj, 5, seed=1)
    turned = other.copy()
    for start in tree.turning_speeds[1]:
        turned[:, start : start + 4] *= -2.5
    assert relative(back(jnp.asarray(q), jnp.asarray(turned)), back(jnp.asarray(q), jnp.asarray(other))) < 1e-12


def test_first_and_second_derivatives_are_finite_where_nothing_is_displaced(case):
    mj, tree, _, _ = case
    q = jnp.asarray(random_states(mj, 1)[0][0])
    v = jnp.zeros(tree.nv)
    for function, at in ((lambda v: displaced(tree, q, v), v), (lambda p: displacement(tree, q, p), q)):
        assert np.isfinite(jax.jit(jax.hessian(lambda x, f=function: jnp.sum(jnp.sin(f(x)))))(at)).all()
    turns = jax.jit(jax.jacfwd(lambda v: displacement(tree, q, displaced(tree, q, v))))(v)
    assert relative(turns, np.eye(tree.nv)) < 1e-12
