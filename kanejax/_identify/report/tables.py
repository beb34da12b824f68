"""The tables of a report, as rows of texts."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from kanejax._identify.report.numbers import DASH, MINUS, number, number_with_error, percent
from kanejax._identify.report.signals import errors, signal_names, signal_units
from kanejax._identify.report.verdict import inconsistent_bodies
from kanejax._identify.result import Comparison, Estimate, Identification


class ErrorRow(NamedTuple):
    """Errors of one signal: its name and unit, measured size, and for each group of runs the errors and the bars that show them."""

    name: str
    unit: str
    groups: list[dict[str, Any]]


def error_groups(identification: Identification) -> list[tuple[str, Sequence[Comparison]]]:
    """Held-out and fitted runs, those there are."""
    groups = (("held-out runs", identification.validation), ("fitted runs", identification.training))
    return [(title, runs) for title, runs in groups if runs]


def error_rows(identification: Identification) -> list[ErrorRow]:
    """How well each signal is predicted."""
    found = [errors(runs) for _, runs in error_groups(identification)]
    longest = np.nanmax([1e-12, *(value for group in found for value in np.minimum(np.append(group.nominal, group.relative), 1.0))])
    rows = []
    for index, (name, unit) in enumerate(zip(signal_names(identification), signal_units(identification), strict=True)):
        groups = [
            {
                "rms": number(group.rms[index], 3),
                "residual": number(group.residual[index], 3),
                **{key: percent(getattr(group, key)[index]) for key in ("relative", "nominal")},
                **{f"{key}_bar": _bar(getattr(group, key)[index], float(longest)) for key in ("relative", "nominal")},
            }
            for group in found
        ]
        rows.append(ErrorRow(name, unit, groups))
    return rows


def run_rows(identification: Identification) -> list[tuple[str, str, list[str]]]:
    """Relative errors of each run: its name, how it was used, and a text for each signal."""
    rows = []
    for title, runs in error_groups(identification):
        rows += [(run.name, title.removesuffix("s"), [percent(error) for error in errors([run]).relative]) for run in runs]
    return rows


def _bar(value: float, longest: float) -> float:
    """Length of a bar in percent; one that is cut off fills all."""
    return 0.0 if not math.isfinite(value) else round(min(100.0 * value / longest, 100.0), 1)


class Whiskers(NamedTuple):
    """Where, from 0 to 100, a value, its interval and the nominal value lie; None for an interval that there is not."""

    nominal: float
    value: float
    interval: tuple[float, float] | None


def parameter_groups(identification: Identification) -> list[tuple[str, list[dict[str, Any]]]]:
    """Parameters by the body or joint that they belong to."""
    tree = identification.plant.model.tree
    # A name may begin with another's.
    owners = sorted({*tree.body_names, *tree.joint_names}, key=len, reverse=True)
    split = [(*_owner_and_label(estimate.name, owners), estimate) for estimate in identification.estimates]
    groups = {owner: [] for owner, _, _ in split}
    for owner, label, estimate in split:
        groups[owner].append(_parameter(label, estimate))
    return list(groups.items())


def _owner_and_label(name: str, owners: Sequence[str]) -> tuple[str, str]:
    owner = next((owner for owner in owners if name.startswith(owner + ".")), None)
    return ("all together", name) if owner is None else (owner, name.removeprefix(owner + "."))


def _parameter(label: str, estimate: Estimate) -> dict[str, Any]:
    value, std = number_with_error(estimate.value, estimate.std)
    has_interval = math.isfinite(estimate.lower) and math.isfinite(estimate.upper)
    lower, upper = (number_with_error(end, estimate.std)[0] for end in (estimate.lower, estimate.upper))
    return {
        "label": label.replace("_", " "),
        "unit": estimate.unit.replace("^2", "\u00b2"),
        "nominal": number(estimate.nominal),
        "value": value,
        "std": std,
        "interval": f"{lower} to {upper}" if has_interval else DASH,
        "determined": estimate.determined,
        "whiskers": _whiskers(estimate) if has_interval else None,
    }


def _whiskers(estimate: Estimate) -> Whiskers | None:
    places = np.array([estimate.nominal, estimate.value, estimate.lower, estimate.upper])
    low, high = places.min(), places.max()
    if not np.all(np.isfinite(places)) or high <= low:
        return None
    nominal, value, lower, upper = (4.0 + 92.0 * (places - low) / (high - low)).round(1).tolist()
    return Whiskers(nominal, value, (lower, upper))


def base_rows(identification: Identification) -> list[dict[str, str]]:
    """Base parameters with their formulas."""
    base, rows = identification.base, []
    for formula, nominal, found, deviation in zip(base.formulas, base.nominal, base.value, base.std, strict=True):
        value, std = number_with_error(float(found), float(deviation))
        relative = percent(float(deviation / abs(found))) if found else DASH
        rows.append(
            {
                "formula": formula.replace(" - ", f" {MINUS} "),
                "nominal": number(float(nominal)),
                "value": value,
                "std": std,
                "relative": relative,
            }
        )
    return rows


def strongest_correlations(identification: Identification, count: int = 8, least: float = 0.9) -> list[tuple[int, int, str]]:
    """Pairs of base parameters, counted from 1, whose errors go together, and their correlation."""
    correlation = np.nan_to_num(np.asarray(identification.base.correlation))
    first, second = np.triu_indices(len(correlation), 1)
    sizes = correlation[first, second]
    order = [i for i in np.argsort(-np.abs(sizes))[:count] if abs(sizes[i]) >= least]
    return [(int(first[i]) + 1, int(second[i]) + 1, number(float(sizes[i]), 3)) for i in order]


def body_rows(identification: Identification) -> list[dict[str, Any]]:
    """Each body's mass distribution before and after, and whether a rigid body can have it."""
    model, nominal = identification.plant.model, identification.nominal.model
    bad = inconsistent_bodies(identification)
    rows = []
    for body, name in enumerate(model.tree.body_names):
        inertia = np.asarray(model.central_inertia[body], float)
        moments = np.linalg.eigvalsh(0.5 * (inertia + inertia.T))
        empty = not np.any(inertia) and float(model.mass[body]) == 0
        rows.append(
            {
                "name": name,
                "nominal_mass": number(float(nominal.mass[body])),
                "mass": number(float(model.mass[body])),
                "com": ", ".join(number(float(x), 3) for x in np.asarray(model.com[body])),
                "moments": ", ".join(number(float(x), 3) for x in moments),
                "smallest": number(float(identification.consistency[body]), 3),
                "state": "no mass" if empty else "impossible" if name in bad else "possible",
            }
        )
    return rows


def stage_rows(identification: Identification) -> list[dict[str, Any]]:
    """How each stage ended."""
    return [
        {
            "name": stage.name,
            "converged": stage.converged,
            "message": stage.message,
            "iterations": stage.iterations,
            "cost": number(float(stage.cost), 6),
            "rms": ", ".join(number(float(x), 3) for x in stage.rms),
        }
        for stage in identification.stages
    ]
