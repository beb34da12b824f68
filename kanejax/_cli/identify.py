"""The command `kanejax identify`."""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from kanejax._cli.terminal import (
    FAILED,
    Json,
    Repair,
    Robot,
    Strict,
    Unphysical,
    check_report_packages,
    complain,
    console,
    logbook,
    one_line_errors,
    spinner,
    use_compilation_cache,
)
from kanejax._cli.unfinished import DEFAULT_INTERVAL, Fresh, Interval, Resume, check_unfinished, unfinished

if TYPE_CHECKING:
    from kanejax._cli.inputs import Inputs
    from kanejax._identify.result import Identification

# Sentences that are printed, and how much of each; the files have all of them.
_SENTENCES, _LONGEST = 6, 280


def _print_example(wanted: bool) -> bool:
    if wanted:
        import kanejax

        print((Path(kanejax.__file__).parent / "_identify" / "configuration_example.toml").read_text(encoding="utf-8"), end="")
        raise typer.Exit
    return wanted


def identify(
    robot: Robot,
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="Recordings: CSV, NPZ, Parquet or MCAP.", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="The folder to write to.", show_default=False)],
    config: Annotated[
        Path | None,
        typer.Option(help="TOML file with columns, filters, and what is sought; see --example.", show_default=False),
    ] = None,
    validation: Annotated[
        list[Path] | None, typer.Option(help="A recording to hold out; may be given several times.", show_default=False)
    ] = None,
    resume: Resume = False,
    fresh: Fresh = False,
    checkpoint_interval: Interval = DEFAULT_INTERVAL,
    repair: Repair = False,
    strict: Strict = True,
    allow_unphysical: Unphysical = False,
    as_json: Json = False,
    example: Annotated[
        bool, typer.Option("--example", callback=_print_example, is_eager=True, help="Print a configuration, and exit.")
    ] = False,
) -> None:
    """Find inertias, friction and other parameters of a robot from recordings of its motion.

    Writes report.html, identification.json, identified.urdf (inertias, damping and friction; for a URDF), identified.xml (MJCF),
    predictions.npz and run.log. What is unfinished is kept in the folder: after an interruption the same command goes on from
    there with `--resume`.

    Examples:
    - `kanejax identify arm.urdf log.csv --out result`
    - `kanejax identify arm.urdf log.csv --out result --resume`
    - `kanejax identify arm.urdf a.csv b.csv --validation c.csv --config id.toml --out result`
    - `kanejax identify --example > id.toml`
    """
    with one_line_errors():
        import jax

        from kanejax._cli.inputs import read_inputs
        from kanejax._cli.results import LOG_NAME

        check_unfinished(out, resume=resume, fresh=fresh)
        use_compilation_cache()
        with jax.enable_x64(True):
            begun, held_out = time.perf_counter(), validation or []
            with spinner("reading"):
                inputs = read_inputs(robot, logs, held_out, config, repair=repair, strict=strict, allow_unphysical=allow_unphysical)
            check_report_packages(inputs.output, "configuration")
            out.mkdir(parents=True, exist_ok=True)
            say = logbook(out / LOG_NAME)
            files = {"Robot": robot, "Logs": _listed(logs), "Held-out logs": _listed(held_out), "Configuration": str(config or "")}
            files = {kind: listed for kind, listed in files.items() if listed}
            for line in (*(f"{kind}: {listed}" for kind, listed in files.items()), *inputs.notes):
                say(line)
            with unfinished(out, say, fresh=fresh) as checkpoint:
                kept = {"checkpoint": checkpoint, "checkpoint_interval": checkpoint_interval}
                found = _identified(inputs, say, kept, shown=not as_json and sys.stderr.isatty())
                sound = _reported(out, inputs, found, files, say, seconds=time.perf_counter() - begun, as_json=as_json)
                checkpoint.unlink(missing_ok=True)
    if not sound:
        raise typer.Exit(FAILED)


def _identified(inputs: "Inputs", say: Callable[[str], None], kept: dict[str, Any], *, shown: bool) -> "Identification":
    """Run the stages, from where they are kept on."""
    from kanejax._cli.stages import StageTable
    from kanejax._identify import identify as module

    with StageTable(inputs.stages, say, shown=shown) as table:
        return module.identify(
            inputs.plant,
            inputs.training,
            inputs.unknowns,
            validation=inputs.validation,
            progress=table.round,
            **kept,
            **inputs.options,
        )


def _reported(
    out: Path,
    inputs: "Inputs",
    found: "Identification",
    files: dict[str, str],
    say: Callable[[str], None],
    *,
    seconds: float,
    as_json: bool,
) -> bool:
    """Write and print what was found; whether it converged and is consistent."""
    from kanejax._cli.results import error_table, write_results
    from kanejax._identify.record import identification_record
    from kanejax._identify.report.verdict import inconsistent_bodies, sentences_on_fit, verdict

    details = {"inputs": files, "options": {**inputs.options, "stages": inputs.stages}, "fingerprint": inputs.fingerprint}
    record = identification_record(found, {**details, "seconds": seconds, "notes": inputs.notes})
    with spinner("writing"):
        written, problems = write_results(out, inputs, found, record, files)
    findings, sentences = verdict(found), sentences_on_fit(found, inputs.notes)
    for sentence in (*(finding.text for finding in findings), *sentences, *problems):
        say(sentence)
    if as_json:
        print(json.dumps(record, indent=1, allow_nan=False))
    else:
        _print_findings(error_table(found), findings, sentences, written)
    for problem in problems:
        complain(problem, "warning: ")
    return found.converged and not inconsistent_bodies(found)


def _listed(paths: list[Path]) -> str:
    return ", ".join(map(str, paths))


def _print_findings(table: Any, findings: Any, sentences: list[str], written: list[Path]) -> None:
    console().print(table)
    for finding in findings:
        mark, color = {"good": ("ok", "green"), "bad": ("BAD", "bold red"), "note": ("note", "yellow")}[finding.kind]
        console().print(Text.assemble((f"{mark}: ", color), finding.text), soft_wrap=True)
    for sentence in sentences[:_SENTENCES]:
        shown = sentence if len(sentence) <= _LONGEST else sentence[: _LONGEST - 4] + " ..."
        console().print(Text.assemble(("note: ", "yellow"), shown), soft_wrap=True)
    if len(sentences) > _SENTENCES:
        console().print(Text(f"{len(sentences) - _SENTENCES} more notes are in the files"))
    console().print(Text("written: " + ", ".join(map(str, written))), soft_wrap=True)
