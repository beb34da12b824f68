"""Inputs by kind and seed: the files of each, and how it is loaded."""

import io
import struct
import warnings
import zipfile
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from experiments.fuzz import seeds
from experiments.fuzz.mutations import changed_bytes, changed_lines, changed_numbers
from experiments.fuzz.xml_mutations import changed_xml, wrapped

Random = np.random.Generator


class Case(NamedTuple):
    """An input: `files` by name, symbolic `links` by name, the `main` file, and options of its loader."""

    kind: str
    main: str
    files: dict[str, bytes]
    links: Mapping[str, str] = MappingProxyType({})
    options: Mapping[str, Any] = MappingProxyType({})


def case(kind: str, seed: int) -> Case:
    """The input of this kind and seed, always the same."""
    return _KINDS[kind](np.random.default_rng([seed, list(_KINDS).index(kind)]))


def _flags(random: Random) -> dict[str, bool]:
    return {name: bool(random.integers(0, 2)) for name in ("strict", "repair", "allow_unphysical")}


def _mutated(data: bytes, random: Random) -> bytes:
    if random.random() < 0.65:
        data = changed_xml(data, random)
    elif random.random() < 0.5:
        data = changed_numbers(data, random)
    if random.random() < 0.3:
        data = changed_bytes(data, random) if random.random() < 0.8 else wrapped(data, random)
    return data


def _urdf(random: Random) -> Case:
    text = seeds.urdfs()[int(random.integers(0, len(seeds.urdfs())))] if random.random() < 0.6 else seeds.URDF
    return Case("URDF file", "main.xml", {"main.xml": _mutated(text.encode(), random)}, options=_flags(random))


def _mjcf(random: Random) -> Case:
    text = seeds.MJCF if random.random() < 0.8 else seeds.PENDULUM
    files = {**seeds.BESIDE, "main.xml": _mutated(text.encode(), random)}
    if random.random() < 0.1:
        files["more.xml"] = _mutated(files["more.xml"], random)
    return Case("MJCF file", "main.xml", files, {"link.xml": "../secret.xml"}, _flags(random))


def _text(random: Random) -> Case:
    made = (_urdf if random.random() < 0.5 else _mjcf)(random)
    return made._replace(kind="XML text", options={**made.options, "as_text": True})


def _mesh(random: Random) -> Case:
    """A mesh that an inertia needs."""
    corners, triangles = seeds.CORNERS, seeds.TRIANGLES
    if random.random() < 0.5:
        name, data = "part.obj", seeds.TETRAHEDRON
    else:
        name, data = "part.stl", seeds.stl()
        if random.random() < 0.2:
            data = data[:80] + struct.pack("<I", int(random.choice([0, 1, 200_000, 2**31, 2**32 - 1]))) + data[84:]
    if random.random() < 0.2:
        # MuJoCo's own format: four counts, and the numbers.
        counts = [4, 0, 0, 4]
        if random.random() < 0.5:
            counts[int(random.integers(0, 4))] = int(random.choice([-1, 0, 5, 10**6, 2**31 - 1, -(2**31)]))
        name, data = "part.msh", struct.pack("<4i", *counts) + corners.astype("<f4").tobytes() + triangles.astype("<i4").tobytes()
    data = changed_numbers(data, random) if name.endswith("obj") and random.random() < 0.6 else changed_bytes(data, random)
    body = f'<body><joint/><geom type="mesh" mesh="m" density="{random.choice(["1000", "1e-9", "1e30"])}"/></body>'
    kind = random.choice(["legacy", "exact", "convex", "shell"])
    text = f'<mujoco><asset><mesh name="m" file="{name}" inertia="{kind}"/></asset><worldbody>{body}</worldbody></mujoco>'
    return Case("mesh file", "main.xml", {"main.xml": text.encode(), name: data}, options=_flags(random))


