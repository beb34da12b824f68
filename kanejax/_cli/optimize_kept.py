"""The search for an optimal motion, kept in a file so that it can go on as if it had never ended."""

import time
import typing
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from kanejax._cli.terminal import write_arrays
from kanejax._optimal_control.search import Search
from kanejax._optimize.motion import OptimalMotion

# Seconds between two writings.
_PAUSE = 1.0
_MOTION = ("ts", "q", "u", "u_dot", "tau", "duration")


class KeptSearch:
    """Where the search from the present guess is, and what was found from those before; for one fingerprint of the inputs.

    Attributes:
        path: of the file.
        costs: of the motions from guesses that are done, infinite where there is none.
        search: from the present guess, or None at its beginning.
        stale: whether there is a file that belongs to other inputs, or cannot be read.
    """

    def __init__(self, path: Path, fingerprint: str, *, fresh: bool = False) -> None:
        """Read the file, if there is one and it is wanted."""
        self.path, self._fingerprint, self._written = path, fingerprint, time.monotonic()
        self._motion: dict[str, np.ndarray] = {}
        self.costs: list[float] = []
        self.search: Search | None = None
        self.stale = False
        if path.exists() and not fresh:
            self._read()

    def __bool__(self) -> bool:
        """Whether a search has begun."""
        return self.search is not None or bool(self.costs)

    def __str__(self) -> str:
        """How far it is."""
        iterations = 0 if self.search is None else int(self.search.iterations)
        return f"{len(self.costs)} guesses and {iterations} iterations" if self.costs else f"{iterations} iterations"

    def at(self, search: Search) -> None:
        """The search is here."""
        self.search = search
        self._write_now_and_then()

    def shown(self, motion: OptimalMotion) -> None:
        """The motion there, which is written for whoever looks into the file."""
        self._motion = {name: np.asarray(getattr(motion, name)) for name in _MOTION}

    def done(self, cost: float) -> None:
        """The search from a guess has ended."""
        self.costs.append(cost)
        self.search = None
        self._write_now_and_then()

    def write(self) -> bool:
        """Write down where the search is, if it has begun."""
        if not self:
            return False
        found = {} if self.search is None else _arrays("search", self.search)
        state = {"fingerprint": np.array(self._fingerprint), "costs": np.array(self.costs, float)}
        write_arrays(self.path, state | found | self._motion)
        self._written = time.monotonic()
        return True

    def forget(self) -> None:
        """There is nothing to go on with."""
        self.path.unlink(missing_ok=True)

    def _write_now_and_then(self) -> None:
        if time.monotonic() - self._written > _PAUSE:
            self.write()

    def _read(self) -> None:
        try:
            with np.load(self.path, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            self.stale = str(arrays["fingerprint"]) != self._fingerprint
            if not self.stale:
                self.costs = arrays["costs"].tolist()
                self.search = _search(Search, "search", arrays) if "search.mu" in arrays else None
        # A file that something else wrote, or that a full disk cut off.
        except Exception:
            self.stale, self.costs, self.search = True, [], None


def _arrays(name: str, value: Any) -> dict[str, np.ndarray]:
    """The leaves of named tuples by their path."""
    if not hasattr(value, "_fields"):
        return {name: np.asarray(value)}
    return {key: leaf for field in value._fields for key, leaf in _arrays(f"{name}.{field}", getattr(value, field)).items()}


def _search(kind: Any, name: str, arrays: dict[str, np.ndarray]) -> Any:
    """The inverse of `_arrays`."""
    if not hasattr(kind, "_fields"):
        return jnp.asarray(arrays[name])
    hints = typing.get_type_hints(kind)
    return kind(*(_search(hints[field], f"{name}.{field}", arrays) for field in kind._fields))
