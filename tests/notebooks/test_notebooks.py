"""The notebooks run without errors and warnings, and what is committed of them is what they are made of."""

import importlib.util
import json
import os
import pathlib
import re
import subprocess
import sys
from typing import Any

import pytest

import kanejax as kj

FOLDER = pathlib.Path(kj.__file__).parents[1] / "notebooks"
NAMES = sorted(path.stem for path in FOLDER.glob("[0-9][0-9]_*.py"))
MOST_BYTES, MOST_BYTES_IN_ALL = 400_000, 2_000_000

pytestmark = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("jupytext", "nbclient", "ipykernel")),
    reason="jupytext, nbclient or ipykernel is not installed: NO notebook was looked at",
)


def read(path: pathlib.Path) -> dict[str, Any]:
    return json.loads(path.read_text())


def sources(notebook: dict[str, Any]) -> list[tuple[str, str]]:
    return [(cell["cell_type"], "".join(cell["source"])) for cell in notebook["cells"]]


def outputs(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    return [output for cell in notebook["cells"] for output in cell.get("outputs", ())]


def kinds(notebook: dict[str, Any]) -> list[set[str]]:
    """What each cell shows: names of streams, and types of pictures and tables. Streams come in parts, and not always in order."""
    return [
        {output.get("name") or "+".join(sorted(output["data"])) for output in cell.get("outputs", ())} for cell in notebook["cells"]
    ]


def texts(notebook: dict[str, Any]) -> str:
    """All that is shown but pictures."""
    found = []
    for output in outputs(notebook):
        shown = [output["text"]] if "text" in output else [x for kind, x in output["data"].items() if not kind.startswith("image")]
        found += ["".join(each) for each in shown]
    return "\n".join(found)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs_without_warnings_and_shows_what_is_committed(name, tmp_path):
    command = [sys.executable, "-W", "error", str(FOLDER / "execute.py"), name, "--into", str(tmp_path)]
    ran = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(FOLDER.parent)}, timeout=900)
    assert ran.returncode == 0, ran.stderr
    again, committed = read(tmp_path / f"{name}.ipynb"), read(FOLDER / f"{name}.ipynb")
    stderr = ["".join(output["text"]) for output in outputs(again) if output.get("name") == "stderr"]
    assert not stderr, f"warnings: {stderr}"
    # Without the recordings of a real robot there is less to show, and the notebook says so.
    if "NOT RUN" not in texts(again):
        assert kinds(again) == kinds(committed), "run `make notebooks`"


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_and_its_script_are_in_step(name):
    import jupytext

    script = jupytext.read(FOLDER / f"{name}.py")
    committed = read(FOLDER / f"{name}.ipynb")
    assert sources(committed) == [(cell.cell_type, cell.source) for cell in script.cells], "run `make notebooks`"


@pytest.mark.parametrize("name", NAMES)
def test_outputs_are_whole_and_in_order(name):
    notebook = read(FOLDER / f"{name}.ipynb")
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    assert not [output for output in outputs(notebook) if output["output_type"] == "error" or output.get("name") == "stderr"]
    assert any("image/png" in output.get("data", ()) for output in outputs(notebook)), "a notebook without a picture"
    assert "NOT RUN" not in texts(notebook)


@pytest.mark.parametrize("name", NAMES)
def test_outputs_tell_nothing_of_the_machine(name):
    notebook = read(FOLDER / f"{name}.ipynb")
    shown = texts(notebook)
    assert not re.search(r"(?<![\w.:/])/\w+/\w+", shown), "an absolute path"
    assert not re.search(r"0x[0-9a-f]{6,}", shown), "an address"
    assert set(notebook["metadata"]) == {"jupytext", "kernelspec", "language_info"}
    assert all(cell["metadata"] == {} for cell in notebook["cells"])


def test_notebooks_are_small():
    sizes = {name: (FOLDER / f"{name}.ipynb").stat().st_size for name in NAMES}
    assert max(sizes.values()) < MOST_BYTES, sizes
    assert sum(sizes.values()) < MOST_BYTES_IN_ALL, sizes


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_uses_only_what_is_public(name):
    code = (FOLDER / f"{name}.py").read_text()
    assert re.findall(r"^[ \t]*(?:import|from) kanejax.*$", code, re.MULTILINE) == ["import kanejax as kj"]
    private = [used for used in re.findall(r"\bkj((?:\.\w+)+)", code) if any(part.startswith("_") for part in used.split("."))]
    assert not private
    assert all(hasattr(kj, used.split(".")[1]) for used in re.findall(r"\bkj((?:\.\w+)+)", code))


def test_links_between_notebooks_and_pages_lead_somewhere():
    for name in NAMES:
        for target in re.findall(r"\]\((?!https?:)([^)#]+)", (FOLDER / f"{name}.py").read_text()):
            assert (FOLDER / target).exists(), f"{name} links to {target}"
