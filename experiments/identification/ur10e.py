"""A real UR10e identified from recorded motor currents, beside reference baselines on the same data with the same protocol.

The recordings are not part of the project; without them the experiment says where they are. With them
`python -m experiments.identification.ur10e` writes results/identification/ur10e.json, .png and .html; `--quick` leaves out all but
the identification itself and the baselines.
"""

import argparse
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

import kanejax as kj
from experiments.identification import ur10e_picture
from experiments.thesis import record

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "results" / "identification"
SOURCE = "https://github.com/shamilmamedov/dynamic_calibration"
# Torque a unit of motor current [N m/A], as published with the data.
GAINS = (10.0000, 10.6956, 8.4566, 9.0029, 9.4800, 10.1232)
# Column 0 is time, then six each of positions, speeds and measured currents; desired currents and torques follow.
COLUMNS = kj.Columns(time=0, position=range(1, 7), velocity=range(7, 13), effort=range(13, 19))
# Fifth-order Butterworth filters without phase, and central differences of the stamps as they are.
PROTOCOL: dict[str, Any] = {
    "cutoff": 0.15,
    "effort_cutoff": 0.20,
    "cutoff_unit": "Nyquist",
    "accuracy": 2,
    "resampling": None,
    "trim": 0.0,
}
# Of held-out recordings, whatever the filters: resampled or filtered currents are smoother, and errors against them smaller.
AS_SAMPLED: dict[str, Any] = {"effort_cutoff": None, "accuracy": 2, "resampling": None, "trim": 0.0}
UNKNOWNS = ("inertia", "armature", "damping", "coulomb_friction", "offset")
# A width of friction [rad/s] so small that its sense is the sign of the speed.
SIGN = 1e-12
# Relative residual errors [%] on the point-to-point file after training on the first file, as they come with the data.
BASELINES = {
    "ordinary least squares": (12.94, 5.20, 5.73, 12.78, 15.89, 56.21),
    "weighted least squares": (12.81, 5.27, 5.61, 9.39, 15.70, 54.96),
    "Huber": (12.82, 5.22, 5.37, 8.56, 16.35, 58.83),
    "SDP, consistent": (12.79, 5.25, 5.62, 9.41, 15.76, 55.11),
    "nominal inertias, friction fitted": (12.72, 13.48, 6.43, 14.33, 18.40, 55.37),
}


class Recording(NamedTuple):
    """A file, and its first and last row to use, counted from 1."""

    file: str
    rows: tuple[int, int]


TRAINING = Recording("ur-20_02_10-30sec_12harm.csv", (635, 3510))
MORE_TRAINING = Recording("ur-20_02_05-20sec_8harm.csv", (320, 2310))
HELD_OUT = {
    "point to point": Recording("ur-20_01_17-ptp_10_points.csv", (700, 4200)),
    "50 s": Recording("ur-20_02_12-50sec_12harm.csv", (355, 5090)),
}
POINT_TO_POINT = "point to point"


class Variant(NamedTuple):
    """What another choice of options is: its name, unknowns, recordings to train on, filters, and further options."""

    name: str
    unknowns: Sequence[str] = UNKNOWNS
    training: tuple[Recording, ...] = (TRAINING,)
    filters: Mapping[str, Any] = PROTOCOL
    options: Mapping[str, Any] = {}


REFERENCE = Variant("protocol")
VARIANTS = (
    Variant("friction and offsets alone, nominal inertias", unknowns=UNKNOWNS[1:]),
    Variant("robust", options={"robust": True}),
    Variant("two training files", training=(TRAINING, MORE_TRAINING)),
    Variant("load friction", unknowns=(*UNKNOWNS, "load_friction")),
    Variant("Stribeck friction", unknowns=(*UNKNOWNS, "stribeck_friction")),
    Variant("wider friction, 1e-2", options={"friction_width": 1e-2}),
    Variant("delay", unknowns=(*UNKNOWNS, "delay")),
    Variant("delay, wider friction", unknowns=(*UNKNOWNS, "delay"), options={"friction_width": 1e-2}),
    Variant("the library's own filters", filters={}),
    Variant("its filters, load friction", unknowns=(*UNKNOWNS, "load_friction"), filters={}),
    Variant(
        "its filters, load friction, two files",
        unknowns=(*UNKNOWNS, "load_friction"),
        training=(TRAINING, MORE_TRAINING),
        filters={},
    ),
)


def data_folder() -> Path:
    """Where the recordings are.

    Raises:
        SystemExit: they are absent; the message says where to get them.
    """
    folder = Path(os.environ.get("KANEJAX_DATA", ROOT.parent / "shared" / "data")) / "ur10e"
    recordings = (TRAINING, MORE_TRAINING, *HELD_OUT.values())
    missing = [name for name in ("ur10e.urdf", *(recording.file for recording in recordings)) if not (folder / name).is_file()]
    if missing:
        raise SystemExit(
            f"{folder} lacks {', '.join(missing)}. The recordings are not part of this project: get them, and the robot's "
            f"URDF, from {SOURCE}, put them into a folder named ur10e, "
            "and set the environment variable KANEJAX_DATA to the folder around it."
        )
    return folder


