"""An identification of a pendulum with friction, with all that its loops can have; run as a script, see killing."""

import functools
import json
import pathlib
import sys

import jax
import jax.numpy as jnp
import numpy as np

import kanejax as kj
from kanejax._identify.record import identification_record
from tests.helpers.killing import CHECKPOINT, RESULT, tell_of_states

PENDULUM = """<mujoco><worldbody><body name="link"><joint name="hinge" axis="0 1 0"/>
<inertial pos="0.2 0.02 0.01" mass="2" fullinertia="0.01 0.05 0.05 0.001 0.002 -0.001"/></body></worldbody></mujoco>"""
# Shapes of friction are held first and freed later.
UNKNOWNS = ("mass", "damping", "coulomb_friction", "friction_width")


@functools.cache
def pendulum() -> kj.Model:
    """With friction."""
    return kj.load(PENDULUM).replace(damping=[0.5], coulomb_friction=[0.4], friction_width=jnp.full(1, 0.2))


def recording() -> kj.Motion:
    """A noisy motion with some errors far out."""
    ts, random = np.arange(0, 4, 0.02), np.random.default_rng(0)
    w = np.array([1.3, 2.9, 4.1])[:, None]
    q, u, u_dot = (np.sum(wave, 0)[:, None] for wave in (np.sin(w * ts), w * np.cos(w * ts), -(w**2) * np.sin(w * ts)))
    forces = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))(pendulum(), q, u, u_dot)
    far = np.where(random.uniform(size=q.shape) < 0.02, 20.0, 1.0)
    noise = far * random.normal(size=q.shape)
    return kj.Motion(ts, q + 1e-3 * noise, u, u_dot, np.asarray(forces) + 0.05 * noise)


def main(folder: pathlib.Path) -> None:
    """Identify, and write all that was found."""
    nominal = pendulum().replace(mass=pendulum().mass * 1.3, damping=[0.8], coulomb_friction=[0.7], friction_width=[0.5])
    found = kj.identify(
        nominal,
        [recording()],
        UNKNOWNS,
        stages=("inverse dynamics", "simulation"),
        simulation_options={"windows": (0.5, None), "substeps": 2, "max_iterations": 8},
        robust=True,
        anneal=(2.0,),
        starts=2,
        checkpoint=folder / CHECKPOINT,
        checkpoint_interval=0.0,
    )
    runs = {f"{name} {i}": array for i, run in enumerate(found.training) for name, array in run._asdict().items() if name != "name"}
    np.savez(folder / RESULT, record=json.dumps(identification_record(found, {})), phi=np.asarray(found.phi), **runs)


if __name__ == "__main__":
    tell_of_states()
    main(pathlib.Path(sys.argv[1]))
