"""Configurations of an identification: what they become, and what is refused."""

import inspect
import pathlib
import re

import numpy as np
import pytest

import kanejax as kj
from kanejax._identify import configuration as module, identify
from kanejax._identify.configuration import ConfigurationError, configured_plant, parsed_configuration, read_configuration
from kanejax._logs.columns import Columns, Units
from kanejax._logs.processing import motions
from kanejax._parameters.priors import Entropic, Gaussian, Geodesic
from kanejax._parameters.unknowns import Unknown
from kanejax._simulation_fit.simulation_error import fit_simulation

FULL = """
[log]
joints = { shoulder = "axis 1", elbow = "axis 2" }
rows = [[1, 20], [5, 30]]
validation_rows = [2, 9]
bad_rows = "drop"
delimiter = ";"
header = true
[log.columns]
time = 0
position = ["a", 2]
velocity = "v_{joint}"
effort = "i_{joint}"
[log.units]
time = "ms"
position = "deg"
effort = ["A", 0.5]
[motion]
cutoff = "none"
trim = 0.5
accuracy = 2
[locked]
finger = 1
[drives]
gain = { elbow = 8.5 }
stribeck_speed = 0.2
delay = 0.01
[[unknown]]
leaf = "inertia"
of = ["fore*", "upper"]
prior = { geodesic = 0.5 }
[[unknown]]
leaf = "damping"
bounds = [0.0, 5]
prior = { gaussian = 0.5, relative = true }
tied = true
scale = 0.1
[identify]
stages = ["inverse dynamics", "simulation"]
robust = true
starts = 3
seed = 7
validation = 0.2
friction_width = "none"
[simulation]
windows = [0.1, "none"]
[output]
title = "Arm"
urdf = false
"""
ARM = """<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/><geom size="0.1"/>
<body name="fore"><joint name="elbow" axis="0 1 0"/><geom size="0.1"/></body></body>
<body name="ball"><joint name="free" type="free"/><geom size="0.1"/></body></worldbody></mujoco>"""


def test_everything_is_read():
    found = parsed_configuration(FULL)
    assert found.joints == {"shoulder": "axis 1", "elbow": "axis 2"}
    assert (found.rows, found.validation_rows) == (((1, 20), (5, 30)), (2, 9))
    columns = Columns(time=0, position=("a", 2), velocity="v_{joint}", effort="i_{joint}")
    units = Units(time="ms", position="deg", effort=("A", 0.5))
    assert found.log == {"bad_rows": "drop", "delimiter": ";", "header": True, "columns": columns, "units": units}
    assert found.motion == {"cutoff": None, "trim": 0.5, "accuracy": 2, "locked": {"finger": 1.0}}
    assert found.drives == {"gain": {"elbow": 8.5}, "stribeck_speed": 0.2, "delay": 0.01}
    inertia = Unknown("inertia", ("fore*", "upper"), prior=Geodesic(0.5))
    damping = Unknown("damping", bounds=(0.0, 5.0), prior=Gaussian(0.5, True), tied=True, scale=0.1)
    assert found.unknowns == (inertia, damping)
    stages = ("inverse dynamics", "simulation")
    options = {"robust": True, "starts": 3, "seed": 7, "validation": 0.2, "friction_width": None}
    assert found.identify == {"stages": stages, **options, "simulation_options": {"windows": (0.1, None)}}
    assert found.output == {"title": "Arm", "urdf": False}


def test_nothing_is_needed():
    assert parsed_configuration("") == module.Configuration()
    (unknown,) = parsed_configuration('[[unknown]]\nleaf = "inertia"\nprior = { entropic = 2 }').unknowns
    assert isinstance(unknown, Unknown)
    assert unknown.prior == Entropic(2.0)