def plant(folder: Path) -> kj.Plant:
    """The robot by its URDF, with the published gains."""
    model = kj.load(folder / "ur10e.urdf")
    return kj.Plant(model, kj.Drives.ideal(model).replace(gain=GAINS))


def log(folder: Path, joints: Sequence[str], recordings: Sequence[Recording]) -> kj.Log:
    """Recordings with currents as efforts."""
    paths, rows = [folder / recording.file for recording in recordings], [recording.rows for recording in recordings]
    return kj.read_log(paths, joints, columns=COLUMNS, units=kj.Units(effort="A"), rows=rows)


def identified(folder: Path, variant: Variant) -> kj.Identification:
    """Fit to the training recordings, and compare with the currents of those held out as they were sampled."""
    robot = plant(folder)
    joints = robot.model.tree.joint_names
    held_out = kj.motions(log(folder, joints, tuple(HELD_OUT.values())), robot.model, **{**variant.filters, **AS_SAMPLED})
    options = {"motion_options": variant.filters, **variant.options}
    return kj.identify(robot, log(folder, joints, variant.training), variant.unknowns, validation=held_out, **options)


def errors(found: kj.Identification) -> dict[str, list[float]]:
    """Relative residual errors of the held-out files [%]."""
    runs = zip(HELD_OUT, found.validation, strict=True)
    return {name: [float(100 * error) for error in kj.relative_error(run)] for name, run in runs}


def least_squares(folder: Path) -> dict[str, dict[str, list[float]]]:
    """The baselines' ordinary and weighted least squares: torques, linear in parameters that need not be physical."""
    robot = plant(folder)
    model = robot.model.replace(friction_width=jnp.full(robot.model.nv, SIGN))
    sought = kj.parameterization(kj.Plant(model, kj.Drives.ideal(model)), UNKNOWNS)
    joints, gains = model.tree.joint_names, np.array(GAINS)
    (training,) = kj.motions(log(folder, joints, (TRAINING,)), model, **PROTOCOL)
    held_out = kj.motions(log(folder, joints, tuple(HELD_OUT.values())), model, **{**PROTOCOL, **AS_SAMPLED})
    rows, torque = torque_rows(sought, training), gains * np.asarray(training.effort)
    sigma, values = np.ones(model.nv), {}
    values["ordinary least squares"] = solved(rows, torque, sigma)
    for _ in range(50):
        values["weighted least squares"] = solved(rows, torque, sigma)
        sigma = np.std(torque - rows @ values["weighted least squares"], axis=0)
    return {
        method: {
            name: relative(gains * np.asarray(motion.effort), torque_rows(sought, motion) @ value)
            for name, motion in zip(HELD_OUT, held_out, strict=True)
        }
        for method, value in values.items()
    }


def torque_rows(sought: kj.Parameterization, motion: kj.Motion) -> np.ndarray:
    """The regressor (n, nv, parameters) of all that is sought."""

    def torque(phi: jax.Array, q: jax.Array, u: jax.Array, u_dot: jax.Array) -> jax.Array:
        assembled, inertias = sought.assemble(phi)
        return kj.drive_force(assembled, q, u, u_dot, inertias)

    rows = jax.jit(jax.vmap(jax.jacfwd(torque), (None, 0, 0, 0)))
    return np.asarray(rows(jnp.zeros_like(sought.phi0), motion.q, motion.u, motion.u_dot))


