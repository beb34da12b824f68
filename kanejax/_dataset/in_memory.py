"""Simulation of a study that fits into memory, and how well it kept its energy."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._dataset.chunks import run_chunks
from kanejax._dataset.store import LAST
from kanejax._dataset.study import Study
from kanejax._dynamics.energy import kinetic_energy, potential_energy
from kanejax._model.model import Model
from kanejax._simulate.trajectory import Status

BATCH_SIZE = 128


class _Memory:
    """One chunk that is kept."""

    def __init__(self, trajectories: int) -> None:
        self._trajectories = trajectories
        self.arrays: dict[str, np.ndarray] = {}

    def rows(self, chunk: int) -> range:
        return range(self._trajectories)

    def write(self, chunk: int, arrays: Mapping[str, np.ndarray]) -> None:
        self.arrays = dict(arrays)


def simulated_study(study: Study, *, progress: bool = False) -> dict[str, np.ndarray]:
    """All trajectories of a study: the arrays of its data set, by name."""
    memory = _Memory(study.trajectories)
    run_chunks(study, memory, np.arange(1), batch_size=BATCH_SIZE, threads=None, progress=progress)
    shared = {"time": study.ts} | ({} if study.force_times is None else {"force_time": study.force_times})
    return shared | memory.arrays


def energy_change(model: Model, arrays: Mapping[str, np.ndarray]) -> tuple[float | None, float | None]:
    """Median and greatest change of energy of trajectories that reached their end, relative to what is large in each."""
    done = arrays[LAST] == Status.SUCCESSFUL
    if not done.any():
        return None, None
    energies = jax.jit(jax.vmap(lambda q, u: (kinetic_energy(model, q, u), potential_energy(model, q))))
    states = ((jnp.asarray(arrays["q"][:, i]), jnp.asarray(arrays["u"][:, i])) for i in (0, -1))
    begin, end = (np.asarray(energies(*state))[:, done] for state in states)
    change = np.abs(end.sum(0) - begin.sum(0))
    # What moved between the two kinds of energy, or was there to begin with, says what is large.
    size = np.maximum(np.maximum(begin[0], end[0]), np.abs(end[1] - begin[1]))
    relative = np.divide(change, size, out=np.zeros_like(change), where=size > 0)
    return float(np.median(relative)), float(np.max(relative))
