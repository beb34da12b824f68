"""The guide to many trajectories and devices runs as printed."""

import pathlib
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import kanejax as kj
from tests.dataset.test_write_study import ARM

GUIDE = pathlib.Path(kj.__file__).parents[1] / "docs" / "scale.md"


@pytest.fixture(scope="module")
def names(tmp_path_factory):
    """What the reader has, and what the guide defines."""
    folder = tmp_path_factory.mktemp("guide")
    (folder / "arm.urdf").write_text(ARM)
    states = np.linspace(-0.5, 0.5, 32).reshape(2, 8, 2)
    defined: dict = {"jax": jax, "jnp": jnp, "kj": kj, "np": np, "xarray": xarray, "q": states[0], "u": states[1]}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL):
            exec(block, defined)
        defined["runs"].load()
    return defined


def test_the_data_set(names):
    runs = names["runs"]
    assert runs.sizes["trajectory"] == 64
    assert set(runs.status.values.tolist()) == {kj.Status.SUCCESSFUL}
    assert 0 < names["heavy"].sizes["trajectory"] < 64


def test_the_gradient(names):
    ends = jax.jit(jax.vmap(lambda q, u: kj.simulate(names["model"], q, u, np.linspace(0.0, 0.2, 3)).q[-1]))
    assert ends(names["q"], names["u"]).shape == (8, 2)
    assert np.all(np.isfinite(names["by_mass"]))
    assert np.any(names["by_mass"] != 0)


def test_commands_have_only_options_that_there_are():
    from typer.testing import CliRunner

    from kanejax import cli

    known = CliRunner().invoke(cli.app, ["simulate", "--help"]).output
    for line in re.findall(r"kanejax simulate (.*)", GUIDE.read_text()):
        for option in re.findall(r"--[a-z0-9-]+", line):
            assert option in known, option
