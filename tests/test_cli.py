"""The command line: what it prints and writes, its errors and exit codes."""

import json
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import kanejax as kj
from kanejax import cli
from kanejax._validate.report import QUANTITIES

PENDULUM = """<mujoco model="p"><worldbody><body name="arm"><joint name="hinge" axis="0 1 0" range="-90 90"{damping}/>
<geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05" mass="2"/>
<body name="bob" pos="0 0 -1"><joint name="slide" type="slide" armature="0.2" stiffness="50"/><geom size="0.1" mass="1"/>
<body name="tip" pos="0 0 -0.1"/></body></body></worldbody>{rest}</mujoco>"""
FLUID = '<option density="1000"/>'
DIRTY = """<robot name="dirty"><link name="base"/><link name="arm"><inertial><mass value="-1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/></joint></robot>"""


@pytest.fixture
def pendulum(tmp_path):
    path = tmp_path / "pendulum.xml"
    path.write_text(PENDULUM.format(damping="", rest=""))
    return path


def run(*arguments):
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


def test_help_describes_the_commands_and_exit_codes():
    result = run("--help")
    assert result.exit_code == 0
    commands = typer.main.get_command(cli.app).commands  # pyright: ignore[reportAttributeAccessIssue]
    assert {"info", "validate", "simulate", "identify", "optimize"} <= set(commands)
    for command, about in commands.items():
        assert command in result.output
        shown = run(command, "--help").output
        assert "Exit codes" in shown
        assert shown.count(f"• kanejax {command}") >= 2, command
        assert all(parameter.help for parameter in about.params if not parameter.hidden), command


def test_validate(pendulum):
    result = run("validate", pendulum, "--samples", 5)
    assert result.exit_code == 0, result.output
    assert "pendulum.xml: 3 bodies, 2 speeds, 5 random states" in result.stdout
    assert "OVER" not in result.stdout
    result = run("validate", pendulum, "--samples", 5, "--json")
    (report,) = json.loads(result.stdout)
    assert report["passed"]
    assert len(report["rows"]) == 8


def test_validate_fails_over_tolerance(pendulum, monkeypatch):
    none = {dtype: dict.fromkeys(QUANTITIES, 0.0) for dtype in ("float64", "float32")}
    compare = kj.validate
    monkeypatch.setattr(kj, "validate", lambda robot, **options: compare(robot, tolerances=none, **options))
    result = run("validate", pendulum, "--samples", 5)
    assert result.exit_code == cli.FAILED
    assert "OVER" in result.stdout
    assert "over tolerance" in result.stderr


def test_validate_goes_on_after_a_bad_file(pendulum, tmp_path):
    dirty = tmp_path / "dirty.urdf"
    dirty.write_text(DIRTY)
    result = run("validate", dirty, "missing.urdf", pendulum, "--samples", 5)
    assert result.exit_code == cli.BAD_INPUT
    assert "3 bodies" in result.stdout
    lines = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == 2
    assert "dirty.urdf" in lines[0]
    assert "--repair" in lines[0]
    assert "missing.urdf" in lines[1]
    assert "Traceback" not in result.stderr


def test_info(pendulum):
    result = run("info", pendulum)
    assert result.exit_code == 0, result.output
    for part in (
        "3 bodies, 2 joints, 2 coordinates, 2 speeds",
        "hinge: revolute about (0, 1, 0), -1.571 to 1.571 rad",
        "slide: prismatic along (0, 0, 1), armature 0.2 kg, stiffness 50 N/m",
        "tip welded",
        "1 kg, mass centre (0, 0, 0) m",
    ):
        assert part in result.stdout
    shown = json.loads(run("info", pendulum, "--json").stdout)
    assert [body["parent"] for body in shown["bodies"]] == [None, "arm", "bob"]
    assert shown["joints"][0]["range"] == pytest.approx([-np.pi / 2, np.pi / 2])
    assert shown["joints"][1]["range"] == [None, None]
    assert shown["joints"][1]["armature"] == [0.2]
    np.testing.assert_allclose(np.linalg.eigvalsh(shown["bodies"][0]["central_inertia"]), shown["bodies"][0]["principal_moments"])


def test_info_tells_what_is_ignored_and_repaired(tmp_path):
    path = tmp_path / "fluid.xml"
    path.write_text(PENDULUM.format(damping="", rest=FLUID))
    result = run("info", path)
    assert "ignored, though it enters the dynamics: fluid forces" in result.stdout
    result = run("info", path, "--strict")
    assert result.exit_code == cli.BAD_INPUT
    assert "use --no-strict" in result.stderr
    path.write_text(DIRTY)
    result = run("info", path, "--repair")
    assert result.exit_code == 0
    assert "changed: body 'arm': mass -1 kg is negative" in result.stdout
    assert "warning" in run("info", path, "--allow-unphysical").stderr


