"""Meshes come from the robot's folder and its packages alone; what is not there is named, and the rest is shown."""

import os

import numpy as np
import pytest

from kanejax._errors import ModelFileError
from kanejax._view.mesh_files import mesh_surfaces
from kanejax._view.scene import scene_of
from tests.helpers.seen_robots import TETRAHEDRON, URDF, write_tetrahedron

COLLADA = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1" name="meter"/><up_axis>Z_UP</up_axis></asset>
<library_effects><effect id="e"><profile_COMMON><technique sid="t"><phong><diffuse><color>0.2 0.4 0.6 1</color></diffuse></phong>
</technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 0.3 0 0 0 0.2 0 0 0 0.1</float_array><technique_common>
<accessor source="#pa" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4" material="m"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n">
<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="m" target="#m"/></technique_common>
</bind_material></instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
OBJ = "mtllib ../secret.mtl\nv 0 0 0\nv 0.3 0 0\nv 0 0.2 0\nv 0 0 0.1\nusemtl a\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def robot(folder, mesh, name="arm.urdf"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(URDF.replace("tetrahedron.stl", mesh))
    return path


def drawn(path, **options):
    """Whether the mesh of the lower link is drawn, and the notes."""
    scene = scene_of(path, **options)
    return any(each.body == 2 for each in scene.shapes), " ".join(scene.notes)


def test_packages_are_folders_above_the_robot_of_that_name_or_named_by_the_user(tmp_path):
    write_tetrahedron(tmp_path / "my_arm" / "meshes" / "t.stl")
    path = robot(tmp_path / "my_arm" / "urdf", "package://my_arm/meshes/t.stl")
    assert drawn(path) == (True, "")
    elsewhere = robot(tmp_path / "other" / "urdf", "package://my_arm/meshes/t.stl")
    seen, note = drawn(elsewhere)
    assert not seen
    assert "the package 'my_arm' of meshes is not found; name its folder with packages=" in note
    for packages in (tmp_path, tmp_path / "my_arm"):
        assert drawn(elsewhere, packages=(packages,)) == (True, "")
    beside = robot(tmp_path / "other" / "urdf", "../../my_arm/meshes/t.stl")
    assert not drawn(beside)[0]
    assert drawn(robot(tmp_path / "my_arm" / "urdf", "../meshes/t.stl", "up.urdf"), packages=(tmp_path / "my_arm",))[0]
    assert drawn(robot(tmp_path / "my_arm" / "urdf", "meshes/t.stl", "in.urdf"), packages=(tmp_path / "my_arm",))[0]


@pytest.mark.parametrize(
    "name",
    [
        "{secret}",
        "file://{secret}",
        "../secret.stl",
        "package://../secret.stl",
        "package://../../secret.stl",
        "package://inner/../../secret.stl",
        "package://inner/..\\\\..\\\\secret.stl",
        "package:///inner/../../secret.stl",
        "link.stl",
        "package://inner/link.stl",
        "%2e%2e/secret.stl",
        "file://%2e%2e/secret.stl",
        "pipe.stl",
        "",
        "\N{SNOWMAN}" * 5000 + ".stl",
        "http://127.0.0.1:9/secret.stl",
    ],
)
def test_nothing_outside_of_the_robots_folders_is_read(tmp_path, name):
    write_tetrahedron(tmp_path / "secret.stl")
    inner = tmp_path / "inner"
    path = robot(inner, name.format(secret=tmp_path / "secret.stl"))
    os.symlink(tmp_path / "secret.stl", inner / "link.stl")
    os.mkfifo(inner / "pipe.stl")
    seen, note = drawn(path)
    assert not seen
    assert "1 shapes are not drawn: link 'lower'" in note
    assert len(note) < 20_000


