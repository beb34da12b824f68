"""Hostile robots and tables: a slice of the fuzzer's inputs, and each attack and finding by itself."""

import os
import pathlib
import sys
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

import kanejax as kj
from experiments.fuzz import seeds
from experiments.fuzz.cases import Case, case
from experiments.fuzz.judge import judged

PENDULUM = seeds.PENDULUM
TETRAHEDRON = seeds.TETRAHEDRON
INERTIAL = '<inertial><mass value="1"/><inertia ixx="{0}" iyy="{0}" izz="{0}" ixy="0" ixz="0" iyz="0"/></inertial>'


def mjcf(world: str = "", before: str = "", after: str = "") -> str:
    """A pendulum with more in its body, before its world, and after."""
    text = PENDULUM.replace("</body>", f"{world}</body>").replace("<mujoco>", f"<mujoco>{before}")
    return text.replace("</mujoco>", f"{after}</mujoco>")


def chain(count: int, inertia: str = "1") -> str:
    """A URDF whose links hang one on the other."""
    links = "".join(f'<link name="l{i}">{INERTIAL.format(inertia)}</link>' for i in range(count))
    ends = '<parent link="l{}"/><child link="l{}"/>'
    joints = "".join(f'<joint name="j{i}" type="revolute">{ends.format(i - 1, i)}</joint>' for i in range(1, count))
    return f'<robot name="chain">{links}{joints}</robot>'


