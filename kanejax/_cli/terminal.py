"""What the commands share: robots and files, errors of one line, exit codes, and the terminal."""

import contextlib
import json
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from kanejax._errors import IgnoredFeatureWarning, KanejaxError, RepairedModelWarning, UnphysicalInertiaWarning
from kanejax._whole_file import whole_file

if TYPE_CHECKING:
    from kanejax._io.load import LoadReport

FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130
EXIT_CODES = "Exit codes: 0 all is well, 1 over tolerance, failed or not converged, 2 bad input, 130 interrupted."

Robot = Annotated[str, typer.Argument(metavar="ROBOT", help="Path of a URDF or MJCF file.", show_default=False)]
Robots = Annotated[list[str], typer.Argument(metavar="ROBOT...", help="Paths of URDF or MJCF files.", show_default=False)]
Repair = Annotated[bool, typer.Option("--repair", help="Change numbers that no mechanism can have by the least that helps.")]
Strict = Annotated[
    bool, typer.Option("--strict/--no-strict", help="Refuse, or ignore, what enters the dynamics and is not modelled.")
]
Unphysical = Annotated[bool, typer.Option("--allow-unphysical", help="Keep inertias that no rigid body can have.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")]


def load(robot: str, *, strict: bool, repair: bool, allow_unphysical: bool) -> "LoadReport":
    """Load a robot in float64, with what is to be told of it."""
    import jax

    from kanejax import load_report

    with jax.enable_x64(True):
        return load_report(robot, strict=strict, repair=repair, allow_unphysical=allow_unphysical)


def use_compilation_cache() -> None:
    """Keep compiled programs in the user's cache folder, unless JAX is told where."""
    import jax

    if jax.config.jax_compilation_cache_dir is None:
        home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
        jax.config.update("jax_compilation_cache_dir", os.path.join(home, "kanejax", "jax"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def write_arrays(path: Path, arrays: dict[str, Any]) -> None:
    """Write an NPZ file."""
    import numpy as np

    with whole_file(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, **arrays)


def write_json(path: Path, record: Mapping[str, Any]) -> None:
    """Write a JSON file."""
    with whole_file(path) as partial:
        partial.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def logbook(path: Path) -> Callable[[str], None]:
    """Write lines with the time to a file, after those of earlier runs."""

    def say(sentence: str) -> None:
        with path.open("a", encoding="utf-8") as file:
            print(time.strftime("%Y-%m-%d %H:%M:%S"), " ".join(sentence.split()), file=file)

    return say


def check_writable(out: Path) -> None:
    """Refuse, before anything is computed, a file that cannot be written."""
    if out.is_dir() or not out.parent.is_dir() or not os.access(out.parent, os.W_OK):
        what = "is a folder" if out.is_dir() else f"cannot be written: {out.parent} is no folder that one may write to"
        complain(f"--out {out} {what}; give the path of a file")
        raise typer.Exit(BAD_INPUT)


@contextlib.contextmanager
def one_line_errors() -> Iterator[None]:
    """Print warnings and expected errors as one line each, without a traceback."""
    with warnings.catch_warnings():
        for category in (IgnoredFeatureWarning, RepairedModelWarning, UnphysicalInertiaWarning):
            warnings.simplefilter("always", category)
        warnings.showwarning = lambda message, category, *_, **__: complain(str(message), "warning: ")
        try:
            yield
        except KanejaxError as error:
            complain(with_options(error))
            raise typer.Exit(BAD_INPUT) from error
        except BrokenPipeError as error:
            # Whoever read the output, such as `head`, has seen enough; nothing may be written at exit either.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(0) from error
        except OSError as error:
            complain(f"{error.filename or ''}: {error.strerror or error}")
            raise typer.Exit(BAD_INPUT) from error
        except ModuleNotFoundError as error:
            if error.name != "pinocchio":
                raise
            complain(str(error))
            raise typer.Exit(BAD_INPUT) from error
        except KeyboardInterrupt as error:
            complain("interrupted", "")
            raise typer.Exit(INTERRUPTED) from error


def with_options(error: BaseException) -> str:
    """An error's message, with the keywords of `load` as options."""
    message = str(error)
    for keyword, option in (
        ("load with repair=True", "use --repair"),
        ("repair=True", "--repair"),
        ("load with strict=False", "use --no-strict"),
        ("strict=False", "--no-strict"),
        ("allow_unphysical=True", "--allow-unphysical"),
        ("resume=True", "--resume"),
        ("give another path", "give another --out"),
    ):
        message = message.replace(keyword, option)
    return message


def complain(message: str, prefix: str = "error: ") -> None:
    """Print a sentence to the terminal, one line."""
    Console(stderr=True).print(Text(prefix + " ".join(message.split())), soft_wrap=True)


def console() -> Console:
    """Where tables go: as wide as the terminal, or wide enough in a file."""
    return Console(width=None if sys.stdout.isatty() else 160)


def spinner(text: str) -> contextlib.AbstractContextManager:
    """Something that turns while one waits, on a terminal."""
    return Console(stderr=True).status(Text(text)) if sys.stderr.isatty() else contextlib.nullcontext()


def print_differences(report: "LoadReport") -> None:
    """Tell how a model differs from its file."""
    for heading, sentences in (
        ("ignored, though it enters the dynamics", report.ignored),
        ("of no effect on the equations of motion", report.unmodelled),
        ("changed", report.repaired),
    ):
        for sentence in sentences:
            console().print(Text.assemble((f"{heading}: ", "yellow"), sentence), soft_wrap=True)


def check_report_packages(output: Mapping[str, Any], file: str) -> None:
    """Refuse, before anything is computed, to write a report without the packages for it."""
    from kanejax._identify.report.svg import report_package

    if not output.get("report", True):
        return
    try:
        for package in ("jinja2", "matplotlib"):
            report_package(package)
    except ImportError as error:
        complain(f"{error}; or say report = false in [output] of the {file}")
        raise typer.Exit(BAD_INPUT) from error
