"""Loading files, strings and specs: what is read, what is ignored, and what each error says."""

import importlib.util
import pathlib
import pickle

import mujoco
import numpy as np
import pytest

from kanejax._errors import InvalidInertiaError, ModelFileError, UnknownNameError, UnsupportedModelError
from kanejax._io.source import compile_source

INERTIAL = """<inertial><origin xyz="0.1 0.2 0.3" rpy="0.3 0.4 0.5"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0.002" iyz="-0.003"/></inertial>"""
HINGE = '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><axis xyz="0 0 1"/>{3}</joint>'


def urdf(body: str) -> str:
    return f'<robot name="test">{body}</robot>'


def arm(link: str = INERTIAL, joint: str = "") -> str:
    """Return a base, a hinge with `joint` inside, and a link with `link` inside."""
    return urdf(f'<link name="base"/><link name="arm">{link}</link>' + HINGE.format("hinge", "base", "arm", joint))


def mjcf(world: str, before: str = "", after: str = "") -> str:
    return f"<mujoco>{before}<worldbody>{world}</worldbody>{after}</mujoco>"


PENDULUM = mjcf('<body name="arm"><joint name="hinge"/><geom name="ball" size="0.1" mass="1"/></body>')


def test_urdf_link_frames_and_rotated_inertial() -> None:
    compiled = compile_source(arm())
    model = compiled.mj_model
    assert [model.body(index).name for index in range(model.nbody)] == ["world", "base", "arm"]
    assert compiled.inertials == {}
    assert compiled.repaired == ()
    cx, cy, cz, sx, sy, sz = *np.cos([0.3, 0.4, 0.5]), *np.sin([0.3, 0.4, 0.5])
    rotation = (
        np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    )
    inertia = np.array([[0.02, 0.001, 0.002], [0.001, 0.03, -0.003], [0.002, -0.003, 0.04]])
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[2])
    axes = axes.reshape(3, 3)
    compiled_inertia = axes @ np.diag(model.body_inertia[2]) @ axes.T
    np.testing.assert_allclose(compiled_inertia, rotation @ inertia @ rotation.T, atol=1e-15)


def test_urdf_geometry_does_not_matter() -> None:
    shape = '<{0}><geometry><mesh filename="package://nowhere/arm.stl"/></geometry></{0}>'
    compiled = compile_source(arm(INERTIAL + shape.format("visual") + shape.format("collision")))
    assert compiled.mj_model.ngeom == 0
    assert "visual and collision shapes are not read (1 links have some)" in compiled.ignored


def test_urdf_link_without_inertial_is_massless() -> None:
    ball = '<link name="tip"><collision><geometry><sphere radius="1"/></geometry></collision></link>'
    weld = '<joint name="weld" type="fixed"><parent link="arm"/><child link="tip"/></joint>'
    compiled = compile_source(arm().replace("</robot>", ball + weld + "</robot>"))
    assert compiled.mj_model.body("tip").mass[0] == 0
    assert "links with collision shapes but no <inertial> have zero mass: tip" in compiled.ignored


def test_urdf_elements_that_are_ignored() -> None:
    joint = '<limit lower="1" upper="1" effort="2" velocity="3"/><safety_controller k_velocity="1"/><calibration/>'
    text = arm(joint=joint).replace("</robot>", "<gazebo/><gazebo/><transmission/></robot>")
    ignored = compile_source(text).ignored
    assert "<safety_controller> are not applied (1 joints have one)" in ignored
    assert "<calibration> is not read (1 joints have one)" in ignored
    assert "velocity limits of joints are not enforced" in ignored
    assert "joint 'hinge': its equal lower and upper limits are dropped" in ignored
    assert "<gazebo> elements are not read (2)" in ignored
    assert "<transmission> elements are not read (1)" in ignored
    assert "tau is not clamped to actuator force ranges (1 joints have one)" in ignored


def test_urdf_mimic_is_refused_or_listed() -> None:
    text = arm(joint='<mimic joint="other" multiplier="2"/>')
    with pytest.raises(UnsupportedModelError, match=r"joint 'hinge' mimics joint 'other'.*strict=False"):
        compile_source(text)
    compiled = compile_source(text, strict=False)
    assert compiled.mj_model.neq == 0
    assert compiled.ignored[0] == "joint 'hinge' mimics joint 'other': mimic joints are not modelled"


def test_urdf_mimic_on_a_fixed_joint_means_nothing() -> None:
    text = arm(joint='<mimic joint="other"/>').replace('type="revolute"', 'type="fixed"')
    assert compile_source(text).mj_model.nv == 0


def test_urdf_inertia_from_geometry_is_refused() -> None:
    text = arm().replace("</robot>", '<mujoco><compiler inertiafromgeom="true"/></mujoco></robot>')
    with pytest.raises(UnsupportedModelError, match="inertiafromgeom='true'"):
        compile_source(text)


