"""Motions to be seen: from results, files of every kind, and what is refused by name."""

import json
import zipfile

import numpy as np
import pytest
import zarr

import kanejax as kj
from kanejax._view.motions import stage_of
from kanejax._view.scene import scene_of
from kanejax._view.track_files import read_tracks
from kanejax._view.tracks import tracks_of
from tests.helpers.seen_robots import URDF, swing

MODEL = kj.load(URDF)
BALL = kj.load("<mujoco><worldbody><body name='b'><freejoint/><geom size='0.1'/></body></worldbody></mujoco>")


def staged(trajectory, robot=MODEL, **options):
    return stage_of(robot, trajectory, **({"rows": None, "reference": None} | options))[0]


def batch(count=3):
    ts, q = swing()
    return {"time": ts, "q": np.stack([q * (1.0 + 0.1 * k) for k in range(count)]), "u": np.zeros((count, len(ts), 3))}


def test_a_trajectory_and_its_batch_are_shown():
    ts = np.linspace(0.0, 0.2, 5)
    q = np.array([[0.1, 0.2, 0.2], [0.3, 0.4, 0.2]])
    found = kj.simulate_batch(MODEL, q, np.zeros_like(q), ts)
    both = staged(found, rows=(1, 0)).tracks
    np.testing.assert_array_equal(both[0].q, found.q[1])
    np.testing.assert_array_equal(both[1].u, found.u[0])
    assert both[0].name == "Trajectory, trajectory 1"
    assert both[0].tau is None
    assert len(staged(found).tracks) == 1


def test_what_a_simulation_did_not_reach_is_left_out():
    ts, q = swing()
    q[15:] = np.nan
    (track,) = staged({"ts": ts + 5.0, "q": q}).tracks
    assert len(track.ts) == 15
    assert track.ts[0] == 0.0
    assert track.duration == pytest.approx(ts[14])


def test_coordinates_between_rows_turn_the_shorter_way():
    half = np.sqrt(0.5)
    q = np.array([[0.0, 0, 0, 1, 0, 0, 0], [1.0, 0, 0, -half, -half, 0, 0]])
    (track,) = tracks_of({"ts": [0.0, 2.0], "q": q}, BALL, None, "it")
    between = track.at(BALL, 1.0)
    expected = np.array([np.cos(np.pi / 8), np.sin(np.pi / 8), 0, 0])
    np.testing.assert_allclose(between[3:] / np.linalg.norm(between[3:]), expected, atol=1e-12)
    assert between[0] == 0.5
    np.testing.assert_array_equal(track.at(BALL, -1.0), q[0])
    np.testing.assert_allclose(np.abs(track.at(BALL, 9.0)), np.abs(q[1]))


def test_forces_that_hold_during_a_step_have_two_values_at_a_time():
    (track,) = staged({"ts": np.arange(3.0), "q": np.zeros((3, 3)), "tau": np.array([[1.0, 0, 0], [2.0, 0, 0]])}).tracks
    assert track.tau is not None
    np.testing.assert_array_equal(track.tau_ts, [0.0, 1.0, 1.0, 2.0])
    np.testing.assert_array_equal(track.tau[:, 0], [1.0, 1.0, 2.0, 2.0])


def test_files_of_the_commands_hold_the_same_motion(tmp_path):
    arrays = batch()
    np.savez_compressed(tmp_path / "runs.npz", **arrays, details=json.dumps({}))
    motion = {"ts": arrays["time"], "q": arrays["q"][2], "tau": np.ones((20, 3)), "joint_names": np.array(MODEL.tree.joint_names)}
    np.savez(tmp_path / "motion.npz", **motion)
    study = kj.Study(MODEL, arrays["time"], 3, q0=None, control=kj.RandomForces(kj.distributions.Normal(0.0, 0.1), period=0.5))
    kj.write_study(study, tmp_path / "runs.zarr", chunk=2)
    first, last = read_tracks(tmp_path / "runs.npz", MODEL, (0, 2))[0]
    np.testing.assert_array_equal(first.q, arrays["q"][0])
    (optimal,) = read_tracks(tmp_path / "motion.npz", MODEL, None)[0]
    np.testing.assert_array_equal(optimal.q, last.q)
    assert optimal.tau is not None
    assert len(optimal.tau) == 40
    (stored,) = read_tracks(tmp_path / "runs.zarr", MODEL, (2,))[0]
    for name in ("q", "tau"):
        np.testing.assert_array_equal(getattr(stored, name), np.asarray(zarr.open_array(str(tmp_path / "runs.zarr" / name)))[2])
    assert stored.name.endswith("runs.zarr, trajectory 2")


