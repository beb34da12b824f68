"""What an identification on the command line starts from: the robot, the recordings, and the configuration."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kanejax._cli.terminal import load
from kanejax._errors import KanejaxError
from kanejax._fingerprint import fingerprint_of
from kanejax._identify.configuration import Configuration, ConfigurationError, configured_plant, read_configuration
from kanejax._identify.identify import INVERSE_DYNAMICS, UNKNOWNS
from kanejax._io.load import LoadReport
from kanejax._logs.log import Log
from kanejax._logs.motion import Motion, split
from kanejax._logs.processing import motions
from kanejax._logs.read_log import read_log
from kanejax._parameters.parameterization import parameterization
from kanejax._parameters.plant import Plant
from kanejax._parameters.unknowns import Unknown


@dataclasses.dataclass(frozen=True)
class Inputs:
    """All that `identify` takes, and what to tell of it.

    Attributes:
        robot: how the robot was loaded.
        plant: the nominal plant.
        training: motions to fit.
        validation: motions to hold out; there may be none.
        unknowns: what is sought.
        options: of `identify`.
        output: what the configuration says of files.
        notes: sentences on how robot and data differ from their files.
        fingerprint: hash of all that the fit depends on, but for which stages it has.
    """

    robot: LoadReport
    plant: Plant
    training: tuple[Motion, ...]
    validation: tuple[Motion, ...]
    unknowns: tuple[Unknown | str, ...]
    options: Mapping[str, Any]
    output: Mapping[str, Any]
    notes: tuple[str, ...]
    fingerprint: str

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages of the fit."""
        return self.options.get("stages", (INVERSE_DYNAMICS,))


def read_inputs(robot: str, logs: Sequence[Path], validation: Sequence[Path], config: Path | None, **loading: bool) -> Inputs:
    """Read the robot, the recordings and the configuration, and check that they go together.

    Raises:
        KanejaxError: they do not, or one of them is malformed.
        OSError: a file cannot be read.
    """
    configuration = Configuration() if config is None else read_configuration(config)
    origin = "configuration" if config is None else str(config)
    options = dict(configuration.identify)
    fraction = options.pop("validation", None)
    if fraction is not None and validation:
        raise ConfigurationError(f"{origin}: [identify] validation is {fraction}, and --validation is given too; leave one out")
    if configuration.validation_rows is not None and not validation:
        raise ConfigurationError(f"{origin}: [log] validation_rows is given, but no --validation")
    report = load(robot, **loading)
    plant = configured_plant(configuration, report.model)
    training = _log(logs, configuration, configuration.rows, plant)
    held_out = _log(validation, configuration, configuration.validation_rows, plant) if validation else None
    unknowns = configuration.unknowns or UNKNOWNS
    try:
        parameterization(plant, unknowns)
        fitted = motions(training, plant.model, **configuration.motion)
        # As they are: filtered signals would make errors look smaller.
        kept = () if held_out is None else motions(held_out, plant.model, **{**configuration.motion, "effort_cutoff": None})
        if fraction is not None:
            fitted, kept = split(fitted, fraction)
    except KanejaxError:
        raise
    except ValueError as error:
        raise ConfigurationError(f"{origin}: {error}") from error
    of_motions = [f"{motion.name}: {note}" for motion in (*fitted, *kept) for note in motion.notes]
    differences = (*report.ignored, *report.unmodelled, *report.repaired)
    notes = (*differences, *training.notes, *(held_out.notes if held_out else ()), *of_motions)
    choices = (unknowns, sorted((key, value) for key, value in options.items() if key != "stages"))
    fingerprint = fingerprint_of(choices, plant, fitted, kept)
    return Inputs(report, plant, fitted, kept, unknowns, options, configuration.output, tuple(dict.fromkeys(notes)), fingerprint)


def _log(paths: Sequence[Path], configuration: Configuration, rows: Any, plant: Plant) -> Log:
    joints = configuration.joints
    if joints is None:
        locked = configuration.motion.get("locked", {})
        joints = tuple(name for name in plant.model.tree.joint_names if name not in locked)
    path = paths[0] if len(paths) == 1 else paths
    if len(paths) == 1 and rows and isinstance(rows[0], tuple):
        rows = rows[0]
    return read_log(path, joints, rows=rows, **configuration.log)
