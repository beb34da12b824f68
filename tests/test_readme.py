"""The example of the README runs as printed."""

import pathlib
import re

import numpy as np
import pytest

import kanejax

README = pathlib.Path(kanejax.__file__).parents[1] / "README.md"


def test_the_example_runs_as_printed():
    try:
        kanejax.robots.example_file("ur10_robot.urdf")
    except ModuleNotFoundError:
        pytest.skip("example-robot-data is not installed: the README's example was NOT run")
    code, *_ = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    names: dict = {}
    exec(code, names)
    assert names["tau"].shape == (6,)
    np.testing.assert_allclose(names["u_dot"], 1.0, atol=1e-9)
    assert names["by_mass"].shape == names["model"].mass.shape
    assert names["heavier"].body("wrist_3_link").mass == 3.0
    assert names["path"].q.shape == (101, 6)
