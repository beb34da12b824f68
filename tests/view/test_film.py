"""Films: so many pictures, so large, the robot where it is, the same pictures each time, and no file after an interruption."""

import json
import os
import signal
import subprocess
import sys

import av
import numpy as np
import pytest
from PIL import Image, ImageSequence
from typer.testing import CliRunner

import kanejax as kj
from kanejax import cli
from kanejax._view.camera import Camera, camera_around
from kanejax._view.ray_cast import Floor, picture
from kanejax._view.shape import box, ellipsoid
from tests.helpers.seen_robots import swing, write_robots

SIZE = (240, 136)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_robots(tmp_path)
    ts, q = swing()
    np.savez(tmp_path / "motion.npz", ts=ts, q=q)
    return tmp_path


def run(*arguments):
    return CliRunner().invoke(cli.app, ["render", "arm.urdf", *map(str, arguments)])


def film(path):
    with av.open(str(path)) as container:
        return container.streams.video[0].average_rate, [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def red(image):
    """Where the red upper arm is."""
    r, g, b = (image[..., k].astype(int) for k in range(3))
    return (r > 90) & (r > 2 * g) & (r > 2 * b)


def test_a_film_has_the_pictures_and_the_robot_moves_in_it(folder):
    result = run(
        "--trajectory", "motion.npz", "--out", "film.mp4", "--size", "240x136", "--camera", "-90,10", "--fps", 10, "--seconds", 0.8
    )
    assert result.exit_code == 0, result.output
    assert "written: film.mp4" in result.stdout
    rate, pictures = film("film.mp4")
    assert rate == 10
    assert [each.shape for each in pictures] == [(136, 240, 3)] * 8
    places = [np.argwhere(red(each)).mean(0) for each in pictures]
    assert all(red(each).sum() > 100 for each in pictures)
    assert np.linalg.norm(places[0] - places[-1]) > 5.0
    (folder / "again.mp4").write_bytes(b"old")
    assert (
        run(
            "--trajectory",
            "motion.npz",
            "--out",
            "again.mp4",
            "--size",
            "240x136",
            "--camera",
            "-90,10",
            "--fps",
            10,
            "--seconds",
            0.8,
        ).exit_code
        == 0
    )
    np.testing.assert_allclose(np.array(film("again.mp4")[1]), np.array(pictures), atol=12)
    assert sorted(path.name for path in folder.glob("*.mp4")) == ["again.mp4", "film.mp4"]


def test_a_gif_keeps_its_colours_and_its_times(folder):
    kj.render("arm.urdf", "motion.npz", "film.gif", size=SIZE, azimuth=-90.0, fps=20.0, speed=2.0)
    with Image.open("film.gif") as pictures:
        # One second at twice the speed; the film ends before it would begin anew.
        frames = [(each.info["duration"], np.array(each.convert("RGB"))) for each in ImageSequence.Iterator(pictures)]
    assert len(frames) == 10
    for duration, frame in frames:
        assert duration == 50
        assert red(frame).sum() > 100


def test_a_picture_shows_the_posture_of_its_time(folder):
    kj.render("arm.urdf", "motion.npz", "later.png", size=SIZE, azimuth=-90.0, start=0.8)
    kj.render("arm.urdf", "motion.npz", "first.png", size=SIZE, azimuth=-90.0)
    kj.render("arm.urdf", "motion.npz", "again.png", size=SIZE, azimuth=-90.0, start=0.8)
    assert (folder / "again.png").read_bytes() == (folder / "later.png").read_bytes()
    later, first = (np.array(Image.open(name)) for name in ("later.png", "first.png"))
    assert later.shape == (136, 240, 3)
    assert np.linalg.norm(np.argwhere(red(later)).mean(0) - np.argwhere(red(first)).mean(0)) > 5.0
    still = {"ts": [0.0], "q": [[-1.0, 0.0, 0.2]]}
    kj.render("arm.urdf", "motion.npz", "ghost.png", size=SIZE, azimuth=-90.0, distance=3.0, start=0.8, reference=still)
    ghost = np.array(Image.open("ghost.png")).astype(int)
    kj.render("arm.urdf", "motion.npz", "alone.png", size=SIZE, azimuth=-90.0, distance=3.0, start=0.8)
    alone = np.array(Image.open("alone.png")).astype(int)
    bluer = (ghost[..., 2] - ghost[..., 0]) - (alone[..., 2] - alone[..., 0])
    assert (bluer > 30).sum() > 200
    kj.render("arm.urdf", None, "inertia.png", size=SIZE, ellipsoids=True)
    inertia = np.array(Image.open("inertia.png")).astype(int)
    orange = (inertia[..., 0] - inertia[..., 2] > 60) & (inertia[..., 1] - inertia[..., 2] > 20)
    assert orange.sum() > 30


def test_a_ray_meets_what_is_at_its_pixel():
    camera = Camera(np.array([3.0, 0.5, 1.0]), np.array([0.0, 0.0, 0.4]))
    places = np.array([[0.0, -0.6, 0.4], [0.2, 0.5, 0.7]])
    balls = [
        ellipsoid(np.full(3, 0.1), color=color).moved(np.eye(3), place)
        for place, color in zip(places, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), strict=True)
    ]
    image = picture(balls, camera, SIZE, Floor(0.0, 0.5)).astype(int)
    for (column, row), channel in zip(camera.pixels(places, SIZE), (0, 1), strict=True):
        seen = np.argwhere(image[..., channel] - image[..., 1 - channel] > 80)
        np.testing.assert_allclose(seen.mean(0), [row, column], atol=1.0)
        distance = np.linalg.norm(places[channel] - camera.position)
        radius = 0.5 * SIZE[1] * 0.1 / (np.tan(0.5 * camera.field_of_view) * distance)
        assert len(seen) == pytest.approx(np.pi * radius**2, rel=0.15)


