import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj

Q0, U0, TS = np.array([0.3, -0.8]), np.array([0.5, 1.0]), np.array([0.0, 0.2, 0.4])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q0": np.zeros(3)}, r"q0 has shape \(3,\), but this model needs \(2,\) = \(nq,\)"),
        ({"u0": np.zeros((4, 2))}, r"u0 has shape \(4, 2\).*simulate_batch"),
        ({"q0": np.array([0.0, np.nan])}, r"q0\[1\] of joint 'elbow' is nan"),
        ({"u0": np.array([np.inf, 0.0])}, r"u0\[0\] of joint 'shoulder' is inf"),
        ({"q0": Q0.astype(np.float16)}, "q0 has dtype float16, but the model has float64"),
        ({"u0": jnp.zeros(2, jnp.float32)}, "u0 has dtype float32, but the model has float64"),
        ({"ts": np.array([0.0])}, r"ts has shape \(1,\)"),
        ({"ts": np.array([0.0, 1.0, 1.0])}, r"strictly increasing in float64, but ts\[2\] = 1.0 follows 1.0"),
        ({"ts": np.array([0.0, np.nan])}, r"ts\[1\] is not finite"),
        ({"dt0": 0.0}, "dt0 is 0.0; it must be positive"),
        ({"rtol": -1e-3}, "rtol is -0.001"),
        ({"max_steps": 0}, "max_steps is 0"),
    ],
)
def test_bad_arguments_are_named(pendulum, change, message):
    arguments = {"q0": Q0, "u0": U0, "ts": TS, **change}
    with pytest.raises(ValueError, match=message):
        kj.simulate(pendulum, arguments.pop("q0"), arguments.pop("u0"), arguments.pop("ts"), **arguments)


def test_times_that_merge_in_single_precision_are_refused(pendulum):
    single = pendulum.astype(jnp.float32)
    with pytest.raises(ValueError, match="strictly increasing in float32"):
        kj.simulate(single, Q0.astype(np.float32), U0.astype(np.float32), np.array([1.0, 1.0 + 1e-9]))


def test_a_zero_quaternion_is_refused(floating):
    q0 = np.zeros(12)
    q0[3] = 1.0
    with pytest.raises(ValueError, match=r"q0\[7:11\], the quaternion of joint 'hip', is zero"):
        kj.simulate(floating, q0, np.zeros(10), TS)
