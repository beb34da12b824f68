"""Costs and constraints, as the file of a task gives them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kanejax._errors import KanejaxError
from kanejax._model.tree import Tree
from kanejax._motion_task.joints import of_joints
from kanejax._motion_task.keys import Term
from kanejax._optimize.moment import Constraint, Cost
from kanejax._toml import ConfigurationError, checked, refuse, written


def read_terms(origin: str, label: str, table: Mapping[str, Any], terms: Mapping[str, Term]) -> list[tuple[str, dict[str, Any]]]:
    """Names of terms and their options; of a list of tables each is a term.

    Raises:
        ConfigurationError: a term or an option is unknown or lacking, or has a value that means nothing.
    """
    found = []
    for name, given in table.items():
        if name not in terms:
            refuse(origin, f"{label} has no {name!r}; there are: {', '.join(terms)}")
        term = terms[name]
        for each in given if isinstance(given, list) and given and all(isinstance(one, dict) for one in given) else [given]:
            if not isinstance(each, dict) and term.main is None:
                refuse(origin, f"{label} {name} is {written(each)}; it must be a table with {', '.join(term.required)}")
            options = checked(origin, f"{label} {name}", each if isinstance(each, dict) else {str(term.main): each}, term.keys)
            # A motion stands for the coordinates and the duration of a path.
            needed = [key for key in term.required if "motion" not in options or key not in ("q", "duration")]
            if lacking := [key for key in needed if key not in options]:
                refuse(origin, f"{label} {name} has no {lacking[0]!r}, which is {term.keys[lacking[0]].words}")
            found.append((name, options))
    return found


def made_terms(
    origin: str, label: str, read: list[tuple[str, dict[str, Any]]], terms: Mapping[str, Term], tree: Tree
) -> tuple[Any, ...]:
    """The terms for a model.

    Raises:
        ConfigurationError: a body or joint is unknown, or a number does not fit.
    """
    return tuple(_made(origin, f"{label} {name}", terms[name], dict(options), tree) for name, options in read)


def _made(origin: str, label: str, term: Term, options: dict[str, Any], tree: Tree) -> Cost | Constraint:
    for key in ("body", "obstacle"):
        if isinstance(body := options.get(key), str) and body not in tree.body_names:
            refuse(origin, f"{label}: no body is named {body!r}; the bodies are: {', '.join(map(repr, tree.body_names))}")
    if "motion" in options:
        options |= _path(origin, label, options)
    if "q" in options:
        options["q"] = _coordinates(origin, f"{label} q", options["q"], tree)
    if "weights" in options:
        options["weights"] = of_joints(origin, f"{label} weights", options["weights"], tree, coordinates="q" in options)
    name = options.pop("name", None)
    try:
        made = term.function(**options)
    except (KanejaxError, ValueError, TypeError) as error:
        raise ConfigurationError(f"{origin}: {label}: {error}") from error
    if name is None:
        return made
    return Constraint(made.function, made.lower, made.upper, name=name, at_end=made.at_end, needs=made.needs)


def _path(origin: str, label: str, options: dict[str, Any]) -> dict[str, Any]:
    """Coordinates and duration of a motion that was written before."""
    if both := [key for key in ("q", "duration") if key in options]:
        refuse(origin, f"{label} has motion and {both[0]}; give one of them")
    found = read_motion(origin, f"{label} motion", options.pop("motion"))
    return {"q": found["q"], "duration": float(found["ts"][-1])}


def read_motion(origin: str, label: str, name: str) -> dict[str, np.ndarray]:
    """The arrays of a motion that was written before; `name` is relative to the file.

    Raises:
        ConfigurationError: there is no such file, or it is no motion.
    """
    path = Path(origin).parent / name
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {key: archive[key] for key in ("ts", "q", "u", "u_dot", "tau", "duration")}
    except (OSError, ValueError, KeyError, EOFError) as error:
        refuse(origin, f"{label} is {written(name)}, but {path} is no motion.npz that `kanejax optimize` wrote: {error}")


def _coordinates(origin: str, label: str, q: Any, tree: Tree) -> np.ndarray:
    if len(q) < 2 or any(len(row) != tree.nq for row in q):
        refuse(origin, f"{label} must be a list of at least two lists of {tree.nq} coordinates each")
    return np.array(q, float)
