import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers.mechanisms import random_states, random_tree, relative

import kanejax as kj

pin = pytest.importorskip("pinocchio")

# Pinocchio lists m, m c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
PINOCCHIO_ORDER = [0, 1, 2, 3, 4, 7, 5, 8, 9, 6]


@jax.jit
def force(model, q, u, u_dot):
    """From the regressor, and what the inertias have no part in."""
    columns = kj.regressor(model, q, u, u_dot)
    of_inertias = jnp.einsum("ibk,bk->i", columns, kj.inertia_parameters(model))
    return of_inertias + model.armature * u_dot - kj.passive_force(model, q, u)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_forces_are_the_regressor_times_the_parameters(seed):
    mj = mujoco.MjModel.from_xml_string(random_tree(seed, 7))
    model = kj.from_mujoco(mj)
    q, u, u_dot = (jnp.asarray(x) for x in random_states(mj, 4, seed))
    if seed == 1:
        rows = jax.vmap(force, (None, 0, 0, 0))(model, q, u, u_dot)
    else:  # One by one: half the time to compile.
        rows = [force(model, *state) for state in zip(q, u, u_dot, strict=True)]
    data = mujoco.MjData(mj)
    for i in range(4):
        data.qpos, data.qvel, data.qacc = q[i], u[i], u_dot[i]
        mujoco.mj_inverse(mj, data)
        assert relative(rows[i], data.qfrc_inverse) < 1e-11


def test_columns_are_those_of_pinocchio():
    text = (
        """<robot name="r"><link name="base"/>"""
        + "".join(
            f"""<joint name="j{i}" type="{kind}"><parent link="{"base" if i == 0 else f"l{i - 1}"}"/><child link="l{i}"/>
        <origin xyz="0.1 {0.2 * i} 0.3" rpy="{i} 0.4 -0.7"/><axis xyz="0 {i % 2} {1 - i % 2}"/>
        <limit effort="1" velocity="1" lower="-3" upper="3"/></joint>
        <link name="l{i}"><inertial><mass value="{1 + i}"/><origin xyz="0.1 0 {0.1 * i}"/>
        <inertia ixx="0.1" iyy="0.12" izz="0.09" ixy="0.01" ixz="0" iyz="0.02"/></inertial></link>"""
            for i, kind in enumerate(["revolute", "prismatic", "revolute", "revolute"])
        )
        + "</robot>"
    )
    model, peer = kj.load(text), pin.buildModelFromXML(text)
    rng = np.random.default_rng(0)
    q, u, u_dot = rng.normal(size=(3, 4))
    expected = pin.computeJointTorqueRegressor(peer, peer.createData(), q, u, u_dot).reshape(4, 4, 10)
    own = np.asarray(kj.regressor(model, jnp.asarray(q), jnp.asarray(u), jnp.asarray(u_dot)))
    bodies = [model.tree.body(f"l{i}") for i in range(4)]
    theirs = np.empty_like(expected)
    theirs[..., PINOCCHIO_ORDER] = expected
    assert relative(own[:, bodies], theirs) < 1e-12


@pytest.mark.parametrize(("dtype", "tolerance"), [(jnp.float64, 1e-12), (jnp.float32, 1e-4)])
def test_does_not_need_masses(dtype, tolerance):
    """A massless body has columns too: the derivative does not pass through the mass centre."""
    model = kj.from_mujoco(mujoco.MjModel.from_xml_string(random_tree(4, 5))).astype(dtype)
    empty = model.replace(mass=jnp.zeros(5), central_inertia=jnp.zeros((5, 3, 3)))
    state = [jnp.asarray(np.random.default_rng(1).normal(size=n), dtype) for n in (model.nq, model.nv, model.nv)]
    regressor = jax.jit(kj.regressor)
    columns = regressor(empty, *state)
    assert columns.dtype == dtype
    assert relative(columns, regressor(model, *state)) < tolerance
    assert jnp.all(jnp.isfinite(columns))
