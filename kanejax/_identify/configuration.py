"""What an identification is asked to do, as a TOML file says it."""

import dataclasses
import os
from collections.abc import Mapping
from typing import Any, final

import numpy as np

from kanejax._errors import KanejaxError
from kanejax._identify.configuration_keys import KEYS, PRIORS
from kanejax._logs.columns import Columns, Units
from kanejax._model.model import Model
from kanejax._parameters.plant import Drives, Plant
from kanejax._parameters.priors import Gaussian, Prior
from kanejax._parameters.unknowns import Unknown
from kanejax._toml import NUMBER, ConfigurationError, checked, file_text, parsed_toml, refuse, written

_TABLES = ("log", "motion", "locked", "drives", "unknown", "identify", "simulation", "output")


@final
@dataclasses.dataclass(frozen=True)
class Configuration:
    """Options by what takes them; what a file does not say is absent, so that defaults have one place.

    Attributes:
        joints: names of the joints that were recorded, or a mapping to the names in the file; None: all of the robot's.
        log: options of `read_log`.
        rows: which rows of the files to use.
        validation_rows: the same of the files that are held out.
        motion: options of `motions`.
        drives: leaves of `Drives`: a number for all joints, or numbers by joint.
        unknowns: what is sought, by name where nothing but the leaf is said; empty: the default of `identify`.
        identify: options of `identify`.
        output: which files to write, and the title of the report.
    """

    joints: tuple[str, ...] | Mapping[str, str] | None = None
    log: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    rows: Any = None
    validation_rows: Any = None
    motion: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    drives: Mapping[str, float | Mapping[str, float]] = dataclasses.field(default_factory=dict)
    unknowns: tuple[Unknown | str, ...] = ()
    identify: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    output: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def read_configuration(path: str | os.PathLike[str]) -> Configuration:
    """Read a configuration from a TOML file.

    Raises:
        ConfigurationError: the file is no TOML, or a key or value in it means nothing; the message says what may stand there.
        OSError: the file cannot be read.
    """
    return parsed_configuration(file_text(path), str(path))


def parsed_configuration(text: str, origin: str = "configuration") -> Configuration:
    """Read a configuration from the text of a TOML file; `origin` is what messages call it.

    Raises:
        ConfigurationError: it is no TOML, or a key or value in it means nothing; the message says what may stand there.
    """
    values = parsed_toml(text, origin)
    for name in values:
        if name not in _TABLES:
            refuse(origin, f"there is no table [{name}]; the tables are: {', '.join(_TABLES)}")
    unknowns = values.get("unknown", [])
    if not isinstance(unknowns, list) or not all(isinstance(each, dict) for each in unknowns):
        refuse(origin, "'unknown' must be a list of tables, each of which begins with [[unknown]]")
    log = _checked(origin, "log", values)
    joints, rows, validation_rows = (log.pop(key, None) for key in ("joints", "rows", "validation_rows"))
    for key, form in (("columns", Columns), ("units", Units)):
        if key in log:
            log[key] = form(**_checked(origin, f"log.{key}", {f"log.{key}": log[key]}))
    motion = _checked(origin, "motion", values)
    if locked := _numbers_by_joint(origin, values.get("locked", {})):
        motion["locked"] = locked
    identify = _checked(origin, "identify", values)
    if simulation := _checked(origin, "simulation", values):
        identify["simulation_options"] = simulation
    return Configuration(
        joints=joints,
        log=log,
        rows=rows,
        validation_rows=validation_rows,
        motion=motion,
        drives=_checked(origin, "drives", values),
        unknowns=tuple(_unknown(origin, number, each) for number, each in enumerate(unknowns, 1)),
        identify=identify,
        output=_checked(origin, "output", values),
    )


def configured_plant(configuration: Configuration, model: Model) -> Plant:
    """The plant that the fit starts from: the model, with the drives of the configuration.

    Raises:
        UnknownNameError: the model has no joint of a name; the message lists those it has.
        ConfigurationError: a joint has several speeds.
    """
    drives, leaves = Drives.ideal(model), {}
    for leaf, value in configuration.drives.items():
        if not isinstance(value, Mapping):
            leaves[leaf] = value
            continue
        numbers = np.array(getattr(drives, leaf))
        for name, number in value.items():
            joint = model.tree.joint(name)
            if model.tree.joint_types[joint] not in ("revolute", "prismatic"):
                raise ConfigurationError(f"[drives] {leaf}: joint {name!r} has several speeds; give one number for all joints")
            numbers[model.tree.v_start[joint]] = number
        leaves[leaf] = numbers
    return Plant(model, drives.replace(**leaves))


def _checked(origin: str, name: str, values: Mapping[str, Any], label: str | None = None) -> dict[str, Any]:
    """The table of this name, or an empty one, with keys and values that mean something."""
    table, label = values.get(name, {}), label or f"[{name}]"
    if not isinstance(table, dict):
        refuse(origin, f"{name!r} must be a table, which begins with [{name}]")
    return checked(origin, label, table, KEYS[name])


def _numbers_by_joint(origin: str, table: Any) -> dict[str, float]:
    if not isinstance(table, dict):
        refuse(origin, "'locked' must be a table, which begins with [locked]")
    for joint, value in table.items():
        if not NUMBER.accepts(value):
            refuse(origin, f"[locked] {joint} is {written(value)}; it must be a number: where the joint is held [rad or m]")
    return {joint: float(value) for joint, value in table.items()}


def _unknown(origin: str, number: int, table: dict[str, Any]) -> Unknown | str:
    label = f"[[unknown]] {number}"
    options = _checked(origin, "unknown", {"unknown": table}, label)
    if "leaf" not in options:
        refuse(origin, f'{label} has no leaf; say what is sought, such as leaf = "damping"')
    try:
        if "prior" in options:
            options["prior"] = _prior(origin, label, options["prior"])
        unknown = Unknown(options.pop("leaf"), of := options.pop("of", None), **options)
    except ConfigurationError:
        raise
    except (KanejaxError, ValueError) as error:
        raise ConfigurationError(f"{origin}: {label}: {error}") from error
    return unknown if options or of is not None else unknown.leaf


def _prior(origin: str, label: str, table: dict[str, Any]) -> Prior:
    options = _checked(origin, "prior", {"prior": table}, f"{label} prior")
    relative = options.pop("relative", False)
    if len(options) != 1:
        refuse(origin, f"{label} prior needs one of {', '.join(PRIORS)}, such as prior = {{ gaussian = 0.1 }}")
    ((kind, std),) = options.items()
    if kind == "gaussian":
        return Gaussian(std, relative)
    if relative or isinstance(std, tuple):
        refuse(origin, f"{label} prior: {kind} takes one number, its standard deviation, and nothing else")
    return PRIORS[kind](std)
