"""A motion task, as a TOML file says it."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import jax.numpy as jnp

from kanejax._errors import KanejaxError
from kanejax._model.model import Model
from kanejax._motion_task.joints import check_joints, limits_of_joints, limits_of_robot, of_joints
from kanejax._motion_task.keys import CONSTRAINTS, COSTS, KEYS, LOCKED
from kanejax._motion_task.terms import made_terms, read_motion, read_terms
from kanejax._optimize.limits import Limits
from kanejax._optimize.locked import with_locked_joints
from kanejax._optimize.optimize import Guess
from kanejax._optimize.task import Boundary, MotionTask
from kanejax._toml import ConfigurationError, checked, file_text, parsed_toml, refuse, written

if TYPE_CHECKING:
    from kanejax._io.load import LoadReport

_OF_TASK = ("steps", "dynamics", "integrator", "substeps")
_OF_SEARCH = {"method": "solver", "tolerance": "tolerance", "max_iterations": "max_iterations"}


@final
@dataclasses.dataclass(frozen=True)
class TaskFile:
    """A task, and how to solve and show it.

    Attributes:
        robot: how the robot was loaded, with all of its joints.
        task: what is asked for.
        guess: where to start, if the file says it.
        guesses: how many, of which the best result counts: all but the first are bent at random.
        bend: how much [rad, m].
        seed: of the random numbers.
        options: of `optimize`.
        output: what to write, and the title.
        constraints: names and options of all constraints, to draw them.
    """

    robot: "LoadReport"
    task: MotionTask
    guess: Guess | None
    guesses: int
    bend: float
    seed: int
    options: Mapping[str, Any]
    output: Mapping[str, Any]
    constraints: tuple[tuple[str, Mapping[str, Any]], ...]


def read_task(path: Path, load: Callable[[str], "LoadReport"]) -> TaskFile:
    """Read a task from a TOML file.

    Args:
        path: of the file; other files that it names are relative to its folder.
        load: reads the robot.

    Raises:
        ConfigurationError: the file is no TOML, or a key or value in it means nothing; the message says what may stand there.
        KanejaxError: the robot cannot be loaded.
        OSError: the file cannot be read.
    """
    origin = str(path)
    values = parsed_toml(file_text(path), origin)
    if "robot" not in values:
        refuse(origin, 'there is no robot; say which, such as robot = "arm.urdf" in the first line')
    top = checked(origin, "the file", values, KEYS[""])
    for name, example in (("start", "q = [0.0, 0.5]"), ("goal", "q = [1.0, 0.0]"), ("costs", "torque = 1.0")):
        if not top.get(name):
            refuse(origin, f"there is no table [{name}], which could have {example}")
    if "duration" not in top:
        refuse(origin, "there is no duration; give seconds, or a pair of the least and the greatest")
    costs = read_terms(origin, "[costs]", top["costs"], COSTS)
    constraints = read_terms(origin, "[constraints]", top.get("constraints", {}), CONSTRAINTS)
    ends = {name: _read_end(origin, name, top[name]) for name in ("start", "goal")}
    tables = {name: checked(origin, f"[{name}]", top.get(name, {}), KEYS[name]) for name in ("limits", "solver", "output")}
    source = top["robot"] if top["robot"].lstrip().startswith("<") else str(path.parent / top["robot"])
    robot = load(source)
    model = _held(origin, robot.model, top)
    solver = tables["solver"]
    with _told(origin, "the task"):
        start, goal = (_boundary(origin, name, *ends[name], model) for name in ("start", "goal"))
        task = MotionTask(
            model,
            start,
            goal,
            top["duration"],
            made_terms(origin, "[costs]", costs, COSTS, model.tree),
            limits=_limits(origin, tables["limits"], model, source),
            constraints=made_terms(origin, "[constraints]", constraints, CONSTRAINTS, model.tree),
            **{key: solver[key] for key in _OF_TASK if key in solver},
        )
    return TaskFile(
        robot,
        task,
        _guess(origin, solver, task),
        solver.get("guesses", 1),
        solver.get("bend", 1.0),
        solver.get("seed", 0),
        {option: solver[key] for key, option in _OF_SEARCH.items() if key in solver},
        tables["output"],
        (*constraints, *ends["start"][1], *ends["goal"][1]),
    )


def _read_end(origin: str, name: str, table: dict[str, Any]) -> tuple[dict[str, Any], list[tuple[str, dict[str, Any]]]]:
    """The state at the start or the goal, and its constraints."""
    options = checked(origin, f"[{name}]", table, KEYS[name])
    constraints = read_terms(origin, f"[{name}.constraints]", options.pop("constraints", {}), CONSTRAINTS)
    if "q" not in options and not constraints:
        refuse(origin, f'[{name}] has neither q nor constraints; give coordinates, constraints, or q = "free"')
    return options, constraints


def _boundary(origin: str, name: str, options: dict[str, Any], constraints: list, model: Model) -> Boundary:
    q, u = options.get("q", "free"), options.get("u", 0.0)
    return Boundary(
        None if q == "free" else of_joints(origin, f"[{name}] q", q, model.tree, coordinates=True),
        None if u == "free" else of_joints(origin, f"[{name}] u", u, model.tree, others=0.0),
        made_terms(origin, f"[{name}.constraints]", constraints, CONSTRAINTS, model.tree),
    )


def _held(origin: str, model: Model, top: dict[str, Any]) -> Model:
    """The model with the file's gravity, and without the joints that are locked."""
    locked = top.get("locked", {})
    check_joints(origin, "[locked]", locked, model.tree)
    for joint, value in locked.items():
        if not LOCKED.accepts(value):
            refuse(origin, f"[locked] {joint} is {written(value)}; it must be {LOCKED.words}")
    if "gravity" in top:
        model = model.replace(gravity=jnp.asarray(top["gravity"], model.dtype))
    with _told(origin, "[locked]"):
        return with_locked_joints(model, locked) if locked else model


def _limits(origin: str, table: dict[str, Any], model: Model, robot: str) -> Limits:
    values, passive = dict(table), table.get("passive", ())
    values.pop("passive", None)
    check_joints(origin, "[limits] passive", passive, model.tree)
    for field, value in values.items():
        label = f"[limits] {field}"
        given = limits_of_robot(origin, label, robot, field, model.tree) if value == "robot" else value
        values[field] = limits_of_joints(origin, label, given, model, field)
    with _told(origin, "[limits]"):
        return Limits(model, passive=passive, **values)


def _guess(origin: str, solver: dict[str, Any], task: MotionTask) -> Guess | None:
    if "guess" not in solver:
        return None
    found = read_motion(origin, "[solver] guess", solver["guess"])
    model, steps = task.model, task.steps
    for name, shape in (("q", (steps + 1, model.nq)), ("u", (steps + 1, model.nv)), ("tau", (steps, model.nv))):
        if found[name].shape != shape:
            refuse(origin, f"[solver] guess has {name} of shape {found[name].shape}, but this task needs {shape}")
    return Guess(*(jnp.asarray(found[name], model.dtype) for name in ("q", "u", "u_dot", "tau", "duration")))


@contextlib.contextmanager
def _told(origin: str, label: str) -> Iterator[None]:
    """Say where an error is."""
    try:
        yield
    except ConfigurationError:
        raise
    except (KanejaxError, ValueError, TypeError) as error:
        raise ConfigurationError(f"{origin}: {label}: {error}") from error
