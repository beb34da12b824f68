"""The command `kanejax render`."""

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from kanejax._cli.terminal import (
    BAD_INPUT,
    Json,
    Repair,
    Robot,
    Strict,
    Unphysical,
    check_writable,
    complain,
    console,
    one_line_errors,
    use_compilation_cache,
)
from kanejax._cli.view import Count, Packages, Reference, Rows, Trajectories, chosen_rows, tell


def render(
    robot: Robot,
    out: Annotated[Path, typer.Option(help="What to write: .mp4, .gif, or .png for one moment.", show_default=False)],
    trajectory: Trajectories = None,
    rows: Rows = None,
    count: Count = None,
    reference: Reference = None,
    packages: Packages = None,
    size: Annotated[str, typer.Option(help="Columns and rows of the picture.")] = "960x540",
    fps: Annotated[
        float | None, typer.Option(min=1.0, max=240.0, help="Pictures a second.", show_default="30, and 25 in a GIF")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="Length of the film, in s.", show_default="to the end of the motion")
    ] = None,
    start: Annotated[float, typer.Option(min=0.0, help="Time of the motion at which it begins, or of the picture, in s.")] = 0.0,
    speed: Annotated[float, typer.Option(min=1e-6, max=1e6, help="Of the film, over that of the motion.")] = 1.0,
    camera: Annotated[
        str | None,
        typer.Option(
            help="Where it is seen from: azimuth and elevation in degrees, perhaps the distance in m, such as 40,18 or 40,18,2.5.",
            show_default="40,18, as near as shows all of it",
        ),
    ] = None,
    ellipsoids: Annotated[
        bool, typer.Option("--ellipsoids", help="Draw the ellipsoids of all inertias, and shapes translucent.")
    ] = False,
    repair: Repair = False,
    strict: Strict = False,
    allow_unphysical: Unphysical = False,
    as_json: Json = False,
) -> None:
    """Make a film of a robot's motion, or a picture of a moment, without a screen or a graphics card.

    Robots and motions are those of `kanejax view`. The same command makes the same pictures.

    Examples:
    - `kanejax render arm.urdf --trajectory runs.npz --out film.mp4`
    - `kanejax render arm.urdf --trajectory result/motion.npz --out film.gif --size 480x270 --fps 20`
    - `kanejax render arm.urdf --out arm.png --camera 120,20 --ellipsoids`
    """
    with one_line_errors():
        chosen = chosen_rows(rows, count)
        columns = _numbers("--size", size, "x", (2,), "960x540")
        angles = _numbers("--camera", camera, ",", (2, 3), "40,18 or 40,18,2.5") if camera is not None else []
        check_writable(out)
        import jax

        from kanejax._view.render import render as film

        use_compilation_cache()
        with jax.enable_x64(True), _bar(str(out), shown=not as_json) as progress:
            notes = film(
                robot,
                trajectory,
                out,
                rows=chosen,
                reference=reference,
                size=(int(columns[0]), int(columns[1])),
                fps=fps,
                seconds=seconds,
                start=start,
                speed=speed,
                ellipsoids=ellipsoids,
                packages=packages or (),
                strict=strict,
                repair=repair,
                allow_unphysical=allow_unphysical,
                progress=progress,
                **dict(zip(("azimuth", "elevation", "distance"), angles, strict=False)),
            )
        if as_json:
            print(json.dumps({"out": str(out), "notes": notes}))
            return
        tell(notes)
        console().print(Text(f"written: {out}"), soft_wrap=True)


def _numbers(option: str, text: str, mark: str, counts: tuple[int, ...], example: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(mark)]
    except ValueError:
        numbers = []
    if len(numbers) not in counts or not all(abs(number) < 1e6 for number in numbers):
        complain(f"{option} {text!r} is not understood; write it like {example}")
        raise typer.Exit(BAD_INPUT)
    return numbers


@contextlib.contextmanager
def _bar(title: str, *, shown: bool) -> Iterator[Callable[[int, int], None] | None]:
    """How far the film is, on a terminal."""
    if not (shown and sys.stderr.isatty()):
        yield None
        return
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)