def test_what_is_behind_is_hidden_and_what_is_translucent_is_seen_through():
    camera = Camera(np.array([3.0, 0.0, 0.5]), np.array([0.0, 0.0, 0.5]))
    back = box(np.array([0.1, 0.8, 0.8]), color=(1.0, 0.0, 0.0)).moved(np.eye(3), np.array([-0.5, 0.0, 0.5]))

    def middle(front):
        return picture([back, *front], camera, (64, 64), Floor(0.0, 0.5))[32, 32].astype(int)

    front = box(np.array([0.1, 0.4, 0.4]), color=(0.0, 0.0, 1.0)).moved(np.eye(3), np.array([0.5, 0.0, 0.5]))
    alone, hidden, veiled = middle([]), middle([front]), middle([front._replace(opacity=0.25)])
    assert alone[0] > 100 > 60 > alone[2]
    assert hidden[2] > 100 > 60 > hidden[0]
    # Two faces of the box are passed.
    assert alone[0] * 0.45 < veiled[0] < alone[0] * 0.7
    assert veiled[2] > 30


def test_the_camera_sees_all_points_and_no_more_than_it_must():
    points = np.random.default_rng(0).normal(size=(50, 3)) * [1.0, 2.0, 0.5] + [5.0, 0.0, 1.0]
    for azimuth, elevation in ((40.0, 18.0), (-120.0, 60.0), (0.0, 90.0)):
        camera = camera_around(points, 16 / 9, azimuth=azimuth, elevation=elevation)
        pixels = camera.pixels(points, (160, 90)) / [160, 90]
        assert pixels.min() > 0.0
        assert pixels.max() < 1.0
        assert np.ptp(pixels, axis=0).max() > 0.8


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("--out", "film.avi"), "ends in none of them"),
        (("--out", "gone/film.mp4"), "cannot be written"),
        (("--out", "film.mp4", "--size", "161x90"), "even number"),
        (("--out", "film.mp4", "--size", "9x9"), "from 16 to 4096"),
        (("--out", "film.mp4", "--size", "99999x90"), "from 16 to 4096"),
        (("--out", "film.mp4", "--size", "wide"), "write it like 960x540"),
        (("--out", "film.mp4", "--camera", "1"), "write it like 40,18"),
        (("--out", "film.mp4", "--camera", "nan,1"), "write it like 40,18"),
        (("--out", "film.mp4", "--rows", "first"), "write it like 0,2,5"),
        (("--out", "film.mp4", "--rows", "0", "--count", "2"), "leave one out"),
        (("--out", "film.mp4", "--rows", "4"), "is one trajectory"),
        (("--out", "film.mp4", "--start", "7"), "from 0 to 1 s"),
        (("--out", "film.mp4", "--seconds", "1e9"), "more than 100000 pictures"),
    ],
)
def test_what_is_no_film_is_refused_in_one_line_and_leaves_no_file(folder, arguments, problem):
    before = sorted(folder.iterdir())
    result = run("--trajectory", "motion.npz", *arguments)
    assert result.exit_code == 2, result.output
    assert problem in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert sorted(folder.iterdir()) == before


def test_a_film_without_a_motion_is_refused(folder):
    result = run("--out", "film.mp4")
    assert result.exit_code == 2
    assert "a film needs a trajectory" in result.stderr


def test_a_program_reads_what_was_written_and_what_is_not_shown(folder):
    (folder / "tetrahedron.stl").unlink()
    result = run("--out", "arm.png", "--size", "64x48", "--json")
    told = json.loads(result.stdout)
    assert told["out"] == "arm.png"
    assert "'tetrahedron.stl' is not there" in told["notes"][0]
    assert result.stderr == ""


def test_an_interrupted_film_leaves_nothing(folder):
    (folder / "film.mp4").write_bytes(b"old")
    command = [sys.executable, "-m", "kanejax.cli", "render", "arm.urdf", "--trajectory", "motion.npz", "--out", "film.mp4"]
    process = subprocess.Popen([*command, "--seconds", "600"], stderr=subprocess.PIPE, text=True, env=os.environ)
    try:
        while not list(folder.glob(".film.mp4.*.partial")):
            assert process.poll() is None, process.communicate()[1]
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert said == "interrupted\n"
    assert (folder / "film.mp4").read_bytes() == b"old"
    assert not list(folder.glob(".film*"))
