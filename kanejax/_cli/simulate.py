"""The command `kanejax simulate`."""

import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from kanejax._cli.terminal import (
    BAD_INPUT,
    FAILED,
    Json,
    Repair,
    Robot,
    Strict,
    Unphysical,
    check_writable,
    complain,
    console,
    load,
    one_line_errors,
    print_differences,
    use_compilation_cache,
)

if TYPE_CHECKING:
    from kanejax._dataset.study import Study
    from kanejax._dataset.study_file import StudyFile
    from kanejax._io.load import LoadReport

STORE, FILE = ".zarr", ".npz"


def _print_example(wanted: bool) -> bool:
    if wanted:
        import kanejax

        print((Path(kanejax.__file__).parent / "_dataset" / "study_example.toml").read_text(encoding="utf-8"), end="")
        raise typer.Exit
    return wanted


def simulate(
    robot: Robot,
    out: Annotated[
        Path, typer.Option(help="What to write: an .npz file, or a .zarr store for any number of trajectories.", show_default=False)
    ],
    study: Annotated[
        Path | None,
        typer.Option(help="TOML file with what is drawn at random, forces and the solver; see --example.", show_default=False),
    ] = None,
    trajectories: Annotated[int | None, typer.Option(min=1, help="Number of trajectories.", show_default="256")] = None,
    duration: Annotated[float | None, typer.Option(min=1e-9, max=1e9, help="Length of each, in s.", show_default="1.0")] = None,
    times: Annotated[
        int | None, typer.Option(min=2, max=1_000_000, help="Times to save, from 0 to the duration.", show_default="101")
    ] = None,
    speed: Annotated[
        float | None, typer.Option(min=0.0, help="Standard deviation of the initial speeds, in rad/s and m/s.", show_default="1.0")
    ] = None,
    damping: Annotated[float, typer.Option(min=0.0, help="Damping to add to every joint, in N m s/rad and N s/m.")] = 0.0,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the random numbers.", show_default="0")] = None,
    float32: Annotated[bool, typer.Option("--float32", help="Compute in float32 instead of float64.")] = False,
    max_steps: Annotated[
        int | None, typer.Option(min=1, help="Stop a trajectory after this many steps.", show_default="4096")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a store: simulate what is missing.")] = False,
    chunk: Annotated[int, typer.Option(min=1, help="Trajectories in one piece of a store.")] = 1024,
    coordinator: Annotated[
        str | None,
        typer.Option(
            help="One of several processes: host:port of the first, or auto on SLURM, Kubernetes or TPUs.", show_default=False
        ),
    ] = None,
    processes: Annotated[int | None, typer.Option(min=1, help="How many there are.", show_default=False)] = None,
    process: Annotated[int | None, typer.Option(min=0, help="Which one this is, from 0 on.", show_default=False)] = None,
    repair: Repair = False,
    strict: Strict = True,
    allow_unphysical: Unphysical = False,
    as_json: Json = False,
    example: Annotated[
        bool, typer.Option("--example", callback=_print_example, is_eager=True, help="Print a study, and exit.")
    ] = False,
) -> None:
    """Simulate a robot from random states, and write the trajectories to a file or a data set.

    Without a study, initial coordinates lie within the joints' ranges and there are no forces at the joints. There are
    time, q (trajectory, time, nq), u (trajectory, time, nv), status (see kanejax.Status), t_end, num_steps, and what was drawn
    for each trajectory. A .zarr store is written piece by piece, in memory that does not grow; after an interruption of any
    kind --resume simulates what is missing, to the same bits. xarray.open_zarr reads it.

    Examples:
    - `kanejax simulate arm.urdf --out arm.npz`
    - `kanejax simulate arm.urdf --trajectories 1000000 --study study.toml --out runs.zarr`
    - `kanejax simulate arm.urdf --trajectories 1000000 --study study.toml --out runs.zarr --resume`
    - `kanejax simulate --example > study.toml`
    """
    with one_line_errors():
        if out.suffix not in (STORE, FILE):
            _refuse(f"--out {out} ends in neither {FILE} nor {STORE}; which of them says what is written")
        if out.suffix == FILE:
            check_writable(out)
        if out.suffix == FILE and (resume or coordinator):
            _refuse(f"--resume and --coordinator are for {STORE} stores; an {FILE} file is written at the end")
        from kanejax._cli.simulate_results import write_file, write_store
        from kanejax._dataset.study_file import StudyFile, read_study

        # Before anything asks JAX for its devices.
        _join(coordinator, processes, process)
        use_compilation_cache()
        file = StudyFile() if study is None else read_study(study)
        given = {"trajectories": trajectories, "duration": duration, "times": times, "seed": seed}
        values = {"trajectories": 256, "duration": 1.0, "times": 101, "seed": 0} | dict(file.values)
        values |= {name: value for name, value in given.items() if value is not None}
        report = load(robot, strict=strict, repair=repair, allow_unphysical=allow_unphysical)
        import jax

        with jax.enable_x64(True):
            drawn = _study(file, report, values, speed, damping, max_steps, "float32" if float32 else "float64")
            shown = not as_json and sys.stderr.isatty() and jax.process_index() == 0
            write = write_store if out.suffix == STORE else write_file
            options = {"resume": resume, "chunk": chunk} if out.suffix == STORE else {}
            begun = time.perf_counter()
            counts, sentences, details = write(drawn, out, report.origin, progress=shown, **options)
            details |= {"status": counts, "seconds": time.perf_counter() - begun, "out": str(out)}
            if jax.process_index() == 0:
                _print(report, values, details, sentences, as_json=as_json)
    if counts.get("SUCCESSFUL", 0) < values["trajectories"]:
        raise typer.Exit(FAILED)


def _refuse(problem: str) -> None:
    complain(problem)
    raise typer.Exit(BAD_INPUT)


def _join(coordinator: str | None, processes: int | None, process: int | None) -> None:
    """Meet the other processes."""
    if coordinator is None:
        if processes is not None or process is not None:
            _refuse("--processes and --process need --coordinator, the host:port of the first process")
        return
    import jax

    if coordinator == "auto":
        jax.distributed.initialize()
    else:
        if processes is None or process is None or process >= processes:
            _refuse(f"--coordinator {coordinator} needs --processes and --process, which counts from 0 on")
        jax.distributed.initialize(coordinator, processes, process)


def _study(
    file: "StudyFile",
    report: "LoadReport",
    values: dict[str, Any],
    speed: float | None,
    damping: float,
    max_steps: int | None,
    dtype: str,
) -> "Study":
    """The study that the file and the command's options describe."""
    import numpy as np

    from kanejax import distributions
    from kanejax._errors import UnsupportedModelError

    if not report.model.nv:
        raise UnsupportedModelError("the robot has no joints, so nothing moves")
    model = dataclasses.replace(report.model, damping=report.model.damping + damping).astype(dtype)
    ts = np.linspace(0.0, values["duration"], values["times"])
    found = file.study(model, ts, values["trajectories"], values["seed"], {})
    changes: dict[str, Any] = {} if speed is None else {"u0": distributions.Normal(0.0, speed)}
    if max_steps is not None:
        changes["options"] = {**found.options, "max_steps": max_steps}
    return dataclasses.replace(found, **changes) if changes else found


def _print(report: "LoadReport", values: dict[str, Any], details: dict[str, Any], sentences: list[str], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(details, indent=1))
        return
    print_differences(report)
    listed = ", ".join(f"{count} {name}" for name, count in details["status"].items())
    what = f"{values['trajectories']} trajectories of {values['duration']:g} s in {details['seconds']:.1f} s"
    console().print(Text(f"{details['out']}: {what}: {listed}"))
    for sentence in sentences:
        console().print(Text(sentence))
