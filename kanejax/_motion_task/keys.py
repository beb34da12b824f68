"""The keys that the file of a task may have, and what their values may be."""

import inspect
from collections.abc import Callable
from typing import Any, NamedTuple

from kanejax import constraints, costs
from kanejax._optimize.limits import FIELDS
from kanejax._toml import COUNT, FLAG, FROM_ZERO, NUMBER, POSITIVE, SEED, TABLE, TEXT, TEXTS, Kind, choice, list_of, table_of

NUMBERS = list_of(NUMBER, "a list of numbers")
_VECTOR = list_of(NUMBER, "a list of three numbers", 3)
_BY_JOINT = table_of(NUMBER.or_else(NUMBERS), "numbers by joint")
_WEIGHTS = FROM_ZERO.or_else(list_of(FROM_ZERO, "a list of such numbers")).or_else(table_of(FROM_ZERO, "such numbers by joint"))
_FREE = choice("free")
_BODY = Kind("the name of a body", TEXT.accepts)
_PAIR = list_of(NUMBER, "a pair, least and greatest", 2)
_LIMIT = FROM_ZERO.or_else(list_of(FROM_ZERO, "a list of such numbers"))
_LIMIT = _LIMIT.or_else(table_of(FROM_ZERO.or_else(_PAIR), "such numbers or pairs, least and greatest, by joint"))
_OF_ROBOT = _LIMIT.or_else(Kind('"robot"', lambda value: value == "robot"))

# Every key that there is, by table; that without a name holds what stands before all tables.
KEYS: dict[str, dict[str, Kind]] = {
    "": {
        "robot": TEXT,
        "duration": POSITIVE.or_else(list_of(POSITIVE, "a pair of such numbers, least and greatest", 2)),
        "gravity": _VECTOR,
        **dict.fromkeys(("locked", "start", "goal", "limits", "costs", "constraints", "solver", "output"), TABLE),
    },
    "start": {
        "q": NUMBERS.or_else(_BY_JOINT).or_else(_FREE),
        "u": NUMBER.or_else(NUMBERS).or_else(_BY_JOINT).or_else(_FREE),
        "constraints": TABLE,
    },
    "limits": {**{field: _OF_ROBOT if field in ("u", "tau") else _LIMIT for field in FIELDS}, "passive": TEXTS},
    "solver": {
        "steps": COUNT,
        "dynamics": choice("inverse", "forward"),
        "integrator": choice("midpoint", "euler", "rk4"),
        "substeps": COUNT,
        "method": choice("interior_point", "ipopt"),
        "tolerance": POSITIVE,
        "max_iterations": COUNT,
        "guess": TEXT,
        "guesses": COUNT,
        "bend": FROM_ZERO,
        "seed": SEED,
    },
    "output": {"title": TEXT, "report": FLAG, "replay": FLAG},
}
KEYS["goal"] = KEYS["start"]
LOCKED = NUMBER.or_else(list_of(NUMBER, "a list of numbers for ball and free joints"))


class Term(NamedTuple):
    """A cost or a constraint: the function that makes it, its options, and the one that a bare number is."""

    function: Callable[..., Any]
    keys: dict[str, Kind]
    main: str | None = None

    @property
    def required(self) -> list[str]:
        """Options without a default."""
        return [name for name, each in inspect.signature(self.function).parameters.items() if each.default is each.empty]


_SQUARES = ("torque", "torque_rate", "speed", "acceleration", "jerk")
_TRACKING = {
    "q": list_of(NUMBERS, "a list of lists of coordinates"),
    "duration": POSITIVE,
    "motion": TEXT,
    "weights": _WEIGHTS,
}
_MANIPULABILITY = {"body": _BODY, "point": _VECTOR, "weight": FROM_ZERO}
_SPHERE = {"body": _BODY, "radius": FROM_ZERO, "center": _VECTOR, "name": TEXT}
COSTS = {
    **{name: Term(getattr(costs, name), {"weights": _WEIGHTS}, "weights") for name in _SQUARES},
    "duration": Term(costs.duration, {"weight": FROM_ZERO}, "weight"),
    "energy": Term(costs.energy, {"weight": FROM_ZERO, "width": POSITIVE}, "weight"),
    "tracking": Term(costs.tracking, _TRACKING),
    "manipulability": Term(costs.manipulability, _MANIPULABILITY),
}
_TOLERANCE = FROM_ZERO.or_else(list_of(FROM_ZERO, "a list of three such numbers", 3))
CONSTRAINTS = {
    "position": Term(
        constraints.position,
        {"body": _BODY, "target": _VECTOR, "point": _VECTOR, "tolerance": _TOLERANCE, "at_end": FLAG, "name": TEXT},
    ),
    "direction": Term(
        constraints.direction,
        {"body": _BODY, "target": _VECTOR, "axis": _VECTOR, "angle": FROM_ZERO, "at_end": FLAG, "name": TEXT},
    ),
    "sphere_clearance": Term(
        constraints.sphere_clearance,
        {**_SPHERE, "obstacle": _VECTOR.or_else(_BODY), "obstacle_radius": FROM_ZERO, "obstacle_center": _VECTOR},
    ),
    "plane_clearance": Term(constraints.plane_clearance, {**_SPHERE, "normal": _VECTOR, "offset": NUMBER}),
}
