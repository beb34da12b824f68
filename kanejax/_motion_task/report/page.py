"""Pictures of a motion, and a page that shows it: everything in one file, without links to anything else."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kanejax._identify.report.numbers import number
from kanejax._identify.report.svg import drawing, report_package, svg
from kanejax._motion_task.report.pictures import motion_figure, places
from kanejax._motion_task.report.skeleton import animation
from kanejax._motion_task.task_file import TaskFile
from kanejax._optimize.motion import OptimalMotion
from kanejax._optimize.task import MotionTask
from kanejax._plots.motion import motion as motion_on_paper

# Of what lies between the limits: what is nearer to one is said to be there.
_NEAR = 1e-3
_QUANTITIES = {"coordinate": "q", "speed": "u", "force": "tau"}
_DPI = 132


def motion_page(file: TaskFile, motion: OptimalMotion, record: Mapping[str, Any], sentences: list[str]) -> str:
    """The page, as HTML.

    Args:
        file: what was asked for.
        motion: what was found.
        record: of the motion.
        sentences: on how good it is.

    Raises:
        ImportError: jinja2 or matplotlib is not installed; the message says how to install it.
    """
    jinja2 = report_package("jinja2")
    folders = [Path(__file__).parent, Path(__file__).parents[2] / "_identify" / "report"]
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.FileSystemLoader(folder) for folder in folders]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    with drawing():
        figure = motion_figure(file.task, motion)
        picture = svg(figure, "coordinates, speeds and forces of each joint over time, with their limits", "signals")
    played = {name: replay for name, replay in record["replays"].items() if "problem" not in replay}
    return environment.get_template("page.html").render(
        title=file.output.get("title", Path(record["task"]).stem),
        summary=_summary(file, record),
        findings=_findings(record, sentences),
        picture=picture,
        quantities=list(_QUANTITIES),
        joints=_joint_rows(file.task, motion),
        costs=[(name, _number(value)) for name, value in record["costs"].items()],
        cost=_number(record["cost"]),
        replays=list(played),
        replay_rows=_replay_rows(played),
        notes=record["notes"],
        data={**animation(file.task, motion, file.constraints), "panels": places(figure)},
    )


def write_png(path: Path, task: MotionTask, motion: OptimalMotion) -> None:
    """The picture alone.

    Raises:
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    motion_on_paper(task.model, motion, limits=task.limits).savefig(path, format="png", dpi=_DPI)


def _summary(file: TaskFile, record: Mapping[str, Any]) -> dict[str, str]:
    task = file.task
    tree = task.model.tree
    sought = (
        f", sought from {number(float(task.duration[0]))} to {number(float(task.duration[1]))} s" if task.is_free_in_time else ""
    )
    return {
        "Task": Path(record["task"]).name,
        "Robot": Path(record["robot"]).name,
        "Mechanism": ", ".join(
            (_count(tree.nbody, "body", "bodies"), _count(tree.njoint, "joint", "joints"), _count(tree.nv, "speed", "speeds"))
        ),
        "Duration": f"{number(record['duration'], 6)} s in {task.steps} steps{sought}",
        "Method": f"{task.dynamics} dynamics, {task.integrator}",
        "Search": f"{record['iterations']} iterations; {number(record['seconds'], 3)} s with compiling and replays",
    }


def _findings(record: Mapping[str, Any], sentences: list[str]) -> list[tuple[str, str]]:
    texts = [text[0].upper() + text[1:] + "." for text in sentences]
    if not record["converged"]:
        problem = record["problem"]
        return [("bad", f"Not converged: {problem}."), *(("note", text) for text in texts)]
    return [("good", texts[0]), *(("note", text) for text in texts[1:])]


def _joint_rows(task: MotionTask, motion: OptimalMotion) -> list[tuple[str, list[dict[str, Any]]]]:
    """Least and greatest values and limits of each speed; of coordinates only where there is one a speed."""
    tree, rows = task.model.tree, []
    plain = dict(zip(*(each.tolist() for each in tree.plain_speeds), strict=True))
    for v, name in enumerate(tree.speed_names):
        columns = {"q": plain.get(v), "u": v, "tau": v}
        cells = [
            {"span": "", "limits": "", "at_limit": False}
            if column is None
            else _cell(np.asarray(getattr(motion, field))[:, column], getattr(task.limits, field), v)
            for field, column in columns.items()
        ]
        rows.append((name, cells))
    return rows


def _cell(values: np.ndarray, limits: Any, v: int) -> dict[str, Any]:
    low, high = (-np.inf, np.inf) if limits is None else np.asarray(limits)[:, v]
    values = np.round(values, 9) + 0.0
    room = _NEAR * (high - low if np.isfinite(high - low) else max(abs(values).max(), 1e-9))
    return {
        "span": f"{number(float(values.min()), 3)} to {number(float(values.max()), 3)}",
        "limits": "none" if not np.any(np.isfinite((low, high))) else f"{_limit(low)} to {_limit(high)}",
        "at_limit": bool(values.min() <= low + room or values.max() >= high - room),
    }


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


def _limit(value: float) -> str:
    return number(float(value), 4) if np.isfinite(value) else "any"


def _replay_rows(replays: Mapping[str, Any]) -> list[tuple[str, list[str]]]:
    if not replays:
        return []
    names = next(iter(replays.values()))["q"]
    keys = ("q", "u", "q_at_end", "u_at_end")
    return [(name, [_number(replay[key][name], 2) for replay in replays.values() for key in keys]) for name in names]


def _number(value: float | None, digits: int = 6) -> str:
    return number(float("nan") if value is None else value, digits)
