"""A small arm, and recordings of it, as exact or as noisy as a test wants."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

import kanejax as kj

ARM = """<mujoco><worldbody><body name="base_link"><joint name="base" axis="0 0 1"/>
<inertial pos="0.02 0.01 0.1" mass="3" fullinertia="0.03 0.04 0.02 0.002 -0.001 0.003"/>
<body name="upper" pos="0 0.1 0.3"><joint name="shoulder" axis="0 1 0"/>
<inertial pos="0.2 0.02 0.01" mass="2" fullinertia="0.01 0.05 0.05 0.001 0.002 -0.001"/>
<body name="fore" pos="0.4 0 0"><joint name="elbow" axis="0 1 0"/>
<inertial pos="0.15 -0.01 0.02" mass="1" fullinertia="0.005 0.02 0.02 0.0005 0.001 0.0002"/></body></body></body>
</worldbody></mujoco>"""
OFFSETS = np.array([0.3, -0.2, 0.1])


@functools.cache
def arm() -> kj.Model:
    """Three joints with friction: 15 base inertia parameters."""
    model = kj.load(ARM)
    return model.replace(damping=[0.5, 0.8, 0.3], coulomb_friction=[0.4, 0.6, 0.2], friction_width=jnp.full(3, 0.02))


def motion_of_arm(rate: float = 100.0, duration: float = 10.0, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Times, coordinates, speeds and their rates of a motion of four harmonics."""
    ts, rng = np.arange(0, duration, 1 / rate), np.random.default_rng(seed)
    w = 2 * np.pi * np.arange(1, 5)[:, None, None] / 10.0
    a, b = rng.normal(size=(2, 4, 1, 3)) * 0.6 / np.sqrt(np.arange(1, 5))[:, None, None]
    sine, cosine = np.sin(w * ts[:, None]), np.cos(w * ts[:, None])
    q = (a * sine + b * cosine).sum(0)
    return ts, q, (w * (a * cosine - b * sine)).sum(0), (-(w**2) * (a * sine + b * cosine)).sum(0)


_forces = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))


def efforts(model: kj.Model, q: np.ndarray, u: np.ndarray, u_dot: np.ndarray) -> np.ndarray:
    """Torques of the joints, with offsets."""
    force = _forces(model, *map(jnp.asarray, (q, u, u_dot)))
    return np.asarray(force) + OFFSETS


def recorded_arm(noise: float = 0.0, seed: int = 0, rate: float = 100.0, duration: float = 10.0) -> kj.Motion:
    """A motion of the arm with its torques, to which noise of this part of their size is added."""
    ts, q, u, u_dot = motion_of_arm(rate, duration)
    torque = efforts(arm(), q, u, u_dot)
    size = np.sqrt(np.mean(torque**2, 0))
    return kj.Motion(ts, q, u, u_dot, torque + noise * size * np.random.default_rng(seed).normal(size=torque.shape))
