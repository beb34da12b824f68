"""Checkpoints: where a long computation is, in a file, so that it goes on as if it had never been cut off.

A computation is a loop over a state, a pytree of arrays, numbers and strings from which everything else follows. It begins with
what the checkpoint has of its state, and hands every new state over; at an interval the latest states are written. A
computation of several loops gives each a part of the checkpoint.
"""

import contextlib
import io
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._errors import KanejaxError, warn_caller
from kanejax._fingerprint import fingerprint_of
from kanejax._whole_file import remove_leftovers, whole_file

# Seconds between two writings.
INTERVAL = 5.0
# The fingerprint's name in the file, and what stands between the names of a part and of a leaf of its state.
_MARK, _LEAF = "fingerprint", "|"


class CheckpointError(KanejaxError, ValueError):
    """A checkpoint cannot be gone on from, or cannot be written where it is asked for; the message says why and what to do."""

    def __init__(self, problem: str, remedy: str) -> None:
        """Say what is wrong, and what helps."""
        super().__init__(f"{problem}; {remedy}")
        self.problem = problem


class CheckpointWarning(UserWarning):
    """A checkpoint was not written; the computation goes on."""


@final
class Checkpoint:
    """An open checkpoint, or a part of one."""

    def __init__(self, file: "_File | None" = None, name: str = "") -> None:
        """A part of a file; without one nothing is kept."""
        self._file, self._name = file, name

    @property
    def has_begun(self) -> bool:
        """Whether anything is in it."""
        return self._file is not None and self._file.has(self._name)

    def part(self, name: str) -> "Checkpoint":
        """The part for a loop within the computation."""
        return Checkpoint(self._file, f"{self._name}{name}/")

    def restored[T](self, first: T) -> T:
        """The state that was kept, or the first one, whose structure it has.

        Raises:
            CheckpointError: the checkpoint has another structure.
        """
        return first if self._file is None else self._file.restored(self._name, first)

    def keep(self, state: Any) -> None:
        """The state is this one now, which must not be written to any more; or what a function returns when it is asked."""
        if self._file is not None:
            self._file.keep(self._name, state)


@contextlib.contextmanager
def opened(checkpoint: Checkpoint | str | os.PathLike[str] | None, interval: float, *inputs: Any) -> Iterator[Checkpoint]:
    """A checkpoint to go on from, written at the interval [s], and at the end, also that by an exception.

    Args:
        checkpoint: path of the file; None keeps nothing. One that is open already is left to who opened it.
        interval: time between two writings [s].
        inputs: all that the computation depends on.

    Raises:
        CheckpointError: the file belongs to other inputs, is no checkpoint, or cannot be written.
    """
    if not isinstance(checkpoint, str | os.PathLike):
        yield checkpoint or Checkpoint()
        return
    if not interval >= 0:
        raise ValueError(f"checkpoint_interval is {interval}; give seconds between two checkpoints, 0 or more")
    file = _File(Path(checkpoint), fingerprint_of(*inputs), interval)
    try:
        yield Checkpoint(file)
    finally:
        file.write()


class _File:
    """The states of all parts, those read and those of now, and when they were written last."""

    def __init__(self, path: Path, mark: str, interval: float) -> None:
        self.path: Path = path
        self._mark, self._interval = mark, interval
        _check_writable(path)
        remove_leftovers(path)
        self._read = _arrays_in(path, mark) if path.exists() else {}
        self._states: dict[str, Any] = {}
        self._is_new, self._failed, self._written = False, False, time.monotonic()

    def has(self, part: str) -> bool:
        return any(name.startswith(part) for name in (*self._states, *self._read))

    def restored[T](self, part: str, first: T) -> T:
        if part in self._states:
            return self._states[part]
        found = {name: value for name, value in self._read.items() if name.startswith(part + _LEAF)}
        if not found:
            return first
        leaves, structure = jax.tree.flatten(first)
        names = _names(part, first)
        if set(names) != set(found):
            raise CheckpointError(f"{self.path} was made by another version of the library", "remove it")
        state = jax.tree.unflatten(structure, [_like(leaf, found[name]) for leaf, name in zip(leaves, names, strict=True)])
        self._states[part] = state
        return state

    def keep(self, part: str, state: Any) -> None:
        self._states[part], self._is_new = state, True
        if time.monotonic() - self._written >= self._interval:
            self.write()

    def write(self) -> None:
        """Write the states, unless they are written; where that fails, warn once."""
        if not self._is_new:
            return
        arrays = dict(self._read)
        for part, kept in self._states.items():
            state = kept() if callable(kept) else kept
            arrays |= {name: np.asarray(leaf) for name, leaf in zip(_names(part, state), jax.tree.leaves(state), strict=True)}
        try:
            # In memory first: an archive on a full disk complains once more when it is forgotten.
            content = io.BytesIO()
            np.savez(content, **{_MARK: np.array(self._mark), **arrays})  # type: ignore[arg-type]
            with whole_file(self.path) as partial:
                partial.write_bytes(content.getbuffer())
            self._is_new = False
        except OSError as error:
            if not self._failed:
                told = f"the checkpoint {self.path} cannot be written, and the computation goes on without: {error.strerror}"
                warn_caller(told, CheckpointWarning)
            self._failed = True
        self._written = time.monotonic()


def _names(part: str, state: Any) -> list[str]:
    paths = [path for path, _ in jax.tree_util.tree_leaves_with_path(state)]
    return [part + _LEAF + jax.tree_util.keystr(path, simple=True, separator=".") for path in paths]


def _like(leaf: Any, array: np.ndarray) -> Any:
    """What was kept, as the kind of value that the leaf is."""
    if isinstance(leaf, jax.Array):
        return jnp.asarray(array, leaf.dtype)
    if isinstance(leaf, bool | int | float | str):
        return type(leaf)(array.item())
    return array


def _check_writable(path: Path) -> None:
    if path.is_dir():
        raise CheckpointError(f"the checkpoint {path} is a folder", "give the path of a file")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise CheckpointError(f"the checkpoint {path} cannot be written", f"{path.parent} is no folder that one may write to")


def _arrays_in(path: Path, mark: str) -> dict[str, np.ndarray]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        found = str(arrays.pop(_MARK))
    except MemoryError:
        raise
    # A file that something else wrote, or that is not whole: there are as many exceptions as ways to break it.
    except Exception as error:
        raise CheckpointError(f"{path} is no checkpoint, or broken", "remove it, or give another path") from error
    if found != mark:
        raise CheckpointError(f"{path} belongs to other inputs", "remove it to begin anew, or give another path")
    return arrays
