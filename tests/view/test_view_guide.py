"""The blocks of Python in the guide run as printed."""

import pathlib
import re

from PIL import Image

GUIDE = pathlib.Path(__file__).parents[2] / "docs" / "view.md"


def test_the_guide_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    exec(compile("\n".join(blocks), str(GUIDE), "exec"), {})
    with Image.open(tmp_path / "arm.gif") as film:
        assert film.size == (320, 240)


def test_the_pictures_of_the_guide_are_small():
    for name, most in (("view.png", 300_000), ("view.gif", 1_000_000)):
        assert f"]({name})" in GUIDE.read_text(encoding="utf-8")
        assert (GUIDE.parent / name).stat().st_size < most
