"""The command `kanejax`: look at a robot, validate it, simulate it, see it move, identify it, find its optimal motions.

Exit codes: 0 all is well; 1 a tolerance is exceeded, a trajectory failed, or a fit did not converge; 2 the input or the usage is
wrong; 130 interrupted.
JAX and MuJoCo are used inside the commands only.
"""

import json
from typing import Annotated

import typer

from kanejax._cli.identify import identify
from kanejax._cli.optimize import optimize
from kanejax._cli.render import render
from kanejax._cli.simulate import simulate
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
    complain,
    console,
    load,
    one_line_errors,
    print_differences,
    spinner,
    use_compilation_cache,
    with_options,
)
from kanejax._cli.usage import Commands, print_version
from kanejax._cli.view import view
from kanejax._errors import KanejaxError

app: typer.Typer = typer.Typer(
    cls=Commands,
    epilog=EXIT_CODES,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Run the command line."""
    app()


@app.callback()
def about(
    version: Annotated[
        bool, typer.Option("--version", callback=print_version, is_eager=True, help="Print the versions, and exit.")
    ] = False,
) -> None:
    """Rigid-body dynamics of robots by Kane's method.

    A first look, from a robot's URDF or MJCF to a comparison with MuJoCo and 256 trajectories:

    - `kanejax info arm.urdf`
    - `kanejax validate arm.urdf`
    - `kanejax simulate arm.urdf --out arm.npz`

    Each command has examples in its `--help`, and prints JSON for programs with `--json`.
    """


@app.command(epilog=EXIT_CODES)
def info(
    robot: Robot,
    repair: Repair = False,
    strict: Strict = False,
    allow_unphysical: Unphysical = False,
    as_json: Json = False,
) -> None:
    """Print a robot's tree of bodies and joints, their parameters, and how the model differs from its file.

    Examples:
    - `kanejax info arm.urdf`
    - `kanejax info --json arm.urdf > arm.json`
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

    Examples:
    - `kanejax validate arm.urdf`
    - `kanejax validate --samples 100 --repair --no-strict *.urdf`
    - `kanejax validate --json arm.urdf > report.json`
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


for _command in (simulate, view, render, identify, optimize):
    app.command(epilog=EXIT_CODES)(_command)


if __name__ == "__main__":
    main()
