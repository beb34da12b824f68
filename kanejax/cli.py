"""The command `kanejax`: look at a robot, validate it, simulate it.

Exit codes: 0 all is well; 1 a tolerance is exceeded, or a trajectory failed; 2 the input or the usage is wrong; 130 interrupted.
JAX and MuJoCo are used inside the commands only.
"""

import contextlib
import json
import os
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from kanejax._errors import IgnoredFeatureWarning, KanejaxError, RepairedModelWarning, UnphysicalInertiaWarning

if TYPE_CHECKING:
    from kanejax._io.load import LoadReport

FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130
_EXIT_CODES = "Exit codes: 0 all is well, 1 over tolerance or failed trajectories, 2 bad input, 130 interrupted."

app = typer.Typer(
    help="Rigid-body dynamics of robots by Kane's method: inspect, validate and simulate URDF and MJCF files.",
    epilog=_EXIT_CODES,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

Robot = Annotated[str, typer.Argument(metavar="ROBOT", help="Path of a URDF or MJCF file.", show_default=False)]
Robots = Annotated[list[str], typer.Argument(metavar="ROBOT...", help="Paths of URDF or MJCF files.", show_default=False)]
Repair = Annotated[bool, typer.Option("--repair", help="Change numbers that no mechanism can have by the least that helps.")]
Strict = Annotated[
    bool, typer.Option("--strict/--no-strict", help="Refuse, or ignore, what enters the dynamics and is not modelled.")
]
Unphysical = Annotated[bool, typer.Option("--allow-unphysical", help="Keep inertias that no rigid body can have.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")]


def main() -> None:
    """Run the command line."""
    app()


@app.command(epilog=_EXIT_CODES)
def validate(
    robots: Robots,
    samples: Annotated[int, typer.Option(min=1, help="Random states for each robot.")] = 1000,
    seed: Seed = 0,
    pinocchio: Annotated[
        bool, typer.Option("--pinocchio", help="Compare URDFs with Pinocchio too (needs the package pin).")
    ] = False,
    repair: Repair = False,
    strict: Strict = True,
    allow_unphysical: Unphysical = False,
    as_json: Json = False,
) -> None:
    """Compare the dynamics of robots with MuJoCo's at random states, in float64 and float32.

    Prints the worst relative errors of inverse dynamics, forward dynamics, mass matrix and bias force, with their
    tolerances. The other robots are still compared when one cannot be.

    Examples: `kanejax validate arm.urdf`, `kanejax validate --samples 100 --repair --no-strict *.urdf`,
    `kanejax validate --json arm.urdf > report.json`
    """
    with _one_line_errors():
        from kanejax import validate as compare

        _use_compilation_cache()
        reports, refused = [], False
        for robot in robots:
            with _spinner(f"comparing {robot}"):
                try:
                    report = compare(
                        robot,
                        samples=samples,
                        seed=seed,
                        against=("mujoco", "pinocchio") if pinocchio else "mujoco",
                        strict=strict,
                        repair=repair,
                        allow_unphysical=allow_unphysical,
                    )
                except KanejaxError as error:
                    _complain(_with_options(error))
                    refused = True
                    continue
            reports.append(report)
            if not as_json:
                _console().print(report.table())
        if as_json:
            print(json.dumps([report.as_dict() for report in reports], indent=1))
        over = [report.robot for report in reports if not report.passed]
        for name in over:
            _complain(f"{name}: over tolerance", "")
    if refused or over:
        raise typer.Exit(BAD_INPUT if refused else FAILED)


@app.command(epilog=_EXIT_CODES)
def info(
    robot: Robot,
    repair: Repair = False,
    strict: Strict = False,
    allow_unphysical: Unphysical = False,
    as_json: Json = False,
) -> None:
    """Print a robot's tree of bodies and joints, their parameters, and how the model differs from its file.

    Examples: `kanejax info arm.urdf`, `kanejax info --json arm.urdf > arm.json`
    """
    with _one_line_errors():
        from kanejax._report import model_dict, model_tree

        report = _load(robot, strict=strict, repair=repair, allow_unphysical=allow_unphysical)
        differences = {"ignored": report.ignored, "not modelled": report.unmodelled, "changed": report.repaired}
        if as_json:
            print(json.dumps({"robot": report.origin, **model_dict(report.model), **differences}, indent=1))
            return
        _console().print(model_tree(report.model, report.origin))
        _print_differences(report)


@app.command(epilog=_EXIT_CODES)
def simulate(
    robot: Robot,
    out: Annotated[Path, typer.Option(help="The .npz file to write.", show_default=False)],
    trajectories: Annotated[int, typer.Option(min=1, help="Number of trajectories.")] = 256,
    duration: Annotated[float, typer.Option(min=1e-9, max=1e9, help="Length of each, in s.")] = 1.0,
    times: Annotated[int, typer.Option(min=2, help="Times to save, from 0 to the duration.")] = 101,
    speed: Annotated[float, typer.Option(min=0.0, help="Standard deviation of the initial speeds, in rad/s and m/s.")] = 1.0,
    damping: Annotated[float, typer.Option(min=0.0, help="Damping to add to every joint, in N m s/rad and N s/m.")] = 0.0,
    seed: Seed = 0,
    float32: Annotated[bool, typer.Option("--float32", help="Compute in float32 instead of float64.")] = False,
    max_steps: Annotated[int, typer.Option(min=1, help="Stop a trajectory after this many steps.")] = 4096,
    repair: Repair = False,
    strict: Strict = True,
    allow_unphysical: Unphysical = False,
    as_json: Json = False,
) -> None:
    """Simulate a robot from random states without forces at its joints, and write the trajectories to a file.

    Initial coordinates lie within the joints' ranges. The file has `ts` (times), `q` (trajectories, times, nq), `u`
    (trajectories, times, nv), `status` (see kanejax.Status), `t_end`, `joint_names`, and how they were made.

    Examples: `kanejax simulate arm.urdf --out arm.npz`,
    `kanejax simulate arm.urdf --trajectories 4096 --duration 2 --damping 0.5 --out arm.npz`
    """
    with _one_line_errors():
        _check_writable(out)
        from kanejax import Status
        from kanejax._report import energies_line, simulated

        _use_compilation_cache()
        report = _load(robot, strict=strict, repair=repair, allow_unphysical=allow_unphysical)
        run = simulated(
            report.model,
            trajectories=trajectories,
            duration=duration,
            times=times,
            speed=speed,
            damping=damping,
            seed=seed,
            dtype="float32" if float32 else "float64",
            max_steps=max_steps,
            progress=not as_json and sys.stderr.isatty(),
        )
        details = {"robot": report.origin, "trajectories": trajectories, "duration": duration, "seed": seed, **run.details}
        _write_atomically(out, {**run.arrays, "details": json.dumps(details)})
        counts = {status.name: int((run.arrays["status"] == status).sum()) for status in Status}
        counts = {name: count for name, count in counts.items() if count}
        if as_json:
            print(json.dumps({**details, "status": counts, "out": str(out)}, indent=1))
        else:
            _print_differences(report)
            listed = ", ".join(f"{count} {name}" for name, count in counts.items())
            _console().print(
                Text(f"{out}: {trajectories} trajectories of {duration:g} s in {run.details['seconds']:.1f} s: {listed}")
            )
            _console().print(Text(energies_line(run.details)))
    if counts.get("SUCCESSFUL", 0) < trajectories:
        raise typer.Exit(FAILED)


def _load(robot: str, *, strict: bool, repair: bool, allow_unphysical: bool) -> "LoadReport":
    import jax

    from kanejax import load_report

    with jax.enable_x64(True):
        return load_report(robot, strict=strict, repair=repair, allow_unphysical=allow_unphysical)


def _use_compilation_cache() -> None:
    """Keep compiled programs in the user's cache folder, unless JAX is told where."""
    import jax

    if jax.config.jax_compilation_cache_dir is None:
        home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
        jax.config.update("jax_compilation_cache_dir", os.path.join(home, "kanejax", "jax"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def _write_atomically(path: Path, arrays: dict[str, Any]) -> None:
    """Write a file that is either whole or not there."""
    import numpy as np

    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with partial.open("wb") as file:
            np.savez_compressed(file, **arrays)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _check_writable(out: Path) -> None:
    """Refuse, before anything is computed, a file that cannot be written."""
    if out.is_dir() or not out.parent.is_dir() or not os.access(out.parent, os.W_OK):
        what = "is a folder" if out.is_dir() else f"cannot be written: {out.parent} is no folder that one may write to"
        _complain(f"--out {out} {what}; give the path of a file")
        raise typer.Exit(BAD_INPUT)


@contextlib.contextmanager
def _one_line_errors() -> Iterator[None]:
    """Print warnings and expected errors as one line each, without a traceback."""
    with warnings.catch_warnings():
        for category in (IgnoredFeatureWarning, RepairedModelWarning, UnphysicalInertiaWarning):
            warnings.simplefilter("always", category)
        warnings.showwarning = lambda message, category, *_, **__: _complain(str(message), "warning: ")
        try:
            yield
        except KanejaxError as error:
            _complain(_with_options(error))
            raise typer.Exit(BAD_INPUT) from error
        except BrokenPipeError as error:
            # Whoever read the output, such as `head`, has seen enough; nothing may be written at exit either.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(0) from error
        except OSError as error:
            _complain(f"{error.filename or ''}: {error.strerror or error}")
            raise typer.Exit(BAD_INPUT) from error
        except ModuleNotFoundError as error:
            if error.name != "pinocchio":
                raise
            _complain(str(error))
            raise typer.Exit(BAD_INPUT) from error
        except KeyboardInterrupt as error:
            _complain("interrupted", "")
            raise typer.Exit(INTERRUPTED) from error


def _with_options(error: Exception) -> str:
    """An error's message, with the keywords of `load` as options."""
    message = str(error)
    for keyword, option in (
        ("load with repair=True", "use --repair"),
        ("repair=True", "--repair"),
        ("load with strict=False", "use --no-strict"),
        ("strict=False", "--no-strict"),
        ("allow_unphysical=True", "--allow-unphysical"),
    ):
        message = message.replace(keyword, option)
    return message


def _complain(message: str, prefix: str = "error: ") -> None:
    Console(stderr=True).print(Text(prefix + " ".join(message.split())), soft_wrap=True)


def _console() -> Console:
    return Console(width=None if sys.stdout.isatty() else 160)


def _spinner(text: str) -> contextlib.AbstractContextManager:
    return Console(stderr=True).status(Text(text)) if sys.stderr.isatty() else contextlib.nullcontext()


def _print_differences(report: "LoadReport") -> None:
    for heading, sentences in (
        ("ignored, though it enters the dynamics", report.ignored),
        ("of no effect on the equations of motion", report.unmodelled),
        ("changed", report.repaired),
    ):
        for sentence in sentences:
            _console().print(Text.assemble((f"{heading}: ", "yellow"), sentence), soft_wrap=True)


if __name__ == "__main__":
    main()