def test_a_motion_of_some_joints_leaves_the_others_at_rest(tmp_path):
    ts, q = swing()
    np.savez(tmp_path / "m.npz", ts=ts, q=q[:, [1, 0]], tau=q[1:, [1, 0]], joint_names=np.array(["elbow", "shoulder"]))
    (track,), (note,) = read_tracks(tmp_path / "m.npz", MODEL, None)
    np.testing.assert_array_equal(track.q, np.column_stack((q[:, :2], np.full(len(ts), 0.1))))
    assert track.tau is not None
    np.testing.assert_array_equal(track.tau[:2, :2], q[[1, 1], :2])
    assert note.endswith("m.npz, and shown at rest: slide")


@pytest.mark.parametrize("measured", [("position",), ("position", "velocity", "effort")])
def test_a_log_moves_the_joints_that_it_has(tmp_path, measured):
    ts, q = swing()
    header = ["time", *(f"{what}_{joint}" for what in measured for joint in ("elbow", "shoulder"))]
    table = np.column_stack((ts + 100.0, *([q[:, [1, 0]]] * len(measured))))
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=",".join(header), comments="")
    (track,), (note,) = read_tracks(tmp_path / "log.csv", MODEL, None)
    np.testing.assert_allclose(track.q[:, :2], q[:, :2])
    np.testing.assert_array_equal(track.q[:, 2], 0.1)
    assert track.duration == pytest.approx(1.0)
    assert (track.tau is None) == (track.u is None) == (measured == ("position",))
    assert "slide" in note
    log = kj.read_log(tmp_path / "log.csv", ("elbow",), columns=kj.Columns(effort="position_{joint}"))
    np.testing.assert_allclose(staged(log).tracks[0].q[:, 1], q[:, 1])


