"""The page of figures runs as printed, and has a picture of each."""

import matplotlib.figure
import matplotlib.image
import numpy as np
import pytest

import kanejax as kj
from experiments.gallery import PAGE, blocks


@pytest.mark.slow
def test_the_page_runs_as_printed(capsys):
    names: dict = {}
    for block, picture in blocks(PAGE.read_text()):
        exec(block, names)
        if picture:
            assert isinstance(names.pop("figure"), matplotlib.figure.Figure), picture
        assert "figure" not in names
    assert "path.q has shape (256, 41, 3), but one motion has (n, nq) = (n, 3)" in capsys.readouterr().out
    found, true = names["found"], names["true"]
    assert found.converged
    np.testing.assert_allclose(found.model.mass, true.mass, rtol=0.05)
    assert bool(names["motion"].converged)
    assert np.all(names["many"].status == kj.Status.SUCCESSFUL)


def test_every_figure_is_on_the_page_with_its_picture():
    text = PAGE.read_text()
    for name in kj.plots.__all__:
        assert f"kj.plots.{name}" in text, name
    pictures = [picture for _, picture in blocks(text) if picture]
    folder = PAGE.parent / "plots"
    assert {path.name for path in folder.iterdir()} == {picture.removeprefix("plots/") for picture in pictures}
    for picture in pictures:
        path = PAGE.parent / picture
        assert path.stat().st_size < 100_000
        # As wide as a page, on white.
        pixels = matplotlib.image.imread(path)
        assert 700 <= pixels.shape[1] <= 1200
        assert np.all(pixels[0, 0] == 1.0)