def _seen_robot(random: Random) -> Case:
    """A robot whose meshes are to be drawn, mutated itself or in its meshes; one mesh lies outside of its folder."""
    files = {"part.obj": seeds.TETRAHEDRON, "part.stl": seeds.stl(), "part.dae": seeds.COLLADA.encode()}
    name = str(random.choice(list(files)))
    where = str(random.choice(["", "", "package://in/", "file://", "./", "../", "../../", "package://../", "/", "package:///"]))
    outside = where in ("../", "package://../") and random.random() < 0.5
    text = seeds.SEEN_URDF if random.random() < 0.6 else seeds.SEEN_MJCF
    text = text.replace("MESH", "../secret.obj" if outside else f"{where}{name}")
    if random.random() < 0.6:
        change = (changed_xml, changed_numbers, changed_bytes)[int(random.integers(0, 2 if name == "part.obj" else 3))]
        change = changed_xml if name == "part.dae" and random.random() < 0.6 else change if name != "part.stl" else changed_bytes
        files[name] = (changed_numbers if change is changed_xml and name == "part.obj" else change)(files[name], random)
    data = _mutated(text.encode(), random) if random.random() < 0.5 else text.encode()
    links = {"link.obj": "../secret.obj"} if random.random() < 0.2 else {}
    if links:
        data = data.replace(name.encode(), b"link.obj")
    return Case("seen robot", "main.xml", {**files, "main.xml": data}, links, _flags(random))


def _seen_motion(random: Random) -> Case:
    """A motion to be shown, as an archive, as text, or as a data set."""
    draw = random.random()
    if draw < 0.4:
        ts = np.linspace(0.0, 1.0, 12)
        arrays: dict[str, Any] = {"ts": ts, "q": np.sin(ts)[:, None], "u": np.cos(ts)[:, None], "tau": np.ones((11, 1))}
        name = str(random.choice(list(arrays)))
        arrays[name] = (
            *(np.zeros((12, 3)), np.zeros(0), np.full((12, 1), np.nan), np.array("x"), np.array([None] * 12), np.zeros((3, 12, 1))),
            *(np.full((12, 1), 1e308), np.zeros((12, 1), complex), np.arange(12)[::-1], np.zeros((12, 0)), np.array(1.0)),
        )[int(random.integers(0, 11))]
        stream = io.BytesIO()
        np.savez(stream, **arrays)
        if random.random() < 0.3:
            _patch_header(stream, name, random)
        data = changed_bytes(stream.getvalue(), random) if random.random() < 0.3 else stream.getvalue()
        return Case("seen motion", "motion.npz", {"motion.npz": data})
    if draw < 0.7:
        return _csv(random)._replace(kind="seen motion", options={})
    return _data_set(random)._replace(kind="seen motion")


_VALUES: tuple[Any, ...] = (
    *(
        float("nan"),
        float("inf"),
        1e308,
        1e-320,
        -1.0,
        0.0,
        -0.0,
        10**400,
        None,
        "x",
        "1",
        b"1",
        True,
        1j,
        [],
        [[]],
        {},
        (1, 2),
        (1, 2, 3),
    ),
    *(
        np.zeros((3, 3)),
        np.full((3, 3), np.nan),
        np.eye(3),
        np.ones((2, 3, 3)),
        np.array("a"),
        np.array([None] * 3),
        object(),
        "\u0661",
        2**63,
    ),
    *(
        (1, (2, 3)),
        ("a", 1, 2),
        np.float32(1),
        range(3),
        lambda: 1,
        [[1, 0, 0], [0, 1], [0, 0, 1]],
        "ball",
        "prismatic",
        (1e308,) * 3,
    ),
)


