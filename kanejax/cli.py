"""The command `kanejax`: look at a robot, validate it, simulate it, identify it, find its optimal motions.

Exit codes: 0 all is well; 1 a tolerance is exceeded, a trajectory failed, or a fit did not converge; 2 the input or the usage is
wrong; 130 interrupted.
JAX and MuJoCo are used inside the commands only.
"""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from kanejax._cli.identify import identify
from kanejax._cli.optimize import optimize
from kanejax._cli.terminal import (
    BAD_INPUT,
    EXIT_CODES,
    FAILED,
    Json,
    Repair,
    Robot,
    Robots,
    Seed,
    Strict,
    Unphysical,
    check_writable,
    complain,
    console,
    load,
    one_line_errors,
    print_differences,
    spinner,
    use_compilation_cache,
    with_options,
    write_arrays,
)
from kanejax._errors import KanejaxError

app = typer.Typer(
    help="Rigid-body dynamics of robots by Kane's method: inspect, validate, simulate, identify and optimize.",
    epilog=EXIT_CODES,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Run the command line."""
    app()


@app.command(epilog=EXIT_CODES)
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
    with one_line_errors():
        from kanejax import validate as compare

        use_compilation_cache()
        reports, refused = [], False
        for robot in robots:
            with spinner(f"comparing {robot}"):
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
                    complain(with_options(error))
                    refused = True
                    continue
            reports.append(report)
            if not as_json:
                console().print(report.table())
        if as_json:
            print(json.dumps([report.as_dict() for report in reports], indent=1))
        over = [report.robot for report in reports if not report.passed]
        for name in over:
            complain(f"{name}: over tolerance", "")
    if refused or over:
        raise typer.Exit(BAD_INPUT if refused else FAILED)


@app.command(epilog=EXIT_CODES)
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
    with one_line_errors():
        from kanejax._report import model_dict, model_tree

        report = load(robot, strict=strict, repair=repair, allow_unphysical=allow_unphysical)
        differences = {"ignored": report.ignored, "not modelled": report.unmodelled, "changed": report.repaired}
        if as_json:
            print(json.dumps({"robot": report.origin, **model_dict(report.model), **differences}, indent=1))
            return
        console().print(model_tree(report.model, report.origin))
        print_differences(report)


@app.command(epilog=EXIT_CODES)
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
    with one_line_errors():
        check_writable(out)
        from kanejax import Status
        from kanejax._report import energies_line, simulated

        use_compilation_cache()
        report = load(robot, strict=strict, repair=repair, allow_unphysical=allow_unphysical)
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
        write_arrays(out, {**run.arrays, "details": json.dumps(details)})
        counts = {status.name: int((run.arrays["status"] == status).sum()) for status in Status}
        counts = {name: count for name, count in counts.items() if count}
        if as_json:
            print(json.dumps({**details, "status": counts, "out": str(out)}, indent=1))
        else:
            print_differences(report)
            listed = ", ".join(f"{count} {name}" for name, count in counts.items())
            console().print(
                Text(f"{out}: {trajectories} trajectories of {duration:g} s in {run.details['seconds']:.1f} s: {listed}")
            )
            console().print(Text(energies_line(run.details)))
    if counts.get("SUCCESSFUL", 0) < trajectories:
        raise typer.Exit(FAILED)


app.command(epilog=EXIT_CODES)(identify)
app.command(epilog=EXIT_CODES)(optimize)


if __name__ == "__main__":
    main()
