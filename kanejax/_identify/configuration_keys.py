"""The keys that a configuration may have, and what their values may be."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

from kanejax._identify.identify import STAGES
from kanejax._parameters.plant import Drives
from kanejax._parameters.priors import Entropic, Gaussian, Geodesic

PRIORS = {"gaussian": Gaussian, "entropic": Entropic, "geodesic": Geodesic}


class Kind(NamedTuple):
    """What a value must be, in words; whether one is; and what is made of it."""

    words: str
    accepts: Callable[[Any], bool]
    made: Callable[[Any], Any] = lambda value: value

    def or_else(self, other: "Kind") -> "Kind":
        """Either."""
        return Kind(
            f"{self.words}, or {other.words}",
            lambda value: self.accepts(value) or other.accepts(value),
            lambda value: (self if self.accepts(value) else other).made(value),
        )


def _choice(*values: Any) -> Kind:
    words = " or ".join(", ".join(each) for each in ([written(value) for value in values[:-1]], [written(values[-1])]) if each)
    return Kind(words, lambda value: any(value == each and type(value) is type(each) for each in values))


def _list_of(kind: Kind, words: str, length: int | None = None) -> Kind:
    """Tuples are made of lists, so that what has them can be hashed."""
    return Kind(
        words,
        lambda value: isinstance(value, list) and length in (None, len(value)) and all(kind.accepts(each) for each in value),
        lambda value: tuple(kind.made(each) for each in value),
    )


def _table_of(kind: Kind, words: str) -> Kind:
    return Kind(
        f"a table of {words}",
        lambda value: isinstance(value, dict) and all(kind.accepts(each) for each in value.values()),
        lambda value: {key: kind.made(each) for key, each in value.items()},
    )


def _is_list_of_stages(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and value == [stage for stage in STAGES if stage in value]


def written(value: Any) -> str:
    """A value as TOML writes it."""
    return f'"{value}"' if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else repr(value)


def _number(words: str, accepts: Callable[[float], bool] = lambda _: True) -> Kind:
    return Kind(words, lambda value: isinstance(value, int | float) and not isinstance(value, bool) and accepts(value), float)


def _whole(words: str, least: int | None = None) -> Kind:
    return Kind(words, lambda value: isinstance(value, int) and not isinstance(value, bool) and (least is None or value >= least))


NUMBER = _number("a number")
_POSITIVE = _number("a positive number", lambda value: value > 0)
_FROM_ZERO = _number("a number from 0 on", lambda value: value >= 0)
_FRACTION = _number("a number between 0 and 1", lambda value: 0 < value < 1)
_COUNT, _SEED = _whole("a whole number from 1 on", 1), _whole("a whole number from 0 on", 0)
_TEXT = Kind("a text", lambda value: isinstance(value, str))
_FLAG = Kind("true or false", lambda value: isinstance(value, bool))
_TABLE = Kind("a table", lambda value: isinstance(value, dict))
_TEXTS = _list_of(_TEXT, "a list of texts")
_NONE = Kind('"none"', lambda value: value == "none", lambda _: None)
_COLUMN = _TEXT.or_else(_whole("a whole number"))
_SELECTION = _TEXT.or_else(_list_of(_COLUMN, "a list of names or numbers of columns"))
_UNIT = _TEXT.or_else(_POSITIVE)
_UNITS = _UNIT.or_else(_list_of(_UNIT, "a list of units or factors"))
_PAIR = _list_of(_COUNT, "a pair of row numbers", 2)
_ROWS = _PAIR.or_else(_list_of(_PAIR, "a list of such pairs, one a file"))
_BOUND = NUMBER.or_else(_list_of(NUMBER, "a list of numbers"))
_BY_JOINT = NUMBER.or_else(_table_of(NUMBER, "numbers by joint"))
_OPTIONAL = _POSITIVE.or_else(_NONE)

# Every key that there is, by table.
KEYS: dict[str, dict[str, Kind]] = {
    "log": {
        "joints": _TEXTS.or_else(_table_of(_TEXT, "names in the file by joint")),
        "rows": _ROWS,
        "validation_rows": _ROWS,
        "bad_rows": _choice("error", "drop"),
        "repeated": _choice("error", "drop"),
        "file_format": _choice("csv", "parquet", "npz", "mcap"),
        "delimiter": _TEXT,
        "header": _FLAG,
        "topic": _TEXT,
        "columns": _TABLE,
        "units": _TABLE,
    },
    "log.columns": {
        "time": _COLUMN,
        **dict.fromkeys(("position", "velocity", "acceleration", "effort"), _SELECTION),
    },
    "log.units": {"time": _UNIT, **dict.fromkeys(("position", "velocity", "acceleration", "effort"), _UNITS)},
    "motion": {
        "cutoff": _POSITIVE.or_else(_choice("automatic").or_else(_NONE)),
        "effort_cutoff": _OPTIONAL,
        "cutoff_unit": _choice("Hz", "Nyquist"),
        "order": _COUNT,
        "accuracy": _choice(2, 4, 6, 8),
        "resampling": _choice("cubic", "linear").or_else(_NONE),
        "longest_gap": _POSITIVE,
        "decimation": _COUNT,
        "rate": _OPTIONAL,
        "trim": _FROM_ZERO.or_else(_NONE),
    },
    "drives": {field.name: NUMBER if field.name == "delay" else _BY_JOINT for field in dataclasses.fields(Drives)},
    "unknown": {
        "leaf": _TEXT,
        "of": _TEXT.or_else(_TEXTS),
        "bounds": _list_of(_BOUND, "a pair, least and greatest", 2),
        "prior": _TABLE,
        "tied": _FLAG,
        "scale": _POSITIVE.or_else(_list_of(_POSITIVE, "a pair of positive numbers", 2)),
    },
    "prior": {**dict.fromkeys(PRIORS, _POSITIVE.or_else(_list_of(_POSITIVE, "a list of positive numbers"))), "relative": _FLAG},
    "identify": {
        "stages": Kind(f"a list of {' and '.join(map(written, STAGES))}, in this order", _is_list_of_stages, tuple),
        "robust": _FLAG,
        "friction_width": _OPTIONAL,
        "starts": _COUNT,
        "seed": _SEED,
        "validation": _FRACTION,
    },
    "simulation": {
        "windows": _list_of(_OPTIONAL, 'a list of positive numbers, or "none" for whole runs'),
        "piece": _OPTIONAL,
        "initial_state": _choice("estimated", "given"),
        "outputs": _list_of(_choice("q", "u"), 'a list of "q" and "u"'),
        "substeps": _COUNT,
        "interpolation": _choice("linear", "hold"),
        "max_iterations": _COUNT,
    },
    "output": {"title": _TEXT, **dict.fromkeys(("report", "urdf", "mjcf", "predictions"), _FLAG)},
}
