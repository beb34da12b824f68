"""The command `kanejax identify`: files, exit codes, what it keeps, and what it refuses."""

import json
import re
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

import kanejax as kj
from kanejax import cli
from kanejax._cli import stages
from kanejax._cli.inputs import read_inputs
from kanejax._cli.terminal import BAD_INPUT, FAILED, INTERRUPTED
from kanejax._identify import identify as module
from kanejax._simulation_fit.simulation_fit import SimulationFit

ARM = """<robot name="arm"><!-- kept --><link name="base"/>
<link name="upper"><inertial><origin xyz="0.15 0.01 0.02"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.1 0 0"/><mass value="{mass}"/>
<inertia ixx="0.005" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<dynamics damping="{damping}" friction="0.1"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/></joint>
</robot>"""
CONFIGURATION = """
[log.columns]
time = "t"
position = "q_{joint}"
effort = ["i1", "i2"]
[log.units]
time = "ms"
[drives]
gain = { elbow = 2.0 }
[identify]
seed = 1
[output]
title = "The <arm>"
"""


def write_log(path, model, seed):
    """A log of the true arm, the elbow of which is measured by its current."""
    random = np.random.default_rng(seed)
    ts = 0.02 * np.arange(250)
    phases, sizes = random.uniform(0, 6, (2, 4)), random.normal(size=(2, 4))
    rates = np.array([1.0, 2.3, 3.1, 4.7])
    waves = rates[:, None] * ts + phases[..., None]
    q, u, u_dot = (
        np.einsum("jk,jkt->tj", sizes * rates**power, wave(waves))
        for power, wave in ((-1, np.sin), (0, np.cos), (1, lambda x: -np.sin(x)))
    )
    force = np.asarray(jax.jit(jax.vmap(lambda *state: kj.inverse_dynamics(model, *state)))(q, u, u_dot))
    effort = (force + 0.02 * random.normal(size=force.shape)) / np.array([1.0, 2.0])
    header = "t,q_shoulder,q_elbow,i1,i2"
    np.savetxt(path, np.column_stack((1e3 * ts, q, effort)), delimiter=",", header=header, comments="")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm")
    (path / "arm.urdf").write_text(ARM.format(mass=1, damping=0.2))
    true = kj.load(ARM.format(mass=1.6, damping=0.6))
    write_log(path / "a.csv", true, 0)
    write_log(path / "b.csv", true, 1)
    (path / "id.toml").write_text(CONFIGURATION)
    return path


def run(folder, *arguments, out="out", config="id.toml", logs=("a.csv",)):
    options = ["--config", folder / config] if config else []
    given = ["identify", folder / "arm.urdf", *(folder / log for log in logs), "--out", folder / out, *options, *arguments]
    return CliRunner().invoke(cli.app, [str(argument) for argument in given])


@pytest.fixture(scope="module")
def first(folder):
    """The first run, on which others build."""
    return run(folder, "--validation", folder / "b.csv")


@pytest.fixture
def cut(monkeypatch):
    """Ctrl-C after a round of a stage, told by its name and number."""
    show, left = stages.StageTable.round, []

    def shown(self, stage, step):
        show(self, stage, step)
        if left and left[0] == (stage, self._rows[stage]["rounds"]):
            left.clear()
            raise KeyboardInterrupt

    monkeypatch.setattr(stages.StageTable, "round", shown)
    return lambda stage, number: left.append((stage, number))


def again(folder, *arguments, **options):
    return run(folder, "--validation", folder / "b.csv", *arguments, **options)


def test_first_run(folder, first):
    assert first.exit_code == 0, first.output
    for text in ("shoulder", "held-out runs", "ok: ", "converged", "written: ", "identified.urdf"):
        assert text in first.stdout
    names = {path.name for path in (folder / "out").iterdir()}
    files = {"report.html", "identification.json", "identified.urdf", "identified.xml", "predictions.npz", "run.log"}
    assert names == files
    assert "The &lt;arm&gt;" in (folder / "out/report.html").read_text()
    lines = (folder / "out/run.log").read_text()
    assert "inverse dynamics: round 1, cost " in lines
    assert "inverse dynamics: ended" in lines


def test_numbers_of_the_first_run(folder, first):
    record = json.loads((folder / "out/identification.json").read_text())
    assert record["converged"]
    assert record["options"] == {"seed": 1, "stages": ["inverse dynamics"]}
    found = {entry["name"]: entry for entry in record["parameters"]}
    damping = found["shoulder.damping"]
    assert damping["nominal"] == 0.2
    assert abs(damping["value"] - 0.6) < 4 * damping["std"] < 0.1
    assert found["fore.mcx"]["value"] == pytest.approx(0.16, abs=0.03)
    runs = {run["name"]: run for run in record["runs"]}
    assert runs["b"]["use"] == "validation"
    assert np.all(np.array(runs["b"]["relative_error"]) < 0.5 * np.array(runs["b"]["nominal_relative_error"]))