def _dh(random: Random) -> Case:
    """Rows of a table, as keyword arguments, with some values that should not be there."""
    fields = (
        "mass",
        "com",
        "central_inertia",
        "joint",
        "alpha",
        "a",
        "d",
        "theta",
        "rotation",
        "next_origin",
        "name",
        "joint_name",
    )
    fields += ("armature", "damping", "coulomb_friction", "joint_range")
    rows: list[Any] = [
        {"mass": 1.0, "com": (0.1, 0, 0), "central_inertia": (1.0, 1.0, 1.0), "alpha": 0.3, "a": 0.2, "d": 0.1}
        for _ in range(int(random.integers(0, 4)))
    ]
    options: dict[str, Any] = {"convention": str(random.choice(["standard", "modified", "nie"]))}
    for _ in range(int(random.integers(1, 4))):
        value = _VALUES[int(random.integers(0, len(_VALUES)))]
        where = random.random()
        if where < 0.8 and rows:
            row = rows[int(random.integers(0, len(rows)))]
            if isinstance(row, dict):
                row[fields[int(random.integers(0, len(fields)))]] = value
        elif where < 0.95:
            names = ("convention", "base_position", "base_rotation", "gravity")
            options[names[int(random.integers(0, len(names)))]] = value
        else:
            rows.append(value)
    return Case("DH table", "", {}, options={"rows": rows, **options})


def _log_options(random: Random) -> dict[str, Any]:
    drop = {"bad_rows": str(random.choice(["error", "drop"])), "repeated": str(random.choice(["error", "drop"]))}
    more = [
        {},
        {},
        {},
        {"delimiter": str(random.choice([",", ";", " ", "\t", "\0", '"', "\n", "\u00e9"]))},
        {"header": bool(random.integers(0, 2))},
    ]
    return {**drop, **more[int(random.integers(0, len(more)))]}


def _csv(random: Random) -> Case:
    data = seeds.csv()
    draw = random.random()
    if draw < 0.08:
        long = (b'"', b"1" * 500_000 + b",", b",".join([b"1"] * 300_000), b'"' + b"x\n" * 100_000, b"a," * 100_000 + b"\n")
        data = (
            data + long[int(random.integers(0, len(long)))]
            if random.random() < 0.5
            else long[int(random.integers(0, len(long)))] + data
        )
    elif draw < 0.4:
        data = changed_lines(data, random)
    elif draw < 0.7:
        data = changed_numbers(data, random)
    else:
        data = data.replace(b",", bytes(random.choice([b";", b"\t", b" ", b",,", b'","', b", "])), int(random.integers(1, 40)))
    if random.random() < 0.4:
        data = changed_bytes(data, random)
    return Case("CSV log", "log.csv", {"log.csv": data}, options=_log_options(random))


def _npz(random: Random) -> Case:
    data = seeds.npz()
    if random.random() < 0.5:
        return Case("NPZ log", "log.npz", {"log.npz": changed_bytes(data, random)}, options=_log_options(random))
    names, values = seeds.columns()
    columns: dict[str, Any] = dict(zip(names, values.T, strict=True))
    name = names[int(random.integers(0, len(names)))]
    hostile = (
        *(
            np.array([1, None, "x"], object),
            np.array(["a", "b"]),
            np.zeros((2, 2, 2)),
            np.zeros(0),
            np.array(1.0),
            np.full(12, np.nan),
        ),
        *(np.arange(12) * 1j, np.zeros(12, "M8[ns]"), np.zeros(12, "m8[Y]"), np.zeros(12, [("a", "f8")]), np.zeros(12, bool)),
        *(
            np.zeros((12, 3)),
            np.full(12, 2**63, np.uint64),
            np.zeros(12, np.float16),
            np.arange(12, dtype=">f8"),
            np.zeros((12, 0)),
        ),
    )
    stream = io.BytesIO()
    columns[name] = hostile[int(random.integers(0, len(hostile)))]
    np.savez(stream, **columns)
    if random.random() < 0.3:
        _patch_header(stream, name, random)
    return Case("NPZ log", "log.npz", {"log.npz": stream.getvalue()}, options=_log_options(random))