def test_urdf_root_called_world_may_have_an_inertial_and_a_floating_joint() -> None:
    text = arm().replace('<link name="base"/>', f'<link name="world">{INERTIAL}</link>').replace('link="base"', 'link="world"')
    model = compile_source(text.replace('type="revolute"', 'type="floating"')).mj_model
    assert (model.nbody, model.nv) == (2, 6)
    assert model.body_mass[0] == 0


def test_urdf_planar_joint() -> None:
    model = compile_source(arm().replace('type="revolute"', 'type="planar"')).mj_model
    assert [model.joint(index).name for index in range(3)] == ["hinge_TX", "hinge_TY", "hinge_RZ"]


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        (urdf(""), ModelFileError, "has no <link>"),
        (urdf("<link/>"), ModelFileError, "<link> lacks name="),
        (urdf('<link name="a"/><link name="a"/>'), ModelFileError, "2 links are named 'a'"),
        (urdf('<link name="a"/><link name="b"/>'), ModelFileError, "2 links have no parent ('a', 'b')"),
        (arm().replace('child link="arm"', 'child link="leg"'), ModelFileError, "child link 'leg' does not exist"),
        (arm().replace('<parent link="base"/>', ""), ModelFileError, "joint 'hinge' has no <parent link=...>"),
        (arm().replace('"revolute"', '"screw"'), ModelFileError, "type 'screw' is unknown"),
        (
            arm().replace('"revolute"', '"floating"'),
            UnsupportedModelError,
            "floating joint 'hinge' hangs on link 'base'",
        ),
        (arm().replace('"0 0 1"', '"0 0 0"'), ModelFileError, "joint 'hinge': axis '0 0 0' is zero"),
        (arm().replace('"0 0 1"', '"0 1"'), ModelFileError, "<axis xyz='0 1'> is not 3 finite numbers"),
        (arm().replace('mass value="2"', 'mass value="2,5"'), ModelFileError, "link 'arm': <mass value='2,5'> is not"),
        (
            arm().replace('mass value="2"', 'mass value="nan"'),
            ModelFileError,
            "<mass value='nan'> is not a finite number",
        ),
        (arm("<inertial><mass value='1'/></inertial>"), ModelFileError, "<inertial> has no <inertia>"),
        (arm().replace('izz="0.04"', ""), ModelFileError, "link 'arm': <inertia> lacks izz="),
        (arm(joint='<dynamics damping="x"/>'), ModelFileError, "joint 'hinge': <dynamics damping='x'> is not"),
        (arm(joint='<origin rpy="0 0"/>'), ModelFileError, "<origin rpy='0 0'> is not 3 finite numbers"),
        (
            arm().replace('name="arm"', 'name="world"').replace('"arm"', '"world"'),
            ModelFileError,
            "'world' has a parent",
        ),
        ('<robot name="r" xmlns:xacro="http://x/xacro"><xacro:macro/></robot>', ModelFileError, "xacro template"),
        ("<sdf/>", ModelFileError, "root element is <sdf>"),
        ("<robot>\n<link>\n</robot>", ModelFileError, "XML string: line 3, column 2 is not well-formed XML: mismatched tag"),
        ('<!DOCTYPE robot [<!ENTITY e "x">]><robot/>', ModelFileError, "DOCTYPE"),
        ("nowhere/robot.urdf", ModelFileError, "nowhere/robot.urdf: cannot be read (No such file or directory)"),
        ("", ModelFileError, "an empty path: cannot be read"),
        (
            mjcf('<body name="arm"><joint/><inertial pos="0 0 0" mass="nan" diaginertia="1 2 3"/></body>'),
            InvalidInertiaError,
            "body 'arm': mass nan kg or inertia 1 2 3 kg m^2 is not finite",
        ),
        (
            mjcf("<body><nonsense/></body>"),
            ModelFileError,
            "XML string: MuJoCo cannot read the model: XML Error: Schema",
        ),
        (mjcf('<body><joint axis="0 0 0"/><geom size="1"/></body>'), ModelFileError, "axis too small in joint"),
    ],
)
def test_error_messages(text: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error) as raised:
        compile_source(text)
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_urdf_that_is_no_tree() -> None:
    two = arm().replace("</robot>", HINGE.format("second", "base", "arm", "") + "</robot>")
    with pytest.raises(ModelFileError, match="link 'arm' is the child of two joints"):
        compile_source(two)
    links = "".join(f'<link name="{name}">{INERTIAL}</link>' for name in "abc")
    with pytest.raises(ModelFileError, match="link 'b' hangs on a loop of joints"):
        compile_source(urdf(links + HINGE.format("one", "b", "c", "") + HINGE.format("two", "c", "b", "")))


def test_a_folder_is_not_a_file(tmp_path: pathlib.Path) -> None:
    with pytest.raises(ModelFileError, match="give a path to a URDF or MJCF file"):
        compile_source(tmp_path)