def test_models_of_the_first_run(folder, first):
    record = json.loads((folder / "out/identification.json").read_text())["identified"]["model"]
    text = (folder / "out/identified.urdf").read_text()
    assert "<!-- kept -->" in text
    for name, exact in (("identified.urdf", 1e-12), ("identified.xml", 1e-12)):
        model = kj.load(folder / "out" / name)
        for leaf in ("mass", "com", "central_inertia", "damping", "coulomb_friction"):
            np.testing.assert_allclose(getattr(model, leaf), record[leaf], rtol=1e-9, atol=exact, err_msg=f"{name}: {leaf}")
    series = np.load(folder / "out/predictions.npz")
    assert list(series["signals"]) == ["shoulder", "elbow"]
    assert series["validation_0_measured"].shape == series["validation_0_predicted"].shape
    assert str(series["validation_0_name"]) == "b"


def test_interruption_keeps_every_round(folder, first, cut):
    both = CONFIGURATION.replace("seed = 1", 'seed = 1\nstages = ["inverse dynamics", "simulation"]')
    (folder / "both.toml").write_text(both + "[simulation]\nwindows = [0.5]\nmax_iterations = 8\n")
    whole = again(folder, "--json", config="both.toml", out="whole")
    for stage, number in (("inverse dynamics", 1), ("simulation", 2)):
        cut(stage, number)
        result = again(folder, "--resume", config="both.toml", out="cut")
        assert result.exit_code == INTERRUPTED
        assert "what is done is kept; --resume goes on from there" in " ".join(result.stderr.split())
        assert not (folder / "cut/identification.json").exists()
    result = again(folder, "--resume", "--json", config="both.toml", out="cut")
    assert result.exit_code == whole.exit_code, result.output
    assert without_time(result.stdout) == without_time(whole.stdout)
    lines = (folder / "cut/run.log").read_text()
    assert lines.count("interrupted; what is done is kept") == 2
    assert lines.count("going on with ") == 2
    # The last process sees nothing of the first stage, and the rest of the second.
    log = (folder / "whole/run.log").read_text()
    assert "inverse dynamics: kept from before" in lines
    assert lines.count("simulation: round ") == log.count("simulation: round ")
    assert not (folder / "cut/unfinished.npz").exists()


def without_time(text):
    return json.loads(text) | {"seconds": 0}


def test_unfinished_work_is_neither_lost_nor_gone_on_with_by_accident(folder, first, cut):
    (folder / "other.toml").write_text(CONFIGURATION.replace("elbow = 2.0", "elbow = 2.1"))
    cut("inverse dynamics", 1)
    assert run(folder, out="held").exit_code == INTERRUPTED
    for config, flags, message in (
        ("id.toml", (), r"held holds unfinished work of [\d: -]*; --resume goes on with it, --fresh drops it and begins anew"),
        ("id.toml", ("--resume", "--fresh"), "--resume and --fresh exclude each other; give one"),
        ("other.toml", ("--resume",), "unfinished.npz belongs to other inputs; --fresh drops it and begins anew"),
    ):
        result = run(folder, *flags, out="held", config=config)
        assert result.exit_code == BAD_INPUT
        (line,) = result.stderr.splitlines()
        assert re.search(message, line)
    # What is written, and where to, does not count.
    (folder / "titled.toml").write_text(CONFIGURATION + "report = false\n")
    assert run(folder, "--resume", out="held", config="titled.toml").exit_code == 0
    cut("inverse dynamics", 1)
    assert run(folder, out="held").exit_code == INTERRUPTED
    assert run(folder, "--fresh", out="held", config="other.toml").exit_code == 0


def test_stage_that_does_not_converge(folder, first, monkeypatch):
    (folder / "both.toml").write_text(CONFIGURATION.replace("seed = 1", 'seed = 1\nstages = ["inverse dynamics", "simulation"]'))

    def diverged(sought, motions, *, starts, robust, progress, checkpoint):
        progress(SimpleNamespace(cost=1.0))
        ones, factor = {"q": np.ones(2)}, jnp.eye(len(sought.phi0) + 1)
        end = (False, "out of patience", 1, 1.0, (), factor, 1, ones, ones, (), np.ones(1), (1, 1))
        return SimulationFit(starts[0], sought.phi(starts[0]), *end)

    monkeypatch.setattr(module, "fit_simulation", diverged)
    result = again(folder, config="both.toml", out="diverged")
    assert result.exit_code == FAILED
    assert "BAD: Stage 'simulation' did not converge: out of patience." in result.stdout