@pytest.mark.parametrize(
    ("kind", "count"),
    [
        ("URDF file", 120),
        ("MJCF file", 160),
        ("XML text", 60),
        ("mesh file", 60),
        ("DH table", 200),
        ("task TOML", 25),
        ("study TOML", 40),
        ("seen robot", 60),
        ("seen motion", 60),
    ],
)
def test_mutated_input_loads_or_is_refused_by_name(
    kind: str, count: int, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # So that the folder is as before, once the inputs went through folders of their own.
    monkeypatch.chdir(tmp_path)
    outcomes = set()
    for seed in range(count):
        folder = tmp_path / str(seed)
        folder.mkdir()
        verdict = judged(case(kind, seed), folder)
        assert verdict.finding == "", f"{kind} {seed}: {verdict}"
        outcomes.add(verdict.outcome)
    assert "loaded" in outcomes
    assert len(outcomes) > 1


def test_seeds_load(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for kind, files in (
        ("URDF file", {"main.xml": seeds.URDF.encode()}),
        ("MJCF file", {**seeds.BESIDE, "main.xml": seeds.MJCF.encode()}),
        ("identify TOML", {"main.toml": seeds.CONFIGURATION.encode()}),
        ("task TOML", {"main.toml": seeds.TASK.encode(), "arm.xml": PENDULUM.encode()}),
    ):
        folder = tmp_path / kind
        folder.mkdir()
        assert judged(Case(kind, "main.toml" if "TOML" in kind else "main.xml", files), folder).outcome == "loaded"


ENTITIES = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(9))


@pytest.mark.parametrize(
    "declared",
    [
        f'<!DOCTYPE r [<!ENTITY e0 "ha">{ENTITIES}]>',
        f'<!DOCTYPE r [<!ENTITY e9 "{"a" * 100_000}">]>',
        '<!DOCTYPE r [<!ENTITY e9 SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE r [<!ENTITY % e9 SYSTEM "file:///etc/passwd"> %e9;]>',
        '<!DOCTYPE r SYSTEM "file:///etc/passwd">',
    ],
    ids=["laughs", "quadratic", "external", "parameter", "system"],
)
def test_entities_are_refused(declared: str, tmp_path: pathlib.Path) -> None:
    for name, text in (("r.urdf", f"{declared}<robot>&e9;</robot>"), ("m.xml", f"{declared}<mujoco>&e9;</mujoco>")):
        (tmp_path / name).write_text(text)
        for source in (tmp_path / name, text):
            with pytest.raises(kj.ModelFileError, match="DOCTYPE"):
                kj.load(source)


def inside(tmp_path: pathlib.Path, text: str) -> pathlib.Path:
    """Write a robot into a folder beside which there are files that it must not read."""
    (tmp_path / "secret.xml").write_text('<mujoco><option gravity="0 0 -77"/></mujoco>')
    (tmp_path / "secret.obj").write_bytes(TETRAHEDRON)
    folder = tmp_path / "robot"
    folder.mkdir(exist_ok=True)
    (folder / "arm.xml").write_text(text)
    return folder / "arm.xml"


@pytest.mark.parametrize(
    "file", ["../secret.xml", "{}/secret.xml", "sub/../../secret.xml", "..\\secret.xml", "link.xml", "/dev/zero"]
)
@pytest.mark.parametrize("element", ['<include file="{}"/>', '<asset><model name="m" file="{}"/></asset>'])
def test_files_outside_of_the_folder_are_refused(element: str, file: str, tmp_path: pathlib.Path) -> None:
    path = inside(tmp_path, mjcf(before=element.format(file.format(tmp_path))))
    (path.parent / "link.xml").symlink_to("../secret.xml")
    with pytest.raises(
        kj.ModelFileError, match=r"names the file .* lies outside of .*; copy it there, or read the model with mujoco"
    ):
        kj.load(path)


def test_links_cannot_turn_the_meaning_of_two_dots(tmp_path: pathlib.Path) -> None:
    path = inside(tmp_path, mjcf(before='<include file="link/../../secret.xml"/>'))
    (path.parent / "a/b").mkdir(parents=True)
    (path.parent / "secret.xml").write_text("<mujoco/>")
    (path.parent / "link").symlink_to("a/b")
    with pytest.raises(kj.ModelFileError, match="lies outside"):
        kj.load(path)


def test_includes_cannot_hide(tmp_path: pathlib.Path) -> None:
    hidden = '<option><include xmlns="http://x" file="../secret.xml"/></option>'
    with pytest.raises(kj.ModelFileError, match="lies outside"):
        kj.load(inside(tmp_path, mjcf(before=hidden)))
    path = inside(tmp_path, mjcf(before='<include file="second.xml"/>'))
    (path.parent / "second.xml").write_text('<mujoco><include file="../secret.xml"/></mujoco>')
    with pytest.raises(kj.ModelFileError, match="lies outside"):
        kj.load(path)
    path.write_bytes(mjcf(before='<?xml version="1.0" encoding="cp037"?>').encode())
    with pytest.raises(kj.ModelFileError):
        kj.load(path)
    path.write_bytes(b'<?xml version="1.0" encoding="utf-16"?>'.decode().encode("utf-16") + PENDULUM.encode("utf-16-le"))
    with pytest.raises(kj.ModelFileError, match="UTF-8"):
        kj.load(path)


@pytest.mark.parametrize("file", ["../secret.obj", "{}/secret.obj", "link.obj"])
def test_meshes_outside_of_the_folder(file: str, tmp_path: pathlib.Path) -> None:
    asset = f'<asset><mesh name="m" file="{file.format(tmp_path)}"/></asset>'
    needed = '<body name="b"><joint/><geom type="mesh" mesh="m"/></body>'
    path = inside(tmp_path, mjcf(needed, asset))
    (path.parent / "link.obj").symlink_to("../secret.obj")
    with pytest.raises(kj.ModelFileError, match=r"body 'b', whose inertia is that of mesh 'm', names the file .* lies outside of"):
        kj.load(path)
    # The caller may read it all the same.
    assert kj.load(mujoco.MjSpec.from_file(str(path))).nbody == 2
    path.write_text(mjcf('<geom type="mesh" mesh="m" mass="0"/>', asset))
    assert kj.load(path).mass == 1
    assert "files are not read, as no inertia needs them" in kj.load_report(path).unmodelled[0]


def test_mesh_folders_outside_of_the_folder(tmp_path: pathlib.Path) -> None:
    body = '<body name="b"><joint/><geom type="mesh" mesh="m"/></body>'
    asset = '<compiler meshdir="..{}"/><asset><mesh name="m" file="secret.obj"/></asset>'
    for more, before in (("", ""), ("", '<include file="more.xml"/>'), ('" strippath="true', "")):
        path = inside(tmp_path, mjcf(body, before or asset.format(more)))
        (path.parent / "more.xml").write_text(f"<mujoco>{asset.format(more)}</mujoco>")
        with pytest.raises(kj.ModelFileError, match="lies outside"):
            kj.load(path)


def test_files_that_no_inertia_needs_are_not_read(tmp_path: pathlib.Path) -> None:
    assets = '<mesh name="m" file="bad.stl"/><texture name="t" type="2d" file="bad.png"/>'
    assets += '<hfield name="h" file="bad.png" size="1 1 1 1"/>'
    path = inside(tmp_path, mjcf('<geom type="mesh" mesh="m" mass="0"/>', f"<asset>{assets}</asset>"))
    for name in ("bad.stl", "bad.png"):
        # Reading from a pipe would never end.
        os.mkfifo(path.parent / name)
    assert kj.load(path).nbody == 1


def test_links_to_the_folder_of_a_link_are_followed(tmp_path: pathlib.Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    (source / "arm.xml").write_text(mjcf(before='<include file="more.xml"/>'))
    (source / "more.xml").write_text('<mujoco><option gravity="0 0 -1"/></mujoco>')
    share = tmp_path / "share"
    share.mkdir()
    for name in ("arm.xml", "more.xml"):
        (share / name).symlink_to(source / name)
    np.testing.assert_array_equal(kj.load(share / "arm.xml").gravity, [0, 0, -1])


def test_text_reads_no_files(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "more.xml").write_text("<mujoco/>")
    (tmp_path / "part.obj").write_bytes(TETRAHEDRON)
    mesh = mjcf('<body><joint/><geom type="mesh" mesh="m"/></body>', '<asset><mesh name="m" file="part.obj"/></asset>')
    for text in (mjcf(before='<include file="more.xml"/>'), mesh):
        with pytest.raises(kj.ModelFileError, match="XML text reads no files"):
            kj.load(text)


def test_a_urdf_reads_no_files_and_takes_no_sizes(tmp_path: pathlib.Path) -> None:
    more = '<include file="../secret.xml"/><size nuser_body="2000000000"/>'
    text = (
        chain(3)
        .replace("</inertial>", '<include file="../secret.xml"/></inertial>')
        .replace("</robot>", f"<mujoco>{more}</mujoco></robot>")
    )
    path = inside(tmp_path, text)
    assert kj.load(path).gravity[2] == -9.81


def test_a_model_that_takes_parts_from_itself(tmp_path: pathlib.Path) -> None:
    part = '<asset><model name="s" file="{}"/></asset>'
    attach = '<attach model="s" body="arm" prefix="x"/>'
    path = inside(tmp_path, mjcf(attach, part.format("arm.xml")))
    with pytest.raises(kj.ModelFileError, match="takes parts from itself"):
        kj.load(path)
    for i in range(14):
        world = f'{attach}<attach model="s" body="arm" prefix="y"/>' if i else ""
        (path.parent / f"{i}.xml").write_text(mjcf(world, part.format(f"{i - 1}.xml") if i else ""))
    with pytest.raises(kj.ModelFileError, match="more than 10000 bodies"):
        kj.load(path.parent / "13.xml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (mjcf('<replicate count="1000000000"><body/></replicate>'), r"<replicate count='1000000000'> is not made of whole numbers"),
        (mjcf('<replicate count="-inf"><body/></replicate>'), r"<replicate count='-inf'>"),
        (mjcf('<replicate count="50"><replicate count="50"><body/></replicate></replicate>'), "makes 2500 copies"),
        (mjcf('<flexcomp type="grid" count="300 300 300" spacing="1 1 1" name="f" dim="3"/>'), "makes 27000000 copies"),
        (mjcf('<flexcomp type="grid" count="3 3 3" cellcount="2000000000 9 9" name="f"/>'), "<flexcomp cellcount="),
        (mjcf('<camera name="c" resolution="100000 100000"/>'), r"<camera resolution='100000 100000'> 'c'"),
        (mjcf(before='<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>'), "<hfield nrow='60000'> 'h'"),
        (mjcf(before='<asset><mesh name="m" builtin="cone" params="100000 1"/></asset>'), "<mesh params='100000 1'> 'm'"),
        (mjcf(after='<actuator><general joint="hinge" actdim="2000000000"/></actuator>'), "<general actdim="),
        (mjcf(after='<sensor><user dim="2000000000"/></sensor>'), "<user dim="),
        (mjcf(after='<sensor><contact geom1="ball" num="2000000000"/></sensor>'), "<contact num="),
        (mjcf("<body>" * 600 + "</body>" * 600), "nested more than 500 elements deep"),
        (mjcf("<site/>" * 50_001), "more than 10000 bodies or 50000 elements"),
        (chain(1003), "more than 1000 links one below another"),
        ('<robot name="r">' + '<link name="l"/>' * 10_001 + "</robot>", "10001 links, but at most 10000"),
        ("<mujoco>\ud800</mujoco>", "cannot be decoded"),
    ],
)
def test_more_than_memory_holds(text: str, message: str) -> None:
    with pytest.raises(kj.ModelFileError, match=message):
        kj.load(text)


@pytest.mark.parametrize(
    "before",
    [
        '<size memory="4000G" nuser_body="1000000000" nkey="100000000"/>',
        '<size njmax="2000000000" nconmax="2000000000"/>',
        '<asset><texture name="t" type="2d" builtin="checker" width="60000" height="60000"/></asset>',
        '<compiler><lengthrange mode="all" inttotal="1e12" timestep="1e-9"/></compiler>',
    ],
)
def test_sizes_that_the_dynamics_do_not_need_are_not_taken(before: str) -> None:
    after = '<actuator><motor joint="hinge"/></actuator>'
    assert kj.load(mjcf(before=before, after=after)).mass == 1


def test_flexible_bodies_from_files_are_refused(tmp_path: pathlib.Path) -> None:
    path = inside(tmp_path, mjcf('<flexcomp name="f" type="mesh" file="../secret.obj" dim="2"/>'))
    with pytest.raises(kj.UnsupportedModelError, match="flexcomp 'f' is a deformable body from a file"):
        kj.load(path, strict=False)


def test_a_long_chain_that_moves_no_inertia_is_refused_soon() -> None:
    text = chain(400, "0")
    with pytest.raises(kj.InvalidInertiaError, match="a joint moves too little inertia"):
        kj.load(text)
    with pytest.raises(kj.InvalidInertiaError, match="too many to repair"):
        kj.load(text, repair=True)


def test_names_that_mean_nothing() -> None:
    with pytest.raises(kj.ModelFileError, match="nowhere"):
        kj.load(mjcf('<body><joint/><geom type="mesh" mesh="nowhere"/></body>'))


def large(number: str) -> list[Callable[[], kj.Model]]:
    """Ways to load a number that is finite."""
    return [
        lambda: kj.load(chain(3, number)),
        lambda: kj.load(PENDULUM.replace('mass="1"', f'mass="{number}"')),
        lambda: kj.load(PENDULUM.replace("<joint", f'<inertial pos="0 0 0" mass="{number}" diaginertia="1 1 1"/><joint')),
        lambda: kj.from_dh([kj.DHLink(1.0, central_inertia=(float(number),) * 3)]),
        lambda: kj.from_dh([kj.DHLink(1.0, (float(number), 0, 0))]),
    ]


def test_numbers_whose_products_overflow_are_refused() -> None:
    for load in large("1e308"):
        with pytest.raises((kj.InvalidInertiaError, kj.InvalidParameterError), match="too large"):
            load()
    for load in large("1e20"):
        assert load().nbody > 0


def test_texts_are_no_numbers_of_a_table() -> None:
    for change, message in (
        ({"mass": "1"}, "mass = '1' is no array of numbers"),
        ({"mass": True}, "mass = True is no array of numbers"),
        ({"com": (10**400, 0, 0)}, "is no array of numbers"),
        ({"name": 1.5}, "row 1: name = 1.5 is no text"),
        ({"central_inertia": "x"}, "central_inertia = 'x' is no array of numbers"),
    ):
        link = kj.DHLink(1.0, (1, 0, 0))
        for name, value in change.items():
            object.__setattr__(link, name, value)
        with pytest.raises(ValueError, match=message):
            kj.from_dh([link])


def test_deep_chains_do_not_exhaust_the_stack() -> None:
    model = kj.load(chain(400))
    assert model.tree.nbody == 400
    assert sys.getrecursionlimit() >= 1000