def test_mjcf_file_with_include_and_missing_meshes(tmp_path: pathlib.Path) -> None:
    assets = '<compiler meshdir="meshes"/><asset><mesh name="hull" file="hull.obj"/>'
    assets += '<texture name="t" type="2d" file="t.png"/>'
    assets += '<material name="m" texture="t"/><hfield name="h" file="h.png" size="1 1 1 1"/></asset>'
    hull = '<geom name="hull" type="mesh" mesh="hull" material="m"/>'
    inertial = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
    world = f'<geom type="hfield" hfield="h"/><body name="arm"><joint/>{inertial}{hull}<geom name="ball" size="1"/></body>'
    pair = '<contact><pair geom1="hull" geom2="ball"/></contact>'
    (tmp_path / "assets.xml").write_text(f"<mujoco>{assets}</mujoco>")
    path = tmp_path / "arm.xml"
    path.write_text(mjcf(world, '<include file="assets.xml"/>', pair))
    compiled = compile_source(path)
    assert compiled.mj_model.body("arm").mass[0] == 1
    assert any(
        "files are not read, as no inertia needs them" in sentence and "hull.obj" in sentence for sentence in compiled.ignored
    )

    path.write_text(mjcf(world.replace(inertial, ""), '<include file="assets.xml"/>', pair))
    with pytest.raises(ModelFileError, match=r"body 'arm' takes its inertia from mesh file '.*hull\.obj', which cannot be read"):
        compile_source(path)

    path.write_text(mjcf(world, '<include file="nowhere.xml"/>'))
    with pytest.raises(ModelFileError, match=r"MuJoCo cannot read the model.*nowhere\.xml"):
        compile_source(path)


def test_mjcf_files_that_are_present_are_used(tmp_path: pathlib.Path) -> None:
    (tmp_path / "meshes").mkdir()
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "meshes" / "hull.obj").write_text(corners)
    path = tmp_path / "arm.xml"
    asset = '<compiler meshdir="meshes"/><asset><mesh name="hull" file="hull.obj"/></asset>'
    path.write_text(mjcf('<body name="arm"><joint/><geom type="mesh" mesh="hull"/></body>', asset))
    assert compile_source(path).mj_model.body("arm").mass[0] == pytest.approx(1000 / 6)
    assert compile_source(str(path)).mj_model.nmesh == 1


def test_mjcf_keeps_static_bodies() -> None:
    text = mjcf('<body name="a"><joint/><geom size="1"/><body name="b"/></body>', '<compiler fusestatic="true"/>')
    assert compile_source(text).mj_model.nbody == 3


def test_spec_is_left_as_it_is() -> None:
    spec = mujoco.MjSpec.from_string(PENDULUM.replace("<mujoco>", '<mujoco><compiler fusestatic="true"/>'))
    before = spec.to_xml()
    compiled = compile_source(spec)
    assert compiled.mj_model.nv == 1
    assert spec.to_xml() == before


def test_xml_string_may_begin_with_blank_lines() -> None:
    assert compile_source('\n  <?xml version="1.0"?>' + PENDULUM).mj_model.nv == 1
    with pytest.raises(ModelFileError, match="line 3, "):
        compile_source("\n\n<mujoco></robot>")


def test_unmodelled_features_refuse_only_if_strict() -> None:
    text = PENDULUM.replace("<mujoco>", '<mujoco><option density="1"/>')
    with pytest.raises(UnsupportedModelError, match="XML string: fluid forces"):
        compile_source(text)
    assert compile_source(text, strict=False).ignored[0].startswith("fluid forces")


def test_unknown_name_error() -> None:
    error = UnknownNameError("body", "lag", ["leg", "arm"])
    assert str(error) == "no body is named 'lag'; the names are: 'leg', 'arm'"
    assert isinstance(error, KeyError)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def robot_files() -> list[pathlib.Path]:
    """Return the URDFs of example-robot-data, if it is installed."""
    specification = importlib.util.find_spec("cmeel")
    folders = [pathlib.Path(path).parent for path in (specification.submodule_search_locations or [])] if specification else []
    return sorted(file for folder in folders for file in folder.glob("cmeel.prefix/share/example-robot-data/**/*.urdf"))


def test_all_robot_files_load_or_are_refused_by_name() -> None:
    files = robot_files()
    if not files:
        pytest.skip("example-robot-data is not installed")
    refusals = {
        None: "",
        InvalidInertiaError: "repair=True",
        UnsupportedModelError: "mimics",
        ModelFileError: "no <link>",
    }
    for file in files:
        error = refusal(file)
        assert refusals[type(error) if error else None] in str(error)
        if not isinstance(error, ModelFileError):
            compiled = compile_source(file, strict=False, repair=True)
            assert np.all(compiled.mj_model.body_mass >= 0)
            assert bool(compiled.repaired) or not isinstance(error, InvalidInertiaError)


def refusal(file: pathlib.Path) -> Exception | None:
    """Return the exception that loading a file raises, if any."""
    try:
        compile_source(file)
    except (InvalidInertiaError, UnsupportedModelError, ModelFileError) as error:
        return error
    return None