def test_simulate_writes_a_file(pendulum, tmp_path):
    out = tmp_path / "run.npz"
    arguments = ("simulate", pendulum, "--out", out, "--trajectories", 6, "--duration", 0.5, "--times", 11)
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    assert "6 SUCCESSFUL" in result.stdout
    assert "energy drift" in result.stdout
    first = np.load(out)
    assert first["q"].shape == first["u"].shape == (6, 11, 2)
    assert first["q"].dtype == np.float64
    np.testing.assert_allclose(first["time"], np.linspace(0, 0.5, 11))
    details = json.loads(str(first["details"]))
    assert details["joint_names"] == ["hinge", "slide"]
    assert details["energy_change_worst"] < 1e-5
    assert [path.name for path in tmp_path.iterdir() if "partial" in path.name] == []
    result = run(*arguments, "--json")
    assert json.loads(result.stdout)["status"] == {"SUCCESSFUL": 6}
    np.testing.assert_array_equal(np.load(out)["q"], first["q"])


def test_simulate_says_that_trajectories_failed(pendulum, tmp_path):
    out = tmp_path / "run.npz"
    result = run(
        "simulate", pendulum, "--out", out, "--trajectories", 6, "--duration", 0.5, "--times", 11, "--max-steps", 2, "--damping", 1
    )
    assert result.exit_code == cli.FAILED
    assert "6 MAX_STEPS" in result.stdout
    assert np.isfinite(np.load(out)["q"][:, 0]).all()


def test_simulate_checks_the_output_first(pendulum, tmp_path):
    folder = tmp_path / "folder.npz"
    folder.mkdir()
    for out, message in (
        (folder, "is a folder"),
        (tmp_path / "nowhere" / "run.npz", "cannot be written"),
        (tmp_path / "run.csv", "ends in neither .npz nor .zarr"),
    ):
        result = run("simulate", pendulum, "--out", out)
        assert result.exit_code == cli.BAD_INPUT
        assert message in result.stderr


@pytest.mark.parametrize("command", [("info",), ("validate", "--samples", 2), ("simulate", "--out", "run.npz")])
@pytest.mark.parametrize(
    ("text", "messages"),
    [
        (None, ("cannot be read", "give a path to a URDF or MJCF file")),
        ("<mujoco>", ("line 1, column 8 is not well-formed XML",)),
        (DIRTY, ("body 'arm': mass -1 kg is negative", "--repair", "--allow-unphysical")),
        (DIRTY.replace("-1", "1").replace('izz="1"', 'izz="3"'), ("body 'arm': principal moments 1, 1, 3 kg m^2", "--repair")),
        (DIRTY.replace("-1", "0").replace('"1"', '"0"'), ("body 'arm'", "mass 0 kg", "--repair")),
    ],
)
def test_bad_input_is_one_line_without_a_traceback(command, text, messages, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        (tmp_path / "robot.urdf").write_text(text)
    result = run(*command, "robot.urdf")
    assert result.exit_code == cli.BAD_INPUT
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: robot.urdf: ")
    for message in messages:
        assert message in line


def test_simulate_needs_joints(tmp_path):
    path = tmp_path / "table.xml"
    path.write_text('<mujoco><worldbody><body name="table"/></worldbody></mujoco>')
    result = run("simulate", path, "--out", tmp_path / "run.npz")
    assert result.exit_code == cli.BAD_INPUT
    assert result.stderr == "error: the robot has no joints, so nothing moves\n"


@pytest.mark.parametrize(
    "arguments",
    [
        ("simulate", "a.xml", "--trajectories", 0, "--out", "a.npz"),
        ("simulate", "a.xml", "--seed", -1, "--out", "a.npz"),
        ("simulate", "a.xml", "--duration", "inf", "--out", "a.npz"),
        ("validate",),
        ("frobnicate",),
    ],
)
def test_wrong_usage_is_one_line_too(arguments):
    result = run(*arguments)
    assert result.exit_code == cli.BAD_INPUT
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ")
    assert "--help tells the usage" in line


def test_a_misspelt_command_is_guessed():
    assert "Did you mean 'simulate'? " in run("simulat").stderr


def test_no_command_prints_the_help():
    assert "Commands" in run().output


def test_versions_are_told():
    result = run("--version")
    assert result.exit_code == 0
    assert f"kanejax {kj.__version__}" in result.stdout


def test_shells_complete_commands_and_options():
    for line, expected in (("kanejax sim", "simulate"), ("kanejax simulate --traj", "--trajectories")):
        words = line.split()
        told = {"_KANEJAX_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
        done = subprocess.run(
            [pathlib.Path(sys.executable).with_name("kanejax")], env=os.environ | told, capture_output=True, text=True
        )
        assert done.stdout.split() == [expected]
