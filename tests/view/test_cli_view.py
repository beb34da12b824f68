"""The command `kanejax view`: what it prints, and how it ends."""

import json
import signal
import subprocess
import sys
import urllib.request

import numpy as np
import pytest
from typer.testing import CliRunner

from kanejax import cli
from tests.helpers.seen_robots import swing, write_robots


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_robots(tmp_path)
    ts, q = swing()
    np.savez(tmp_path / "runs.npz", time=ts, q=np.stack([q] * 3))
    return tmp_path


def run(*arguments):
    return CliRunner().invoke(cli.app, ["view", *map(str, arguments), "--no-open", "--port", "0"])


def test_the_command_serves_a_page_until_it_is_interrupted(folder):
    (folder / "tetrahedron.stl").unlink()
    options = [
        "--trajectory",
        "runs.npz",
        "--count",
        "2",
        "--reference",
        "runs.npz",
        "--play",
        "--no-open",
        "--port",
        "0",
        "--json",
    ]
    command = [sys.executable, "-m", "kanejax.cli", "view", "arm.urdf", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        told = json.loads(process.stdout.readline())
        with urllib.request.urlopen(told["url"], timeout=20) as page:
            assert b"<html" in page.read()
        process.send_signal(signal.SIGINT)
        printed, said = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, said
    assert "'tetrahedron.stl' is not there" in told["notes"][0]
    assert printed == ""
    assert said.splitlines()[-1] == "interrupted"
    assert len(said.splitlines()) == 2


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("gone.urdf",), "gone.urdf"),
        (("arm.urdf", "--trajectory", "gone.npz"), "no such file"),
        (("arm.urdf", "--trajectory", "runs.npz", "--rows", "0,5"), "no trajectory 5; the 3"),
        (("arm.urdf", "--trajectory", "runs.npz", "--rows", "0;1"), "write it like 0,2,5"),
        (("arm.urdf", "--trajectory", "runs.npz", "--rows", "0", "--count", "1"), "leave one out"),
        (("ball.xml", "--trajectory", "runs.npz"), "but this robot needs (times, 8)"),
        (("arm.urdf", "--reference", "runs.npz"), "no trajectory that it belongs to"),
        (("arm.urdf", "--host", "192.0.2.1"), "no address of this machine"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(folder, arguments, problem):
    result = run(*arguments)
    assert result.exit_code == 2, result.output
    assert problem in result.stderr
    assert len(result.stderr.splitlines()) == 1
