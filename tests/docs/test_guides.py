"""Pages of the documentation run as printed: the blocks of Python of each, one after another."""

import ast
import importlib.util
import json
import pathlib
import re
import shlex
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import kanejax as kj
from kanejax import cli

ROOT = pathlib.Path(kj.__file__).parents[1]
DOCS = ROOT / "docs"


def blocks(name, language="python"):
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / name).read_text(), re.DOTALL)


def printed(name, blocks):
    """What blocks of a page define, run with JAX's settings as its reader has them."""
    names: dict[str, Any] = {}
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        for block in blocks:
            exec(compile(block, name, "exec"), names)
    return names


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A function that runs all of a page in an empty folder."""
    monkeypatch.chdir(tmp_path)
    mpl.use("Agg")
    return lambda name: printed(name, blocks(name))


def test_ten_minutes(run, tmp_path):
    names = run("getting_started.md")
    assert bool(names["path"].ok)
    assert names["torques"].shape == (4096, 2)
    assert names["heavier"].body("fore").mass == 1.5
    # The forearm hangs on the upper arm: from its mass centre to the shoulder it is never farther than both are long.
    assert np.all(np.linalg.norm(names["tips"], axis=1) < 0.7 + 1e-9)
    assert (tmp_path / "motion.svg").is_file()


def test_kanes_method(run):
    names = run("concepts.md")
    # The slide moves the last link alone, along its z axis, the others not at all.
    np.testing.assert_array_equal(names["v"][:2, 2], 0.0)
    np.testing.assert_allclose(names["v"][2, 2], kj.poses(names["arm"], names["q"]).link_rotation[2, :, 2], atol=1e-12)


def test_the_pendulum_of_the_signs():
    """What the page's picture says of a pendulum is what MuJoCo's conventions say of it."""
    rod = kj.load("""<mujoco><worldbody><body><joint axis="0 1 0"/>
        <inertial pos="0 0 -1" mass="2" diaginertia=".1 .1 .01"/></body></worldbody></mujoco>""")
    q, still = jnp.array([0.8]), jnp.zeros(1)
    torque = 2 * 9.81 * np.sin(0.8)
    np.testing.assert_allclose(kj.gravity_force(rod, q), -torque)
    np.testing.assert_allclose(kj.bias_force(rod, q, still), torque)
    assert f"{torque:+.2f}" == "+14.07"


def test_load(run, tmp_path):
    names = run("howto/load.md")
    assert names["moon"].gravity[2] == -1.62
    assert "swing[3]" in names["model"].tree.coordinate_names
    assert any("boom" in sentence for sentence in names["mended"].repaired)
    assert {path.name for path in tmp_path.iterdir()} == {"crane.xml"}


def test_refusals(run):
    names = run("howto/refused.md")
    assert "fluid forces" in names["refused"]
    assert len(names["report"].ignored) == 1


def parts(file, prefix, kind) -> list[Any]:
    """Syntax of a kind in the functions of the loader whose names begin so."""
    module = ast.parse((ROOT / "kanejax" / "_io" / file).read_text())
    chosen = [node for node in module.body if isinstance(node, ast.FunctionDef) and node.name.startswith(prefix)]
    return [part for function in chosen for part in ast.walk(function) if isinstance(part, kind)]


def test_every_feature_that_the_code_refuses_or_leaves_out_is_on_the_page():
    page = " ".join((DOCS / "howto" / "refused.md").read_text().split())
    left_out = [part.value for part in parts("unsupported.py", "unmodelled", ast.Constant) if "({" in str(part.value)]
    # The first words of each message, which come before what is named; a remedy begins with a colon.
    messages = [
        part.values for file in ("unsupported.py", "urdf.py") for part in parts(file, ("_refused", "_mimic"), ast.JoinedStr)
    ]
    firsts = [next(str(part.value) for part in values if isinstance(part, ast.Constant)) for values in messages]
    refused = [re.split(r" \(option| of | \($|^joint ", text)[0].strip() for text in firsts]
    refused = [text for text in refused if len(text.split()) > 1 and not text.startswith(":")]
    assert len(left_out) == 11
    assert len(refused) >= 10
    for phrase in (*(text.partition(" ({")[0] for text in left_out), *refused):
        assert phrase in page, phrase
    for prefix, carrier in (("_refused_constraints", "of a tendon"), ("_refused_actuators", "of an actuator")):
        (row,) = re.findall(rf"^\| (.+ {carrier}) \|", (DOCS / "howto" / "refused.md").read_text(), re.MULTILINE)
        tuples = [part.elts for part in parts("unsupported.py", prefix, ast.Tuple) if len(part.elts) > 2]
        for name in (element.value for elements in tuples for element in elements):
            assert re.search(rf"\b{name}\b", row), name


def test_batch(run):
    names = run("howto/batch.md")
    assert names["u_dot"].shape == names["weights"].shape == (1000, 3)
    np.testing.assert_allclose(names["ends"], names["paths"].q_end, rtol=1e-4, atol=1e-5)


def test_differentiate(run):
    names = run("howto/differentiate.md")
    assert np.all(np.isfinite(names["slope"].joint_axis))
    assert np.linalg.norm(names["by_friction"]) > 1e-3
    # Only turning about x tilts towards y.
    np.testing.assert_allclose(names["along"], [0, 0, 0, 1.2, 0, 0], atol=1e-12)


def test_randomise(run):
    names = run("howto/randomise.md")
    weights = np.asarray(names["weight"])
    assert 0.01 < np.std(weights[:, 1]) / abs(np.mean(weights[:, 1])) < 0.3
    assert set(names["first"].leaves) >= {"mass", "central_inertia", "damping", "gravity"}


def test_precision(run):
    assert run("howto/precision.md")["single"].dtype == np.float32


def test_compile(run):
    assert run("howto/compile.md")["traced"] == ["compiled"]


def test_control(run):
    names = run("howto/control.md")
    assert np.all(np.isfinite(names["slope"]["p"]))
    assert names["q_s"].shape == (100, 3)
    assert np.linalg.norm(names["q_s"][-1] - names["goal"]) < 0.1
    path = kj.simulate(names["model"], names["start"], names["rest"], names["ts"], events={"low": names["low"]})
    assert path.status == kj.Status.EVENT
    np.testing.assert_allclose(names["depth"](path.t_end, path.q_end, path.u_end), 0.0, atol=1e-6)


@pytest.fixture(scope="module")
def frameworks():
    """What the page on other libraries defines before flax comes in."""
    *first, _ = blocks("howto/frameworks.md")
    return printed("howto/frameworks.md", first)


def test_diffrax_and_optax(frameworks):
    np.testing.assert_allclose(np.exp(frameworks["found"]["mass"]), 70.0, rtol=1e-3)
    np.testing.assert_allclose(np.exp(frameworks["found"]["damping"]), 4.0, rtol=1e-3)
    assert frameworks["q"].shape == (6, 3)


def test_flax(frameworks):
    if importlib.util.find_spec("flax") is None:
        pytest.skip("flax is not installed (pip install '.[docs]'): the guide's policy was NOT run")
    *_, last = blocks("howto/frameworks.md")
    assert "flax" in last
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        exec(compile(last, "flax", "exec"), frameworks)
    assert np.isfinite(frameworks["value"])
    assert all(np.any(np.asarray(leaf) != 0) for leaf in jax.tree.leaves(frameworks["slope"]))


def commands():
    app = typer.main.get_command(cli.app)
    return app.commands  # type: ignore[attr-defined]


def test_the_commands_are_those_of_the_library(tmp_path, monkeypatch):
    page = (DOCS / "howto" / "command_line.md").read_text()
    rows = re.findall(r"^\| `kanejax (\w+)", page, re.MULTILINE)
    assert sorted(rows) == sorted(commands())
    codes = re.findall(r"^\| (\d+) \|", page, re.MULTILINE)
    assert codes == re.findall(r"\d+", cli.EXIT_CODES)
    for option in ("--strict", "--repair", "--allow-unphysical", "--json"):
        assert f"`{option}`" in page
        assert all(option in options_of(command) for command in commands().values()), option


def options_of(command):
    return {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}


def test_commands_run_as_printed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (arm,) = re.findall(r'"""\n(<robot.*?)"""', (DOCS / "getting_started.md").read_text(), re.DOTALL)
    (tmp_path / "arm.urdf").write_text(arm)
    lines = [line for block in blocks("howto/command_line.md", "sh") for line in block.splitlines()]
    for line in lines:
        arguments, *_ = line.split(" > ")
        result = CliRunner().invoke(cli.app, shlex.split(arguments)[1:])
        assert result.exit_code == 0, result.output
        if "--json" in arguments:
            assert json.loads(result.stdout)
    assert len(lines) == 4
    with np.load(tmp_path / "runs.npz") as runs:
        assert runs["q"].shape == (16, 3, 2)


def test_options_of_the_commands_exist():
    text = (DOCS / "howto" / "command_line.md").read_text()
    known = set().union(*(options_of(command) for command in commands().values())) | {"--help"}
    known |= {option for parameter in typer.main.get_command(cli.app).params for option in parameter.opts}
    assert set(re.findall(r"`[^`\n]*?(--[a-z-]+)", text)) <= known
