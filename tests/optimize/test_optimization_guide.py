"""The guide to optimal motions runs as printed."""

import pathlib
import re

import jax
import numpy as np
import pytest

import kanejax as kj

GUIDE = pathlib.Path(kj.__file__).parents[1] / "docs" / "optimization.md"


@pytest.mark.slow
def test_the_guide_runs_as_printed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL):
        # optax mixes integers and numbers.
        with jax.numpy_dtype_promotion("standard" if "optax" in block else "strict"):
            exec(block, names)
    assert bool(names["motion"].converged)
    assert bool(names["around"].converged)
    assert 0.3 < float(names["around"].duration) < 3.0
    assert names["many"].converged.all()
    np.testing.assert_array_equal(names["kept"].q, names["many"].q)
    np.testing.assert_array_equal(names["one"].q, names["motion"].q)
    assert {path.name for path in tmp_path.iterdir()} == {"many.npz", "one.npz"}
    assert "which takes at least 0.6 s" in str(names["refused"])
    assert np.isfinite(names["slope"])
    assert np.abs(names["held"].q[-1]).max() < np.abs(names["off_wrong"].q[-1]).max()
    assert float(names["miss"](names["tuned"].value, None)) < 0.1 * float(names["miss"](names["knots"], None))