def test_example_is_a_configuration_of_defaults():
    path = pathlib.Path(module.__file__).with_name("configuration_example.toml")
    found = read_configuration(path)
    assert found.unknowns == identify.UNKNOWNS
    given = inspect.signature(identify.identify).parameters
    for key, value in found.identify.items():
        if key != "simulation_options":
            assert given[key].default == value, key
    given = inspect.signature(motions).parameters
    for key, value in found.motion.items():
        assert given[key].default == value, key
    given = inspect.signature(fit_simulation).parameters
    for key, value in found.identify["simulation_options"].items():
        assert given[key].default == value, key
    assert found.log["columns"] == Columns()
    assert found.log["units"] == Units()
    # What is commented out can be used too.
    text = re.sub(r"^# (\w+ = )", r"\1", path.read_text(), flags=re.MULTILINE)
    assert text != path.read_text()
    every = parsed_configuration(text)
    assert every.joints == ("shoulder", "elbow")
    assert every.drives["gain"] == {"shoulder": 10.0, "elbow": 8.5}
    damping = every.unknowns[1]
    assert isinstance(damping, Unknown)
    assert damping.bounds == (0.0, 50.0)
    assert every.identify["simulation_options"]["outputs"] == ("q", "u")


def test_drives_by_joint():
    model = kj.load(ARM)
    drives = configured_plant(parsed_configuration(FULL), model).drives
    np.testing.assert_array_equal(drives.gain, [1.0, 8.5, 1, 1, 1, 1, 1, 1])
    np.testing.assert_array_equal(drives.stribeck_speed, np.full(8, 0.2))
    assert drives.delay == 0.01
    with pytest.raises(kj.UnknownNameError, match=r"no joint is named 'elbo'.*'shoulder', 'elbow'"):
        configured_plant(parsed_configuration("[drives]\ngain = { elbo = 2 }"), model)
    with pytest.raises(ConfigurationError, match="gain: joint 'free' has several speeds"):
        configured_plant(parsed_configuration("[drives]\ngain = { free = 2 }"), model)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = ", "id.toml: not TOML: Invalid value"),
        ("[motions]", r"there is no table \[motions\]; the tables are: log, motion, locked"),
        ("motion = 3", r"'motion' must be a table, which begins with \[motion\]"),
        ("locked = 3", r"'locked' must be a table"),
        ("[unknown]\nleaf = 'damping'", r"'unknown' must be a list of tables, each of which begins with \[\[unknown\]\]"),
        ("[motion]\ncutof = 3", r"\[motion\] has no key 'cutof'; the keys are: cutoff, effort_cutoff"),
        ("[motion]\ncutoff = 'auto'", r'\[motion\] cutoff is "auto"; it must be a positive number, or "automatic", or "none"'),
        ("[motion]\ncutoff = -3", r"\[motion\] cutoff is -3; it must be a positive number"),
        ("[motion]\norder = 2.5", r"\[motion\] order is 2.5; it must be a whole number from 1 on"),
        ("[motion]\norder = true", r"\[motion\] order is true; it must be a whole number"),
        ("[motion]\naccuracy = 3", r"\[motion\] accuracy is 3; it must be 2, 4, 6 or 8"),
        ("[motion]\ntrim = -1", r"\[motion\] trim is -1; it must be a number from 0 on, or \"none\""),
        ("[log]\nrow = [1, 2]", r"\[log\] has no key 'row'; the keys are: joints, rows"),
        ("[log]\nrows = [1, 2, 3]", r"\[log\] rows is \[1, 2, 3\]; it must be a pair of row numbers, or a list of such pairs"),
        ("[log]\njoints = [1]", r"\[log\] joints is \[1\]; it must be a list of texts, or a table of names in the file by joint"),
        ("[log]\nbad_rows = 'skip'", r'\[log\] bad_rows is "skip"; it must be "error" or "drop"'),
        ("[log]\nheader = 'yes'", r'\[log\] header is "yes"; it must be true or false'),
        ("[log]\ncolumns = 'a'", r'\[log\] columns is "a"; it must be a table'),
        ("[log.columns]\ncurrent = 'a'", r"\[log.columns\] has no key 'current'; the keys are: time, position, velocity"),
        (
            "[log.columns]\neffort = 1.5",
            r"\[log.columns\] effort is 1.5; it must be a text, or a list of names or numbers of columns",
        ),
        ("[log.units]\ntime = false", r"\[log.units\] time is false; it must be a text, or a positive number"),
        ("[locked]\nfinger = 'open'", r'\[locked\] finger is "open"; it must be a number'),
        ("[drives]\ngains = 3", r"\[drives\] has no key 'gains'; the keys are: gain, offset"),
        ("[drives]\ngain = { a = 'x' }", r"\[drives\] gain is .*; it must be a number, or a table of numbers by joint"),
        ("[drives]\ndelay = { a = 1 }", r"\[drives\] delay is .*; it must be a number"),
        ("[[unknown]]\nof = 'a'", r"\[\[unknown\]\] 1 has no leaf"),
        (
            "[[unknown]]\nleaf = 'damping'\n[[unknown]]\nleaf = 'dampin'",
            r"\[\[unknown\]\] 2: no leaf .* is named 'dampin'; .*'damping'",
        ),
        ("[[unknown]]\nleaf = 'damping'\nbound = [1, 2]", r"\[\[unknown\]\] 1 has no key 'bound'; the keys are: leaf, of, bounds"),
        (
            "[[unknown]]\nleaf = 'damping'\nbounds = [1]",
            r"\[\[unknown\]\] 1 bounds is \[1\]; it must be a pair, least and greatest",
        ),
        ("[[unknown]]\nleaf = 'damping'\nbounds = [2, 1]", r"\[\[unknown\]\] 1: bounds of .* the first must be less"),
        ("[[unknown]]\nleaf = 'damping'\nscale = 'big'", r"\[\[unknown\]\] 1 scale is \"big\"; it must be a positive number"),
        ("[[unknown]]\nleaf = 'damping'\nprior = 3", r"\[\[unknown\]\] 1 prior is 3; it must be a table"),
        (
            "[[unknown]]\nleaf = 'damping'\nprior = { normal = 3 }",
            r"\[\[unknown\]\] 1 prior has no key 'normal'; the keys are: gaussian",
        ),
        (
            "[[unknown]]\nleaf = 'damping'\nprior = { gaussian = 0 }",
            r"\[\[unknown\]\] 1 prior gaussian is 0; it must be a positive number",
        ),
        (
            "[[unknown]]\nleaf = 'damping'\nprior = { relative = true }",
            r"\[\[unknown\]\] 1 prior needs one of gaussian, entropic, geodesic",
        ),
        ("[[unknown]]\nleaf = 'inertia'\nprior = { entropic = [1, 2] }", r"\[\[unknown\]\] 1 prior: entropic takes one number"),
        ("[[unknown]]\nleaf = 'damping'\nprior = { entropic = 1 }", r"\[\[unknown\]\] 1: .* use Gaussian"),
        (
            "[identify]\nstages = ['dynamics']",
            r'\[identify\] stages is .*; it must be a list of "inverse dynamics" and "simulation"',
        ),
        ("[identify]\nstages = ['simulation', 'inverse dynamics']", "in this order"),
        ("[simulation]\nwindows = [0.1, 'all']", r"\[simulation\] windows is .*; it must be a list of positive numbers"),
        ("[simulation]\nwindow = [0.1]", r"\[simulation\] has no key 'window'; the keys are: windows, piece"),
        ("[identify]\nstages = []", r"\[identify\] stages is \[\]"),
        ("[identify]\nstarts = 0", r"\[identify\] starts is 0; it must be a whole number from 1 on"),
        ("[identify]\nseed = -1", r"\[identify\] seed is -1; it must be a whole number from 0 on"),
        ("[identify]\nvalidation = 1.0", r"\[identify\] validation is 1.0; it must be a number between 0 and 1"),
        ("[output]\npdf = true", r"\[output\] has no key 'pdf'; the keys are: title, report"),
        ("[output]\nurdf = 1", r"\[output\] urdf is 1; it must be true or false"),
    ],
)
def test_what_means_nothing_is_refused(text, message):
    with pytest.raises(ConfigurationError, match=message) as caught:
        parsed_configuration(text, "id.toml")
    assert str(caught.value).startswith("id.toml: ")


def test_files(tmp_path):
    path = tmp_path / "id.toml"
    path.write_bytes(b"\xff\xfe[motion]")
    with pytest.raises(ConfigurationError, match=r"id\.toml: not a text in UTF-8"):
        read_configuration(path)
    with pytest.raises(FileNotFoundError):
        read_configuration(tmp_path / "none.toml")
