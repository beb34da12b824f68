"""The arm of Kane and Levinson: where its bodies are, its impossible load, and MuJoCo."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj
from kanejax.robots import rrp_arm

STATES = 200


@pytest.fixture(scope="module")
def arm() -> kj.Model:
    with pytest.warns(kj.UnphysicalInertiaWarning):
        return rrp_arm()


def states() -> np.ndarray:
    """q, u and u', (3, states, 3): angles all around, the slide out to 1 m."""
    random = np.random.default_rng(3)
    q = random.uniform((-np.pi, -np.pi, 0.0), (np.pi, np.pi, 1.0), (STATES, 3))
    return np.stack((q, *random.uniform(-2.0, 2.0, (2, STATES, 3))))


def test_the_load_is_kept_with_a_warning() -> None:
    message = "body 'RB': principal moments 0.110257, 2.78894, 2.90081 kg m.2 break the triangle inequality A . B >= C by 0.00161"
    with pytest.warns(kj.UnphysicalInertiaWarning, match=message) as warned:
        model = rrp_arm()
    assert len(warned) == 1
    assert model.tree.body_names == ("link1", "link2", "link3", "RB")
    assert model.tree.joint_names == ("q3", "q1", "q2")
    assert model.tree.body_links == (0, 1, 2, 2)
    np.testing.assert_array_equal(model.body("RB").central_inertia, [[2, 0.6, -1.1], [0.6, 2.5, 0.75], [-1.1, 0.75, 1.3]])


def test_mass_centres_are_where_the_text_has_them(arm: kj.Model) -> None:
    q3, q1, q2 = 0.4, 0.7, 0.25
    poses = kj.poses(arm, jnp.array([q3, q1, q2]))
    # Unit vectors as world components along j0, k0, i0: link 1 turns by q3 about i0, link 2 by q1 about j1, (1.7).
    i1, j1, k1 = np.array([0, 0, 1]), np.array([np.cos(q3), np.sin(q3), 0]), np.array([-np.sin(q3), np.cos(q3), 0])
    i2, k2 = np.cos(q1) * i1 - np.sin(q1) * k1, np.sin(q1) * i1 + np.cos(q1) * k1
    c1, c2 = 0.3 * k1, 1.1 * k1 + 0.5 * k2
    c3 = c2 + q2 * k2
    np.testing.assert_allclose(poses.com, [c1, c2, c3, c3 + 0.2 * i2 + 0.4 * j1 + 0.6 * k2], rtol=0, atol=1e-15)
    np.testing.assert_allclose(poses.rotation[0], np.stack((k1, i1, j1), axis=1), rtol=0, atol=1e-15)
    for body in (1, 2, 3):
        np.testing.assert_allclose(poses.rotation[body], np.stack((i2, j1, k2), axis=1), rtol=0, atol=1e-15)


def test_the_fused_load_moves_alike_without_a_warning(arm: kj.Model) -> None:
    fused = rrp_arm(load="fused")
    assert fused.tree.body_names == ("link1", "link2", "link3")
    kj.check_model(fused)
    assert_same(inverse_dynamics(fused), inverse_dynamics(arm))


def test_mujoco_refuses_the_load_alone(arm: kj.Model) -> None:
    with pytest.raises(kj.InvalidInertiaError, match="MuJoCo refuses the inertias of: body 'RB': principal moments"):
        kj.to_mujoco(arm)
    with pytest.raises(ValueError, match=r"(?s)inertia must satisfy A \+ B >= C.*'RB'"):
        mujoco.MjModel.from_xml_string(kj.to_mjcf(arm))


def test_mjcf_keeps_the_load(arm: kj.Model) -> None:
    text = kj.to_mjcf(arm)
    with pytest.raises(kj.InvalidInertiaError, match="body 'RB'"):
        kj.load(text)
    with pytest.warns(kj.UnphysicalInertiaWarning, match="body 'RB'"):
        back = kj.load(text, allow_unphysical=True)
    assert back.tree == arm.tree
    assert_same(inverse_dynamics(back), inverse_dynamics(arm))


def test_equations_of_motion_against_mujoco(arm: kj.Model) -> None:
    mj_model = mujoco.MjModel.from_xml_string(kj.to_mjcf(rrp_arm(load="fused")))
    mj_data = mujoco.MjData(mj_model)
    forces, masses = [], []
    for q, u, u_dot in states().swapaxes(0, 1):
        mj_data.qpos[:], mj_data.qvel[:], mj_data.qacc[:] = q, u, u_dot
        mujoco.mj_inverse(mj_model, mj_data)
        forces.append(mj_data.qfrc_inverse.copy())
        full = np.zeros((3, 3))
        mujoco.mj_fullM(mj_model, mj_data, full)
        masses.append(full)
    assert_same(inverse_dynamics(arm), np.array(forces))
    assert_same(jax.jit(jax.vmap(functools.partial(kj.mass_matrix, arm)))(states()[0]), np.array(masses))
    accelerations = jax.jit(jax.vmap(functools.partial(kj.forward_dynamics, arm)))(*states()[:2], np.array(forces))
    assert_same(accelerations, states()[2])


def test_unknown_loads_are_refused() -> None:
    unknown: Any = "none"
    with pytest.raises((ValueError, TypeError), match="none"):
        rrp_arm(load=unknown)


def inverse_dynamics(model: kj.Model) -> jax.Array:
    return jax.jit(jax.vmap(functools.partial(kj.inverse_dynamics, model)))(*states())


def assert_same(actual: Any, expected: Any) -> None:
    """Within 1e-11 of the largest number."""
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
