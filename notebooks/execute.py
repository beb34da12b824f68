"""Execute the notebooks: from NN_name.py in this folder the NN_name.ipynb beside it, with outputs.

`make notebooks` executes all of them; `python notebooks/execute.py 03_intelledex --into /tmp` some, to another folder. The outputs
differ from one run to the next in measured times and last digits; all the rest of a file depends on its .py alone.
"""

import argparse
import base64
import io
import os
import tempfile
import time
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from PIL import Image

FOLDER = Path(__file__).parent
ROOT = FOLDER.parent
KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}
TIMEOUT = 600
"""Of a cell [s]."""


def sources() -> dict[str, Path]:
    """The notebooks' percent scripts by name, in order."""
    return {path.stem: path for path in sorted(FOLDER.glob("[0-9][0-9]_*.py"))}


def unexecuted(source: Path) -> nbformat.NotebookNode:
    """The notebook of a percent script, without outputs. Cells get their numbers as ids; metadata are the same for all."""
    notebook = jupytext.read(source)
    for number, cell in enumerate(notebook.cells, 1):
        cell.id, cell.metadata = f"cell-{number}", nbformat.NotebookNode()
    notebook.metadata.kernelspec = nbformat.NotebookNode(KERNEL)
    notebook.metadata.language_info = nbformat.NotebookNode(name="python", file_extension=".py", mimetype="text/x-python")
    return notebook


def executed(source: Path) -> nbformat.NotebookNode:
    """The notebook of a percent script, with outputs.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell raised; the message has its source and the traceback.
    """
    notebook = unexecuted(source)
    metadata = nbformat.from_dict(notebook.metadata)
    with tempfile.TemporaryDirectory() as directory:
        options = {"timeout": TIMEOUT, "kernel_name": "python3", "record_timing": False, "coalesce_streams": True}
        # No warning that messages of the kernel are not encrypted on this machine; pictures with twice the pixels.
        options["extra_arguments"] = ["--log-level=ERROR", "--InlineBackend.figure_formats=retina"]
        NotebookClient(notebook, resources={"metadata": {"path": directory}}, **options).execute()
    # The kernel tells its versions.
    notebook.metadata = metadata
    for output in (output for cell in notebook.cells for output in cell.get("outputs", ())):
        if "image/png" in output.get("data", ()):
            output.data["image/png"] = compact(output.data["image/png"])
    return notebook


def compact(png: str) -> str:
    """A picture in 64 colours, which takes a third of the place and looks the same where there are lines and areas."""
    stream = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(png))) as picture:
        picture.convert("RGB").quantize(64, dither=Image.Dither.NONE).save(stream, "png", optimize=True)
    return base64.b64encode(stream.getvalue()).decode()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(sources())}; all of them if there is none")
    parser.add_argument("--into", type=Path, default=FOLDER, help="folder for the .ipynb files")
    options = parser.parse_args()
    # Where the recordings of the experiments are by default.
    os.environ.setdefault("KANEJAX_DATA", str(ROOT.parent / "shared" / "data"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    known = sources()
    unknown = set(options.names) - set(known)
    if unknown:
        parser.error(f"no notebook is called {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    for name in options.names or known:
        begin = time.perf_counter()
        path = options.into / f"{name}.ipynb"
        nbformat.write(executed(known[name]), path)
        print(f"{path.name}: {time.perf_counter() - begin:.0f} s, {path.stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
