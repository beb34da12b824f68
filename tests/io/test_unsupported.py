"""Each refused feature is named, each unmodelled one is counted, and modelled ones are not mentioned."""

import mujoco
import numpy as np
import pytest

from kanejax._io.flags import with_flags_applied
from kanejax._io.unsupported import refused_features, unmodelled_features

BODY = '<body name="arm"{body}><joint name="hinge" {joint}/><geom size="0.1"/></body>'


def model(body: str = "", joint: str = "", world: str = "", option: str = "", after: str = "") -> mujoco.MjModel:
    text = f"<mujoco>{option}<worldbody>{world}{BODY.format(body=body, joint=joint)}</worldbody>{after}</mujoco>"
    return mujoco.MjModel.from_xml_string(text)


TENDON = '<tendon><fixed name="cable" {}><joint joint="hinge" coef="1"/></fixed></tendon>'


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            {"option": '<option density="2" wind="1 0 0"/>'},
            "fluid forces (option density=2, viscosity=0, wind='1 0 0')",
        ),
        ({"option": '<option viscosity="2"/>'}, "viscosity=2"),
        ({"option": '<option><flag gravity="disable"/></option>'}, "option flag gravity='disable'"),
        ({"option": '<option><flag spring="disable"/></option>', "joint": 'stiffness="1"'}, "flag spring='disable'"),
        ({"option": '<option><flag damper="disable"/></option>', "joint": 'damping="1"'}, "flag damper='disable'"),
        (
            {"option": '<option><flag constraint="disable"/></option>', "joint": 'frictionloss="1"'},
            "constraint='disable'",
        ),
        ({"body": ' gravcomp="1"'}, "gravity compensation (gravcomp) of body 'arm'"),
        ({"joint": 'stiffness="1 2 0"'}, "polynomial stiffness of joint 'hinge'"),
        ({"joint": 'damping="1 0 2"'}, "polynomial damping of joint 'hinge'"),
        ({"after": '<equality><joint name="lock" joint1="hinge"/></equality>'}, "equality constraints (joint) 'lock'"),
        ({"after": TENDON.format('stiffness="1"')}, "stiffness of tendon 'cable'"),
        ({"after": TENDON.format('damping="1"')}, "damping of tendon 'cable'"),
        ({"after": TENDON.format('armature="1"')}, "armature of tendon 'cable'"),
        ({"after": TENDON.format('frictionloss="1"')}, "frictionloss of tendon 'cable'"),
        ({"after": '<actuator><motor name="m" joint="hinge" armature="1"/></actuator>'}, "armature of actuator 'm'"),
        ({"after": '<actuator><motor name="m" joint="hinge" damping="1"/></actuator>'}, "damping of actuator 'm'"),
        (
            {"world": '<body mocap="true" name="cart"><body><joint/><geom size="0.1"/></body></body>'},
            "body 'cart' is a mocap body that carries moving bodies",
        ),
    ],
)
def test_refused(arguments: dict[str, str], sentence: str) -> None:
    features = refused_features(model(**arguments))
    assert len(features) == 1
    assert sentence in features[0]


def test_refused_plastic_spring_and_flex() -> None:
    compiled = model(joint='stiffness="1"')
    compiled.jnt_springyield[:] = 1
    assert refused_features(compiled) == ["plastic springs (springyield) of joint 'hinge' are not modelled"]
    cloth = '<flexcomp name="cloth" type="grid" count="3 3 1" spacing="0.1 0.1 0.1" dim="2" mass="1" radius="0.01">'
    cloth += '<edge equality="true"/></flexcomp>'
    assert any("1 flex: deformable bodies" in feature for feature in refused_features(model(world=cloth)))


def test_modelled_features_are_not_mentioned() -> None:
    joints = "".join(
        f'<body pos="0 0 1"><joint type="{kind}" pos="0.1 0 0" stiffness="2" springref="0.1" '
        f'armature="0.1" damping="0.2" frictionloss="0.3" range="0 1"/>'
        '<geom size="0.1" contype="0" conaffinity="0"/></body>'
        for kind in ("hinge", "slide")
    )
    joints += '<body><joint type="ball" stiffness="1" damping="1"/><geom size="0.1" contype="0" conaffinity="0"/></body>'
    joints += '<body><freejoint/><geom size="0.1" contype="0" conaffinity="0"/></body>'
    compiled = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{joints}</worldbody></mujoco>")
    assert refused_features(compiled) == []
    assert unmodelled_features(compiled) == []


def test_unmodelled_features_are_counted() -> None:
    after = '<equality><joint joint1="hinge" active="false"/></equality><actuator><motor joint="hinge"/></actuator>'
    after += "<sensor><clock/></sensor><keyframe><key/></keyframe>" + TENDON.format('range="0 1"')
    compiled = model(world='<body mocap="true"/>', joint='actuatorfrcrange="-1 1"', after=after)
    assert refused_features(compiled) == []
    assert unmodelled_features(compiled) == [
        "contacts, with their friction and adhesion, are not modelled (1 geoms can collide)",
        "actuators are not modelled (1): give their generalized forces as tau",
        "tau is not clamped to actuator force ranges (1 joints have one)",
        "tendon length limits are not enforced (1)",
        "equality constraints that start inactive stay inactive (1)",
        "mocap bodies stay where the model puts them (1)",
        "sensors are not computed (1)",
        "keyframes are not read (1)",
    ]


def test_long_lists_of_names_are_cut_and_unnamed_elements_numbered() -> None:
    bodies = "".join('<body gravcomp="1"><joint/><geom size="0.1"/></body>' for _ in range(10))
    sentence = refused_features(mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"))[0]
    assert "'number 1', 'number 2'" in sentence
    assert "and 2 more" in sentence


def test_flags_are_carried_out_on_a_copy() -> None:
    flags = '<option><flag gravity="disable" spring="disable" damper="disable" frictionloss="disable"/></option>'
    compiled = model(option=flags, joint='stiffness="1" damping="2" frictionloss="3"')
    applied = with_flags_applied(compiled)
    assert refused_features(applied) == []
    assert len(refused_features(compiled)) == 4
    for values in (applied.opt.gravity, applied.jnt_stiffness, applied.dof_damping, applied.dof_frictionloss):
        assert not np.any(values)
    plain = model()
    assert with_flags_applied(plain) is plain


def test_flags_keep_the_smooth_dynamics() -> None:
    flags = '<option><flag gravity="disable" damper="disable"/></option>'
    compiled = model(option=flags, joint='pos="0 1 0" stiffness="1" damping="2"')
    forces = []
    for each in (compiled, with_flags_applied(compiled)):
        data = mujoco.MjData(each)
        data.qpos[0], data.qvel[0] = 0.3, 0.7
        mujoco.mj_forward(each, data)
        forces.append(data.qfrc_bias - data.qfrc_passive)
    np.testing.assert_array_equal(*forces)
