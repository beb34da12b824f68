"""What `kanejax optimize` writes and prints."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from kanejax._cli.optimize_search import Found
from kanejax._cli.terminal import write_arrays, write_json
from kanejax._identify.record import plain, versions
from kanejax._model.tree import Tree
from kanejax._motion_task.task_file import TaskFile
from kanejax._optimal_control.search import Result
from kanejax._optimize.motion import OptimalMotion
from kanejax._optimize.tracking import Deviation, replayed, replayed_by_mujoco
from kanejax._simulate.trajectory import SimulationError
from kanejax._whole_file import whole_file

JSON_NAME, LOG_NAME = "motion.json", "run.log"
_UNITS = "SI units and radians"


def replays(file: TaskFile, motion: OptimalMotion) -> dict[str, Deviation | str]:
    """How simulations of the motion's forces differ from it, or why there is none."""
    found: dict[str, Deviation | str] = {}
    for name, replay in (("diffrax", replayed), ("MuJoCo", replayed_by_mujoco)):
        try:
            found[name] = replay(file.task.model, motion)
        except SimulationError as error:
            found[name] = str(error)
    return found


def motion_record(
    file: TaskFile, found: Found, played: Mapping[str, Deviation | str], details: Mapping[str, Any]
) -> dict[str, Any]:
    """Everything but the motion over time, for `json.dump`."""
    motion, task = found.best.motion, file.task
    names = task.model.tree.speed_names
    return plain(
        {
            **details,
            "versions": versions(),
            "units": _UNITS,
            "converged": not found.best.problem,
            "result": Result(int(motion.result)).name,
            "problem": found.best.problem or None,
            "iterations": int(motion.iterations),
            "errors": motion.errors._asdict(),
            "duration": motion.duration,
            "cost": motion.cost,
            "costs": dict(motion.costs),
            "guess": found.best.guess,
            "costs_of_guesses": found.costs,
            "joints": task.model.tree.joint_names,
            "greatest": {what: dict(zip(names, _greatest(getattr(motion, what)), strict=True)) for what in ("u", "u_dot", "tau")},
            "units_of_q": dict(zip(names, _units(task.model.tree), strict=True)),
            "replays": {name: _replay(each, names) for name, each in played.items()},
        }
    )


def write_motion(folder: Path, file: TaskFile, motion: OptimalMotion, record: Mapping[str, Any]) -> list[Path]:
    """Write the motion and the record.

    Returns:
        The files.
    """
    tree = file.task.model.tree
    paths = [folder / name for name in (JSON_NAME, "motion.npz", "motion.csv")]
    write_json(paths[0], record)
    arrays = {name: np.asarray(getattr(motion, name)) for name in ("ts", "q", "u", "u_dot", "tau", "duration", "cost")}
    write_arrays(paths[1], {**arrays, "joint_names": np.array(tree.joint_names), "converged": np.array(record["converged"])})
    # Forces and accelerations hold during a step; those of the last one stand in the last row too.
    columns = [motion.q, motion.u, *(np.concatenate((each, each[-1:])) for each in (motion.u_dot, motion.tau))]
    header = ["time", *(f"position_{name}" for name in tree.coordinate_names)]
    header += [f"{what}_{name}" for what in ("velocity", "acceleration", "effort") for name in tree.speed_names]
    with whole_file(paths[2]) as partial, partial.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        writer.writerows(np.column_stack((motion.ts, *columns)).tolist())
    return paths


def write_pictures(folder: Path, file: TaskFile, motion: OptimalMotion, record: Mapping[str, Any]) -> list[Path]:
    """Draw the motion.

    Returns:
        The files.
    """
    # Only here, as it needs matplotlib.
    from kanejax._motion_task.report.page import motion_page, write_png

    paths = [folder / name for name in ("motion.png", "report.html")]
    with whole_file(paths[0]) as partial:
        write_png(partial, file.task, motion)
    with whole_file(paths[1]) as partial:
        partial.write_text(motion_page(file, motion, record, sentences(record)), encoding="utf-8")
    return paths


def cost_table(record: Mapping[str, Any]) -> Table:
    """The costs, for a terminal."""
    table = Table(title=Text(f"duration {record['duration']:.6g} s"), title_justify="left")
    table.add_column("cost", no_wrap=True)
    table.add_column("", justify="right")
    for name, value in record["costs"].items():
        table.add_row(Text(name), _number(value))
    if len(record["costs"]) > 1:
        table.add_row(Text("all"), _number(record["cost"]))
    return table


def sentences(record: Mapping[str, Any]) -> list[str]:
    """How good the motion is, in words."""
    errors, costs, found = record["errors"], record["costs_of_guesses"], []
    if record["converged"]:
        listed = ", ".join(f"{name} {value:.1e}" for name, value in errors.items())
        found.append(f"optimal after {record['iterations']} iterations: {listed}")
    if len(costs) > 1:
        ended = [cost for cost in costs if cost is not None]
        spread = f"; their costs are {min(ended):.7g} to {max(ended):.7g}" if ended else ""
        found.append(f"{len(ended)} of {len(costs)} guesses came to an optimum{spread}")
    for name, replay in record["replays"].items():
        if "problem" in replay:
            found.append(f"replay in {name}: {replay['problem']}")
            continue
        worst, at_end = (max(replay[key].items(), key=lambda item: item[1]) for key in ("q", "q_at_end"))
        off, left = (f"{value:.2g} {record['units_of_q'][name]}" for name, value in (worst, at_end))
        off = f"{off} off the motion ({worst[0]}), and {left} at its end ({at_end[0]})"
        found.append(f"replayed in {name}, the forces alone, without feedback, lead up to {off}")
    return found


def _greatest(values: Any) -> np.ndarray:
    return np.abs(np.asarray(values)).max(0)


def _replay(replay: Deviation | str, names: tuple[str, ...]) -> dict[str, Any]:
    if isinstance(replay, str):
        return {"problem": replay}
    rows = {"q": _greatest(replay.q), "u": _greatest(replay.u), "q_at_end": np.abs(replay.q[-1]), "u_at_end": np.abs(replay.u[-1])}
    return {what: dict(zip(names, values, strict=True)) for what, values in rows.items()}


def _units(tree: Tree) -> list[str]:
    """Of small displacements, for each speed."""
    of_kind = {"revolute": ["rad"], "prismatic": ["m"], "ball": ["rad"] * 3, "free": ["m"] * 3 + ["rad"] * 3}
    return [unit for kind in tree.joint_types for unit in of_kind[kind]]


def _number(value: float | None) -> str:
    return "infinite" if value is None else f"{value:.7g}"
