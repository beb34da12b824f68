"""Random trees with every joint type: the library and MuJoCo agree to rounding."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import kanejax as kj
from tests.helpers.mechanisms import KINDS, random_states, random_tree, relative
from tests.helpers.oracle import ask


@jax.jit
def everything(model, q, u, u_dot, tau):
    return {
        "inverse": kj.inverse_dynamics(model, q, u, u_dot),
        "forward": kj.forward_dynamics(model, q, u, tau),
        "mass_matrix": kj.mass_matrix(model, q),
        "bias": kj.bias_force(model, q, u),
        "passive": kj.passive_force(model, q, u),
    }


def compare(xml: str, dtype: str, tolerance: float, forward_tolerance: float, count: int = 3, batch: bool = False) -> None:
    """In a batch, or one state after the other, which compiles in half the time."""
    mj = mujoco.MjModel.from_xml_string(xml)
    model = kj.from_mujoco(mj).astype(dtype)
    q, u, other = random_states(mj, count)
    states = [jnp.asarray(x, dtype) for x in (q, u, other, other)]
    if batch:
        found = jax.vmap(everything, (None, 0, 0, 0, 0))(model, *states)
        found = [{name: values[i] for name, values in found.items()} for i in range(count)]
    else:
        found = [everything(model, *(x[i] for x in states)) for i in range(count)]
    for i in range(count):
        answer = ask(mj, q[i], u[i], other[i], other[i])
        for name, value in found[i].items():
            limit = forward_tolerance if name == "forward" else tolerance
            error = relative(value, getattr(answer, name))
            assert error <= limit, f"{name} differs by {error:.1e} from MuJoCo's in state {i}"


@settings(max_examples=4, deadline=None, derandomize=True, database=None)
@given(seed=st.integers(0, 10_000), bodies=st.integers(2, 40))
def test_random_trees_in_float64(seed, bodies):
    compare(random_tree(seed, bodies), "float64", 1e-11, 1e-9)


@pytest.mark.parametrize(("seed", "bodies"), [(1, 4), (2, 12)])
def test_random_trees_in_float32(seed, bodies):
    compare(random_tree(seed, bodies), "float32", 1e-4, 1e-4, batch=bodies > 4)


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "weld"])
def test_each_joint_type_alone(kind):
    compare(random_tree(5, 1, (kind,)), "float64", 1e-11, 1e-9)


def test_chains_mix_revolute_and_prismatic_joints():
    compare(random_tree(7, 6, ("hinge", "slide"), chain=True), "float64", 1e-11, 1e-9)


def test_ball_joints_between_branches():
    compare(random_tree(11, 9, ("ball", "hinge")), "float64", 1e-11, 1e-9, batch=True)


def test_kinematics_energy_and_momentum():
    mj = mujoco.MjModel.from_xml_string(random_tree(2, 12))
    model = kj.from_mujoco(mj)
    assert set(model.tree.joint_types) == {"revolute", "prismatic", "ball", "free"}
    (q,), (u,), (rate,) = random_states(mj, 1)
    wrench = np.random.default_rng(0).normal(size=(model.nbody, 6))
    tau = np.zeros(mj.nv)
    answer = ask(mj, q, u, rate, tau, wrench)

    @jax.jit
    def measure(model, q, u):
        external = kj.external_force(model, q, jnp.asarray(wrench[:, :3]), jnp.asarray(wrench[:, 3:]))
        return (
            kj.poses(model, q),
            kj.partial_velocities(model, q),
            kj.kinetic_energy(model, q, u),
            kj.potential_energy(model, q),
            kj.momentum(model, q, u),
            kj.forward_dynamics(model, q, u, external),
        )

    at, partial, kinetic, potential, momentum, forward = measure(model, q, u)
    assert relative(at.com, answer.com) < 1e-11
    assert relative(at.rotation, answer.rotation) < 1e-11
    assert relative(partial.linear, answer.jacobian_com) < 1e-11
    assert relative(partial.angular, answer.jacobian_rotation) < 1e-11
    assert relative(kinetic, answer.kinetic) < 1e-11
    assert relative(potential, answer.potential) < 1e-11
    assert relative(momentum.linear, answer.momentum) < 1e-11
    assert relative(momentum.angular, answer.angular_momentum) < 1e-11
    assert relative(forward, answer.forward) < 1e-9


def test_a_model_without_joints_has_no_forces():
    model = kj.from_mujoco(mujoco.MjModel.from_xml_string('<mujoco><worldbody><body><geom size=".1"/></body></worldbody></mujoco>'))
    nothing = jnp.zeros(0)
    assert kj.inverse_dynamics(model, nothing, nothing, nothing).shape == (0,)
    assert kj.forward_dynamics(model, nothing, nothing, nothing).shape == (0,)
    assert kj.mass_matrix(model, nothing).shape == (0, 0)
    assert kj.poses(model, nothing).com.shape == (1, 3)
