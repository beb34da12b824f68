"""Files of real robots by name."""

import importlib.metadata

import pytest

import kanejax as kj

try:
    importlib.metadata.version("example-robot-data")
except importlib.metadata.PackageNotFoundError:
    pytest.skip("example-robot-data is not installed: its robots were NOT looked for", allow_module_level=True)


def test_a_robot_is_found_by_name_or_by_the_end_of_its_path():
    path = kj.robots.example_file("ur10_robot.urdf")
    assert path.is_file()
    assert path == kj.robots.example_file("ur_description/urdf/ur10_robot.urdf")
    assert kj.load(path).nv == 6


def test_unknown_and_ambiguous_names_list_what_there_is():
    with pytest.raises(kj.UnknownNameError, match=r"no example robot is named 'ur11.urdf'; the names are: .*'ur10_robot.urdf'"):
        kj.robots.example_file("ur11.urdf")
    with pytest.raises(kj.UnknownNameError, match=r"anymal_b_simple_description/robots/anymal\.urdf") as caught:
        kj.robots.example_file("anymal.urdf")
    assert "panda" not in str(caught.value)


def test_without_the_package_it_is_said_how_to_get_it(monkeypatch):
    def missing(_):
        raise importlib.metadata.PackageNotFoundError

    monkeypatch.setattr(importlib.metadata, "files", missing)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'kanejax\[demo\]'"):
        kj.robots.example_file("panda.urdf")
