"""Hostile logs and configurations: a slice of the fuzzer's inputs, and each attack and finding by itself."""

import importlib.util
import io
import json
import pathlib
import pickle
import zipfile
from typing import Any

import numpy as np
import pytest

from experiments.fuzz import seeds
from experiments.fuzz.cases import case
from experiments.fuzz.judge import judged
from kanejax._errors import LogError
from kanejax._identify.configuration import parsed_configuration
from kanejax._logs.columns import Columns
from kanejax._logs.read_log import read_log
from kanejax._toml import ConfigurationError

JOINTS = seeds.JOINTS


@pytest.mark.parametrize(
    ("kind", "count"), [("CSV log", 150), ("NPZ log", 120), ("Parquet log", 60), ("MCAP log", 60), ("identify TOML", 60)]
)
def test_mutated_logs_are_read_or_refused_by_name(kind, count, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for seed in range(count):
        folder = tmp_path / str(seed)
        folder.mkdir()
        verdict = judged(case(kind, seed), folder)
        assert verdict.finding == "", f"{kind} {seed}: {verdict}"


def test_seeds_are_read(tmp_path):
    for name, made in (
        ("log.csv", seeds.csv()),
        ("log.npz", seeds.npz()),
        ("log.parquet", seeds.parquet()),
        ("log.mcap", seeds.mcap()),
    ):
        if made is not None:
            (tmp_path / name).write_bytes(made)
            np.testing.assert_allclose(read_log(tmp_path / name, JOINTS).runs[0].q, seeds.columns()[1][:, 1:3], atol=1e-15)


class Trap:
    """What unpickling would carry out."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return pathlib.Path.touch, (self.path,)


def test_nothing_is_unpickled(tmp_path):
    trap = tmp_path / "sprung"
    names, values = seeds.columns()
    columns: dict[str, Any] = dict(zip(names, values.T, strict=True))
    columns["time"] = np.array([Trap(trap)] * len(values), object)
    np.savez(tmp_path / "log.npz", **columns)
    with pytest.raises(LogError, match="allow_pickle"):
        read_log(tmp_path / "log.npz", JOINTS)
    (tmp_path / "bare.npz").write_bytes(pickle.dumps(Trap(trap)))
    with pytest.raises(LogError, match="not an NPZ file"):
        read_log(tmp_path / "bare.npz", JOINTS)
    assert not trap.exists()


def test_archives_that_unpack_to_much_are_refused(tmp_path):
    names, values = seeds.columns()
    header = io.BytesIO()
    count = 2**29 // 8
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (count,)})
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            stream = io.BytesIO()
            np.save(stream, values[:, 0])
            archive.writestr(f"{name}.npy", stream.getvalue())
        with archive.open("position_bomb.npy", "w") as entry:
            entry.write(header.getvalue())
            for _ in range(2**29 // 2**22):
                entry.write(bytes(2**22))
    columns = Columns(position=("position_bomb", "position_elbow"))
    with pytest.raises(LogError, match=r"unpack to \d+ bytes, from a file of \d+"):
        read_log(tmp_path / "bomb.npz", JOINTS, columns=columns)


def test_arrays_that_promise_more_than_there_is(tmp_path):
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }\n"
    array = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(80)
    with zipfile.ZipFile(tmp_path / "log.npz", "w") as archive:
        for name in seeds.columns()[0]:
            archive.writestr(f"{name}.npy", array)
    with pytest.raises(LogError, match="says that it is larger than it is"):
        read_log(tmp_path / "log.npz", JOINTS)


def test_names_of_arrays_lead_nowhere(tmp_path):
    names, values = seeds.columns()
    np.savez(tmp_path / "log.npz", **dict(zip(names, values.T, strict=True)))
    with zipfile.ZipFile(tmp_path / "log.npz", "a") as archive:
        archive.writestr("../../outside.npy", b"x")
    assert len(read_log(tmp_path / "log.npz", JOINTS).runs[0]) == len(values)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.npz"]


def test_broken_archives(tmp_path):
    whole = seeds.npz()
    for number, data in enumerate(
        (whole[:100] + b"?" + whole[101:], whole[:30] + b"?" * 40 + whole[70:], whole[:-30], b"PK\x03\x04")
    ):
        (tmp_path / f"{number}.npz").write_bytes(data)
        with pytest.raises(LogError):
            read_log(tmp_path / f"{number}.npz", JOINTS)


def test_times_stand_in_the_column_of_times_only(tmp_path):
    names, values = seeds.columns()
    columns = dict(zip(names, values.T, strict=True)) | {"position_elbow": np.zeros(len(values), "M8[ns]")}
    np.savez(tmp_path / "log.npz", **columns)  # type: ignore[arg-type]
    with pytest.raises(LogError, match="position is asked of a column of times"):
        read_log(tmp_path / "log.npz", JOINTS)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b'"' + b"x" * 200_000 + b'",1\n', "field larger than field limit"),
        (b",".join([b"a"] * 100_000) + b"\n1\n", "there is no such column"),
        (b"1,x," * 100_000 + b"\n", "the first line has numbers and text"),
        (b"time,position_shoulder,position_elbow,effort_shoulder,effort_elbow\n0,1,1,1," + b"x" * 100_000 + b"\n", "not a number"),
        (b"\xff\xfe\x00", "not a text file"),
        (b"#\n", "the columns are: none"),
    ],
)
def test_hostile_text(data, message, tmp_path):
    (tmp_path / "log.csv").write_bytes(data)
    with pytest.raises(LogError, match=message) as raised:
        read_log(tmp_path / "log.csv", JOINTS)
    assert len(str(raised.value)) < 12_000


@pytest.mark.parametrize("delimiter", ['"', "\n", "\r", "\0", ""])
def test_delimiters_that_cannot_be(delimiter, tmp_path):
    (tmp_path / "log.csv").write_bytes(seeds.csv())
    with pytest.raises(LogError, match="delimiter is"):
        read_log(tmp_path / "log.csv", JOINTS, delimiter=delimiter)


@pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None, reason="pyarrow is not installed: Parquet files were not read")
def test_parquet_that_contradicts_itself_or_unpacks_to_much(tmp_path):
    import pyarrow
    import pyarrow.parquet

    names, _ = seeds.columns()
    zeros = np.zeros(2**23)
    pyarrow.parquet.write_table(pyarrow.table(dict.fromkeys(names, zeros)), tmp_path / "bomb.parquet", compression="zstd")
    with pytest.raises(LogError, match="unpack to"):
        read_log(tmp_path / "bomb.parquet", JOINTS)
    whole = seeds.parquet() or b""
    (tmp_path / "cut.parquet").write_bytes(whole[:40] + bytes(60) + whole[100:])
    with pytest.raises(LogError, match="the columns cannot be read"):
        read_log(tmp_path / "cut.parquet", JOINTS)


@pytest.mark.skipif(importlib.util.find_spec("mcap") is None, reason="mcap is not installed: MCAP files were not read")
@pytest.mark.parametrize(
    "change",
    [
        {"position": ["1", "2"]},
        {"position": 3},
        {"name": [["a"], "b"]},
        {"effort": [True, 1.0]},
        {"position": [10**400, 0]},
        {"name": 5},
    ],
)
def test_messages_of_anything(change, tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "log.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/arm", "json", writer.register_schema("JointState", "jsonschema", b"{}"))
        for i in range(3):
            message = {"name": list(JOINTS), "position": [0.0, 1.0], "effort": [0.0, 1.0], **(change if i == 1 else {})}
            writer.add_message(channel, i, json.dumps(message).encode(), i)
        writer.finish()
    with pytest.raises(LogError, match="not an MCAP file that can be read"):
        read_log(tmp_path / "log.mcap", JOINTS, columns=Columns(time="log_time"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = " + "[" * 100_000, "not TOML"),
        ("x = " + "9" * 10_000, "not TOML"),
        ("[locked]\nwrist = nan", r"\[locked\] wrist is nan; it must be a number"),
        ("[motion]\ncutoff = 1" + "0" * 400, r"\[motion\] cutoff is 10+; it must be"),
    ],
)
def test_hostile_configurations(text, message):
    with pytest.raises(ConfigurationError, match=message):
        parsed_configuration(text)
