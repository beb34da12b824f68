"""A process that loads inputs, is limited in time and memory, and is started again when it dies."""

import contextlib
import multiprocessing
import os
import resource
import shutil
import tempfile
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path

_MEMORY = 3 << 30


class Worker:
    """One process. `judged` returns (outcome, finding, seconds, megabytes)."""

    def __init__(self, limit: float) -> None:
        """`limit` is in seconds, of one input."""
        self.limit = limit
        self._start()

    def judged(self, kind: str, seed: int) -> tuple[str, str, float, float]:
        """Load one input there."""
        try:
            self._connection.send((kind, seed))
            if self._connection.poll(self.limit):
                return self._connection.recv()
            outcome = ("hang", f"took more than {self.limit:g} s", self.limit, 0.0)
        except (EOFError, OSError):
            self._process.join()
            outcome = ("crash", f"the process ended with {self._process.exitcode}", 0.0, 0.0)
        self.close()
        self._start()
        return outcome

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()
        self._connection.close()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_work, args=(other,), daemon=True)
        self._process.start()
        other.close()


def _work(connection: Connection) -> None:
    # What MuJoCo prints is of no interest; and JAX must not see the other packages' settings.
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    import jax

    jax.config.update("jax_enable_x64", True)
    from experiments.fuzz.cases import case
    from experiments.fuzz.judge import _known_trees, judged

    _known_trees()
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if Path("/proc/self/statm").exists() else None
    if pages is not None:
        limit = pages * resource.getpagesize() + _MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    with contextlib.suppress(EOFError, KeyboardInterrupt):
        while True:
            kind, seed = connection.recv()
            with _empty_folder() as folder:
                connection.send(tuple(judged(case(kind, seed), folder)))


@contextlib.contextmanager
def _empty_folder() -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="kanejax_fuzz_"))
    try:
        yield folder
    finally:
        os.chdir(tempfile.gettempdir())
        shutil.rmtree(folder, ignore_errors=True)
