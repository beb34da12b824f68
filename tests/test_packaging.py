"""What is published: a wheel from a source archive, installed where there is nothing else, and what says which version it is."""

import os
import pathlib
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile

import pytest
import yaml

import kanejax

ROOT = pathlib.Path(kanejax.__file__).parents[1]
# Not of Python, and needed: types, pages, examples of configurations.
DATA = (".css", ".html", ".js", ".toml", ".typed")
PENDULUM = """<mujoco model="p"><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05" mass="2"/></body></worldbody></mujoco>"""
PROGRAM = """
import importlib.metadata, pathlib, sys, types
import kanejax as kj
assert "site-packages" in kj.__file__, kj.__file__
assert (pathlib.Path(kj.__file__).parent / "py.typed").exists()
assert kj.__version__ == importlib.metadata.version("kanejax")
import jax.numpy as jnp
model = kj.load("pendulum.xml")
assert jnp.allclose(kj.inverse_dynamics(model, jnp.zeros(1), jnp.zeros(1), jnp.ones(1)), kj.mass_matrix(model, jnp.zeros(1))[0])
assert "matplotlib" not in sys.modules
try:
    kj.plots.coordinates(model, types.SimpleNamespace(ts=jnp.arange(2.0), q=jnp.zeros((2, 1))))
except ImportError as error:
    assert "pip install 'kanejax[plots]'" in str(error), error
else:
    raise AssertionError("matplotlib is not of the base installation")
"""


def run(*command: object, **options):
    # Of the environment that runs the tests nothing may leak into the empty one.
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, timeout=900, env=clean, check=False, **options
    )
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dist")
    # The wheel is built from the source archive, as those are who install from it.
    run(sys.executable, "-m", "build", "--outdir", folder, ROOT)
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


def files_of_the_package() -> set[str]:
    return {
        str(path.relative_to(ROOT))
        for path in (ROOT / "kanejax").rglob("*")
        if path.suffix in {".py", *DATA} and "__pycache__" not in path.parts
    }


@pytest.mark.slow
def test_the_wheel_has_the_package_and_nothing_else(archives):
    with zipfile.ZipFile(archives[0]) as wheel:
        names = set(wheel.namelist())
    about = {name for name in names if ".dist-info/" in name}
    assert names - about == files_of_the_package()
    assert any(name.endswith("licenses/LICENSE") for name in about)


@pytest.mark.slow
def test_the_source_archive_has_what_builds_tests_and_explains(archives):
    with tarfile.open(archives[1]) as source:
        names = {name.partition("/")[2] for name in source.getnames()}
    assert files_of_the_package() <= names
    assert {"pyproject.toml", "Makefile", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "tests/conftest.py"} <= names
    assert not {name for name in names if name.startswith((".venv", ".cache", "results")) or "__pycache__" in name}


@pytest.mark.slow
def test_it_installs_into_an_empty_environment(archives, tmp_path):
    venv.create(tmp_path / "empty", with_pip=True)
    python = tmp_path / "empty" / "bin" / "python"
    run(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", archives[0])
    run(python, "-m", "pip", "check")
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    run(python, "-W", "error", "-c", PROGRAM, cwd=tmp_path)
    assert "hinge: revolute" in run(python.with_name("kanejax"), "info", "pendulum.xml", cwd=tmp_path)
    for command in ("simulate", "optimize"):
        assert run(python.with_name("kanejax"), command, "--example")


def test_one_version():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["version"] == kanejax.__version__
    assert f"\n## {kanejax.__version__} " in (ROOT / "CHANGELOG.md").read_text()
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dynamic"] == ["version"]


def test_every_extra_is_explained_in_the_readme():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    readme = (ROOT / "README.md").read_text()
    assert all(f"`{extra}`" in readme for extra in extras)
