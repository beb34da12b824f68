"""The guide to identification runs as printed: its blocks of Python one after another, then its commands with its configuration."""

import pathlib
import re

import numpy as np
import pytest
from typer.testing import CliRunner

import kanejax as kj
from kanejax import cli

GUIDE = pathlib.Path(kj.__file__).parents[1] / "docs" / "identification.md"
README = GUIDE.parents[1] / "README.md"


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", GUIDE.read_text(), re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("guide")


@pytest.fixture(scope="module")
def names(folder):
    """Everything the guide defines."""
    defined: dict = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in blocks("python"):
            exec(block, defined)
    return defined


def test_the_robot_is_found(names):
    true = kj.load(names["URDF"].format(mass=1.6, damping=0.6))
    found = names["found"]
    np.testing.assert_allclose(found.model.damping, true.damping, atol=0.01)
    np.testing.assert_allclose(found.model.coulomb_friction, true.coulomb_friction, atol=0.01)
    estimate = found["shoulder.damping"]
    assert estimate.lower < true.damping[0] < estimate.upper
    (run,) = found.validation
    assert np.all(kj.relative_error(run) < 0.5 * kj.relative_error(run, run.nominal))


def test_options_are_taken(names):
    assert len(names["log"].runs[0]) == 400
    assert any("8 Hz" in note for note in names["motion"].notes)
    assert "fore.Ixz" in names["sought"].names
    assert names["carrying"].tree.body_names[-1] == "payload"
    assert names["design"].feasible


def test_what_is_kept_is_there(names, folder):
    assert (folder / "fit.npz").is_file()
    np.testing.assert_array_equal(names["kept"].phi, names["found"].phi)


def test_the_command(names, folder, monkeypatch):
    monkeypatch.chdir(folder)
    (configuration,) = blocks("toml")
    (folder / "id.toml").write_text(configuration)
    commands = [line.split()[1:] for block in blocks("sh") for line in block.splitlines() if line.startswith("kanejax identify")]
    assert len(commands) == 2
    for command in commands:
        result = CliRunner().invoke(cli.app, command)
        assert result.exit_code == 0, result.output
        assert (folder / command[-1] / "report.html").is_file() or (folder / "result/report.html").is_file()
    assert {path.name for path in (folder / "result").iterdir()} >= {
        "report.html",
        "identification.json",
        "identified.urdf",
        "identified.xml",
        "predictions.npz",
        "run.log",
    }


def test_the_example_of_the_readme(names, folder, monkeypatch):
    monkeypatch.chdir(folder)
    text = README.read_text()
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "kj.identify(" in block)
    defined = {"kj": kj}
    exec(code, defined)
    run = defined["found"].validation[0]
    assert np.all(kj.relative_error(run) < 0.5 * kj.relative_error(run, run.nominal))


def test_every_leaf_is_in_the_table():
    with pytest.raises(kj.UnknownNameError) as error:
        kj.Unknown("nothing")
    leaves = str(error.value).partition("nothing")[2]
    table = "\n".join(line for line in GUIDE.read_text().splitlines() if line.startswith("|"))
    for leaf in re.findall(
        r"[a-z]+_[a-z]+(?:_[a-z]+)*|mass|com|inertia|damping|gain|offset|delay|stiffness|gravity|armature", leaves
    ):
        assert f"`{leaf}`" in table, leaf