def solved(rows: np.ndarray, torque: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """The shortest solution: what no torque depends on stays zero."""
    weighted = (rows / sigma[:, None]).reshape(-1, rows.shape[-1])
    length = np.linalg.norm(weighted, axis=0)
    length = np.where(length > 0, length, 1.0)
    return np.linalg.lstsq(weighted / length, (torque / sigma).ravel(), rcond=1e-10)[0] / length


def relative(measured: np.ndarray, predicted: np.ndarray) -> list[float]:
    """Relative residual error of each joint [%]."""
    return [float(x) for x in 100 * np.linalg.norm(measured - predicted, axis=0) / np.linalg.norm(measured, axis=0)]


def tried(folder: Path, variants: Sequence[Variant], say: Callable[[str], object]) -> dict[str, dict[str, Any]]:
    """Held-out errors of other choices; of one that is refused, why."""
    rows: dict[str, dict[str, Any]] = {}
    for variant in variants:
        begin = time.perf_counter()
        try:
            found = identified(folder, variant)
        except kj.LogError as error:
            rows[variant.name] = {"refused": str(error)}
        else:
            rows[variant.name] = {**errors(found), "converged": found.converged, "message": found.stages[-1].message}
            further = [leaf for leaf in variant.unknowns if leaf not in UNKNOWNS]
            rows[variant.name] |= {leaf: np.asarray(getattr(found.drives, leaf)).tolist() for leaf in further}
        rows[variant.name]["seconds"] = time.perf_counter() - begin
        reached = rows[variant.name].get(POINT_TO_POINT)
        say(f"{variant.name}: {'refused' if reached is None else ' '.join(map('{:.2f}'.format, reached))}")
    return rows


def run(quick: bool, into: Path = RESULTS) -> None:
    """Identify the robot, print and write what came out; fails where weighted least squares predicts a joint better."""
    folder = data_folder()
    # Wide enough for the tables where there is no terminal.
    console = Console() if Console().is_terminal else Console(width=120)
    begin = time.perf_counter()
    found = identified(folder, REFERENCE)
    seconds = time.perf_counter() - begin
    console.print(f"identified in {seconds:.0f} s, compiling included: {found.stages[-1].message}")
    reproduced = least_squares(folder)
    held_out = errors(found)
    nominal = [float(100 * error) for error in kj.relative_error(found.validation[0], found.validation[0].nominal)]
    ours = np.array(held_out[POINT_TO_POINT])
    better = ours < np.array(BASELINES["weighted least squares"])
    consistent = {name: float(x) for name, x in zip(found.model.tree.body_names, found.consistency, strict=True)}
    record.save(into, "ur10e", ur10e_picture.picture(found, np.array(GAINS), BASELINES, ours))
    write_page(found, into / "ur10e.html")
    console.print(error_table(ours, reproduced, nominal, better))
    rest = tried(folder, () if quick else VARIANTS, console.print)
    numbers = {
        "quick": quick,
        "seconds": seconds,
        "held_out_errors_percent": held_out,
        "training_errors_percent": [float(100 * error) for error in kj.relative_error(found.training[0])],
        "nominal_without_friction_percent": nominal,
        "baselines_percent": {name: list(values) for name, values in BASELINES.items()},
        "reproduced_percent": reproduced,
        "better_than_weighted_least_squares": [bool(x) for x in better],
        "smallest_eigenvalue_of_pseudo_inertia_over_trace": consistent,
        "base_parameters": len(found.base.formulas),
        "condition_number": float(found.base.condition_number),
        "converged": found.converged,
        "variants": rest,
    }
    record.write(into, "ur10e", numbers)
    if rest:
        console.print(variant_table({REFERENCE.name: held_out, **rest}))
    console.print(f"pictures, numbers and report: {into}")
    masses = np.asarray(found.model.mass)
    record.require(found.converged, "the fit converges")
    record.require(bool(np.all((found.consistency > 0) | (masses == 0))), "every body with mass can exist")
    record.require(bool(np.all(better[:-1])), "better than weighted least squares for every joint but the last")
    for method, runs in reproduced.items():
        difference = np.max(np.abs(np.array(runs[POINT_TO_POINT]) - np.array(BASELINES[method])))
        record.require(bool(difference < 0.1), f"{method} is reproduced within 0.1 points")


def write_page(found: kj.Identification, path: Path) -> None:
    """The report that `kanejax identify` writes."""
    from kanejax._identify.report.page import write_report

    files = {"Robot": "ur10e.urdf", "Logs": TRAINING.file, "Held-out logs": ", ".join(each.file for each in HELD_OUT.values())}
    write_report(found, path, title="UR10e", inputs={**files, "Source": SOURCE})


def error_table(
    ours: np.ndarray, reproduced: dict[str, dict[str, list[float]]], nominal: Sequence[float], better: np.ndarray
) -> Table:
    """Errors on the point-to-point file against the baselines."""
    table = Table(title="held-out relative residual error of joints 1 to 6 [%], point to point", title_justify="left")
    table.add_column("method", no_wrap=True)
    for joint in range(len(ours)):
        table.add_column(str(joint + 1), justify="right", no_wrap=True)
    for name, values in BASELINES.items():
        table.add_row(name, *map("{:.2f}".format, values))
        if name in reproduced:
            table.add_row("  the same, made here", *map("{:.2f}".format, reproduced[name][POINT_TO_POINT]), style="dim")
    table.add_row("nominal model, no friction", *map("{:.2f}".format, nominal))
    table.add_row("kanejax", *map("{:.2f}".format, ours), style="bold")
    table.add_row("better than weighted", *("yes" if x else "no" for x in better))
    return table


def variant_table(rows: Mapping[str, Mapping[str, Any]]) -> Table:
    """Errors of both held-out files with other choices."""
    table = Table(title="other choices: held-out errors [%], point to point and 50 s", title_justify="left")
    for heading in ("choice", *HELD_OUT):
        table.add_column(heading)
    for name, row in rows.items():
        cells = [" ".join(map("{:5.2f}".format, row[file])) if file in row else "refused" for file in HELD_OUT]
        table.add_row(name if row.get("converged", True) else f"{name} (did not converge)", *cells)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m experiments.identification.ur10e", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the identification and the baselines alone")
    parser.add_argument("--into", type=Path, default=RESULTS, help="directory for picture, numbers and report")
    arguments = parser.parse_args()
    run(arguments.quick, arguments.into)


if __name__ == "__main__":
    main()
