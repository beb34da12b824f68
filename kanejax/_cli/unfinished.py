"""Unfinished work in the folder of a command: gone on with or dropped as the flags say, and never by accident."""

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import typer

from kanejax._checkpoint import INTERVAL, CheckpointError
from kanejax._cli.terminal import BAD_INPUT, complain

NAME = "unfinished.npz"
Resume = Annotated[bool, typer.Option("--resume", help="Go on with the unfinished work in the folder, if there is any.")]
Fresh = Annotated[bool, typer.Option("--fresh", help="Begin anew, and drop unfinished work in the folder.")]
Interval = Annotated[float, typer.Option("--checkpoint-interval", min=0.0, help="Time between two checkpoints [s].")]
DEFAULT_INTERVAL = INTERVAL


def check_unfinished(out: Path, *, resume: bool, fresh: bool) -> None:
    """Refuse, before anything is computed, to lose unfinished work, or to go on with it unasked."""
    path = out / NAME
    if resume and fresh:
        complain("--resume and --fresh exclude each other; give one")
        raise typer.Exit(BAD_INPUT)
    if path.exists() and not resume and not fresh:
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(path.stat().st_mtime))
        complain(f"{out} holds unfinished work of {when}; --resume goes on with it, --fresh drops it and begins anew")
        raise typer.Exit(BAD_INPUT)


@contextlib.contextmanager
def unfinished(out: Path, say: Callable[[str], None], *, fresh: bool) -> Iterator[Path]:
    """Where to keep what is unfinished, with words on it: from where it goes on, why it does not, and that it can after Ctrl-C."""
    path = out / NAME
    if fresh:
        path.unlink(missing_ok=True)
    if path.exists():
        say(f"going on with {path}")
    try:
        yield path
    except CheckpointError as error:
        say(error.problem)
        complain(f"{error.problem}; --fresh drops it and begins anew, or give another --out")
        raise typer.Exit(BAD_INPUT) from error
    except KeyboardInterrupt:
        done = "what is done is kept; --resume goes on from there" if path.exists() else "there is nothing to keep yet"
        say(f"interrupted; {done}")
        complain(f"{out}: {done}", "")
        raise
