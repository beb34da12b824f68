"""Loading: what warns, what is reported, what is logged, and the checks of a model's numbers."""

import logging
import pathlib
import warnings
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj

INERTIAL = '<inertial pos="0 0 0" mass="1" diaginertia="{}"/>'
BROKEN = INERTIAL.format("1 1 3")


def mjcf(inertial: str = INERTIAL.format("1 1 1"), before: str = "", after: str = "") -> str:
    body = f'<body name="arm"><joint name="hinge"/>{inertial}<geom size="0.1"/></body>'
    return f"<mujoco>{before}<worldbody>{body}</worldbody>{after}</mujoco>"


def outside_the_package(warning: warnings.WarningMessage) -> bool:
    """Return whether a warning points at the caller; type checkers that wrap functions count as callers."""
    return not pathlib.Path(warning.filename).is_relative_to(pathlib.Path(kj.__file__).parent)


def test_load_from_path_and_text(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(mjcf())
    for source in (path, str(path), mjcf()):
        model = kj.load(source)
        assert model.tree.body_names == ("arm",)
        assert model.dtype == jnp.float64


def test_other_sources_are_refused() -> None:
    mj_model: Any = mujoco.MjModel.from_xml_string(mjcf())
    with pytest.raises(TypeError, match="MjModel"):
        kj.load(mj_model)


def test_ignored_features_warn_at_the_caller() -> None:
    text = mjcf(before='<option density="1"/>')
    with pytest.raises(kj.UnsupportedModelError, match="fluid forces"):
        kj.load(text)
    with pytest.warns(kj.IgnoredFeatureWarning, match="XML string: ignored, though it changes the dynamics: fluid") as caught:
        kj.load(text, strict=False)
    assert outside_the_package(caught[0])


def test_repairs_warn() -> None:
    with pytest.raises(kj.InvalidInertiaError, match="repair=True"):
        kj.load(mjcf(BROKEN))
    with pytest.warns(kj.RepairedModelWarning, match=r"XML string: body 'arm': .* changed to mass 1 kg"):
        kj.load(mjcf(BROKEN), repair=True)


def test_kept_unphysical_inertias_warn_at_the_caller() -> None:
    for load in (kj.load, kj.load_report):
        with pytest.warns(kj.UnphysicalInertiaWarning, match="body 'arm': principal moments 1, 1, 3") as caught:
            load(mjcf(BROKEN), allow_unphysical=True)
        assert [outside_the_package(warning) for warning in caught] == [True]


def test_what_does_not_enter_the_dynamics_is_logged_only(caplog: pytest.LogCaptureFixture) -> None:
    text = mjcf(after='<actuator><motor joint="hinge"/></actuator>')
    with caplog.at_level(logging.INFO, logger="kanejax"), warnings.catch_warnings():
        warnings.simplefilter("error")
        kj.load(text)
    assert "XML string: actuators are not modelled (1): give their generalized forces as tau" in caplog.messages


def test_warnings_of_mujoco_are_logged_only(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = mjcf(before='<compiler settotalmass="3"/><custom><numeric name="unused" data="nan"/></custom>')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = kj.load(text)
    assert model.mass == 3
    found = [sentence for sentence in kj.load_report(text).unmodelled if sentence.startswith("MuJoCo warns: ")]
    assert len(found) == 2
    assert "'NaN'" in found[0]
    assert "'settotalmass' is deprecated" in found[1]
    # MuJoCo would write a log.
    assert list(tmp_path.iterdir()) == []


def test_report_has_everything_and_warns_of_nothing() -> None:
    after = '<actuator><motor joint="hinge"/></actuator>'
    text = mjcf(BROKEN, before='<option density="1"/>', after=after)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = kj.load_report(text, strict=False, repair=True)
    assert report.model.nv == 1
    assert len(report.ignored) == 1
    assert report.ignored[0].startswith("fluid forces")
    assert [sentence.split()[0] for sentence in report.unmodelled] == ["contacts,", "actuators"]
    assert len(report.repaired) == 1
    shown = str(report).splitlines()
    assert shown[0] == "XML string: 1 bodies, 1 joints, 1 coordinates, 1 speeds"
    assert shown[1] == "ignored, though it enters the dynamics:"
    assert shown[2].startswith("  - fluid forces")


def test_a_clean_file_has_a_short_report() -> None:
    report = kj.load_report(mjcf().replace("<geom", '<geom contype="0" conaffinity="0"'))
    assert str(report) == "XML string: 1 bodies, 1 joints, 1 coordinates, 1 speeds"


def test_ball_joint_ranges_are_reported() -> None:
    text = mjcf().replace('name="hinge"', 'name="hinge" type="ball" range="0 1"')
    assert "ranges of ball joints are not read (1)" in kj.load_report(text).unmodelled


@pytest.mark.parametrize(
    ("compiler", "inertial", "sentence"),
    [
        ('balanceinertia="true"', BROKEN, "body 'arm': principal moments replaced by their mean"),
        ('boundmass="2"', INERTIAL.format("1 1 1"), "body 'arm': raised to the compiler's boundmass = 2"),
        ('boundmass="20"', "", "body 'arm': raised to the compiler's boundmass = 20"),
        ('boundinertia="2"', INERTIAL.format("1 1 1"), "body 'arm': raised to the compiler's boundinertia = 2"),
    ],
)
def test_changes_that_the_file_asks_for_are_reported(compiler: str, inertial: str, sentence: str) -> None:
    report = kj.load_report(mjcf(inertial, before=f"<compiler {compiler}/>"))
    assert [sentence in repaired for repaired in report.repaired] == [True]
    within = mjcf(INERTIAL.format("5 5 5"), before='<compiler boundmass="1" boundinertia="5" balanceinertia="true"/>')
    assert kj.load_report(within).repaired == ()


def test_included_files_may_not_declare_entities(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(mjcf(before='<include file="first.xml"/>'))
    (tmp_path / "first.xml").write_text('<mujoco><include file="second.xml"/></mujoco>')
    (tmp_path / "second.xml").write_text('<!DOCTYPE m [<!ENTITY e "x">]><mujoco/>')
    with pytest.raises(kj.ModelFileError, match=r"second\.xml: the XML has a DOCTYPE"):
        kj.load(path)
    (tmp_path / "second.xml").write_text('<mujoco><option gravity="0 0 -1"/></mujoco>')
    np.testing.assert_array_equal(kj.load(path).gravity, [0, 0, -1])


def changed(**leaves: object) -> kj.Model:
    return kj.load(mjcf()).replace(**{name: jnp.asarray(value, float) for name, value in leaves.items()})


@pytest.mark.parametrize(
    ("model", "error", "message"),
    [
        (lambda: changed(mass=[np.nan]), kj.InvalidParameterError, "body 'arm': mass = nan is not finite"),
        (lambda: changed(gravity=[0, 0, np.inf]), kj.InvalidParameterError, "gravity = 0 0 inf is not finite"),
        (lambda: changed(damping=[np.inf]), kj.InvalidParameterError, "joint 'hinge': damping = inf is not finite"),
        (lambda: changed(spring_reference=[np.nan]), kj.InvalidParameterError, "joint 'hinge': spring_reference = nan"),
        (lambda: changed(joint_range=[[np.nan, 1]]), kj.InvalidParameterError, "joint 'hinge': joint_range = nan 1"),
        (lambda: changed(joint_range=[[2, 1]]), kj.InvalidParameterError, "joint_range = 2 1 is empty"),
        (lambda: changed(joint_axis=[[0, 0, 0]]), kj.InvalidParameterError, "joint 'hinge': joint_axis = 0 0 0 is zero"),
        (lambda: changed(body_quaternion=[[0, 0, 0, 0]]), kj.InvalidParameterError, "body 'arm': body_quaternion = "),
        (lambda: changed(friction_width=[0]), kj.InvalidParameterError, "friction_width = 0 is not positive"),
        (lambda: changed(armature=[-1]), kj.InvalidParameterError, "joint 'hinge': armature = -1 is negative"),
        (lambda: changed(mass=[-1]), kj.InvalidInertiaError, "body 'arm': mass -1 kg is negative. Correct it"),
        (
            lambda: changed(central_inertia=[np.diag([1, 1, 3])]),
            kj.InvalidInertiaError,
            "body 'arm': principal moments 1, 1, 3 kg m^2 break the triangle inequality",
        ),
        (lambda: changed(central_inertia=[np.diag([-1, 1, 1])]), kj.InvalidInertiaError, "include a negative one"),
        (
            lambda: changed(mass=[0], central_inertia=[np.zeros((3, 3))]),
            kj.InvalidInertiaError,
            "body 'arm': joint 'hinge' moves no inertia, so the mass matrix is singular",
        ),
        (
            lambda: changed(central_inertia=[np.zeros((3, 3))]),
            kj.InvalidInertiaError,
            "joint 'hinge' moves no inertia",
        ),
    ],
)
def test_check_model_messages(model: Callable[[], kj.Model], error: type[Exception], message: str) -> None:
    with pytest.raises(error) as raised:
        kj.check_model(model())
    assert message in str(raised.value)


def test_check_model_keeps_what_is_sound() -> None:
    kj.check_model(changed(mass=[0], central_inertia=[np.zeros((3, 3))], armature=[1]))
    kj.check_model(changed(central_inertia=[np.zeros((3, 3))], com=[[1, 0, 0]]))
    with pytest.warns(kj.UnphysicalInertiaWarning, match="kept as it is") as caught:
        kj.check_model(changed(central_inertia=[np.diag([1, 1, 3])]), allow_unphysical=True)
    assert outside_the_package(caught[0])


@pytest.mark.parametrize("kind", ["ball", "free"])
def test_check_model_of_joints_with_quaternions(kind: str) -> None:
    model = kj.load(mjcf().replace('name="hinge"', f'name="hinge" type="{kind}" stiffness="1"'))
    kj.check_model(model)
    rod = model.replace(central_inertia=jnp.diag(jnp.array([1.0, 1.0, 0.0]))[None])
    with pytest.raises(kj.InvalidInertiaError, match="moves no inertia"):
        kj.check_model(rod)
    with pytest.raises(kj.InvalidParameterError, match="the quaternion in spring_reference is zero"):
        kj.check_model(model.replace(spring_reference=jnp.zeros(model.nq)))


def test_check_model_refuses_batches() -> None:
    model = kj.load(mjcf())
    with pytest.raises(ValueError, match=r"model\.gravity has shape \(2, 3\)"):
        kj.check_model(jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), model))


def test_massless_links_between_joints_are_sound() -> None:
    ankle = '<body name="inner"><joint axis="1 0 0"/><body name="outer"><joint axis="0 1 0"/>'
    text = f"<mujoco><worldbody>{ankle}{INERTIAL.format('1 1 1')}</body></body></worldbody></mujoco>"
    model = kj.load(text)
    assert model.body("inner").mass == 0
    kj.check_model(model)
