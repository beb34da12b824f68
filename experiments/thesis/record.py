"""The numbers of an experiment as a file of JSON, with all that made them, and its pictures."""

import importlib.metadata
import json
import os
import platform
from pathlib import Path

import jax
import matplotlib as mpl

# Before pyplot: pictures go to files, also where there is no display.
mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.figure import Figure

SEED = 0
"""Of all random states."""
PACKAGES = ("kanejax", "jax", "jaxlib", "numpy", "diffrax", "equinox", "mujoco")
COLORS = ("#2f6f9f", "#c8553d", "#3a8a5f", "#8d6cab", "#b8860b", "#444444")
"""Of curves."""


def write(directory: Path, name: str, numbers: dict) -> Path:
    """Write `numbers`, with the seed, versions and device, to directory/name.json.

    Raises:
        ValueError: a number is NaN or infinite.
        TypeError: a value is none that JSON has, such as an array; give plain numbers, strings, lists and dicts.
    """
    record = {"experiment": name, "numbers": numbers, "seed": SEED, "versions": versions(), "device": device()}
    try:
        text = json.dumps(record, indent=1, allow_nan=False)
    except ValueError as error:
        bad = [key for key, value in numbers.items() if any(word in repr(value) for word in ("nan", "inf"))]
        raise ValueError(f"{name}: NaN or infinity in {', '.join(bad)}") from error
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f"{name}.json"
    path.write_text(text + "\n")
    return path


def save(directory: Path, name: str, figure: Figure) -> Path:
    """Write a picture to directory/name.png."""
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f"{name}.png"
    figure.savefig(path, dpi=150)
    return path


def figure_of(rows: int, columns: int, *, size: tuple[float, float], title: str) -> tuple[Figure, list[Axes]]:
    """An empty picture of rows times columns axes, size in inches, and its axes row by row."""
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(title, fontsize=13)
    axes = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for each in axes:
        each.spines[["top", "right"]].set_visible(False)
        each.grid(color="#e6e6e6", linewidth=0.6)
        each.set_axisbelow(True)
    return figure, axes


def require(holds: bool, claim: str) -> None:
    """Let the experiment fail unless what it claims holds; call it after `write`, so that the numbers can be looked at.

    Raises:
        AssertionError: it does not.
    """
    if not holds:
        raise AssertionError(f"does not hold: {claim}")


def versions() -> dict[str, str]:
    """Of Python and the packages that compute."""
    return {"python": platform.python_version()} | {package: importlib.metadata.version(package) for package in PACKAGES}


def device() -> dict[str, str | float | None]:
    """Where it ran, and how busy that machine was."""
    cpu_info = Path("/proc/cpuinfo")
    lines = cpu_info.read_text().splitlines() if cpu_info.exists() else []
    cpu = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    load = round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None
    return {"jax": jax.devices()[0].device_kind, "cpu": cpu, "cores": os.cpu_count(), "load": load}
