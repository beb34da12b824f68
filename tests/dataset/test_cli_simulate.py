"""`kanejax simulate` with a study: what its file may say, what is refused in one line, and what is printed."""

import json
import re

import numpy as np
import pytest
import xarray
from typer.testing import CliRunner

import kanejax as kj
from kanejax import cli
from tests.dataset.test_write_study import ARM

STUDY = """trajectories = 32
duration = 0.2
times = 3
seed = 4
[initial]
u = { distribution = "uniform", low = -1.0, high = [1.0, 2.0] }
[forces]
distribution = "normal"
std = [2.0, 1.0]
period = 0.1
interpolation = "linear"
[parameters]
density = { distribution = "log-normal", sigma = 0.1 }
damping = { distribution = "uniform", low = 0.0, high = 0.5, how = "added" }
[solver]
method = "dopri5"
rtol = 1e-7
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path


def run(*arguments):
    return CliRunner().invoke(cli.app, ["simulate", "arm.xml", *map(str, arguments)])


def test_a_study_from_a_file(folder):
    result = run("--study", "study.toml", "--out", "runs.zarr")
    assert result.exit_code == 0, result.output
    assert "runs.zarr: 32 trajectories of 0.2 s" in result.stdout
    assert "32 SUCCESSFUL" in result.stdout
    data = xarray.open_zarr("runs.zarr")
    assert data.attrs["robot"] == "arm.xml"
    assert data.attrs["solver"] == "Dopri5()"
    assert data.attrs["options"] == {"rtol": "1e-07"}
    assert data.attrs["u0"] == "Uniform(low = -1.0, high = [1.0, 2.0])"
    assert data.tau.shape == (32, 3, 2)
    assert data.tau.attrs["interpolation"] == "linear"
    np.testing.assert_allclose(data.damping.min("trajectory").values, [0.1, 0.0], atol=0.1)

    # Again, and in memory: the same trajectories.
    refused = run("--study", "study.toml", "--out", "runs.zarr")
    assert refused.exit_code == cli.BAD_INPUT
    assert refused.stderr == "error: runs.zarr is there already; go on with it with --resume, or give another --out\n"
    again = run("--study", "study.toml", "--out", "runs.zarr", "--resume", "--json")
    assert json.loads(again.stdout)["status"] == {"SUCCESSFUL": 32}
    result = run("--study", "study.toml", "--out", "runs.npz")
    assert result.exit_code == 0, result.output
    arrays = np.load("runs.npz")
    np.testing.assert_array_equal(arrays["q"], data.q)
    np.testing.assert_array_equal(arrays["tau"], data.tau)

    # Options come before the file.
    refused = run("--study", "study.toml", "--out", "runs.zarr", "--resume", "--seed", 5)
    assert refused.exit_code == cli.BAD_INPUT
    assert "seed is 5, but was 4" in refused.stderr


def test_states_and_forces_from_files(folder):
    random = np.random.default_rng(0)
    q, u, tau = random.normal(size=(4, 2)), random.normal(size=(4, 2)), random.normal(size=(4, 2, 2))
    np.savez("states.npz", q=q, u=u)
    np.savez("forces.npz", ts=[0.0, 0.2], tau=tau)
    (folder / "given.toml").write_text('[initial]\nfile = "states.npz"\n[forces]\nfile = "forces.npz"\n')
    result = run("--study", "given.toml", "--trajectories", 4, "--duration", 0.2, "--times", 3, "--out", "runs.npz")
    assert result.exit_code == 0, result.output
    arrays = np.load("runs.npz")
    np.testing.assert_array_equal(arrays["q"][:, 0], q)
    np.testing.assert_array_equal(arrays["tau"], tau)
    model, control = kj.load(ARM), kj.TorqueTable(np.array([0.0, 0.2]), tau[2])
    path = kj.simulate(model, q[2], u[2], np.linspace(0.0, 0.2, 3), control=control)
    np.testing.assert_allclose(arrays["q"][2], path.q, rtol=0, atol=1e-12)


def test_the_example_is_a_study(folder):
    example = CliRunner().invoke(cli.app, ["simulate", "--example"]).output
    (folder / "example.toml").write_text(example)
    assert run("--study", "example.toml", "--trajectories", 2, "--duration", 0.1, "--times", 2, "--out", "runs.npz").exit_code == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("trajectories = 32", "trajectories = 0", "trajectories is 0; it must be a whole number from 1 on"),
        ("times = 3", "times = 1000000000000", "times is 1000000000000; it must be a whole number from 2 to 1000000"),
        ("duration = 0.2", "duration = inf", "duration is inf; it must be a positive number up to 1e+09"),
        ("seed = 4", f"seed = {10**30}", "it must be a whole number from 0 on"),
        ("duration", "length", "the file has no key 'length'; the keys are: trajectories, duration"),
        (
            '"uniform", low = -1.0',
            '"even", low = -1.0',
            '[initial] u has distribution \'even\'; it must be one of "fixed", "uniform"',
        ),
        ("low = -1.0, high = [1.0, 2.0]", "low = 3.0, high = 1.0", "low must not be greater"),
        ("low = -1.0, high = [1.0, 2.0]", "low = 3.0", "a uniform distribution has low and high"),
        ("high = [1.0, 2.0]", "high = [1.0, 2.0, 3.0]", "is for 2 numbers"),
        ("period = 0.1\n", "", "[forces] has no period"),
        ("density =", "weight =", "[parameters] has no 'weight'; there are: density, gravity"),
        ('how = "added"', 'how = "somehow"', '[parameters] damping how is "somehow"; it must be "factor" or "added"'),
        ('"dopri5"', '"magic"', '[solver] method is "magic"; it must be "euler", "heun"'),
        ("u = {", 'file = "states.npz"\nu = {', "[initial] has a file, and q or u beside it"),
        ('distribution = "log-normal", sigma = 0.1', 'distribution = "normal"', "density must not become negative"),
    ],
)
def test_a_study_that_means_nothing_is_refused_in_one_line(folder, old, new, message):
    assert old in STUDY
    (folder / "study.toml").write_text(STUDY.replace(old, new))
    result = run("--study", "study.toml", "--out", "runs.npz")
    assert result.exit_code == cli.BAD_INPUT
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: study.toml: ")
    assert message in line


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"q": np.zeros((32, 2))}, "has no array u; it needs q and u"),
        ({"q": np.zeros((31, 2)), "u": np.zeros((31, 2))}, "q0 has shape (31, 2), but this study needs (32, 2)"),
        ({"q": np.full((32, 2), np.nan), "u": np.zeros((32, 2))}, "q has numbers that are not finite"),
        ({"q": np.array([object()]), "u": np.zeros((32, 2))}, "is no NPZ file with arrays of numbers"),
        (None, "is no NPZ file"),
    ],
)
def test_files_of_states_are_checked(folder, arrays, message):
    if arrays is None:
        (folder / "states.npz").write_bytes(b"nothing of the kind")
    else:
        np.savez("states.npz", **arrays)  # type: ignore[arg-type]
    (folder / "study.toml").write_text(re.sub(r"u = .*", 'file = "states.npz"', STUDY, count=1))
    result = run("--study", "study.toml", "--out", "runs.npz")
    assert result.exit_code == cli.BAD_INPUT
    (line,) = result.stderr.splitlines()
    assert message in line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--out", "runs.npz", "--resume"), "are for .zarr stores"),
        (("--out", "runs.npz", "--trajectories", 10**12), "TB, all in memory before; write a .zarr store, piece by piece"),
        (("--out", "runs.zarr", "--process", 1), "need --coordinator"),
        (("--out", "runs.zarr", "--coordinator", "localhost:1"), "needs --processes and --process"),
        (("--out", "runs.zarr", "--coordinator", "localhost:1", "--processes", 2, "--process", 2), "counts from 0 on"),
    ],
)
def test_options_that_do_not_go_together(folder, arguments, message):
    result = run(*arguments)
    assert result.exit_code == cli.BAD_INPUT
    assert message in result.stderr


def test_a_disk_without_room_is_told_before(folder, monkeypatch):
    from kanejax._cli import simulate_results

    monkeypatch.setattr(simulate_results, "free_bytes", lambda path: 1000)
    result = run("--study", "study.toml", "--out", "runs.zarr")
    assert result.exit_code == 0
    assert re.search(r"warning: runs.zarr will have .* kB, but its disk has room for 1 kB", result.stderr)
