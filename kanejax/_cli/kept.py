"""Stages of an identification that converged, kept in a file so that nothing has to be done twice."""

import json
from pathlib import Path

import numpy as np

from kanejax._cli.terminal import write_arrays
from kanejax._identify.result import Stage

# After the key of a stage, for how it ended; the key alone is for its theta.
_RECORD = ": how it ended"


class KeptStages:
    """How each stage ended, and its free coordinates theta; for one fingerprint of the inputs.

    What a stage finds depends on those before it, so a kept stage counts only if all before it are the same.
    """

    def __init__(self, path: Path, fingerprint: str, stages: tuple[str, ...], *, fresh: bool = False) -> None:
        """Read the file, if there is one and it is wanted.

        Attributes:
            stale: whether there is a file that belongs to other inputs, or cannot be read.
        """
        self._path, self._fingerprint, self._stages = path, fingerprint, stages
        self._arrays: dict[str, np.ndarray] = {}
        self.stale = False
        if path.exists() and not fresh:
            self._read()

    @property
    def resumable(self) -> dict[str, tuple[Stage, np.ndarray]]:
        """The stages that need not be repeated."""
        found = {}
        for name in self._stages:
            key = self._key(name)
            if key not in self._arrays or key + _RECORD not in self._arrays:
                break
            fields = json.loads(str(self._arrays[key + _RECORD]))
            stage = Stage(**fields)._replace(rms=np.array(fields["rms"], float))
            found[name] = (stage, self._arrays[key])
        return found

    def keep(self, stage: Stage, theta: object) -> None:
        """Write down where a stage ended."""
        key = self._key(stage.name)
        record = stage._replace(rms=np.asarray(stage.rms).tolist())  # type: ignore[arg-type]
        self._arrays[key] = np.asarray(theta)
        self._arrays[key + _RECORD] = np.array(json.dumps(record._asdict()))
        write_arrays(self._path, {"fingerprint": np.array(self._fingerprint), **self._arrays})

    def _key(self, stage: str) -> str:
        return " then ".join(self._stages[: self._stages.index(stage) + 1])

    def _read(self) -> None:
        try:
            with np.load(self._path, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
        # A file that something else wrote, or that a full disk cut off.
        except Exception:
            arrays = {}
        self.stale = str(arrays.pop("fingerprint", "")) != self._fingerprint
        self._arrays = {} if self.stale else arrays
