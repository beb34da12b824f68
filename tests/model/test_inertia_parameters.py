"""Inertia parameters against MuJoCo's masses, centres and principal moments, and back."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers.mechanisms import random_tree, relative

import kanejax as kj
from kanejax._model.inertia import NAMES, second_moment, six, symmetric


def parameters_of_mujoco(mj: mujoco.MjModel) -> np.ndarray:
    """Each body's ten, from its principal moments in its inertial frame, by the parallel-axis theorem."""
    rows = []
    for body in range(1, mj.nbody):
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, mj.body_iquat[body])
        axes = axes.reshape(3, 3)
        mass, com = mj.body_mass[body], mj.body_ipos[body]
        inertia = axes @ np.diag(mj.body_inertia[body]) @ axes.T + mass * (com @ com * np.eye(3) - np.outer(com, com))
        rows.append([mass, *(mass * com), *(inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))])
    return np.array(rows)


@pytest.mark.parametrize("seed", [0, 1])
def test_parameters_are_those_of_mujoco(seed):
    xml = random_tree(seed, 6)
    expected = parameters_of_mujoco(mujoco.MjModel.from_xml_string(xml))
    assert len(NAMES) == expected.shape[1]
    model = kj.load(xml)
    assert relative(kj.inertia_parameters(model), expected) < 1e-12
    assert relative(jax.jit(kj.inertia_parameters)(model.astype(jnp.float32)), expected) < 1e-6


def test_only_the_symmetric_part_of_an_inertia_counts():
    model = kj.load(random_tree(0, 2))
    skew = model.replace(central_inertia=model.central_inertia + jnp.array([[0, 1, 2], [-1, 0, 3], [-2, -3, 0.0]])[None])
    np.testing.assert_allclose(kj.inertia_parameters(skew), kj.inertia_parameters(model), rtol=0, atol=1e-15)


@pytest.mark.parametrize(("dtype", "tolerance"), [(jnp.float64, 1e-13), (jnp.float32, 1e-5)])
def test_models_round_trip(dtype, tolerance):
    model = kj.load(random_tree(2, 5)).astype(dtype)
    other = kj.load(random_tree(3, 5)).astype(dtype)
    back = kj.with_inertia_parameters(model, kj.inertia_parameters(other))
    assert back.dtype == dtype
    for name in ("mass", "com", "central_inertia"):
        assert relative(getattr(back, name), getattr(other, name)) < tolerance
    np.testing.assert_array_equal(back.joint_axis, model.joint_axis)


def test_a_body_without_mass_keeps_its_centre_and_has_finite_derivatives():
    model = kj.load(random_tree(2, 3))
    model = model.replace(mass=[1.0, 0.0, 2.0])
    parameters = kj.inertia_parameters(model)
    back = kj.with_inertia_parameters(model, parameters)
    np.testing.assert_allclose(back.com, model.com, rtol=0, atol=1e-14)
    np.testing.assert_allclose(back.central_inertia, model.central_inertia, rtol=0, atol=1e-14)
    derivative = jax.jacrev(lambda x: kj.with_inertia_parameters(model, x).com)(parameters)
    assert np.isfinite(derivative).all()


def test_second_moments():
    """Of points: the sum of m r r^T."""
    rng = np.random.default_rng(0)
    masses, points = rng.uniform(1, 2, 20), rng.normal(size=(20, 3))
    inertia = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True))
    parameters = jnp.concatenate((jnp.zeros(4), six(jnp.asarray(inertia))))
    np.testing.assert_allclose(second_moment(parameters), (points.T * masses) @ points, rtol=1e-13, atol=1e-13)
    np.testing.assert_array_equal(symmetric(six(jnp.asarray(inertia))), inertia)
