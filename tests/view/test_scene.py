"""Shapes, frames and ellipsoids lie where MuJoCo has them, and are as large as the masses say."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.distance import cdist

import kanejax as kj
from kanejax._view.scene import reference_coordinates, scene_of, semi_axes
from kanejax._view.stage import Stage, placed_surfaces
from tests.helpers.seen_robots import URDF, write_robots


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robots")
    write_robots(folder)
    return folder


def posed(path, q):
    mj = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(mj)
    data.qpos[:] = q
    mujoco.mj_kinematics(mj, data)
    return mj, data


def in_world(scene, q):
    """Vertices of the shapes, by body."""
    placed = scene.postures(q[None])
    found = {}
    for body, each in scene.shapes:
        rotation, origin = (np.eye(3), np.zeros(3)) if body < 0 else (placed.rotation[0, body], placed.origin[0, body])
        found.setdefault(body, []).append(each._replace(vertices=each.vertices @ rotation.T + origin))
    return found


def on_surface(mj, data, geom, vertices):
    """How far from the surface of a geom of MuJoCo vertices are, in one way or another that is zero on it."""
    size, local = mj.geom_size[geom], (vertices - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
    kind, aside = mujoco.mjtGeom(mj.geom_type[geom]).name, np.hypot(local[:, 0], local[:, 1])
    if kind == "mjGEOM_BOX":
        return np.abs(np.abs(local) / size - 1.0).max(1)
    if kind in ("mjGEOM_SPHERE", "mjGEOM_ELLIPSOID"):
        axes = np.repeat(size[:1], 3) if kind == "mjGEOM_SPHERE" else size
        return np.abs(np.linalg.norm(local / axes, axis=1) - 1.0)
    if kind == "mjGEOM_CYLINDER":
        # Vertices are on the rims, or in the middles of the ends.
        return np.maximum(np.abs(np.abs(local[:, 2]) - size[1]), np.minimum(np.abs(aside - size[0]), aside))
    if kind == "mjGEOM_CAPSULE":
        beyond = np.maximum(np.abs(local[:, 2]) - size[1], 0.0)
        return np.abs(np.hypot(aside, beyond) - size[0])
    start, count = mj.mesh_vertadr[mj.geom_dataid[geom]], mj.mesh_vertnum[mj.geom_dataid[geom]]
    mesh = mj.mesh_vert[start : start + count]
    distances = cdist(local, mesh)
    return np.full(len(local), max(distances.min(0).max(), distances.min(1).max()))


def test_visuals_of_a_urdf_are_where_mujoco_puts_them(folder):
    q = np.array([0.4, -1.1, 0.23])
    mj, data = posed(folder / "arm.urdf", q)
    scene = scene_of(folder / "arm.urdf")
    assert scene.notes == ()
    shapes = in_world(scene, q)
    assert {body: len(each) for body, each in shapes.items()} == {0: 1, 1: 2, 2: 1}
    for geom in range(mj.ngeom):
        body = int(mj.geom_bodyid[geom]) - 1
        number = geom - int(mj.body_geomadr[body + 1])
        surface = shapes[body][number]
        assert on_surface(mj, data, geom, surface.vertices).max() < 1e-6, mj.geom(geom).name
    assert scene.shapes[0].surface.color == (0.1, 0.2, 0.9)
    assert scene.shapes[1].surface.color == (0.9, 0.1, 0.1)


def test_geoms_of_an_mjcf_are_where_mujoco_has_them(folder, tmp_path):
    rng = np.random.default_rng(0)
    scene = scene_of(folder / "ball.xml")
    # MuJoCo does not load a model with a mesh that is not there.
    text = (folder / "ball.xml").read_text()
    for missing in ('<mesh name="missing" file="gone.obj"/>', '<geom name="missing" type="mesh" mesh="missing"/>'):
        assert missing in text
        text = text.replace(missing, "")
    (folder / "whole.xml").write_text(text)
    q = np.array([0.1, 0.2, 0.3, *(rng.normal(size=4)), 0.7])
    q[3:7] /= np.linalg.norm(q[3:7])
    mj, data = posed(folder / "whole.xml", q)
    shapes = in_world(scene, q)
    seen = {-1: ["post"], 0: ["ball", "egg"], 1: ["rod", "can", "kept", "own"]}
    assert {body: len(each) for body, each in shapes.items()} == {body: len(names) for body, names in seen.items()}
    for body, names in seen.items():
        for surface, name in zip(shapes[body], names, strict=True):
            assert on_surface(mj, data, mj.geom(name).id, surface.vertices).max() < 1e-6, name
    colors = {name: surface.color for body, names in seen.items() for surface, name in zip(shapes[body], names, strict=True)}
    np.testing.assert_allclose(colors["ball"], [0.2, 0.7, 0.3], atol=1e-6)
    np.testing.assert_allclose(colors["egg"], [0.8, 0.3, 0.1], atol=1e-6)
    (note,) = scene.notes
    assert "1 shapes are not drawn: body 'arm': 'gone.obj' is not there" in note


def test_frames_and_mass_centres_are_mujocos(folder):
    q = np.array([[0.4, -1.1, 0.23], [-1.0, 2.0, 0.15]])
    scene = scene_of(folder / "arm.urdf")
    placed = scene.postures(q)
    for row, each in enumerate(q):
        mj, data = posed(folder / "arm.urdf", each)
        mujoco.mj_comPos(mj, data)
        np.testing.assert_allclose(placed.origin[row], data.xpos[1:], atol=1e-12)
        np.testing.assert_allclose(placed.com[row], data.xipos[1:], atol=1e-12)
        np.testing.assert_allclose(placed.rotation[row].reshape(-1, 9), data.xmat[1:], atol=1e-12)


def test_an_ellipsoid_has_the_mass_and_the_inertia_of_its_link():
    scene = scene_of(URDF)
    model = scene.model
    assert [each.body for each in scene.ellipsoids] == [1, 2, 3]
    for body, surface in scene.ellipsoids:
        # Signed tetrahedra from the origin to each triangle, of a polyhedron a little within the ellipsoid.
        corners = surface.vertices[surface.faces]
        volumes = np.linalg.det(corners) / 6.0
        assert volumes.sum() > 0
        middle = np.einsum("m,mi->i", volumes, corners.sum(1) / 4.0) / volumes.sum()
        second = np.zeros((3, 3))
        for triangle, volume in zip(corners - middle, np.linalg.det(corners - middle) / 6.0, strict=True):
            total = triangle.sum(0)
            second += volume / 20.0 * (triangle.T @ triangle + np.outer(total, total))
        second *= float(model.mass[body]) / volumes.sum()
        inertia = np.trace(second) * np.eye(3) - second
        np.testing.assert_allclose(middle, model.com[body], atol=1e-4)
        np.testing.assert_allclose(inertia, model.central_inertia[body], atol=0.015 * np.trace(inertia))


def test_an_inertia_that_no_body_has_still_has_something_to_be_seen():
    np.testing.assert_allclose(semi_axes(2.0, np.array([1.0, 1.0, 3.0])), [np.sqrt(3.75), np.sqrt(3.75), 0.0])
    flat = kj.load(URDF).body("tool").set(central_inertia=np.diag([1e-3, 1e-3, 5e-3]))
    shown = scene_of(flat).ellipsoids[-1].surface
    assert np.ptp(shown.vertices, axis=0).min() > 0.0


def test_an_ellipsoid_larger_than_the_robot_is_named_and_not_drawn():
    made_up = kj.load(URDF).body("tool").set(mass=1e-5, central_inertia=np.eye(3))
    scene = scene_of(made_up)
    assert [each.body for each in scene.ellipsoids] == [1, 2]
    (note,) = scene.notes
    assert "'tool' (500 m)" in note


def test_a_link_without_shapes_has_a_frame_an_ellipsoid_and_a_bone():
    scene = scene_of(URDF.replace("tetrahedron.stl", "gone.stl"))
    names = scene.model.tree.body_names
    assert [names[body] for body in scene.bare] == ["lower", "tool"]
    assert [(names[parent], names[body]) for parent, body in scene.bones] == [("upper", "lower"), ("lower", "tool")]
    (note,) = scene.notes
    assert "link 'lower'" in note
    assert "'gone.stl'" in note


def test_a_model_has_no_shapes_but_ellipsoids():
    scene = scene_of(kj.robots.intelledex_605())
    assert scene.shapes == ()
    assert len(scene.ellipsoids) == 6
    assert scene.bare == tuple(range(6))


def test_the_reference_posture_is_within_the_ranges():
    np.testing.assert_allclose(reference_coordinates(kj.load(URDF)), [0.0, 0.0, 0.1])


def test_copies_stand_apart(folder):
    scene = scene_of(folder / "arm.urdf")
    from kanejax._view.tracks import Track

    rest = reference_coordinates(scene.model)[None]
    stage = Stage(scene, tuple(Track(f"{k}", np.zeros(1), rest) for k in range(3)))
    offsets = stage.offsets()
    count = len(placed_surfaces(stage, 0.0, offsets)) // 3
    alone = placed_surfaces(Stage(scene), 0.0, np.zeros((1, 3)))
    assert count == len(alone)
    length = np.ptp(np.concatenate([each.vertices for each in alone]), axis=0)
    for one in range(3):
        for other in range(one):
            assert np.any(np.abs(offsets[one] - offsets[other])[:2] > length[:2])


def test_surfaces_turn_outward(folder):
    for body, surface in (*scene_of(folder / "arm.urdf").shapes, *scene_of(folder / "ball.xml").shapes):
        corners = surface.vertices[surface.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert np.einsum("mi,mi->m", across, surface.normals[surface.faces[:, 0]]).min() > 0, body
        np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0)
