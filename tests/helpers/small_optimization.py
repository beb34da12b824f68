"""Searches for optimal motions of a pendulum, one alone and then some at once; run as a script, see killing."""

import functools
import pathlib
import sys

import jax
import numpy as np

import kanejax as kj
from kanejax import costs
from tests.helpers.killing import CHECKPOINT, RESULT, tell_of_states

PENDULUM = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping=".1"/>
  <inertial pos="0 0 -1" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body></worldbody></mujoco>"""
ROWS = np.linspace(0.2, 3.1, 80)[:, None]


@functools.cache
def pendulum() -> kj.Model:
    """A point at the end of a rod."""
    return kj.load(PENDULUM)


def swing_up(goal: jax.Array | np.ndarray) -> kj.MotionTask:
    """Too weak to do without swinging."""
    return kj.MotionTask(pendulum(), [0.0], goal, 3.0, costs.torque(), limits=kj.Limits(pendulum(), u=8.0, tau=4.0), steps=30)


def main(folder: pathlib.Path) -> None:
    """Search, and write the motions."""
    one = kj.optimize(swing_up(ROWS[-1]), throw=False, checkpoint=folder / CHECKPOINT, checkpoint_interval=0.0)
    path = folder / f"many_{CHECKPOINT}"
    many = kj.optimize_batch(swing_up, ROWS, threads=1, checkpoint=path, checkpoint_interval=0.0)
    arrays = {
        f"{name} {i}": leaf for name, motion in (("one", one), ("many", many)) for i, leaf in enumerate(jax.tree.leaves(motion))
    }
    np.savez(folder / RESULT, **arrays)


if __name__ == "__main__":
    tell_of_states()
    main(pathlib.Path(sys.argv[1]))
