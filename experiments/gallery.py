"""The pictures of docs/plots.md: runs its blocks of Python, and writes each figure to where the page shows it."""

import argparse
import os
import re
from pathlib import Path

import jax

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "plots.md"
DPI = 110


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=PAGE.parent, help="folder of the page, in whose plots/ the pictures go")
    out = parser.parse_args().out
    jax.config.update("jax_compilation_cache_dir", os.environ.get("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".cache" / "jax")))
    names: dict = {}
    for block, picture in blocks(PAGE.read_text()):
        exec(block, names)
        if picture:
            path = out / picture
            path.parent.mkdir(parents=True, exist_ok=True)
            names["figure"].savefig(path, dpi=DPI)
            shrink(path)
            print(path)


def blocks(text: str) -> list[tuple[str, str]]:
    """Blocks of Python, and for each the picture below it, empty if there is none."""
    return re.findall(r"```python\n(.*?)```\n(?:\n!\[[^\]]*\]\(([^)]+)\))?", text, re.DOTALL)


def shrink(path: Path) -> None:
    """Write a picture with indexed colours, which take a third of the space."""
    from PIL import Image

    with Image.open(path) as image:
        small = image.convert("RGB").quantize(128, dither=Image.Dither.NONE)
    small.save(path, optimize=True)


if __name__ == "__main__":
    main()
