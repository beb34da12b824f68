"""Validation: that it agrees where it should, notices what is wrong, and says so."""

import json
import re
import subprocess
import sys
import textwrap

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj
from kanejax._validate import validate as module
from kanejax._validate.peers import without_constraints
from kanejax._validate.states import sample_coordinates, sample_states

MIXED = """<mujoco><option gravity="0.3 -0.2 -9.7"/><worldbody>
<body name="head" pos="0 0 0.3"><joint name="neck" type="ball" pos="0 0 -0.1" stiffness="2" damping="0.1"/>
 <geom type="box" size="0.1 0.05 0.05" mass="0.5"/>
 <body name="arm" pos="0.1 0.2 0.3" euler="10 20 30">
  <joint name="hinge" axis="1 2 3" range="-60 90" damping="0.3" frictionloss="0.2"/>
  <geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0.1" mass="2"/>
  <body name="slider" pos="0 0.1 0.2"><joint name="slide" type="slide" axis="0 1 1" armature="0.1" stiffness="3" springref="0.1"/>
   <geom type="capsule" size="0.05 0.2" pos="0.05 0 0" mass="1"/></body></body></body>
</worldbody></mujoco>"""
FLOATING = """<mujoco><worldbody><body><freejoint/><geom size="0.1" mass="3"/></body></worldbody></mujoco>"""
SWIMMER = """<mujoco><option density="1000" viscosity="0.1"/><worldbody><body name="fin"><joint name="hinge" axis="0 1 0"/>
<geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0" mass="1"/></body></worldbody>
<actuator><motor joint="hinge"/></actuator></mujoco>"""
WHEEL = """<robot name="wheel"><link name="base"/><link name="wheel"><inertial><origin xyz="0.1 0.2 0.3" rpy="0.3 0.4 0.5"/>
<mass value="2"/><inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0.002" iyz="-0.003"/></inertial></link>
<link name="arm"><inertial><origin xyz="0 0.1 0"/><mass value="{mass}"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="b_turn" type="continuous"><parent link="base"/><child link="wheel"/><origin rpy="0.1 0.2 0.3"/>
<axis xyz="0 1 0"/><dynamics damping="0.5" friction="0.1"/></joint>
<joint name="a_slide" type="prismatic"><parent link="wheel"/><child link="arm"/><origin xyz="0.3 0 0"/><axis xyz="1 0 1"/>
<limit lower="-0.5" upper="2" effort="1" velocity="1"/></joint></robot>"""


@pytest.fixture(scope="module")
def report() -> kj.ValidationReport:
    return kj.validate(MIXED, samples=30)


def test_ball_hinge_and_slide_agree_in_both_data_types(report):
    assert report.passed, str(report)
    assert [(row.dtype, row.quantity) for row in report.rows] == [(d, q) for d in ("float64", "float32") for q in module.QUANTITIES]
    assert report.worst("float64", "inverse dynamics") < 1e-13
    assert 1e-9 < report.worst("float32", "inverse dynamics") < 1e-5
    assert all(0 < row.median <= row.error and 1 <= row.condition_number < 1e6 for row in report.rows)
    assert (report.nbody, report.nq, report.nv, report.samples) == (3, 6, 5, 30)
    assert any("friction is left out" in note for note in report.notes)


def test_report_prints_and_converts(report):
    text = str(report)
    assert "against MuJoCo" in text
    assert "forward dynamics" in text
    read = json.loads(report.to_json())
    assert read["passed"] is True
    assert read["rows"][0]["verdict"] == "ok"
    assert read["versions"]["mujoco"] == mujoco.__version__


def test_compiled_model_and_model_give_what_the_file_gives(report):
    mj_model = mujoco.MjModel.from_xml_string(MIXED)
    for robot in (mj_model, kj.from_mujoco(mj_model), kj.from_mujoco(mj_model).astype(jnp.float32)):
        other = kj.validate(robot, samples=30, dtypes=["float64"])
        assert other.passed, str(other)


def test_what_is_over_tolerance_fails():
    strict = {dtype: dict.fromkeys(module.QUANTITIES, 0.0) for dtype in ("float64", "float32")}
    failed = kj.validate(MIXED, samples=30, tolerances=strict, dtypes=["float64"])
    assert not failed.passed
    assert {row.verdict for row in failed.rows if row.quantity != "forward dynamics"} == {"OVER"}
    assert "OVER" in str(failed)


def test_wrong_and_undefined_numbers_are_found(monkeypatch):
    right = module.own_terms

    def wrong(model, states, dtype):
        found = right(model, states, dtype)
        found = {name: values.copy() for name, values in found.items()}
        found["inverse dynamics"][7, 2] += 1e-6
        found["mass matrix"][3, 0, 0] = np.nan
        return found

    monkeypatch.setattr(module, "own_terms", wrong)
    report = kj.validate(MIXED, samples=30, dtypes=["float64"])
    rows = {row.quantity: row for row in report.rows}
    assert not report.passed
    assert rows["inverse dynamics"].state == 7
    assert rows["inverse dynamics"].verdict == "OVER"
    assert rows["mass matrix"].error == np.inf
    assert rows["mass matrix"].state == 3
    assert rows["bias force"].passed
    assert '"Infinity"' in report.to_json()


