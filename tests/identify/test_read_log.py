"""Log files of every format, and what is wrong with them."""

import json
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest

from kanejax._errors import LogError
from kanejax._logs.columns import Columns, Units
from kanejax._logs.read_log import read_log

JOINTS = ("shoulder", "elbow")
N = 40
RANDOM = np.random.default_rng(0)
# Times as a header's stamp has them: whole nanoseconds.
STAMPS = 1_700_000_000_000_000_000 + np.cumsum(RANDOM.integers(900_000, 1_100_000, N))
TS = STAMPS // 10**9 + 1e-9 * (STAMPS % 10**9)
Q, U, EFFORT = RANDOM.normal(size=(3, N, 2))
ALL = Columns(velocity="velocity_{joint}")
UR10E = pathlib.Path(os.environ.get("KANEJAX_DATA", pathlib.Path(__file__).parents[2].parent / "shared/data")) / "ur10e"

JOINT_STATE = """\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def table():
    names = ["time", *(f"{quantity}_{joint}" for quantity in ("position", "velocity", "effort") for joint in JOINTS)]
    return names, np.column_stack((TS, Q, U, EFFORT))


def write_csv(path, delimiter=",", header=True, rows=None):
    names, values = table()
    rows = [[f"{x!r}" for x in row] for row in values.tolist()] if rows is None else rows
    lines = [names, *rows] if header else rows
    path.write_text("".join(delimiter.join(line) + "\n" for line in lines))
    return path


def state(i, stamped=True):
    """Every other message lists the joints the other way round, with a joint more."""
    order = [0, 1] if i % 2 else [1, 0]
    names = [JOINTS[j] for j in order] + ([] if i % 2 else ["finger"])
    fields = {
        quantity: [float(x[i, j]) for j in order] + ([] if i % 2 else [0.5])
        for quantity, x in (("position", Q), ("velocity", U), ("effort", EFFORT))
    }
    stamp = {"sec": int(STAMPS[i] // 10**9), "nanosec": int(STAMPS[i] % 10**9)} if stamped else {"sec": 0, "nanosec": 0}
    return {"header": {"stamp": stamp, "frame_id": ""}, "name": names, **fields}


def write_ros2(path, topics=("/joint_states",), stamped=True, gripper=False):
    writer_module = pytest.importorskip("mcap_ros2.writer", reason="mcap-ros2-support is not installed: MCAP files were not read")
    with path.open("wb") as stream:
        writer = writer_module.Writer(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        for i in range(N):
            for topic in topics:
                writer.write_message(topic, schema, state(i, stamped), log_time=int(STAMPS[i]) + 10**6, publish_time=int(STAMPS[i]))
            if gripper:
                other = {**state(i), "name": ["gripper"], "position": [0.1], "velocity": [], "effort": []}
                writer.write_message(topics[0], schema, other, log_time=int(STAMPS[i]) + 2 * 10**6)
        writer.finish()
    return path


def write_json(path, encoding="json", schema_name="JointState", change=None):
    writer_module = pytest.importorskip("mcap.writer", reason="mcap is not installed: MCAP files were not read")
    with path.open("wb") as stream:
        writer = writer_module.Writer(stream)
        writer.start()
        schema = writer.register_schema(schema_name, "jsonschema", b"{}")
        channel = writer.register_channel("/arm", encoding, schema)
        for i in range(N):
            message = {**state(i), **(change or {})} if i == 7 else state(i)
            writer.add_message(channel, int(STAMPS[i]), json.dumps(message).encode(), int(STAMPS[i]))
        writer.finish()
    return path


def write_parquet(path, columns):
    arrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed: Parquet files were not read")
    parquet = pytest.importorskip("pyarrow.parquet")
    parquet.write_table(arrow.table(columns), path)
    return path


def columns_of_table():
    names, values = table()
    return dict(zip(names, values.T, strict=True))


def check(log, exact=True, velocity=True):
    assert log.joints == JOINTS
    (run,) = log.runs
    np.testing.assert_allclose(run.ts, TS, rtol=0, atol=0 if exact else 3e-7)
    np.testing.assert_array_equal(run.q, Q)
    np.testing.assert_array_equal(run.effort, EFFORT)
    assert run.u_dot is None
    if velocity:
        np.testing.assert_array_equal(run.u, U)
    else:
        assert run.u is None


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_text_with_a_header(tmp_path, delimiter):
    log = read_log(write_csv(tmp_path / "log.csv", delimiter), JOINTS, columns=ALL)
    check(log)
    assert log.runs[0].name == "log"
    assert log.notes == ()


def test_text_without_a_header_by_number(tmp_path):
    path = write_csv(tmp_path / "log.txt", "|", header=False)
    check(read_log(path, JOINTS, columns=Columns(0, range(1, 3), (3, 4), None, (5, 6)), delimiter="|"))


def test_a_header_after_a_number_sign_as_numpy_writes_it(tmp_path):
    names, values = table()
    np.savetxt(tmp_path / "log.dat", values, fmt="%.17g", header=" ".join(names))
    check(read_log(tmp_path / "log.dat", JOINTS, columns=ALL))


def test_a_header_of_numbers_must_be_said_to_be_one(tmp_path):
    rows = [["0", "1", "2"], ["0.0", "1.0", "3.0"], ["0.1", "1.5", "4.0"]]
    path = write_csv(tmp_path / "log.csv", header=False, rows=rows)
    by_name = Columns("0", ("1",), None, None, ("2",))
    log = read_log(path, ["elbow"], columns=by_name, header=True)
    np.testing.assert_array_equal(log.runs[0].q, [[1.0], [1.5]])
    assert len(read_log(path, ["elbow"], columns=Columns(0, (1,), None, None, (2,)), repeated="drop").runs[0]) == 2
    path.write_text("0.0,oops,1.0\n0.1,1.0,1.0\n")
    with pytest.raises(LogError, match=r"the first line has numbers and text, .*; say header=True or header=False"):
        read_log(path, ["elbow"], columns=by_name)


def test_npz_with_columns_or_with_arrays(tmp_path):
    np.savez(tmp_path / "columns.npz", **columns_of_table())
    check(read_log(tmp_path / "columns.npz", JOINTS, columns=ALL))
    np.savez_compressed(tmp_path / "arrays.npz", t=TS, q=Q, tau=EFFORT, text="more")
    check(read_log(tmp_path / "arrays.npz", JOINTS, columns=Columns("t", "q", None, None, "tau")), velocity=False)


def test_parquet_with_columns_lists_and_times(tmp_path):
    arrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed: Parquet files were not read")
    check(read_log(write_parquet(tmp_path / "log.parquet", columns_of_table()), JOINTS, columns=ALL))
    lists = {"stamp": arrow.array(STAMPS, arrow.timestamp("ns")), "q": list(Q), "tau": list(EFFORT)}
    path = write_parquet(tmp_path / "lists.pq", lists)
    for unit in ("s", "ns"):
        log = read_log(path, JOINTS, columns=Columns("stamp", "q", None, None, "tau"), units=Units(time=unit))
        check(log, exact=False, velocity=False)


def test_a_missing_number_of_a_parquet_file_is_a_bad_row(tmp_path):
    arrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed: Parquet files were not read")
    lists = [None if i == 4 else row for i, row in enumerate(Q.tolist())]
    effort = [None if i == 6 else x for i, x in enumerate(EFFORT[:, 0].tolist())]
    columns = {"time": TS, "q": arrow.array(lists), "a": effort, "b": EFFORT[:, 1]}
    path = write_parquet(tmp_path / "log.parquet", columns)
    log = read_log(path, JOINTS, columns=Columns("time", "q", None, None, ("a", "b")), bad_rows="drop")
    np.testing.assert_array_equal(log.runs[0].q, np.delete(Q, [4, 6], axis=0))
    assert log.notes == ("log: 2 of 40 rows are bad and were dropped, the first is row 5: the position of joint 'shoulder' is nan",)


def test_mcap_as_ros_2_writes_it(tmp_path):
    path = write_ros2(tmp_path / "log.mcap", topics=("/joint_states", "/goal"))
    check(read_log(path, JOINTS, columns=ALL, topic="/joint_states"), exact=False)
    with pytest.raises(LogError, match=r"2 topics have messages of type JointState; give topic=..., one of: '/goal \(sensor"):
        read_log(path, JOINTS)
    with pytest.raises(LogError, match=r"there is no topic '/arm'; the topics are: '/goal .*, '/joint_states "):
        read_log(path, JOINTS, topic="/arm")
    with pytest.raises(LogError, match=r"column 'position_wrist', but there is no such column; .*'position_elbow'"):
        read_log(path, ["wrist"], topic="/goal")


def test_mcap_in_json_from_which_the_topic_and_other_names_are_taken(tmp_path):
    log = read_log(write_json(tmp_path / "log.mcap"), {"joint1": "shoulder", "joint2": "elbow"}, columns=ALL)
    assert log.joints == ("joint1", "joint2")
    np.testing.assert_array_equal(log.runs[0].q, Q)
    np.testing.assert_array_equal(log.runs[0].u, U)
    np.testing.assert_allclose(log.runs[0].ts, TS, rtol=0, atol=3e-7)


def test_mcap_messages_without_stamps_and_of_other_joints(tmp_path):
    path = write_ros2(tmp_path / "log.mcap", stamped=False)
    with pytest.raises(LogError, match=r"column 'time', but there is no such column; the columns are: 'log_time', 'publ"):
        read_log(path, JOINTS)
    log = read_log(path, JOINTS, columns=Columns("log_time"))
    np.testing.assert_allclose(log.runs[0].ts, TS + 1e-3, rtol=0, atol=6e-7)
    log = read_log(write_ros2(tmp_path / "two.mcap", gripper=True), JOINTS, columns=ALL)
    check(log, exact=False)
    assert log.notes == ("two: 40 of 80 messages have none of the joints and were left out",)


def test_mcap_with_a_broken_message_or_encoding(tmp_path):
    path = write_json(tmp_path / "log.mcap", change={"position": [1.0]})
    with pytest.raises(LogError, match=r"row 8: the message has 1 numbers of position for 2 joints; 1 of 40 rows are bad"):
        read_log(path, JOINTS)
    np.testing.assert_array_equal(read_log(path, JOINTS, bad_rows="drop").runs[0].q, np.delete(Q, 7, axis=0))
    path = write_json(tmp_path / "other.mcap", encoding="cbor")
    with pytest.raises(LogError, match=r"topic '/arm' is encoded as 'cbor' with a schema in 'jsonschema'; JSON, and CDR with"):
        read_log(path, JOINTS)
    path = write_json(tmp_path / "type.mcap", schema_name="Image")
    with pytest.raises(LogError, match=r"0 topics have messages of type JointState; .*'/arm \(Image\)'"):
        read_log(path, JOINTS)
    path.write_bytes(b"nothing")
    with pytest.raises(LogError, match=r"type.mcap: not an MCAP file that can be read \(.*\); if the recording was cut off"):
        read_log(path, JOINTS)


@pytest.mark.parametrize(("module", "extra"), [("pyarrow.parquet", "parquet"), ("mcap.reader", "mcap")])
def test_a_missing_package_is_named(tmp_path, monkeypatch, module, extra):
    monkeypatch.setitem(sys.modules, module, None)
    path = tmp_path / f"log.{extra}"
    path.write_bytes(b"something")
    with pytest.raises(LogError, match=rf"needs the package of {module}: pip install 'kanejax\[{extra}\]'"):
        read_log(path, JOINTS)


def test_packages_are_imported_when_a_file_needs_them():
    program = "import sys, kanejax._logs.read_log; assert not {'pyarrow', 'mcap', 'mcap_ros2', 'pandas'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)


def test_units(tmp_path):
    path = write_csv(tmp_path / "log.csv")
    units = Units(time="ms", position=("deg", 0.5), velocity="rpm", effort=(-1.0, "mA"))
    (run,) = read_log(path, JOINTS, columns=ALL, units=units).runs
    np.testing.assert_allclose(run.ts, 1e-3 * TS, rtol=1e-15)
    np.testing.assert_allclose(run.q, Q * [np.pi / 180, 0.5], rtol=1e-15)
    assert run.u is not None
    np.testing.assert_allclose(run.u, U * 2 * np.pi / 60, rtol=1e-15)
    np.testing.assert_allclose(run.effort, EFFORT * [-1.0, 1e-3], rtol=1e-15)
    (run,) = read_log(path, JOINTS, columns=ALL, units=Units(position="deg")).runs
    assert run.u is not None
    np.testing.assert_allclose(run.u, np.deg2rad(U), rtol=1e-15)


@pytest.mark.parametrize(
    ("units", "message"),
    [
        (Units(time="min"), r"units.time is 'min'; use one of 's', 'ms', 'us', 'ns', or a factor"),
        (Units(time=-1.0), r"units.time is -1.0; a factor must be finite and not zero, and that of time positive"),
        (Units(position="grad"), r"units.position is 'grad'; use one of 'rad', 'deg', 'turn', 'm', 'mm', or a factor"),
        (Units(position=("rad", "m", "m")), r"units.position has 3 entries for 2 joints; give one for all, or one a joint"),
        (Units(effort=0.0), r"units.effort is 0.0; a factor must be finite and not zero"),
    ],
)
def test_bad_units(tmp_path, units, message):
    with pytest.raises(LogError, match=message):
        read_log(write_csv(tmp_path / "log.csv"), JOINTS, columns=ALL, units=units)


def test_rows_of_one_file_and_of_several(tmp_path):
    first = write_csv(tmp_path / "a.csv")
    second = write_csv(tmp_path / "b.csv")
    (run,) = read_log(first, JOINTS, rows=(3, 10)).runs
    np.testing.assert_array_equal(run.q, Q[2:10])
    assert len(read_log(first, JOINTS, rows=(39, None)).runs[0]) == 2
    log = read_log([first, second], JOINTS, rows=[(1, 5), None])
    assert [(run.name, len(run)) for run in log.runs] == [("a", 5), ("b", N)]
    for rows in ((0, 3), (3, 41), (5, 4)):
        with pytest.raises(LogError, match=rf"a.csv: rows {rows[0]} to {rows[1]} are asked for, but there are rows 1 to 40"):
            read_log(first, JOINTS, rows=rows)
    with pytest.raises(LogError, match=r"rows is \[\(1, 2\)\]; for one file it must be a pair"):
        read_log(first, JOINTS, rows=[(1, 2)])
    for rows in ((1, 5), [(1, 5)]):
        with pytest.raises(LogError, match=r"for 2 files it must be a sequence with a pair \(first, last\), or None, for each"):
            read_log([first, second], JOINTS, rows=rows)


def test_runs_are_named_by_what_tells_the_files_apart(tmp_path):
    (tmp_path / "more").mkdir()
    paths = [write_csv(tmp_path / "a.csv"), write_csv(tmp_path / "more" / "a.csv")]
    assert [run.name for run in read_log(paths, JOINTS).runs] == [str(path) for path in paths]
    with pytest.raises(LogError, match=r"a.csv is given more than once"):
        read_log([paths[0], paths[0]], JOINTS)


def broken(path, changes):
    rows = [[f"{x!r}" for x in row] for row in table()[1].tolist()]
    for i, change in changes.items():
        change(rows[i])
    return write_csv(path, rows=rows)


def put(column, text):
    return lambda row: row.__setitem__(column, text)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put(1, "oops"), r"log.csv: row 11: column 'position_shoulder' is 'oops', not a number; 1 of 40 rows are bad. Repair"),
        (put(6, ""), r"row 11: column 'effort_elbow' is '', not a number"),
        (put(6, "nan"), r"row 11: the effort of joint 'elbow' is nan; 1 of 40 rows are bad"),
        (put(2, "inf"), r"row 11: the position of joint 'elbow' is inf"),
        (put(0, "nan"), r"row 11: the time is nan"),
        (lambda row: row.pop(), r"row 11: there are 6 fields instead of 7"),
        (lambda row: row.append("1"), r"row 11: there are 8 fields instead of 7; .* or drop the bad ones with bad_rows='drop'"),
        (lambda row: row.__setitem__(slice(None), [""] * 7), r"row 11: column 'time' is '', not a number"),
    ],
)
def test_bad_rows_are_refused_or_dropped_and_told(tmp_path, change, message):
    path = broken(tmp_path / "log.csv", {10: change})
    with pytest.raises(LogError, match=message):
        read_log(path, JOINTS)
    log = read_log(path, JOINTS, bad_rows="drop")
    np.testing.assert_array_equal(log.runs[0].effort, np.delete(EFFORT, 10, axis=0))
    (note,) = log.notes
    assert note.startswith("log: 1 of 40 rows are bad and were dropped, the first is row 11: ")
    assert len(read_log(path, JOINTS, rows=(12, 40)).runs[0]) == 29


def test_columns_and_lines_that_are_not_read_do_not_matter(tmp_path):
    path = broken(tmp_path / "log.csv", {10: put(3, "a comment")})
    path.write_text("\n" + path.read_text() + "\n\n")
    check(read_log(path, JOINTS), velocity=False)
    with pytest.raises(LogError, match="column 'velocity_shoulder' is 'a comment'"):
        read_log(path, JOINTS, columns=ALL)


def test_repeated_times_are_refused_or_dropped_and_told(tmp_path):
    path = broken(tmp_path / "log.csv", {10: put(0, str(TS[9])), 20: put(0, str(TS[15]))})
    with pytest.raises(
        LogError,
        match=r"repeat or go back in 2 of 40 rows, first in row 11: 1700000000.00.* s follows .* with repeated='drop'",
    ):
        read_log(path, JOINTS)
    log = read_log(path, JOINTS, repeated="drop")
    np.testing.assert_array_equal(log.runs[0].q, np.delete(Q, [10, 20], axis=0))
    assert "times repeat or go back in 2 of 40 rows, which were dropped, first in row 11" in log.notes[0]


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (Columns("t"), r"time is asked of column 't', but there is no such column; the columns are: 'time', 'position_shoulder', "),
        (Columns(position="q_{joint}"), r"position is asked of column 'q_shoulder', but there is no such column"),
        (Columns(position=(1, 7)), r"position is asked of column 7, but the columns are 0 to 6"),
        (Columns(position=(1,)), r"columns.position lists 1 columns for 2 joints: shoulder, elbow"),
        (Columns(position="time"), r"position has 1 columns for 2 joints \(shoulder, elbow\); put {joint} into the name"),
    ],
)
def test_columns_that_are_not_there(tmp_path, columns, message):
    with pytest.raises(LogError, match=message):
        read_log(write_csv(tmp_path / "log.csv"), JOINTS, columns=columns)


def test_ambiguous_and_missing_names(tmp_path):
    path = write_csv(tmp_path / "log.csv", header=False, rows=[["time", "a", "a"], ["0", "1", "2"], ["1", "1", "2"]])
    with pytest.raises(LogError, match=r"position is asked of column 'a', but 2 columns have that name; give their numbers"):
        read_log(path, ["j"], columns=Columns("time", ("a",), None, None, (2,)))
    path = write_csv(tmp_path / "none.csv", header=False)
    with pytest.raises(LogError, match=r"time is asked of column 'time', but there is no header; give a number up to 6"):
        read_log(path, JOINTS)
    names = ",".join(f"c{i}" for i in range(100))
    path.write_text(names + "\n")
    with pytest.raises(LogError, match=r"'c59' and 40 more$"):
        read_log(path, JOINTS)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(LogError, match=r"none.csv: there is no such file"):
        read_log(tmp_path / "none.csv", JOINTS)
    with pytest.raises(LogError, match=r"this is a folder"):
        read_log(tmp_path, JOINTS)
    path = tmp_path / "log.csv"
    path.write_text("\n\n")
    with pytest.raises(LogError, match=r"log.csv: the file is empty"):
        read_log(path, JOINTS)
    write_csv(path, rows=[])
    with pytest.raises(LogError, match=r"log.csv: the file has no rows"):
        read_log(path, JOINTS)
    write_csv(path, rows=[["0"] * 7])
    with pytest.raises(LogError, match=r"log.csv: 1 rows are left, but a run needs at least 2"):
        read_log(path, JOINTS)
    path.write_bytes(b"time,\xff\xfe\n")
    with pytest.raises(LogError, match=r"log.csv: not a text file with columns"):
        read_log(path, JOINTS)
    path = path.rename(tmp_path / "log.bin")
    with pytest.raises(LogError, match=r"cannot tell the format by the suffix '.bin'; known are .csv, .*; give file_format=..."):
        read_log(path, JOINTS)
    with pytest.raises(LogError, match=r"log.bin: not an NPZ file"):
        read_log(path, JOINTS, file_format="npz")
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: a broken Parquet file was not read")
    with pytest.raises(LogError, match=r"log.bin: not a Parquet file"):
        read_log(path, JOINTS, file_format="parquet")


def test_arrays_that_do_not_fit(tmp_path):
    path = tmp_path / "log.npz"
    columns = Columns("t", "q", None, None, "tau")
    np.savez(path, t=TS, q=Q[:-1], tau=EFFORT)
    with pytest.raises(LogError, match=r"the columns have different lengths: 't' 40, 'q' 39, 'tau' 40"):
        read_log(path, JOINTS, columns=columns)
    np.savez(path, t=TS, q=np.array(["text"] * N), tau=EFFORT)
    with pytest.raises(LogError, match=r"column 'q' has type <U4 and shape \(40,\), but needs numbers, \(n,\) or \(n, njoint\)"):
        read_log(path, JOINTS, columns=columns)
    np.savez(path, t=TS, q=np.array([None] * N), tau=EFFORT)
    with pytest.raises(LogError, match=r"an array is not of numbers"):
        read_log(path, JOINTS, columns=columns)
    np.savez(path, t=Q, q=Q, tau=EFFORT)
    with pytest.raises(LogError, match=r"the times have shape \(40, 2\), but need \(n,\)"):
        read_log(path, JOINTS, columns=columns)
    np.savez(path, t=TS, q=np.column_stack((Q, Q)), tau=EFFORT)
    with pytest.raises(LogError, match=r"position has 4 columns for 2 joints"):
        read_log(path, JOINTS, columns=columns)


def test_options_without_meaning(tmp_path):
    path = write_csv(tmp_path / "log.csv")
    with pytest.raises(LogError, match=r"joints is the text 'elbow'; give a sequence of names"):
        read_log(path, "elbow")
    with pytest.raises(ValueError, match=r"delimiter is ', '; it must be one character"):
        read_log(path, JOINTS, delimiter=", ")


def test_a_real_log():
    path = UR10E / "ur-20_02_10-30sec_12harm.csv"
    if not path.exists():
        pytest.skip(f"{path} is absent: the log of a real UR10e was not read")
    joints = [f"joint{i}" for i in range(6)]
    columns = Columns(0, range(1, 7), range(7, 13), None, range(13, 19))
    (run,) = read_log(path, joints, columns=columns, rows=(635, 3510)).runs
    reference = np.loadtxt(path, delimiter=",")[634:3510]
    for array, expected in ((run.ts, reference[:, 0]), (run.q, reference[:, 1:7]), (run.u, reference[:, 7:13])):
        np.testing.assert_array_equal(array, expected)
    np.testing.assert_array_equal(run.effort, reference[:, 13:19])
