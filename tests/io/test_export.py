"""Writing models: MJCF that loads as the same model, specs that MuJoCo compiles, and URDFs with other inertias."""

import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj

INERTIA = "0.03 0.04 0.05 0.002 -0.003 0.004"
MJCF = f"""<mujoco><compiler angle="radian"/><option gravity="0.1 0 -9.8"/><worldbody>
<body name="base"><joint type="free"/><inertial pos="0.1 0 0" mass="3" fullinertia="{INERTIA}"/>
  <body name="arm" pos="0.1 0.2 1e-7" quat="1 0.3 0 0"><inertial pos="0 0 0" mass="0.7" diaginertia="0.1 0.1 0.2"/>
    <joint name="yaw" axis="1 1 0" range="-0.1 0.2" damping="0.1" stiffness="1" ref="0.3" springref="0.1" frictionloss="0.4"/>
    <joint name="lift" type="slide" armature="0.3" pos="0 0 0.1"/>
    <body name="wrist"><joint name="wrist" type="ball" stiffness="2" damping="0.2"/>
      <inertial pos="0 0 0" mass="1" fullinertia="{INERTIA}"/></body>
    <body name="mark" pos="0 0 1"/></body></body></worldbody></mujoco>"""


def assert_same_leaves(a: kj.Model, b: kj.Model, absolute: float = 1e-15) -> None:
    assert a.tree == b.tree
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=0, atol=absolute), a, b)


def test_mjcf_loads_as_the_same_model() -> None:
    model = kj.load(MJCF)
    text = kj.to_mjcf(model, name="three <links>")
    assert text.startswith('<mujoco model="three &lt;links&gt;">')
    assert_same_leaves(kj.load(text), model)


def test_mass_centres_of_massless_bodies_are_at_their_origins() -> None:
    model = kj.load(MJCF)
    np.testing.assert_array_equal(model.body("mark").com, np.zeros(3))
    np.testing.assert_array_equal(kj.load(kj.to_mjcf(model)).body("mark").com, np.zeros(3))


def test_mjcf_of_changed_numbers() -> None:
    model = kj.load(MJCF)
    model = model.body("wrist").set(mass=0.1 + 0.2, com=[0.1, 1 / 3, -1e-9], central_inertia=np.diag([0.3, 0.2, 0.25]))
    model = model.joint("lift").set(range=[-jnp.inf, 2.0], axis=[0.0, 3.0, 4.0])
    back = kj.load(kj.to_mjcf(model))
    np.testing.assert_array_equal(back.body("wrist").com, model.body("wrist").com)
    assert back.body("wrist").mass == 0.1 + 0.2
    np.testing.assert_allclose(back.joint("lift").axis, [0, 0.6, 0.8], atol=1e-16)
    np.testing.assert_array_equal(back.joint("lift").range, [-1e10, 2])


def test_mjcf_of_a_free_joint_with_a_spring() -> None:
    model = kj.load(MJCF.replace('type="free"', 'type="free" stiffness="1"'))
    model = model.replace(spring_reference=model.spring_reference.at[:7].set(jnp.array([1, 2, 3, 0, 1, 0, 0.0])))
    back = kj.load(kj.to_mjcf(model))
    np.testing.assert_array_equal(back.spring_reference[:7], [1, 2, 3, 0, 1, 0, 0])


def test_mjcf_of_a_model_without_joints() -> None:
    model = kj.load("<mujoco><worldbody><body name='a'><body name='b'/></body></worldbody></mujoco>")
    assert_same_leaves(kj.load(kj.to_mjcf(model)), model)
    empty = kj.load("<mujoco/>")
    assert kj.load(kj.to_mjcf(empty)).nbody == 0
    kj.check_model(empty)


def test_mjcf_keeps_massless_and_unphysical_bodies_that_mujoco_refuses() -> None:
    model = kj.load(MJCF)
    massless = model.body("arm").set(mass=0.0, central_inertia=np.zeros((3, 3)))
    assert_same_leaves(kj.load(kj.to_mjcf(massless)), massless)
    with pytest.raises(kj.InvalidInertiaError, match=r"MuJoCo refuses the inertias of: body 'arm': mass 0 kg.* too small"):
        kj.to_mujoco(massless)
    broken = model.body("arm").set(central_inertia=np.diag([1.0, 1.0, 3.0]))
    with pytest.raises(kj.InvalidInertiaError, match=r"body 'arm': principal moments 1, 1, 3 .*Give the bodies inertias"):
        kj.to_mujoco(broken)
    with pytest.warns(kj.UnphysicalInertiaWarning):
        assert_same_leaves(kj.load(kj.to_mjcf(broken), allow_unphysical=True), broken)


