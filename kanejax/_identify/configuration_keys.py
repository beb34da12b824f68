"""The keys that a configuration may have, and what their values may be."""

import dataclasses
from typing import Any

from kanejax._identify.identify import STAGES
from kanejax._parameters.plant import Drives
from kanejax._parameters.priors import Entropic, Gaussian, Geodesic
from kanejax._toml import (
    COUNT,
    FLAG,
    FROM_ZERO,
    NUMBER,
    POSITIVE,
    SEED,
    TABLE,
    TEXT,
    TEXTS,
    Kind,
    choice,
    list_of,
    number,
    table_of,
    whole,
    written,
)

PRIORS = {"gaussian": Gaussian, "entropic": Entropic, "geodesic": Geodesic}


def _is_list_of_stages(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and value == [stage for stage in STAGES if stage in value]


_FRACTION = number("a number between 0 and 1", lambda value: 0 < value < 1)
_NONE = Kind('"none"', lambda value: value == "none", lambda _: None)
_COLUMN = TEXT.or_else(whole("a whole number"))
_SELECTION = TEXT.or_else(list_of(_COLUMN, "a list of names or numbers of columns"))
_UNIT = TEXT.or_else(POSITIVE)
_UNITS = _UNIT.or_else(list_of(_UNIT, "a list of units or factors"))
_PAIR = list_of(COUNT, "a pair of row numbers", 2)
_ROWS = _PAIR.or_else(list_of(_PAIR, "a list of such pairs, one a file"))
_BOUND = NUMBER.or_else(list_of(NUMBER, "a list of numbers"))
_BY_JOINT = NUMBER.or_else(table_of(NUMBER, "numbers by joint"))
_OPTIONAL = POSITIVE.or_else(_NONE)

# Every key that there is, by table.
KEYS: dict[str, dict[str, Kind]] = {
    "log": {
        "joints": TEXTS.or_else(table_of(TEXT, "names in the file by joint")),
        "rows": _ROWS,
        "validation_rows": _ROWS,
        "bad_rows": choice("error", "drop"),
        "repeated": choice("error", "drop"),
        "file_format": choice("csv", "parquet", "npz", "mcap"),
        "delimiter": TEXT,
        "header": FLAG,
        "topic": TEXT,
        "columns": TABLE,
        "units": TABLE,
    },
    "log.columns": {
        "time": _COLUMN,
        **dict.fromkeys(("position", "velocity", "acceleration", "effort"), _SELECTION),
    },
    "log.units": {"time": _UNIT, **dict.fromkeys(("position", "velocity", "acceleration", "effort"), _UNITS)},
    "motion": {
        "cutoff": POSITIVE.or_else(choice("automatic").or_else(_NONE)),
        "effort_cutoff": _OPTIONAL,
        "cutoff_unit": choice("Hz", "Nyquist"),
        "order": COUNT,
        "accuracy": choice(2, 4, 6, 8),
        "resampling": choice("cubic", "linear").or_else(_NONE),
        "longest_gap": POSITIVE,
        "decimation": COUNT,
        "rate": _OPTIONAL,
        "trim": FROM_ZERO.or_else(_NONE),
    },
    "drives": {field.name: NUMBER if field.name == "delay" else _BY_JOINT for field in dataclasses.fields(Drives)},
    "unknown": {
        "leaf": TEXT,
        "of": TEXT.or_else(TEXTS),
        "bounds": list_of(_BOUND, "a pair, least and greatest", 2),
        "prior": TABLE,
        "tied": FLAG,
        "scale": POSITIVE.or_else(list_of(POSITIVE, "a pair of positive numbers", 2)),
    },
    "prior": {**dict.fromkeys(PRIORS, POSITIVE.or_else(list_of(POSITIVE, "a list of positive numbers"))), "relative": FLAG},
    "identify": {
        "stages": Kind(f"a list of {' and '.join(map(written, STAGES))}, in this order", _is_list_of_stages, tuple),
        "robust": FLAG,
        "friction_width": _OPTIONAL,
        "starts": COUNT,
        "seed": SEED,
        "validation": _FRACTION,
    },
    "simulation": {
        "windows": list_of(_OPTIONAL, 'a list of positive numbers, or "none" for whole runs'),
        "piece": _OPTIONAL,
        "initial_state": choice("estimated", "given"),
        "outputs": list_of(choice("q", "u"), 'a list of "q" and "u"'),
        "substeps": COUNT,
        "interpolation": choice("linear", "hold"),
        "max_iterations": COUNT,
    },
    "output": {"title": TEXT, **dict.fromkeys(("report", "urdf", "mjcf", "predictions"), FLAG)},
}
