"""The command `kanejax view`."""

import json
import threading
import webbrowser
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from kanejax._cli.terminal import (
    BAD_INPUT,
    Json,
    Repair,
    Robot,
    Strict,
    Unphysical,
    complain,
    console,
    one_line_errors,
    spinner,
    use_compilation_cache,
)

Trajectories = Annotated[
    list[Path] | None,
    typer.Option(
        "--trajectory",
        help="A motion: .npz or .zarr of simulate, motion.npz of optimize, or a log such as a CSV. Several are shown side by side.",
        show_default=False,
    ),
]
Reference = Annotated[Path | None, typer.Option(help="A motion that a translucent robot makes beside each.", show_default=False)]
Rows = Annotated[
    str | None, typer.Option(help="Trajectories of a batch to show side by side, such as 0,2,5.", show_default="the first")
]
Count = Annotated[int | None, typer.Option(min=1, max=64, help="The first so many of a batch.", show_default=False)]
Packages = Annotated[
    list[Path] | None,
    typer.Option(help="A folder of packages of ROS, for package:// in a URDF, or of meshes elsewhere.", show_default=False),
]


def chosen_rows(rows: str | None, count: int | None) -> tuple[int, ...] | None:
    """What --rows and --count ask for."""
    if rows is not None and count is not None:
        _refuse("--rows and --count both say which trajectories to show; leave one out")
    if count is not None:
        return tuple(range(count))
    if rows is None:
        return None
    words = [word.strip() for word in rows.split(",")]
    if not all(word.isdecimal() and len(word) < 10 for word in words):
        _refuse(f"--rows {rows!r} is no list of numbers; write it like 0,2,5")
    return tuple(int(word) for word in words)


def view(
    robot: Robot,
    trajectory: Trajectories = None,
    rows: Rows = None,
    count: Count = None,
    reference: Reference = None,
    packages: Packages = None,
    host: Annotated[str, typer.Option(help="Address to serve at; the default is seen by this machine alone.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of the page; if it is taken, the next that is free.")] = 8080,
    no_open: Annotated[bool, typer.Option("--no-open", help="Print the address, and do not open a browser.")] = False,
    play: Annotated[bool, typer.Option("--play", help="Play the motion at once.")] = False,
    repair: Repair = False,
    strict: Strict = False,
    allow_unphysical: Unphysical = False,
    as_json: Json = False,
) -> None:
    """Show a robot and its motion on a page of the browser, until Ctrl-C.

    Links look as the robot's file says; one without shapes is drawn as its frame and the ellipsoid of its inertia: the solid one of
    uniform density with the link's mass and principal moments. Without a trajectory there is a slider for each joint.

    Examples:
    - `kanejax view arm.urdf`
    - `kanejax view arm.urdf --trajectory runs.zarr --count 4`
    - `kanejax view arm.urdf --trajectory log.csv --reference result/motion.npz`
    - `kanejax view arm.urdf --packages ~/ros/src --no-open --port 9000`
    """
    with one_line_errors():
        chosen = chosen_rows(rows, count)
        import jax

        from kanejax._view.view import view as show

        use_compilation_cache()
        with spinner("reading"), jax.enable_x64(True):
            page = show(
                robot,
                trajectory,
                rows=chosen,
                reference=reference,
                packages=packages or (),
                strict=strict,
                repair=repair,
                allow_unphysical=allow_unphysical,
                host=host,
                port=port,
            )
        with page:
            tell(page.notes)
            if as_json:
                print(json.dumps({"url": page.url, "notes": page.notes}), flush=True)
            else:
                console().print(Text(f"{robot}: {page.url}   (Ctrl-C ends it)"), soft_wrap=True)
            if play:
                page.play()
            if not no_open:
                webbrowser.open(page.url)
            threading.Event().wait()


def tell(notes: tuple[str, ...]) -> None:
    """Print what is not shown as it should be, to the terminal."""
    for note in notes:
        complain(note.replace("packages=", "--packages"), "note: ")


def _refuse(problem: str) -> None:
    complain(problem)
    raise typer.Exit(BAD_INPUT)