def bomb(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("q.npy", "w", force_zip64=True) as entry:
        np.lib.format.write_array_header_1_0(entry, {"descr": "<f8", "fortran_order": False, "shape": (1 << 25, 3)})
        for _ in range(600):
            entry.write(bytes(1 << 20))


ts, q = swing()
WRONG = {
    "no q": ({"ts": ts}, "no array 'q'; it has ts"),
    "no times": ({"q": q}, "has no 'ts'"),
    "other robot": ({"ts": ts, "q": q[:, :2]}, r"q has shape \(21, 2\), but this robot needs \(times, 3\)"),
    "other length": ({"ts": ts[1:], "q": q}, r"ts has shape \(20,\), but needs \(21\)"),
    "scalar": ({"ts": ts, "q": np.zeros(3)}, r"q has shape \(3,\)"),
    "text": ({"ts": ts, "q": q.astype(str)}, "q is of type <U"),
    "complex": ({"ts": ts, "q": q + 1j}, "must be numbers"),
    "nothing finite": ({"ts": ts, "q": q * np.nan}, "first row of q"),
    "huge": ({"ts": ts, "q": q + 1e300}, "first row of q"),
    "empty": ({"ts": ts[:0], "q": q[:0]}, "first row of q|no row"),
    "backward": ({"ts": ts[::-1], "q": q}, "times must increase"),
    "speeds": ({"ts": ts, "q": q, "u": q[:, :1]}, "u has shape"),
    "forces": ({"ts": ts, "q": q, "tau": q[:5]}, "tau has 5 rows for 21 times"),
    "objects": ({"ts": ts, "q": np.array([{"a": 1}], object)}, "not an NPZ file of a motion"),
    "names": ({"ts": ts, "q": q, "joint_names": np.array(["a", "b", "c"])}, "joints a, b, c, but this one has shoulder"),
}


@pytest.mark.parametrize("case", WRONG)
def test_an_npz_that_does_not_fit_is_refused_in_one_line(tmp_path, case):
    arrays, problem = WRONG[case]
    np.savez(tmp_path / "motion.npz", **arrays)
    with pytest.raises(kj.KanejaxError, match=f"^[^\n]*({problem})[^\n]*$"):
        read_tracks(tmp_path / "motion.npz", MODEL, None)


def test_other_files_that_are_none_are_refused_in_one_line(tmp_path):
    (tmp_path / "text.npz").write_text("time,q")
    (tmp_path / "text.csv").write_text("time,position_a\n0,1\n1,2\n")
    (tmp_path / "numbers.csv").write_text("time,position_elbow\n0,1\n1,much\n")
    (tmp_path / "empty.zarr").mkdir()
    (tmp_path / "file.zarr").write_text("")
    (tmp_path / "motion.pkl").write_bytes(b"")
    bomb(tmp_path / "bomb.npz")
    problems = {
        "gone.npz": "no such file",
        "gone.csv": "no such file",
        "gone.zarr": "no such file",
        "file.zarr": "no folder",
        "text.npz": "not an NPZ file",
        "text.csv": "none of the columns position_shoulder",
        "numbers.csv": "'much'",
        "empty.zarr": "no data set",
        "motion.pkl": "ends in none of them",
        "bomb.npz": "unpacks to",
    }
    for name, problem in problems.items():
        with pytest.raises(kj.KanejaxError, match=f"^[^\n]*{problem}[^\n]*$"):
            read_tracks(tmp_path / name, MODEL, None)


def test_a_store_of_somebody_else_is_refused_in_one_line(tmp_path):
    group = zarr.create_group(str(tmp_path / "x.zarr"))
    group.create_array("q", shape=(2, 21, 3), chunks=(1 << 20, 1 << 10, 3), dtype="f8", fill_value=0.0)
    with pytest.raises(kj.DatasetError, match=r"takes \d+ bytes"):
        read_tracks(tmp_path / "x.zarr", MODEL, None)
    other = zarr.create_group(str(tmp_path / "y.zarr"))
    other.create_array("q", data=np.zeros((2, 21, 3)))
    with pytest.raises(kj.KanejaxError, match="has no 'ts'"):
        read_tracks(tmp_path / "y.zarr", MODEL, None)
    with pytest.raises(kj.KanejaxError, match="there is no trajectory 7; the 2"):
        read_tracks(tmp_path / "y.zarr", MODEL, (7,))


def test_rows_that_are_not_there_are_named():
    arrays = {"ts": ts, "q": batch()["q"]}
    with pytest.raises(kj.KanejaxError, match="no trajectory 3; the 3 are numbered from 0 to 2"):
        staged(arrays, rows=(0, 3))
    with pytest.raises(kj.KanejaxError, match="no trajectory -1"):
        staged(arrays, rows=(-1,))
    with pytest.raises(kj.KanejaxError, match="is one trajectory, but 1 are asked for"):
        staged({"ts": ts, "q": q}, rows=(1,))
    with pytest.raises(kj.KanejaxError, match="65 trajectories are asked for; at most 64"):
        staged([{"ts": ts, "q": q}] * 65)


def test_what_is_no_motion_and_a_reference_alone_are_refused():
    with pytest.raises(kj.KanejaxError, match="cannot show a int"):
        staged(3)
    with pytest.raises(kj.KanejaxError, match="no trajectory that it belongs to"):
        staged(None, reference={"ts": ts, "q": q})
    with pytest.raises(kj.KanejaxError, match="the reference has 2 motions"):
        staged({"ts": ts, "q": q}, reference=[{"ts": ts, "q": q}] * 2)
    with pytest.raises(kj.KanejaxError, match="the quaternion q"):
        staged({"ts": [0.0], "q": np.zeros((1, 7))}, robot=BALL)
    assert scene_of(BALL).size > 0
