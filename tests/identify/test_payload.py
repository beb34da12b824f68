"""Payloads, against MuJoCo."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.mechanisms import random_states, random_tree, relative

import kanejax as kj
from kanejax._parameters.payload import with_payload


def test_payloads_weigh_what_they_say():
    """Against MuJoCo, for a body in the middle of a branching tree."""
    model = kj.load(random_tree(5, 6))
    carrier = model.tree.body_names[1]
    numbers = {"position": [0.1, 0.2, 0.3], "quaternion": [1, 0.2, 0.3, 0.1], "com": [0.05, 0, 0.1]}
    nothing = with_payload(model, carrier, **numbers)
    loaded = with_payload(model, carrier, "load", mass=1.5, central_inertia=np.diag([0.1, 0.2, 0.25]), **numbers)
    mj = kj.to_mujoco(loaded).compile()
    assert loaded.tree.joint_names == model.tree.joint_names
    assert kj.from_mujoco(mj).tree == loaded.tree
    q, u, u_dot = (jnp.asarray(x[0]) for x in random_states(mj, 1))
    assert relative(kj.inverse_dynamics(nothing, q, u, u_dot), kj.inverse_dynamics(model, q, u, u_dot)) < 1e-12
    expected = kj.inverse_dynamics(kj.from_mujoco(mj), q, u, u_dot)
    assert relative(kj.inverse_dynamics(loaded, q, u, u_dot), expected) < 1e-12
    assert relative(kj.inverse_dynamics(nothing, q, u, u_dot), expected) > 1e-3
    single = jax.jit(lambda m: with_payload(model.astype(jnp.float32), carrier, mass=m))(jnp.float32(2.0))
    assert single.dtype == jnp.float32
    assert single.body("payload").mass == 2.0


def test_payloads_check_what_they_get():
    model = kj.load(random_tree(5, 3))
    with pytest.raises(kj.UnknownNameError, match="no body is named 'hand'; the names are: 'b0', 'b1'"):
        with_payload(model, "hand")
    with pytest.raises(ValueError, match="a body is named 'b0' already; give the payload another name"):
        with_payload(model, "b1", "b0")
    with pytest.raises(ValueError, match=r"com of payload 'load' has shape \(2,\), but needs \(3,\)"):
        with_payload(model, "b1", "load", com=[1, 2])
