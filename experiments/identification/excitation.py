"""Excitation design for a Franka Emika Panda: what a designed motion tells of its parameters, beside random ones and one by hand.

Ten seconds, five harmonics, within 95 % of the limits of positions, speeds and torques in the arm's URDF, the hand above the table
and clear of the arm's column. `python -m experiments.identification.excitation` writes results/identification/excitation.png,
.json and the motion for a robot, .csv; two to three minutes on two cores.
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console

import kanejax as kj
from experiments.thesis import record
from kanejax._excitation.excitation import ExcitationDesign, excitation
from kanejax._excitation.fourier_motion import write_csv
from kanejax._excitation.motion_information import DEFAULT, MotionInformation, motion_information
from kanejax._excitation.motion_search import Progress, states

RESULTS = Path(__file__).parents[2] / "results" / "identification"
URDF = "panda_description/urdf/panda.urdf"
HOME = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])
PERIOD, HARMONICS, STARTS, STEPS, RANDOM = 10.0, 5, 16, 300, 200
# Standard deviations of the errors of measured torques [N m], a percent or so of the limits.
SIGMA = np.array([0.8, 0.8, 0.8, 0.8, 0.15, 0.15, 0.15])
RATE = 100
# The hand stays this high [m] above the table that the arm stands on, and this far [m] from the axis of the first joint.
HEIGHT, CLEARANCE = 0.1, 0.25
# What a person would program: sweeps of single joints with this frequency [Hz], about these postures.
SWEEP_FREQUENCY, SWEEP_SAMPLES = 0.3, 100
POSTURES = (
    HOME,
    np.array([0.8, 0.2, 0.5, -1.6, 0.6, 2.0, -0.6]),
    np.array([-0.8, 0.6, -0.5, -2.0, -1.0, 1.2, 1.2]),
)
LABELS = {
    "by hand": "one joint after another",
    "random": f"best of {RANDOM} random ones",
    "designed": "designed",
}
COLORS = {"by hand": "#c9ced6", "random": "#d98c5f", "designed": "#1f4e79"}


class Arm(NamedTuple):
    """The model, and greatest speeds [rad/s] and torques [N m] of its joints."""

    model: kj.Model
    speed: np.ndarray
    torque: np.ndarray


def panda() -> Arm:
    """The Panda from example-robot-data, its fingers fixed; a model has no limits of speed, so they are read from the file."""
    root = ElementTree.parse(kj.robots.example_file(URDF)).getroot()
    for joint in root.iter("joint"):
        if "finger" in joint.get("name", ""):
            joint.set("type", "fixed")
    limits = [joint.find("limit") for joint in root.iter("joint") if joint.get("type") == "revolute"]
    speed, torque = ([float(limit.get(name, "nan")) for limit in limits if limit is not None] for name in ("velocity", "effort"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "panda.urdf"
        ElementTree.ElementTree(root).write(path)
        model = kj.load_report(path, strict=False).model
    return Arm(model, np.array(speed), np.array(torque))


def designed(arm: Arm, starts: int, steps: int, progress: object = None) -> ExcitationDesign:
    hand = [arm.model.tree.body(name) for name in ("panda_link7", "panda_hand_tcp")]

    def out_of_reach(q: jax.Array) -> jax.Array:
        places = kj.poses(arm.model, q).origin[jnp.array(hand)]
        return jnp.concatenate((HEIGHT - places[:, 2], CLEARANCE - jnp.linalg.norm(places[:, :2], axis=1)))

    return excitation(
        arm.model,
        period=PERIOD,
        harmonics=HARMONICS,
        speed=arm.speed,
        torque=arm.torque,
        path_constraint=out_of_reach,
        sigma=SIGMA,
        starts=starts,
        max_steps=steps,
        seed=record.SEED,
        progress=progress,  # type: ignore[arg-type]
    )


def sweeps(arm: Arm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """In each of three postures one joint after another to and fro, as far as limits allow; torques and table are not minded."""
    nv = arm.model.nv
    rate = 2 * np.pi * SWEEP_FREQUENCY
    angle = 2 * np.pi * np.arange(SWEEP_SAMPLES) / SWEEP_SAMPLES
    low, high = np.asarray(arm.model.joint_range).T
    pieces = []
    for posture in POSTURES:
        size = 0.95 * np.minimum(np.minimum(high - posture, posture - low), arm.speed / rate)
        for joint in range(nv):
            moved = size[joint] * np.eye(nv)[joint]
            pieces.append(
                (
                    posture + np.outer(np.sin(angle), moved),
                    rate * np.outer(np.cos(angle), moved),
                    -(rate**2) * np.outer(np.sin(angle), moved),
                )
            )
    q, u, u_dot = (np.concatenate(part) for part in zip(*pieces, strict=True))
    return q, u, u_dot


def run(directory: Path, progress: object = None) -> dict:
    """Design the motion, compare it, write picture, numbers and CSV; fails where the designed motion is not the better one."""
    arm = panda()
    begin = time.perf_counter()
    best = designed(arm, STARTS, STEPS, progress)
    seconds = time.perf_counter() - begin
    random = designed(arm, RANDOM, 0)
    base = best.information.base
    by_hand = motion_information(arm.model, *sweeps(arm), unknowns=DEFAULT, sigma=SIGMA, base=base)
    found = {"by hand": by_hand, "random": random.information, "designed": best.information}
    samples = int(PERIOD * RATE)
    std = {name: information.std(samples) for name, information in found.items()}
    numbers = {
        "seconds": seconds,
        "parameters": len(base),
        "random_motions_within_limits": int(np.isfinite(random.values).sum()),
        **{f"log_det_{name.replace(' ', '_')}": information.log_det for name, information in found.items()},
        **{f"condition_number_{name.replace(' ', '_')}": information.condition_number for name, information in found.items()},
        "log_det_of_random_motions": [float(value) for value in random.values if np.isfinite(value)],
        "log_det_of_starts": [None if np.isnan(value) else float(value) for value in best.values],
        "median_ratio_of_std_by_hand_to_designed": float(np.median(std["by hand"] / std["designed"])),
        "median_ratio_of_std_random_to_designed": float(np.median(std["random"] / std["designed"])),
        "samples": samples,
        "base_parameters": list(base.formulas),
        "std": {name: values.tolist() for name, values in std.items()},
        "margins": {name: np.asarray(getattr(best.margins, name)).tolist() for name in ("position", "speed", "torque", "path")},
        "message": best.message,
    }
    record.save(directory, "excitation", picture(arm, best, found, std))
    record.write(directory, "excitation", numbers)
    write_csv(best.motion, directory / "excitation.csv", rate=RATE, start=HOME, blend=3.0, model=arm.model)
    record.require(best.feasible and random.feasible, "designed and random motions keep all limits")
    for name in ("by hand", "random"):
        record.require(best.log_det > found[name].log_det, f"more information than {name}")
        record.require(best.condition_number < found[name].condition_number, f"better condition than {name}")
    return numbers


def picture(arm: Arm, design: ExcitationDesign, found: dict[str, MotionInformation], std: dict[str, np.ndarray]) -> record.Figure:
    figure = record.Figure(figsize=(15, 9.2), layout="constrained")
    figure.suptitle(
        f"Ten seconds that tell most of a Panda's {len(design.information.base)} base parameters", fontsize=16, weight="bold"
    )
    top, bottom = figure.subfigures(2, 1, height_ratios=(1.0, 1.15))
    draw_motion(top, arm, design)
    draw_precision(bottom.subplots(), design, found, std)
    return figure


def draw_motion(figure: record.Figure, arm: Arm, design: ExcitationDesign) -> None:
    """Positions, speeds and torques over their limits."""
    ts = jnp.linspace(0.0, PERIOD, 501)
    q, u, u_dot = states(design.motion, ts)
    torque = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))(arm.model, q, u, u_dot)
    low, high = np.asarray(arm.model.joint_range).T
    parts = {
        "position in its range": (np.asarray(q) - 0.5 * (low + high)) / (0.5 * (high - low)),
        "speed over its limit": np.asarray(u) / arm.speed,
        "torque over its limit": np.asarray(torque) / arm.torque,
    }
    colors = record.mpl.colormaps["viridis"](np.linspace(0.0, 0.92, arm.model.nv))
    for axes, (title, values) in zip(figure.subplots(1, 3, sharey=True), parts.items(), strict=True):
        for side in (-1, 1):
            axes.axhspan(side, 1.12 * side, color="#c8553d", alpha=0.25, linewidth=0)
            axes.axhspan(0.95 * side, side, color="#c8553d", alpha=0.1, linewidth=0)
        for joint in range(arm.model.nv):
            axes.plot(ts, values[:, joint], color=colors[joint], linewidth=1.7, label=f"joint {joint + 1}")
        axes.set(xlim=(0, PERIOD), ylim=(-1.12, 1.12), xlabel="time [s]")
        axes.set_title(title, loc="left", fontsize=11)
        axes.spines[["top", "right"]].set_visible(False)
        axes.axhline(0, color="#999999", linewidth=0.6)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside right center", frameon=False)


def draw_precision(
    axes: record.Axes, design: ExcitationDesign, found: dict[str, MotionInformation], std: dict[str, np.ndarray]
) -> None:
    """Predicted standard deviations of the base parameters, with those of the designed motion in front."""
    base = design.information.base
    order = sorted(range(len(base)), key=lambda i: _kind(base.names[base.independent[i]]))
    names = [base.names[base.independent[i]].removeprefix("panda_").replace("coulomb_friction", "Coulomb") for i in order]
    floor = 0.5 * min(values.min() for values in std.values())
    for (name, values), width in zip(std.items(), (0.86, 0.6, 0.34), strict=True):
        information = found[name]
        label = f"{LABELS[name]}: condition {information.condition_number:.3g}, log det {information.log_det:.0f}"
        axes.bar(range(len(base)), values[order] - floor, bottom=floor, width=width, color=COLORS[name], label=label)
    axes.set_yscale("log")
    axes.set_ylim(floor, 3.0 * max(values.max() for values in std.values()))
    axes.set_xlim(-0.8, len(base) - 0.2)
    axes.set_xticks(range(len(base)), names, rotation=90, fontsize=7.5)
    axes.set_ylabel("standard deviation, SI units")
    samples = int(PERIOD * RATE)
    axes.set_title(
        f"Predicted standard deviations after {samples} samples with the same errors of torque; lower is better",
        loc="left",
        fontsize=11,
    )
    axes.grid(axis="y", color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="upper left", ncols=3, fontsize=9)


def _kind(name: str) -> int:
    """First moments, inertias, friction and offsets, each base to tip."""
    ending = name.rpartition(".")[2]
    return 0 if ending.startswith("mc") or ending == "m" else 1 if ending.startswith("I") else 2 + DEFAULT.index(ending)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m experiments.identification.excitation", description=__doc__)
    parser.add_argument("--into", type=Path, default=RESULTS, help="directory for picture, numbers and motion")
    arguments = parser.parse_args()
    console = Console()

    def report(progress: Progress) -> None:
        console.print(f"step {progress.step} of {progress.steps}: log det {progress.value:.1f}, violation {progress.violation:.3f}")

    numbers = run(arguments.into, report)
    console.print(numbers["message"])
    console.print(f"{numbers['seconds']:.0f} s; pictures and numbers: {arguments.into}")


if __name__ == "__main__":
    main()
