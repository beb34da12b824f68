"""Real robots against MuJoCo; `make validate` compares all of them at more states."""

import importlib.metadata
from pathlib import Path

import pytest

import kanejax as kj

ROBOTS = {
    "example-robot-data": (
        "panda_description/urdf/panda.urdf",
        "ur_description/urdf/ur5_robot.urdf",
        "talos_data/robots/talos_reduced.urdf",
    ),
    "dm-control": (
        "dm_control/suite/cheetah.xml",
        "dm_control/suite/fish.xml",
        "dm_control/suite/ball_in_cup.xml",
        "dm_control/suite/humanoid.xml",
    ),
}
IN_FLOAT32 = ("ur5_robot.urdf",)
QUICK = ("panda.urdf", "talos_reduced.urdf", "fish.xml")


def path_of(package: str, name: str) -> Path:
    try:
        files = importlib.metadata.files(package) or []
    except importlib.metadata.PackageNotFoundError:
        pytest.skip(f"{package} is not installed, so {name} was not compared")
    return next(Path(str(file.locate())) for file in files if file.as_posix().endswith(name))


# MuJoCo's word on a file of dm_control's.
@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass' is deprecated")
@pytest.mark.parametrize(
    ("package", "name"),
    [
        pytest.param(package, name, id=Path(name).stem, marks=() if name.endswith(QUICK) else pytest.mark.slow)
        for package, names in ROBOTS.items()
        for name in names
    ],
)
def test_robot(package, name):
    dtypes = ("float64", "float32") if name.endswith(IN_FLOAT32) else ("float64",)
    report = kj.validate(path_of(package, name), samples=30, strict=False, repair=True, dtypes=dtypes)
    assert report.passed, str(report)


def test_pinocchio_agrees_too():
    pytest.importorskip("pinocchio")
    path = path_of("example-robot-data", "panda_description/urdf/panda.urdf")
    report = kj.validate(path, samples=30, strict=False, dtypes=["float64"], against="pinocchio")
    assert report.passed, str(report)