def _patch_header(stream: io.BytesIO, name: str, random: Random) -> None:
    """Add a second array of a name, with a header that promises what is not there."""
    shapes = ("(1000000000000,)", "(-5,)", "(2**40,)", "('a',)", "(12, 10000000000)", "__import__('os')", "(" * 5000)
    types = ("'<f8'", "'|O'", "'<U1000000000'", "'V99999999999'", "[('a', '|O')]", "'klingon'")
    header = f"{{'descr': {random.choice(types)}, 'fortran_order': False, 'shape': {random.choice(shapes)}, }}".encode() + b"\n"
    array = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header) % 65536) + header + bytes(96)
    with zipfile.ZipFile(stream, "a") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        archive.writestr(f"{random.choice(['../', '/', ''])}{random.choice([name, 'new', 'time'])}.npy", array)


def _binary(kind: str, suffix: str, made: Callable[[], bytes | None]) -> Callable[[Random], Case]:
    def mutated(random: Random) -> Case:
        data = made() or b""
        # Of what is not installed, the message is the test.
        return Case(kind, f"log{suffix}", {f"log{suffix}": changed_bytes(data, random)}, options=_log_options(random))

    return mutated


def _toml(kind: str, text: str) -> Callable[[Random], Case]:
    def mutated(random: Random) -> Case:
        data = text.encode()
        for _ in range(int(random.integers(1, 3))):
            data = (changed_lines, changed_numbers, changed_numbers, changed_bytes)[int(random.integers(0, 4))](data, random)
        if random.random() < 0.02:
            data += b"\nx = " + b"[" * 100_000
        return Case(kind, "main.toml", {"main.toml": data, "arm.xml": seeds.PENDULUM.encode()})

    return mutated


def _data_set(random: Random) -> Case:
    """A store whose metadata someone changed, with files missing, and links in place of files and folders."""
    files, links = dict(seeds.data_set()), {}
    metadata = [name for name in files if name.endswith("zarr.json")]
    for _ in range(int(random.integers(1, 4)) if files else 0):
        name = str(random.choice(metadata if random.random() < 0.7 else sorted(files)))
        if name not in files:
            continue
        draw = random.random()
        if name in metadata and draw < 0.7:
            change = (changed_numbers, changed_lines, changed_bytes)[int(random.integers(0, 3))]
            files[name] = change(files[name], random)
        elif draw < 0.85:
            del files[name]
        else:
            # The file, or a folder that it lies in, elsewhere.
            parts = name.split("/")
            place = "/".join(parts[: int(random.integers(1, len(parts) + 1))])
            files = {other: data for other, data in files.items() if other != place and not other.startswith(f"{place}/")}
            links = {other: to for other, to in links.items() if not other.startswith(f"{place}/")}
            links[place] = str(random.choice(["../" * (place.count("/") + 2) + "secret.xml", "..", "nowhere", "/dev/zero"]))
    for folder in ("", *(f"{name}/" for name in ("q", "status"))):
        if random.random() < 0.05 and folder[:-1] not in links:
            files[f"{folder}{random.choice(['.zarray', '.zattrs', 'x.pkl'])}"] = random.bytes(20)
    stored = {f"runs.zarr/{name}": data for name, data in files.items()}
    return Case("data set", "runs.zarr", stored, {f"runs.zarr/{name}": to for name, to in links.items()})


_KINDS: dict[str, Callable[[Random], Case]] = {
    "URDF file": _urdf,
    "MJCF file": _mjcf,
    "XML text": _text,
    "mesh file": _mesh,
    "DH table": _dh,
    "CSV log": _csv,
    "NPZ log": _npz,
    "Parquet log": _binary("Parquet log", ".parquet", seeds.parquet),
    "MCAP log": _binary("MCAP log", ".mcap", seeds.mcap),
    "identify TOML": _toml("identify TOML", seeds.CONFIGURATION),
    "task TOML": _toml("task TOML", seeds.TASK),
    "study TOML": _toml("study TOML", seeds.STUDY),
    "data set": _data_set,
    "seen robot": _seen_robot,
    "seen motion": _seen_motion,
}
# How often each kind is drawn.
SHARES = dict(zip(_KINDS, (20, 28, 8, 6, 10, 10, 6, 3, 3, 3, 3, 3, 8, 8, 6), strict=True))
