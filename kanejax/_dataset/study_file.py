"""A study, as a TOML file says it."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, final

import numpy as np

from kanejax import distributions
from kanejax._dataset.solvers import SOLVERS
from kanejax._dataset.study import GivenForces, RandomForces, Randomized, Study
from kanejax._dataset.study_checks import DENSITY
from kanejax._model.model import Model, leaf_shapes
from kanejax._toml import (
    COUNT,
    FLAG,
    NUMBER,
    POSITIVE,
    SEED,
    TABLE,
    TEXT,
    ConfigurationError,
    checked,
    choice,
    file_text,
    list_of,
    number,
    parsed_toml,
    refuse,
    whole,
)

# Of the times that are saved, and of their number: what is beyond is a slip, or meant to fill the memory.
LONGEST, MOST_TIMES = 1e9, 1_000_000
_VALUES = NUMBER.or_else(list_of(NUMBER, "a list of numbers"))
_INTERPOLATION = choice("hold", "linear", "cubic")
_KEYS = {
    "": {
        "trajectories": COUNT,
        "duration": number(f"a positive number up to {LONGEST:g}", lambda value: 0 < value <= LONGEST),
        "times": whole(f"a whole number from 2 to {MOST_TIMES}", 2, MOST_TIMES),
        "seed": SEED,
        **dict.fromkeys(("initial", "forces", "parameters", "solver"), TABLE),
    },
    "initial": {"q": TABLE, "u": TABLE, "file": TEXT},
    "solver": {
        "method": choice(*SOLVERS),
        "dt0": POSITIVE,
        "rtol": POSITIVE,
        "atol": POSITIVE,
        "max_steps": COUNT,
        "joint_limits": FLAG,
    },
}


@final
@dataclasses.dataclass(frozen=True)
class StudyFile:
    """What a file says of a study; what it does not say is for the command to say, or as a `Study` has it.

    Attributes:
        origin: the path, for messages.
        folder: other files that it names are relative to it.
        values: of the first lines: trajectories, duration, times and seed.
        tables: the others, by name.
    """

    origin: str = "the study"
    folder: Path = Path()
    values: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    tables: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)

    def study(self, model: Model, ts: np.ndarray, trajectories: int, seed: int, defaults: Mapping[str, Any]) -> Study:
        """The study of a model; `defaults` are its fields where the file is silent.

        Raises:
            ConfigurationError: a number or a file does not fit the model.
        """
        fields = {**defaults, **_initial(self), **_forces(self)}
        fields["options"] = {**defaults.get("options", {}), **_options(self)}
        parameters = self.tables.get("parameters", {})
        fields["parameters"] = {name: _randomized(self.origin, name, table, model) for name, table in parameters.items()}
        try:
            return Study(model, ts, trajectories, seed=seed, **fields)
        except ValueError as error:
            raise ConfigurationError(f"{self.origin}: {error}") from error


def read_study(path: Path) -> StudyFile:
    """Read a file; files that it names are read when the study is made.

    Raises:
        ConfigurationError: the file is no TOML, or a key or value in it means nothing; the message says what may stand there.
        OSError: the file cannot be read.
    """
    origin = str(path)
    top = checked(origin, "the file", parsed_toml(file_text(path), origin), _KEYS[""])
    tables = {name: top.pop(name) for name in ("initial", "forces", "parameters", "solver") if name in top}
    for name in ("initial", "solver"):
        if name in tables:
            tables[name] = checked(origin, f"[{name}]", tables[name], _KEYS[name])
    if "file" in tables.get("initial", {}) and len(tables["initial"]) > 1:
        refuse(origin, "[initial] has a file, and q or u beside it; leave one out")
    return StudyFile(origin, path.parent, top, tables)


def distribution_of(origin: str, label: str, table: Mapping[str, Any], others: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
    """The distribution that a table describes, and the values of its other keys.

    Raises:
        ConfigurationError: a key or value means nothing, or there is no distribution of that name.
    """
    name = table.get("distribution")
    if name not in distributions.BY_NAME:
        listed = ", ".join(f'"{each}"' for each in distributions.BY_NAME)
        refuse(origin, f"{label} has distribution {name!r}; it must be one of {listed}")
    kind = distributions.BY_NAME[name]
    fields = [field.name for field in dataclasses.fields(kind)]
    values = checked(origin, label, table, {"distribution": TEXT, **dict.fromkeys(fields, _VALUES), **others})
    try:
        made = kind(**{field: values[field] for field in fields if field in values})
    except (TypeError, ValueError) as error:
        refuse(origin, f"{label}: {error}; a {name} distribution has {' and '.join(fields)}")
    return made, {key: values[key] for key in others if key in values}


def _initial(file: StudyFile) -> dict[str, Any]:
    table = file.tables.get("initial", {})
    if "file" in table:
        arrays = _arrays(file, "[initial]", table["file"], ("q", "u"))
        return {"q0": arrays["q"], "u0": arrays["u"]}
    return {
        f"{name}0": distribution_of(file.origin, f"[initial] {name}", table[name], {})[0] for name in ("q", "u") if name in table
    }


def _forces(file: StudyFile) -> dict[str, Any]:
    table = file.tables.get("forces")
    if table is None:
        return {}
    others = {"period": POSITIVE, "interpolation": _INTERPOLATION}
    if "file" in table:
        given = checked(file.origin, "[forces]", table, {"file": TEXT, "interpolation": _INTERPOLATION})
        arrays = _arrays(file, "[forces]", given.pop("file"), ("ts", "tau"))
        return {"control": GivenForces(arrays["ts"], arrays["tau"], **given)}
    distribution, values = distribution_of(file.origin, "[forces]", table, others)
    if "period" not in values:
        refuse(file.origin, "[forces] has no period, the seconds from one draw to the next")
    return {"control": RandomForces(distribution, **values)}


def _randomized(origin: str, name: str, table: Any, model: Model) -> Randomized:
    if name not in leaf_shapes(model.tree) and name != DENSITY:
        refuse(origin, f"[parameters] has no {name!r}; there are: {DENSITY}, {', '.join(leaf_shapes(model.tree))}")
    if not isinstance(table, dict):
        refuse(origin, f'[parameters] {name} must be a table, such as {{ distribution = "log-normal", sigma = 0.1 }}')
    distribution, values = distribution_of(origin, f"[parameters] {name}", table, {"how": choice("factor", "added")})
    return Randomized(distribution, **values)


def _options(file: StudyFile) -> dict[str, Any]:
    table = dict(file.tables.get("solver", {}))
    method = table.pop("method", None)
    return table if method is None else {"solver": SOLVERS[method](), **table}


def _arrays(file: StudyFile, label: str, name: str, wanted: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Arrays of numbers of an NPZ file."""
    path = file.folder / name
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {key: np.asarray(archive[key], float) for key in wanted}
    except OSError as error:
        if error.errno is None:
            refuse(file.origin, f"{label} file {path} is no NPZ file")
        raise
    except KeyError as error:
        refuse(file.origin, f"{label} file {path} has no array {error.args[0].split()[0]}; it needs {' and '.join(wanted)}")
    except Exception as error:
        refuse(file.origin, f"{label} file {path} is no NPZ file with arrays of numbers: {error}")
    for key, array in arrays.items():
        if not np.all(np.isfinite(array)):
            refuse(file.origin, f"{label} file {path}: {key} has numbers that are not finite")
    return arrays
