"""The command `kanejax optimize`."""

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from kanejax._cli.terminal import (
    FAILED,
    Json,
    Repair,
    Strict,
    Unphysical,
    check_report_packages,
    complain,
    console,
    load,
    logbook,
    one_line_errors,
    spinner,
    use_compilation_cache,
)
from kanejax._cli.unfinished import DEFAULT_INTERVAL, Fresh, Interval, Resume, check_unfinished, unfinished

if TYPE_CHECKING:
    from collections.abc import Callable

    from kanejax._motion_task.task_file import TaskFile


def _print_example(wanted: bool) -> bool:
    if wanted:
        import kanejax

        print((Path(kanejax.__file__).parent / "_motion_task" / "task_example.toml").read_text(encoding="utf-8"), end="")
        raise typer.Exit
    return wanted


def optimize(
    task: Annotated[Path, typer.Argument(metavar="TASK", help="TOML file of the task; see --example.", show_default=False)],
    out: Annotated[Path, typer.Option(help="The folder to write to.", show_default=False)],
    resume: Resume = False,
    fresh: Fresh = False,
    checkpoint_interval: Interval = DEFAULT_INTERVAL,
    repair: Repair = False,
    strict: Strict = True,
    allow_unphysical: Unphysical = False,
    as_json: Json = False,
    example: Annotated[
        bool, typer.Option("--example", callback=_print_example, is_eager=True, help="Print the file of a task, and exit.")
    ] = False,
) -> None:
    """Find the motion of a robot that costs least, from a start to a goal within limits.

    Writes motion.json (costs, errors of the conditions of optimality, replays in diffrax and MuJoCo), motion.npz, motion.csv,
    motion.png (coordinates, speeds and forces with their limits), report.html (the same with the robot moving) and run.log.
    What is unfinished is kept in the folder: after an interruption the same command goes on from there with `--resume`.

    Examples:
    - `kanejax optimize task.toml --out result`
    - `kanejax optimize task.toml --out result --resume`
    - `kanejax optimize --example > task.toml`
    """
    with one_line_errors():
        import jax

        from kanejax._cli.optimize_results import LOG_NAME
        from kanejax._motion_task.task_file import read_task
        from kanejax._optimize.feasibility import InfeasibleTaskError, NonFiniteTaskError

        check_unfinished(out, resume=resume, fresh=fresh)
        use_compilation_cache()
        with jax.enable_x64(True):
            begun = time.perf_counter()
            options = {"strict": strict, "repair": repair, "allow_unphysical": allow_unphysical}
            with spinner("reading"):
                file = read_task(task, lambda robot: load(robot, **options))
            check_report_packages(file.output, "task")
            out.mkdir(parents=True, exist_ok=True)
            say = logbook(out / LOG_NAME)
            for line in (f"Task: {task}", f"Robot: {file.robot.origin}", *_notes(file)):
                say(line)
            try:
                with unfinished(out, say, fresh=fresh) as checkpoint:
                    kept = {"checkpoint": checkpoint, "checkpoint_interval": checkpoint_interval}
                    problem = _solved(file, {"task": str(task)}, out, say, begun, kept, as_json=as_json)
            except (InfeasibleTaskError, NonFiniteTaskError) as error:
                problem = str(error)
            if problem:
                say(problem)
                complain(problem, "")
    if problem:
        raise typer.Exit(FAILED)


def _solved(
    file: "TaskFile",
    details: dict[str, Any],
    out: Path,
    say: "Callable[[str], None]",
    begun: float,
    kept: dict[str, Any],
    *,
    as_json: bool,
) -> str:
    """Search, replay, write and print; why there is no optimal motion, or nothing."""
    from kanejax._cli.optimize_progress import SearchLine
    from kanejax._cli.optimize_results import motion_record, replays, sentences, write_motion, write_pictures
    from kanejax._cli.optimize_search import fingerprint, searched
    from kanejax._optimal_control.search import Result

    with SearchLine(file.guesses, say, shown=not as_json and sys.stderr.isatty()) as line:
        found = searched(file, line, **kept)
    motion, problem = found.best.motion, found.best.problem
    with spinner("replaying"):
        played = replays(file, motion) if not problem and file.output.get("replay", True) else {}
    details |= {"robot": file.robot.origin, "fingerprint": fingerprint(file), "notes": _notes(file)}
    details["seconds"] = time.perf_counter() - begun
    record = motion_record(file, found, played, details)
    with spinner("writing"):
        written = write_motion(out, file, motion, record)
        if file.output.get("report", True):
            written += write_pictures(out, file, motion, record)
    if motion.result == Result.RUNNING:
        say("the search is kept for more iterations")
    else:
        kept["checkpoint"].unlink(missing_ok=True)
    for sentence in sentences(record):
        say(sentence)
    _print(record, written, as_json=as_json)
    return f"not converged: {problem}" if problem else ""


def _notes(file: "TaskFile") -> tuple[str, ...]:
    robot = file.robot
    return (*robot.ignored, *robot.unmodelled, *robot.repaired)


def _print(record: dict[str, Any], written: list[Path], *, as_json: bool) -> None:
    from kanejax._cli.optimize_results import cost_table, sentences

    if as_json:
        print(json.dumps(record, indent=1, allow_nan=False))
        return
    console().print(cost_table(record))
    for sentence in sentences(record):
        console().print(Text(sentence), soft_wrap=True)
    console().print(Text("written: " + ", ".join(map(str, written))), soft_wrap=True)
