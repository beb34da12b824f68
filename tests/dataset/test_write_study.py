"""Data sets: what is in them, that nothing is lost or mixed by interruptions, and what is refused."""

import dataclasses
import json
import os
import shutil
import threading

import numpy as np
import pytest
import xarray

import kanejax as kj
from experiments.fuzz.cases import case
from experiments.fuzz.judge import judged
from kanejax import distributions
from kanejax._dataset import store as stores, write_study as module

TS = np.linspace(0.0, 0.3, 4)
ARM = """<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.05" mass="2"/><body name="lower" pos="0 0 -0.5">
<joint name="elbow" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.04" mass="1"/>
</body></body></worldbody></mujoco>"""
CHUNK, COUNT = 16, 70


@pytest.fixture(scope="module")
def study():
    return kj.Study(
        kj.load(ARM),
        TS,
        COUNT,
        parameters={"density": kj.Randomized(), "damping": kj.Randomized(distributions.Uniform(0.0, 0.5), "added")},
        control=kj.RandomForces(distributions.Normal(0.0, 2.0), 0.1),
        seed=5,
    )


def write(study, path, **options):
    return kj.write_study(study, path, chunk=CHUNK, batch_size=32, **options)


@pytest.fixture(scope="module")
def whole(study, tmp_path_factory):
    """A data set that was written without an interruption."""
    return write(study, tmp_path_factory.mktemp("data") / "whole.zarr", source={"robot": "arm.xml"})


def files(path):
    """Content of every file, by name."""
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


def test_xarray_reads_names_units_and_attributes(whole, study):
    data = xarray.open_zarr(whole)
    assert data.q.dims == ("trajectory", "time", "coordinate")
    assert data.u.dims == ("trajectory", "time", "speed")
    assert data.tau.dims == ("trajectory", "force_time", "speed")
    assert data.central_inertia.dims == ("trajectory", "body", "row", "axis")
    np.testing.assert_array_equal(data.time, TS)
    assert data.time.attrs["units"] == "s"
    assert data.q.attrs["joints"] == ["shoulder", "elbow"]
    assert data.attrs["robot"] == "arm.xml"
    assert data.attrs["seed"] == 5
    assert data.attrs["versions"]["kanejax"] == kj.__version__
    assert data.attrs["parameters"]["damping"] == "added: Uniform(low = 0.0, high = 0.5)"
    assert set(data.status.values.tolist()) == {kj.Status.SUCCESSFUL}


def test_trajectories_are_those_of_what_was_drawn(whole, study):
    data = xarray.open_zarr(whole)
    for row in (0, 17, COUNT - 1):
        drawn = study.rows(row, 1)
        for name, leaf in (*drawn.leaves.items(), ("tau", drawn.forces)):
            np.testing.assert_array_equal(data[name][row], leaf[0])
        model = study.model.replace(**{name: leaf[0] for name, leaf in drawn.leaves.items()})
        control = kj.TorqueTable(study.force_times, drawn.forces[0], "hold")
        path = kj.simulate(model, drawn.q0[0], drawn.u0[0], TS, control=control)
        np.testing.assert_allclose(data.q[row], path.q, rtol=0, atol=1e-12)
        np.testing.assert_allclose(data.u[row], path.u, rtol=0, atol=1e-11)
        assert int(data.num_steps[row]) == int(path.stats["num_steps"])