def test_bad_conditioning_is_told_from_error():
    row = kj.ValidationRow("mujoco", "float32", "forward dynamics", 1e-2, 1e-3, 1e-4, 0, 1e6)
    assert not row.passed
    assert row.rounding == pytest.approx(1e6 * 2.0**-24)
    assert row.verdict == "ill-conditioned"
    better = kj.ValidationRow("mujoco", "float32", "forward dynamics", 1e-2, 1e-3, 1e-4, 0, 1e4)
    assert better.verdict == "OVER"
    forces = kj.ValidationRow("mujoco", "float32", "inverse dynamics", 1e-2, 1e-3, 1e-4, 0, 1e6)
    assert forces.verdict == "OVER"


def test_ignored_features_are_left_out_of_both_sides():
    with pytest.raises(kj.UnsupportedModelError, match="density"):
        kj.validate(SWIMMER, samples=3)
    report = kj.validate(SWIMMER, samples=10, strict=False, dtypes=["float64"])
    assert report.passed, str(report)
    assert any("left out on both sides" in note and "density" in note for note in report.notes)
    mj_model = mujoco.MjModel.from_xml_string(SWIMMER)
    assert without_constraints(mj_model).opt.density == 0
    assert mj_model.opt.density == 1000


def test_unphysical_inertias_are_compared_and_warned_of_once():
    plate = '<inertial pos="1 0 0" mass="1" diaginertia="1 1 3"/>'
    text = f'<mujoco><worldbody><body name="plate"><joint axis="0 1 0"/>{plate}</body></worldbody></mujoco>'
    with pytest.warns(kj.UnphysicalInertiaWarning, match="body 'plate'") as caught:
        assert kj.validate(text, samples=2, dtypes=["float64"], allow_unphysical=True).passed
    assert len(caught) == 1


@pytest.mark.parametrize("mass", [1.5, -1.0])
def test_pinocchio_reads_the_same_urdf(mass):
    pytest.importorskip("pinocchio")
    report = kj.validate(WHEEL.format(mass=mass), samples=20, against="pinocchio", repair=True, dtypes=["float64"])
    assert report.passed, str(report)
    assert {row.against for row in report.rows} == {"pinocchio"}
    assert any("repaired" in note for note in report.notes) == (mass < 0)


def test_states_lie_in_the_ranges_and_are_those_of_the_seed():
    model = kj.load(MIXED)

    def draw(seed):
        return sample_states(model, 200, seed, lambda states: np.tile([10.0, 1, 1, 1, 1], (200, 1)))

    states = draw(0)
    hinge, slide = states.q[:, 4], states.q[:, 5]
    assert np.degrees(hinge.min()) >= -60
    assert np.degrees(hinge.max()) <= 90
    assert np.degrees(np.ptp(hinge)) > 120
    assert np.abs(slide).max() <= 1
    np.testing.assert_allclose(np.linalg.norm(states.q[:, :4], axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(np.std(states.tau, axis=0), [10.0, 1, 1, 1, 1], rtol=0.25)
    for values, again in zip(states, draw(0), strict=True):
        np.testing.assert_array_equal(values, values.astype(np.float32))
        np.testing.assert_array_equal(values, again)
    assert np.all(draw(1).u != states.u)


def test_floating_base_starts_around_the_origin():
    q = sample_coordinates(kj.load(FLOATING), 100, np.random.default_rng(0))
    assert 0.9 < np.abs(q[:, :3]).max() <= 1
    np.testing.assert_allclose(np.linalg.norm(q[:, 3:], axis=1), 1, atol=1e-12)


def test_far_and_wide_ranges_are_cut():
    xml = (
        '<mujoco><worldbody><body><joint range="10 4000" limited="true"/><geom size="0.1" pos="1 0 0"/></body></worldbody></mujoco>'
    )
    q = sample_coordinates(kj.load(xml), 100, np.random.default_rng(0))
    assert np.degrees(q.min()) >= 10
    assert np.degrees(q.max()) <= 190


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"robot": MIXED, "samples": 0}, ValueError, "samples is 0; give at least 1"),
        ({"robot": MIXED, "against": "bullet"}, ValueError, "against is 'bullet'; choose from 'mujoco', 'pinocchio'"),
        ({"robot": MIXED, "dtypes": ["float16"]}, ValueError, "dtypes is 'float16'; choose from 'float64', 'float32'"),
        ({"robot": MIXED, "dtypes": "float16"}, ValueError, "dtypes is 'float16'; choose from 'float64', 'float32'"),
        ({"robot": MIXED, "dtypes": []}, ValueError, "dtypes is empty"),
        ({"robot": "nowhere.urdf"}, kj.ModelFileError, "nowhere.urdf"),
        ({"robot": "<mujoco/>"}, kj.UnsupportedModelError, "it has no joints"),
        ({"robot": SWIMMER, "strict": False, "samples": 2, "against": "pinocchio"}, kj.UnsupportedModelError, "needs a URDF"),
    ],
)
def test_bad_arguments(arguments, error, message):
    with pytest.raises(error, match=re.escape(message)):
        kj.validate(**arguments)


def test_float64_without_the_setting_and_float32_before_and_after():
    xml = SWIMMER.replace('density="1000" viscosity="0.1"', "")
    program = """
    import sys, jax, jax.numpy as jnp
    import kanejax as kj
    def tau():
        return kj.inverse_dynamics(kj.load(sys.argv[1]), *jnp.ones((3, 1)))
    before = tau()
    report = kj.validate(sys.argv[1], samples=5)
    assert report.passed, str(report)
    assert report.worst("float64", "inverse dynamics") < 1e-13
    assert not jax.config.jax_enable_x64
    assert tau().dtype == before.dtype == jnp.float32
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program), xml], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