def test_example_configuration_works(folder, first):
    example = CliRunner().invoke(cli.app, ["identify", "--example"])
    assert example.exit_code == 0
    text = (folder / "a.csv").read_text().split("\n", 1)[1]
    (folder / "plain.csv").write_text("time,position_shoulder,position_elbow,effort_shoulder,effort_elbow\n" + text)
    (folder / "example.toml").write_text(example.stdout.replace('time = "s" ', 'time = "ms" '))
    result = run(folder, "--json", config="example.toml", logs=("plain.csv",), out="example")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["options"]["starts"] == 1


def test_fraction_is_held_out(folder):
    (folder / "part.toml").write_text(CONFIGURATION.replace("seed = 1", "validation = 0.4"))
    part, whole = (
        read_inputs(
            str(folder / "arm.urdf"), [folder / "a.csv"], [], folder / name, repair=False, strict=True, allow_unphysical=False
        )
        for name in ("part.toml", "id.toml")
    )
    counts = [sum(map(len, runs)) for runs in (part.training, part.validation, whole.training, whole.validation)]
    assert counts[0] + counts[1] == counts[2]
    assert counts[1] == pytest.approx(0.4 * counts[2], abs=2)
    assert counts[3] == 0
    assert "validation" not in part.options
    assert part.fingerprint != whole.fingerprint


def test_only_what_is_asked_for_is_written(folder, first):
    (folder / "little.toml").write_text(CONFIGURATION + "urdf = false\nmjcf = false\nreport = false\npredictions = false\n")
    result = run(folder, config="little.toml", out="little")
    assert result.exit_code == 0, result.output
    assert {path.name for path in (folder / "little").iterdir()} == {"identification.json", "run.log"}
    record = json.loads((folder / "little/identification.json").read_text())
    assert [run["use"] for run in record["runs"]] == ["training"]


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        (("seed = 1", "sed = 1"), (), r"wrong.toml: [identify] has no key 'sed'; the keys are: stages"),
        (
            ("seed = 1", "validation = 0.2"),
            ("--validation", "b.csv"),
            "[identify] validation is 0.2, and --validation is given too",
        ),
        (("[log.columns]", "[log]\nvalidation_rows = [1, 9]\n[log.columns]"), (), "validation_rows is given, but no --validation"),
        (("elbow = 2.0", "elbo = 2.0"), (), "no joint is named 'elbo'; the names are: 'shoulder', 'elbow'"),
        (("q_{joint}", "p_{joint}"), (), "a.csv: "),
        (("[identify]", '[[unknown]]\nleaf = "damping"\nof = "wrist*"\n[identify]'), (), "no joint is named 'wrist*'"),
        (
            ("[identify]", "[motion]\ndecimation = 2\nrate = 10\n[identify]"),
            (),
            "wrong.toml: give decimation (2) or rate (10.0), not both",
        ),
        (("[identify]", "[motion]\ncutoff = 1000\n[identify]"), (), "cutoff"),
        (("[identify]", "[locked]\nelbow = 0.1\n[identify]"), (), "columns.effort lists 2 columns for 1 joints: shoulder"),
    ],
)
def test_wrong_inputs(folder, change, arguments, message):
    assert change[0] in CONFIGURATION
    (folder / "wrong.toml").write_text(CONFIGURATION.replace(*change))
    arguments = [folder / argument if argument.endswith(".csv") else argument for argument in arguments]
    result = run(folder, *arguments, config="wrong.toml", out="wrong")
    assert result.exit_code == BAD_INPUT, result.output
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ")
    assert message in line
    assert not (folder / "wrong").exists()


def test_missing_files(folder):
    for result in (run(folder, config="none.toml"), run(folder, logs=("none.csv",))):
        assert result.exit_code == BAD_INPUT
        assert "none." in result.stderr
        assert "Traceback" not in result.stderr
    assert CliRunner().invoke(cli.app, ["identify", str(folder / "arm.urdf"), "--out", "x"]).exit_code == BAD_INPUT
    (folder / "file").write_text("")
    assert run(folder, out="file").exit_code == BAD_INPUT


def test_packages_of_the_report_are_looked_for_first(folder, first, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "jinja2", None)
    result = run(folder, out="bare")
    assert result.exit_code == BAD_INPUT
    assert "pip install 'kanejax[report]'; or say report = false in [output]" in " ".join(result.stderr.split())
    assert not (folder / "bare").exists()


def test_what_a_file_format_cannot_say_is_told(folder, first, monkeypatch):
    from kanejax._cli import results

    def refuses(model):
        raise kj.UnsupportedModelError("MJCF cannot express this")

    monkeypatch.setattr(results, "to_mjcf", refuses)
    (folder / "out/identified.xml").unlink(missing_ok=True)
    result = again(folder)
    assert result.exit_code == 0, result.output
    assert "identified.xml is not written: MJCF cannot express this" in " ".join(result.stderr.split())
    assert not (folder / "out/identified.xml").exists()
    assert [path.name for path in (folder / "out").iterdir() if "partial" in path.name] == []