@pytest.mark.parametrize("threads", [1, 2])
def test_chunks_that_are_lost_come_back_with_the_same_bits(whole, study, tmp_path, threads):
    again = tmp_path / "again.zarr"
    shutil.copytree(whole, again)
    for name in ("status/c/1", "q/c/1/0/0", "status/c/4", "u/c/2/0/0"):
        (again / name).unlink()
    # What a killed process leaves.
    (again / "q" / "c" / "1" / "0" / "0.0123.partial").write_bytes(b"half")
    missing = xarray.open_zarr(again).status.values == kj.Status.NOT_RUN
    np.testing.assert_array_equal(missing, np.isin(np.arange(COUNT) // CHUNK, (1, 4)))
    write(study, again, resume=True, threads=threads, source={"robot": "arm.xml"})
    assert files(again) == files(whole)


def test_a_full_disk_loses_nothing_that_was_written(whole, study, tmp_path, monkeypatch):
    path, write_chunk, written = tmp_path / "full.zarr", stores.Store.write, []

    def fails(self, chunk, arrays):
        if len(written) == 2:
            raise OSError(28, "No space left on device")
        write_chunk(self, chunk, arrays)
        written.append(chunk)

    monkeypatch.setattr(stores.Store, "write", fails)
    with pytest.raises(OSError, match="No space left"):
        write(study, path, threads=1, source={"robot": "arm.xml"})
    kept = xarray.open_zarr(path).status.values != kj.Status.NOT_RUN
    np.testing.assert_array_equal(kept, np.isin(np.arange(COUNT) // CHUNK, written))
    monkeypatch.undo()
    write(study, path, resume=True, source={"robot": "arm.xml"})
    assert files(path) == files(whole)


def test_an_interrupt_is_told_and_gone_on_from(whole, study, tmp_path, monkeypatch):
    path, write_chunk = tmp_path / "interrupted.zarr", stores.Store.write

    def interrupts(self, chunk, arrays):
        write_chunk(self, chunk, arrays)
        raise KeyboardInterrupt

    monkeypatch.setattr(stores.Store, "write", interrupts)
    with pytest.raises(module.StudyInterrupted, match=r"4 of 5 chunks are missing; go on with resume=True"):
        write(study, path, threads=1, source={"robot": "arm.xml"})
    monkeypatch.undo()
    write(study, path, resume=True, source={"robot": "arm.xml"})
    assert files(path) == files(whole)


def test_memory_holds_some_chunks_only(study, tmp_path, monkeypatch):
    from kanejax._dataset import chunks

    most, lock, alive = [0], threading.Lock(), [0]
    made, gone = chunks._OpenChunk.__init__, stores.Store.write

    def counted(self, *args):
        with lock:
            alive[0] += 1
            most[0] = max(most[0], alive[0])
        made(self, *args)

    def written(self, *args):
        gone(self, *args)
        with lock:
            alive[0] -= 1

    monkeypatch.setattr(chunks._OpenChunk, "__init__", counted)
    monkeypatch.setattr(stores.Store, "write", written)
    kj.write_study(study, tmp_path / "small.zarr", chunk=4, batch_size=32, threads=1)
    # As many as the lanes need, and two.
    assert most[0] <= 32 // 4 + 2 < COUNT // 4


def test_other_trajectories_are_refused(whole, study, tmp_path):
    with pytest.raises(kj.DatasetError, match="is there already"):
        write(study, whole)
    for change, message in (
        ({"seed": 6}, "seed is 6, but was 5"),
        ({"trajectories": 71}, "trajectories is 71, but was 70"),
        ({"ts": np.linspace(0.0, 0.4, 4)}, "times_fingerprint"),
        ({"model": study.model.replace(mass=1.01 * study.model.mass)}, "model_fingerprint"),
        ({"parameters": {}}, "parameters is {}"),
        ({"options": {"dt0": 0.01}}, 'options is {"dt0": "0.01"}'),
    ):
        with pytest.raises(kj.DatasetError, match=message):
            write(dataclasses.replace(study, **change), whole, resume=True, source={"robot": "arm.xml"})
    with pytest.raises(kj.DatasetError, match="chunk is 8, but was 16"):
        kj.write_study(study, whole, chunk=8, batch_size=32, resume=True, source={"robot": "arm.xml"})


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[]", b'{"attributes": 3}', b"\xff\xfe", b"[" * 100000, b'{"attributes": {"seed": 5}, "zarr_format": 2}'],
    ids=["nothing", "cut", "list", "number", "no text", "nested", "other format"],
)
def test_metadata_that_someone_else_wrote_is_not_believed(whole, study, tmp_path, content):
    again = tmp_path / "again.zarr"
    shutil.copytree(whole, again)
    for name in ("zarr.json", "q/zarr.json"):
        (again / name).write_bytes(content)
        with pytest.raises(kj.DatasetError):
            write(study, again, resume=True, source={"robot": "arm.xml"})
        shutil.copy(whole / name, again / name)


def test_links_lead_nowhere(whole, study, tmp_path):
    outside = tmp_path / "outside"
    shutil.copytree(whole / "q", outside)
    before = files(outside)
    for number, (name, is_done) in enumerate((("q", False), ("q/c/1", False), ("q/c/1", True), ("q/c/1/0/0", True))):
        again = tmp_path / f"again{number}.zarr"
        shutil.copytree(whole, again)
        if (again / name).is_dir():
            shutil.rmtree(again / name)
        else:
            (again / name).unlink()
        if not is_done:
            (again / "status" / "c" / "1").unlink()
        os.symlink(outside / name.removeprefix("q").lstrip("/"), again / name)
        with pytest.raises(kj.DatasetError, match=r"is a link|behind one"):
            write(study, again, resume=True, source={"robot": "arm.xml"})
    link = tmp_path / "link.zarr"
    os.symlink(whole, link)
    with pytest.raises(kj.DatasetError, match="is a link"):
        write(study, link, resume=True, source={"robot": "arm.xml"})
    assert files(outside) == before


def test_a_failed_trajectory_says_so(study, tmp_path):
    path = write(dataclasses.replace(study, trajectories=32, options={"max_steps": 3}), tmp_path / "short.zarr")
    data = xarray.open_zarr(path)
    assert set(data.status.values.tolist()) == {kj.Status.MAX_STEPS}
    assert data.status.attrs["flag_meanings"].split()[kj.Status.MAX_STEPS] == "MAX_STEPS"
    assert np.all(np.isfinite(data.q[:, 0]))
    assert np.all(np.isnan(data.q[:, -1]))


def test_attributes_are_plain_json(whole):
    assert json.loads((whole / "zarr.json").read_text())["attributes"]["chunk"] == CHUNK


def test_mutated_stores_are_gone_on_with_or_refused_by_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcomes = set()
    for seed in range(100):
        folder = tmp_path / str(seed)
        folder.mkdir()
        verdict = judged(case("data set", seed), folder)
        assert verdict.finding == "", f"{seed}: {verdict}"
        outcomes.add(verdict.outcome)
    assert outcomes == {"loaded", "DatasetError"}


def test_chunks_that_memory_does_not_hold_are_refused(study, tmp_path):
    long = dataclasses.replace(study, ts=np.linspace(0.0, 1.0, 1_000_001), trajectories=10**6)
    with pytest.raises(kj.DatasetError, match=r"a chunk of 1024 trajectories has [0-9.]+ GB; give a smaller chunk, or fewer times"):
        kj.write_study(long, tmp_path / "long.zarr")
    with pytest.raises(kj.DatasetError, match="give a larger chunk"):
        kj.write_study(dataclasses.replace(study, trajectories=10**12), tmp_path / "many.zarr")
    assert not list(tmp_path.iterdir())
