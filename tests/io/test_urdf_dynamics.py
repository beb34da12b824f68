"""Damping and friction in the text of a URDF."""

import numpy as np
import pytest

import kanejax as kj
from kanejax._io.urdf_dynamics import with_joint_dynamics

LINK = """<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
ROBOT = f"""<robot name="r"><!-- <joint name="a"> --><link name="base"/>{"".join(map(LINK.format, "xyz"))}
<joint name="a" type="continuous"><parent link="base"/><child link="x"/><dynamics other='>' damping = '0.5'/></joint>
<joint name="b &amp; c" type="prismatic"><parent link="x"/><child link="y"/>
<limit effort="1" velocity="1" lower="-1" upper="1"/></joint>
<joint name="d" type="continuous"><parent link="y"/><child link="z"/></joint>
<transmission name="t"><joint name="a"><dynamics damping="9"/></joint></transmission></robot>"""


def test_numbers_are_written_and_all_else_stays():
    model = kj.load(ROBOT, strict=False)
    changed = model.replace(damping=np.array([0.1, 0.25, 0.0]), coulomb_friction=np.array([1 / 3, 0.0, 0.0]))
    text = with_joint_dynamics(changed, ROBOT)
    again = kj.load(text, strict=False)
    np.testing.assert_array_equal(again.damping, changed.damping)
    np.testing.assert_array_equal(again.coulomb_friction, changed.coulomb_friction)
    written = (
        (f"""<dynamics friction="{1 / 3!r}" other='>' damping="0.1"/>""", "<dynamics other='>' damping = '0.5'/>"),
        ("""<dynamics damping="0.25" friction="0.0"/>""", ""),
    )
    for new, old in written:
        assert text.count(new) == 1
        text = text.replace(new, old)
    assert text == ROBOT


def test_joints_must_be_there():
    model = kj.load(ROBOT, strict=False)
    with pytest.raises(kj.ModelFileError, match="no <joint> named 'd'; give the URDF that the model was loaded from"):
        with_joint_dynamics(model, ROBOT.replace('name="d"', 'name="e"'))
    with pytest.raises(kj.ModelFileError, match="not well-formed"):
        with_joint_dynamics(model, "<robot>")
