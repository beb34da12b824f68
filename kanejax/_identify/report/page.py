"""The page itself: everything in one file, without links to anything else."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kanejax._identify.report import tables
from kanejax._identify.report.pictures import correlation_picture, fit_picture, spectrum_picture
from kanejax._identify.report.signals import duration, sample_count, signal_names, signal_units
from kanejax._identify.report.svg import drawing, report_package
from kanejax._identify.report.verdict import sentences_on_fit, verdict
from kanejax._identify.result import Comparison, Identification

# Pictures of fits, and bins of all their lines together: what keeps the file below 3 MB.
_MOST_PICTURES, _MOST_BINS, _BINS = 96, 16000, 500
# Sentences beside the verdict; all of them are among the notes.
_SENTENCES = 6


def write_report(
    identification: Identification,
    path: str | os.PathLike[str],
    *,
    title: str = "Identification",
    inputs: Mapping[str, Any] | None = None,
    notes: Sequence[str] = (),
) -> None:
    """Write what an identification found as a page of HTML: one file, which needs no network.

    It has a verdict in words, measured signals beside those that the identified and the nominal plant predict, errors, spectra of
    the residuals, parameters with their 95 % intervals, base parameters with their correlations, the bodies, and the stages. Long
    runs are drawn by the least and greatest value of short stretches of time. Needs the packages jinja2 and matplotlib, which
    `pip install 'kanejax[report]'` installs.

    Args:
        identification: what `identify` returned.
        path: of the file to write.
        title: heading of the page, such as the robot's name.
        inputs: what the summary says of where robot and data came from, by name.
        notes: sentences on the data and the robot, such as what was ignored or dropped.

    Raises:
        ImportError: a package is not installed.
    """
    text = _page(identification, title, dict(inputs or {}), tuple(notes))
    Path(path).write_text(text, encoding="utf-8")


def _page(identification: Identification, title: str, inputs: dict[str, Any], notes: tuple[str, ...]) -> str:
    jinja2 = report_package("jinja2")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    with drawing():
        shown = _pictures(identification)
    return environment.get_template("page.html").render(
        title=title,
        summary={**inputs, **_summary(identification)},
        findings=verdict(identification),
        sentences=sentences_on_fit(identification, notes),
        first=_SENTENCES,
        notes=notes,
        groups=[heading for heading, _ in tables.error_groups(identification)],
        errors=tables.error_rows(identification),
        runs=tables.run_rows(identification),
        signals=signal_names(identification),
        parameters=tables.parameter_groups(identification),
        base=tables.base_rows(identification),
        condition=tables.number(float(identification.base.condition_number), 3),
        strongest=tables.strongest_correlations(identification),
        bodies=tables.body_rows(identification),
        stages=tables.stage_rows(identification),
        **shown,
    )


def _summary(identification: Identification) -> dict[str, str]:
    tree = identification.plant.model.tree
    summary = {
        "Mechanism": f"{tree.nbody} bodies, {tree.njoint} joints, {tree.nv} speeds",
        "Sought": ", ".join(dict.fromkeys(unknown.leaf.replace("_", " ") for unknown in identification.parameterization.unknowns)),
        "Parameters": f"{len(identification.phi)}, in {len(identification.base.formulas)} combinations that one can tell apart",
    }
    for heading, runs in (("Fitted", identification.training), ("Held out", identification.validation)):
        if runs:
            names = ", ".join(run.name for run in runs)
            summary[heading] = f"{names}: {sample_count(runs)} samples in {duration(runs):.4g} s"
    return summary


def _pictures(identification: Identification) -> dict[str, Any]:
    names, units = signal_names(identification), signal_units(identification)
    noise, base = identification.noise, identification.base
    return {
        "fits": _fits(identification),
        "spectra": [
            (name, spectrum_picture(noise, i, name, unit, f"spectrum{i}"))
            for i, (name, unit) in enumerate(zip(names, units, strict=True))
            if np.any(noise.density[1:, i] > 0)
        ],
        "correlation": correlation_picture(np.asarray(base.correlation), "correlation") if len(base.formulas) else None,
    }


def _fits(identification: Identification) -> list[dict[str, Any]]:
    """Pictures of the fits, run by run; of many runs the first ones, some that were held out and some that were fitted."""
    names, units = signal_names(identification), signal_units(identification)
    groups = tables.error_groups(identification)
    each = max(_MOST_PICTURES // (max(len(names), 1) * max(len(groups), 1)), 1)
    panels = sum(min(len(runs), each) for _, runs in groups) * len(names)
    bins = int(np.clip(_MOST_BINS // max(panels, 1), 60, _BINS))

    def of_run(run: Comparison, key: str) -> list[tuple[str, str]]:
        drawn = [i for i in range(len(names)) if np.any(run.weight[:, i] > 0)]
        return [(names[i], fit_picture(run, i, names[i], units[i], bins, f"{key}-{i}")) for i in drawn]

    return [
        {
            "heading": heading,
            "left_out": len(runs) - len(runs[:each]),
            "runs": [(run.name, of_run(run, f"fit{group}-{number}")) for number, run in enumerate(runs[:each])],
        }
        for group, (heading, runs) in enumerate(groups)
    ]