def test_inertias_at_the_limit_survive_rounding() -> None:
    rotation = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    plate = rotation @ np.diag([0.1, 0.2, 0.3]) @ rotation.T
    model = kj.load(MJCF).body("arm").set(central_inertia=plate)
    for each in (model, model.astype(jnp.float32)):
        assert kj.to_mujoco(each).compile().body("arm").mass[0] == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("joint", "change", "message"),
    [
        ("wrist", {"damping": [1.0, 2.0, 3.0]}, "joint 'wrist': damping = 1.0 2.0 3.0 differs among its speeds"),
        ("wrist", {"spring_reference": [0.0, 1.0, 0.0, 0.0]}, "joint 'wrist': its spring is relaxed at 0.0 1.0 0.0 0.0"),
    ],
)
def test_what_mjcf_cannot_express(joint: str, change: dict[str, list[float]], message: str) -> None:
    with pytest.raises(kj.UnsupportedModelError, match=message):
        kj.to_mjcf(kj.load(MJCF).joint(joint).set(**change))


def test_numbers_are_checked_before_writing() -> None:
    model = kj.load(MJCF)
    for write in (kj.to_mjcf, kj.to_mujoco, lambda each: kj.to_urdf_inertials(each, URDF)):
        with pytest.raises(kj.InvalidParameterError, match="body 'arm': mass = nan"):
            write(model.body("arm").set(mass=jnp.nan))
        with pytest.raises(ValueError, match="has shape"):
            write(jax.tree.map(lambda leaf: leaf[None], model))


def test_other_refusals_of_mujoco_are_model_file_errors() -> None:
    world = kj.from_dh([kj.DHLink(1.0, central_inertia=(1, 1, 1), name="world")])
    with pytest.raises(kj.ModelFileError, match="MuJoCo cannot"):
        kj.to_mujoco(world)


URDF = """<?xml version="1.0"?>
<!-- <link name="arm"><inertial/></link> -->
<robot name="two">
  <link name="base" />
  <link name="arm" note="a > b">
    <visual><geometry><box size="1 1 1"/></geometry></visual> <!-- kept -->
    <inertial>
      <origin xyz="0.1 0.2 0.3" rpy="0.3 0.4 0.5"/><mass value="2"/>
      <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0.002" iyz="-0.003"/>
    </inertial>
  </link>
\t<link name='tip'></link>
  <joint name="hinge" type="revolute"><origin xyz="1 0 0" rpy="0.1 0.2 0.3"/><parent link="base"/><child link="arm"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="weld" type="fixed"><parent link="arm"/><child link="tip"/></joint>
</robot>
"""


def test_urdf_with_other_inertias() -> None:
    model = kj.load(URDF)
    changed = model.body("arm").set(mass=1 / 3, com=[0.1, 0.2, 0.7], central_inertia=np.diag([0.3, 0.2, 0.25]))
    text = kj.to_urdf_inertials(changed, URDF)
    assert_same_leaves(kj.load(text), changed)
    before, after = URDF.split("    <inertial>")
    assert text.startswith(before)
    assert text.endswith(after.split("</inertial>", 1)[1])
    assert '\n    <inertial>\n      <origin xyz="0.1 0.2 0.7" rpy="0 0 0"/>\n      <mass value="0.3333333333333333"/>\n' in text


def test_urdf_links_without_an_inertial_get_one() -> None:
    model = kj.load(URDF)
    for name in ("base", "tip"):
        model = model.body(name).set(mass=1.0, central_inertia=np.eye(3))
    text = kj.to_urdf_inertials(model, URDF)
    assert '<link name="base">\n    <inertial>\n' in text
    assert "\n\t<link name='tip'>\n\t  <inertial>\n" in text
    assert text.count("</link>") == 4
    assert_same_leaves(kj.load(text), model)
    assert kj.to_urdf_inertials(model, text) == text


def test_urdf_of_an_unchanged_model_moves_like_the_original() -> None:
    text = kj.to_urdf_inertials(kj.load(URDF), URDF)
    assert_same_leaves(kj.load(text), kj.load(URDF))
    second = URDF.replace("    <inertial>", "    <inertial><mass value='9'/></inertial><inertial>")
    assert kj.to_urdf_inertials(kj.load(URDF), second).count("<inertial") == text.count("<inertial")


def test_urdf_files_in_other_encodings(tmp_path: pathlib.Path) -> None:
    text = URDF.replace("?>", ' encoding="latin-1"?>', 1).replace("kept", "gek\u00fcrzt")
    path = tmp_path / "two.urdf"
    path.write_bytes(text.encode("latin-1"))
    assert "gek\u00fcrzt" in kj.to_urdf_inertials(kj.load(path), path)


def test_urdf_that_does_not_fit(tmp_path: pathlib.Path) -> None:
    model = kj.load(URDF)
    with pytest.raises(kj.ModelFileError, match="XML string: no <link> for body 'tip'"):
        kj.to_urdf_inertials(model, URDF.replace("tip", "tool"))
    with pytest.raises(kj.ModelFileError, match="root element is <mujoco>"):
        kj.to_urdf_inertials(model, MJCF)
    with pytest.raises(kj.ModelFileError, match="cannot be read"):
        kj.to_urdf_inertials(model, tmp_path / "nowhere.urdf")
    with pytest.raises(kj.ModelFileError, match="DOCTYPE"):
        kj.to_urdf_inertials(model, '<!DOCTYPE robot [<!ENTITY e "x">]><robot/>')
