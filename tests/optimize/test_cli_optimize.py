"""The command `kanejax optimize`: files, exit codes, what it keeps, and what it refuses."""

import json
import pathlib
import re

import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

import kanejax as kj
from kanejax import cli
from kanejax._cli import optimize_progress
from kanejax._cli.terminal import BAD_INPUT, FAILED, INTERRUPTED
from kanejax._identify.report import svg

ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 -0.25"/><mass value="2"/>
<inertia ixx="0.05" iyy="0.05" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/>
<inertia ixx="0.02" iyy="0.02" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="tool"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="12" velocity="3"/><dynamics damping="0.1"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 -0.5"/><axis xyz="0 1 0"/>
<limit lower="-2.5" upper="2.5" effort="5" velocity="3"/><dynamics damping="0.05"/></joint>
<joint name="end" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="0 0 -0.4"/></joint></robot>"""
FILES = {"motion.json", "motion.npz", "motion.csv", "motion.png", "report.html", "run.log"}


@pytest.fixture(scope="module")
def example():
    """The printed example, with fewer steps."""
    found = CliRunner().invoke(cli.app, ["optimize", "--example"])
    assert found.exit_code == 0
    return found.stdout.replace("steps = 50 ", "steps = 10 ")


@pytest.fixture(scope="module")
def quick(example):
    """Without what takes time to write."""
    return example.replace("report = true", "report = false").replace("replay = true", "replay = false")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("task")
    (path / "arm.urdf").write_text(ARM)
    return path


def run(folder, text, *arguments, out="out"):
    (folder / "task.toml").write_text(text)
    given = ["optimize", folder / "task.toml", "--out", folder / out, *arguments]
    return CliRunner().invoke(cli.app, [str(argument) for argument in given])


@pytest.fixture(scope="module")
def first(folder, example):
    """The first run, on which others build."""
    return run(folder, example.replace('# title = "My arm"', 'title = "The <arm>"'))


@pytest.fixture
def cut(monkeypatch):
    """Ctrl-C when progress is shown for the so manieth time."""
    show, left = optimize_progress.SearchLine.__call__, []

    def shown(self, guess, motion):
        show(self, guess, motion)
        if left and left.pop() == "now":
            raise KeyboardInterrupt

    monkeypatch.setattr(optimize_progress.SearchLine, "__call__", shown)
    return lambda times: left.extend(["now", *[""] * (times - 1)])


def arrays(path):
    with np.load(path) as archive:
        return {name: archive[name] for name in archive.files}


def test_files_and_words_of_the_first_run(folder, first):
    assert first.exit_code == 0, first.output
    for text in ("torque", "optimal after", "replayed in diffrax", "replayed in MuJoCo", "written: ", "report.html"):
        assert text in first.stdout
    assert {path.name for path in (folder / "out").iterdir()} == FILES
    log = (folder / "out/run.log").read_text()
    assert re.search(r"iteration 10, cost [\d.]+, violation [\d.e-]+, slope ", log)
    assert (folder / "out/motion.png").read_bytes().startswith(b"\x89PNG")


def test_record_of_the_first_run(folder, first):
    record = json.loads((folder / "out/motion.json").read_text())
    assert record["converged"]
    assert record["problem"] is None
    assert max(record["errors"].values()) <= 1e-8
    assert record["costs"] == {"torque": record["cost"]}
    assert record["costs_of_guesses"] == [record["cost"]]
    assert record["greatest"]["u"]["elbow"] < 3.0 + 1e-6
    for replay in record["replays"].values():
        # The midpoint rule of ten steps.
        assert 0 < max(replay["q_at_end"].values()) < 0.05
    assert record["versions"]["jax"]


def test_motion_is_that_of_the_library(folder, first):
    arm = kj.load(folder / "arm.urdf")
    clear = kj.constraints.sphere_clearance("tool", 0.05, [0.0, 0.0, -1.05], 0.1)
    task = kj.MotionTask(
        arm,
        [-1.0, 0.5],
        [0.8, -0.6],
        1.0,
        kj.costs.torque(np.ones(2)),
        limits=kj.Limits(arm, u=3.0, tau=[12.0, 5.0]),
        constraints=clear,
        steps=10,
    )
    motion, found = kj.optimize(task), arrays(folder / "out/motion.npz")
    for name in ("ts", "q", "u", "u_dot", "tau", "cost"):
        np.testing.assert_allclose(found[name], getattr(motion, name), rtol=1e-7, atol=1e-7, err_msg=name)
    log = kj.read_log(folder / "out/motion.csv", ("shoulder", "elbow"))
    (part,) = log.runs
    np.testing.assert_array_equal(part.q, found["q"])
    np.testing.assert_array_equal(part.effort[:-1], found["tau"])


def test_page_of_the_first_run(folder, first):
    page = (folder / "out/report.html").read_text()
    assert "The &lt;arm&gt;" in page
    assert "Optimal after" in page
    (text,) = re.findall(r'id="motion-data">(.*?)</script>', page)
    data = json.loads(text)
    arm = kj.load(folder / "arm.urdf")
    ends = [kj.poses(arm, jnp.array(q)).origin for q in ([-1.0, 0.5], [0.8, -0.6])]
    for frame, origin in zip((data["frames"][0], data["frames"][-1]), ends, strict=True):
        np.testing.assert_allclose(frame[: data["bodies"]], origin, atol=1e-4)
    assert data["balls"] == [[0.0, 0.0, -1.05, 0.1]]
    assert len(data["panels"]) == 6


def test_interrupted_search_goes_on_as_if_it_had_not_been(folder, first, quick, cut):
    cut(1)
    result = run(folder, quick, out="cut")
    assert result.exit_code == INTERRUPTED
    assert "what is done is kept; --resume goes on from there" in " ".join(result.stderr.split())
    assert arrays(folder / "cut/unfinished.npz")["guess 0/|iterations"] == 10
    assert not (folder / "cut/motion.json").exists()
    # What is written does not count for what is kept.
    result = run(folder, quick.replace("replay = false", 'title = "x"\nreplay = false'), "--resume", out="cut")
    assert result.exit_code == 0, result.output
    log = (folder / "cut/run.log").read_text()
    assert "going on with " in log
    assert log.count("iteration 10, ") == 1
    assert {path.name for path in (folder / "cut").iterdir()} == {"motion.json", "motion.npz", "motion.csv", "run.log"}
    whole, resumed = arrays(folder / "out/motion.npz"), arrays(folder / "cut/motion.npz")
    for name, value in whole.items():
        np.testing.assert_array_equal(resumed[name], value, err_msg=name)


def test_unfinished_work_is_neither_lost_nor_gone_on_with_by_accident(folder, quick, cut):
    cut(1)
    assert run(folder, quick, out="held").exit_code == INTERRUPTED
    for text, flags, message in (
        (quick, (), r"held holds unfinished work of [\d: -]*; --resume goes on with it, --fresh drops it and begins anew"),
        (quick, ("--resume", "--fresh"), "--resume and --fresh exclude each other; give one"),
        (
            quick.replace("q = [0.8, -0.6]", "q = [0.8, -0.5]"),
            ("--resume",),
            "unfinished.npz belongs to other inputs; --fresh drops it and begins anew, or give another --out",
        ),
    ):
        result = run(folder, text, *flags, out="held")
        assert result.exit_code == BAD_INPUT
        (line,) = result.stderr.splitlines()
        assert re.search(message, line)
    assert run(folder, quick, "--fresh", out="held").exit_code == 0
    assert (folder / "held/run.log").read_text().count("iteration 10, ") == 2
    assert run(folder, quick, "--resume", out="held").exit_code == 0, "there is nothing to go on with"


def test_iterations_that_are_used_up_can_be_given_more(folder, first, quick):
    result = run(folder, quick.replace("# max_iterations = 300", "max_iterations = 6"), "--json", out="few")
    assert result.exit_code == FAILED
    assert "not converged: the iterations are used up; " in " ".join(result.stderr.split())
    record = json.loads(result.stdout)
    assert (record["converged"], record["result"], record["iterations"]) == (False, "RUNNING", 6)
    assert record["problem"].startswith("the iterations are used up; ")
    assert record == json.loads((folder / "few/motion.json").read_text())
    assert not arrays(folder / "few/motion.npz")["converged"]
    assert run(folder, quick, "--resume", out="few").exit_code == 0
    np.testing.assert_array_equal(arrays(folder / "few/motion.npz")["q"], arrays(folder / "out/motion.npz")["q"])
    assert not (folder / "few/unfinished.npz").exists()


def test_best_of_several_guesses(folder, quick, cut):
    several = quick.replace("# guesses = 64", "guesses = 3")
    result = run(folder, several, "--json", out="several")
    assert result.exit_code == 0, result.output
    whole = json.loads(result.stdout)
    ended = [cost for cost in whole["costs_of_guesses"] if cost is not None]
    assert len(whole["costs_of_guesses"]) == 3
    assert whole["cost"] == min(ended)
    seen = (folder / "several/run.log").read_text()
    # In the middle of the second guess.
    cut(seen.count("guess 1 of 3") + 1)
    assert run(folder, several, out="parts").exit_code == INTERRUPTED
    result = run(folder, several, "--json", "--resume", out="parts")
    assert result.exit_code == 0, result.output
    log = (folder / "parts/run.log").read_text()
    assert [log.count(f"guess {guess} of 3: iteration 10, ") for guess in (1, 2, 3)] == [1, 1, 1]
    parts = json.loads(result.stdout)
    assert {**parts, "seconds": 0} == {**whole, "seconds": 0}


def test_infeasible_tasks_are_told_in_a_sentence(folder, quick):
    result = run(folder, quick.replace("duration = 1.0 ", "duration = 0.3 "), out="infeasible")
    assert result.exit_code == FAILED
    assert "joint 'shoulder' moves by 1.8, which takes at least 0.6 s at its greatest speed" in " ".join(result.stderr.split())
    assert {path.name for path in (folder / "infeasible").iterdir()} == {"run.log"}


def test_missing_package_is_told_before_anything_is_computed(folder, example, monkeypatch):
    def missing(name):
        raise ImportError(f"a report needs the package {name}: pip install 'kanejax[report]'")

    monkeypatch.setattr(svg, "report_package", missing)
    result = run(folder, example, out="missing")
    assert result.exit_code == BAD_INPUT
    assert "pip install 'kanejax[report]'; or say report = false in [output] of the task" in " ".join(result.stderr.split())
    assert not (folder / "missing").exists()


def test_broken_file_of_a_search_is_not_used(folder, quick):
    (folder / "broken").mkdir()
    (folder / "broken/unfinished.npz").write_bytes(b"half a fi")
    result = run(folder, quick, "--resume", out="broken")
    assert result.exit_code == BAD_INPUT
    assert "unfinished.npz is no checkpoint, or broken; --fresh drops it and begins anew" in " ".join(result.stderr.split())
    assert (folder / "broken/unfinished.npz").read_bytes() == b"half a fi"


def test_task_of_the_guide(folder):
    guide = pathlib.Path(kj.__file__).parents[1] / "docs" / "optimization.md"
    (text,) = re.findall(r"```toml\n(.*?)```", guide.read_text(), re.DOTALL)
    fewer = "[solver]\nsteps = 10\n[output]\nreport = false\nreplay = false\n"
    result = run(folder, text + fewer, "--json", out="guide")
    assert result.exit_code == 0, result.output
    record = json.loads(result.stdout)
    assert 0.3 < record["duration"] < 3.0
    arm, found = kj.load(folder / "arm.urdf"), arrays(folder / "guide/motion.npz")
    end = kj.poses(arm, jnp.asarray(found["q"][-1])).origin[arm.tree.body("tool")]
    np.testing.assert_allclose(end, [0.3, 0.0, -0.6], atol=1e-7)