def test_an_mjcf_reads_its_meshes_from_its_folder_alone(tmp_path):
    write_tetrahedron(tmp_path / "secret.stl")
    text = """<mujoco><asset><mesh name="m" file="{}"/></asset><worldbody><body><joint/><inertial pos="0 0 0" mass="1"
      diaginertia="1e-3 1e-3 1e-3"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
    inner = tmp_path / "inner"
    write_tetrahedron(inner / "own.stl")
    os.symlink(tmp_path / "secret.stl", inner / "link.stl")
    for file, count in (("own.stl", 1), ("link.stl", 0), ("../secret.stl", 0), (str(tmp_path / "secret.stl"), 0)):
        (inner / "robot.xml").write_text(text.format(file))
        scene = scene_of(inner / "robot.xml")
        assert len(scene.shapes) == count
        assert len(scene.notes) == 1 - count, scene.notes


@pytest.mark.parametrize(("name", "content", "color"), [("t.dae", COLLADA, (0.2, 0.4, 0.6)), ("t.obj", OBJ, None)])
def test_meshes_of_all_formats_are_read(tmp_path, name, content, color):
    (tmp_path / name).write_text(content)
    (tmp_path.parent / "secret.mtl").write_text("newmtl a\nKd 1 0 0\n")
    (surface,) = mesh_surfaces(tmp_path / name, np.diag([2.0, 1.0, 1.0]), np.array([0.0, 0.0, 1.0]), None)
    corners = {tuple(np.round(each, 6)) for each in surface.vertices}
    assert corners == {tuple(np.round(each, 6)) for each in TETRAHEDRON * [2.0, 1.0, 1.0] + [0.0, 0.0, 1.0]}
    assert len(surface.faces) == 4
    # Flat triangles that meet in sharp edges.
    assert len(surface.vertices) == 12
    assert surface.color == (color or pytest.approx((0.72, 0.73, 0.75), abs=0.01))
    assert mesh_surfaces(tmp_path / name, np.eye(3), np.zeros(3), (0.5, 0.1, 0.2))[0].color == (0.5, 0.1, 0.2)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.stl", b""),
        ("a.stl", b"solid nothing\nendsolid\n"),
        ("a.stl", bytes(80) + b"\xff\xff\xff\x7f" + bytes(50)),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n"),
        ("a.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("a.obj", b"v 1e300 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("a.obj", b"v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n"),
        ("a.obj", bytes(range(256))),
        ("a.dae", b"<COLLADA>"),
        ("a.dae", b'<!DOCTYPE x [<!ENTITY a "b">]><COLLADA/>'),
        ("a.dae", COLLADA.replace("<p>0 2 1", "<p>0 2 999").encode()),
        ("a.dae", COLLADA.replace('<node id="n">', '<node id="n"><instance_node url="#n"/>').encode()),
        ("a.mesh", b"what"),
    ],
)
def test_a_broken_mesh_is_refused_in_one_line(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ModelFileError, match=r"^[^\n]{1,600}$"):
        mesh_surfaces(tmp_path / name, np.eye(3), np.zeros(3), None)


@pytest.mark.parametrize(
    ("before", "after", "problem"),
    [
        ('<sphere radius="0.06"/>', '<sphere radius="-1"/>', "is no size"),
        ('<sphere radius="0.06"/>', "<sphere/>", "lacks radius"),
        ('<sphere radius="0.06"/>', "<torus/>", "<torus>, which is not drawn"),
        ('<sphere radius="0.06"/>', "", "has no geometry"),
        ('rgba="0.1 0.2 0.9 1"', 'rgba="blue"', "material 'blue'"),
        ('scale="0.6 0.5 0.7"', 'scale="1 2"', "not 3 finite numbers"),
    ],
)
def test_a_broken_visual_is_named_and_the_others_are_seen(tmp_path, before, after, problem):
    write_tetrahedron(tmp_path / "tetrahedron.stl")
    path = tmp_path / "arm.urdf"
    assert before in URDF
    path.write_text(URDF.replace(before, after))
    scene = scene_of(path)
    (note,) = scene.notes
    assert problem in note
    assert len(scene.shapes) >= 3
