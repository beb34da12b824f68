"""What `kanejax identify` writes and prints."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from kanejax._cli.inputs import Inputs
from kanejax._cli.terminal import write_arrays, write_json
from kanejax._errors import KanejaxError
from kanejax._identify.report.numbers import percent
from kanejax._identify.report.page import write_report
from kanejax._identify.report.signals import errors, signal_names
from kanejax._identify.report.tables import error_groups
from kanejax._identify.result import Identification
from kanejax._io.export import to_mjcf
from kanejax._io.urdf_dynamics import with_joint_dynamics
from kanejax._io.urdf_inertials import to_urdf_inertials
from kanejax._io.xml_text import file_content, parsed_xml
from kanejax._whole_file import whole_file

JSON_NAME, LOG_NAME = "identification.json", "run.log"


def write_results(
    folder: Path, inputs: Inputs, identification: Identification, record: Mapping[str, Any], files: Mapping[str, str]
) -> tuple[list[Path], list[str]]:
    """Write all files that the configuration asks for.

    Returns:
        The files, and sentences on those that cannot be.
    """
    robot = inputs.robot.origin

    def report(path: Path) -> None:
        title = inputs.output.get("title", Path(robot).stem)
        write_report(identification, path, title=title, inputs=files, notes=inputs.notes)

    def predictions(path: Path) -> None:
        write_arrays(path, _series(identification))

    def urdf(path: Path) -> None:
        text = to_urdf_inertials(identification.model, robot)
        path.write_text(with_joint_dynamics(identification.model, text), encoding="utf-8")

    writers: list[tuple[str, str, Callable[[Path], object]]] = [
        ("report", "report.html", report),
        ("predictions", "predictions.npz", predictions),
        ("mjcf", "identified.xml", lambda path: path.write_text(to_mjcf(identification.model), encoding="utf-8")),
    ]
    if parsed_xml(file_content(robot), robot).tag == "robot":
        writers.append(("urdf", "identified.urdf", urdf))
    write_json(folder / JSON_NAME, record)
    written, problems = [folder / JSON_NAME], []
    for key, name, write in writers:
        if not inputs.output.get(key, True):
            continue
        try:
            with whole_file(folder / name) as partial:
                write(partial)
            written.append(folder / name)
        except (KanejaxError, ValueError) as error:
            problems.append(f"{folder / name} is not written: {error}")
    return written, problems


def error_table(identification: Identification) -> Table:
    """Relative errors of each signal, for a terminal."""
    table = Table(title=Text("residuals over the measured signal"), title_justify="left")
    table.add_column("signal", no_wrap=True)
    groups = [(heading, errors(runs)) for heading, runs in error_groups(identification)]
    for heading, _ in groups:
        table.add_column(heading, justify="right")
        table.add_column("nominal", justify="right")
    for index, name in enumerate(signal_names(identification)):
        cells = [percent(values[index]) for _, found in groups for values in (found.relative, found.nominal)]
        table.add_row(Text(name), *cells)
    return table


def _series(identification: Identification) -> dict[str, np.ndarray]:
    """The signals of each run, under names such as `training_0_measured`."""
    arrays: dict[str, np.ndarray] = {"signals": np.array(signal_names(identification))}
    for use, runs in (("training", identification.training), ("validation", identification.validation)):
        for number, run in enumerate(runs):
            fields = {key: np.asarray(value) for key, value in run._asdict().items()}
            arrays |= {f"{use}_{number}_{key}": value for key, value in fields.items()}
    return arrays
