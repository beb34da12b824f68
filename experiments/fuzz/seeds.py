"""Sound inputs that mutations start from."""

import functools
import importlib.util
import io
import pathlib
import struct
import tempfile

import numpy as np

import kanejax as kj

_INERTIAL = (
    '<inertial><origin xyz="0.1 0 0.2" rpy="0.1 0.2 0"/><mass value="2"/>'
    '<inertia ixx="0.03" iyy="0.03" izz="0.02" ixy="0.001" ixz="0" iyz="0"/></inertial>'
)
_JOINT = (
    '<joint name="j{0}" type="{3}"><origin xyz="0 0 0.3" rpy="0 0.1 0"/><parent link="{1}"/><child link="{2}"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="2" effort="10" velocity="3"/><dynamics damping="0.1" friction="0.2"/></joint>'
)
URDF = (
    '<?xml version="1.0" encoding="utf-8"?>\n<robot name="arm">\n<link name="base"/>\n'
    + "".join(
        f'<link name="l{i}">{_INERTIAL}<visual><geometry><mesh filename="package://arm/l{i}.stl"/></geometry></visual></link>\n'
        for i in range(1, 5)
    )
    + "".join(
        _JOINT.format(i, "base" if i == 1 else f"l{i - 1}", f"l{i}", kind) + "\n"
        for i, kind in enumerate(("revolute", "prismatic", "continuous", "fixed"), 1)
    )
    + "</robot>\n"
)
MJCF = """<mujoco model="arm">
  <compiler angle="radian" meshdir="meshes" autolimits="true"/>
  <option gravity="0 0 -9.81" timestep="0.002"/>
  <default><joint damping="0.1"/><default class="small"><geom size="0.02"/></default></default>
  <asset>
    <mesh name="hull" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/><mesh name="part" file="part.obj"/>
    <texture name="grid" type="2d" builtin="checker" width="16" height="16"/><material name="m" texture="grid"/>
    <hfield name="floor" nrow="2" ncol="2" size="1 1 1 1"/>
  </asset>
  <worldbody>
    <geom type="plane" size="1 1 1" material="m"/><camera name="eye" resolution="8 8"/><light pos="0 0 3"/>
    <body name="torso" pos="0 0 1"><freejoint name="root"/><geom name="ball" size="0.1" mass="3"/>
      <body name="arm" euler="0.1 0.2 0.3" childclass="small"><joint name="hinge" axis="0 1 0" range="-1 1" armature="0.01"/>
        <inertial pos="0 0 0.1" mass="1" diaginertia="0.02 0.02 0.01"/><geom type="mesh" mesh="hull" mass="0"/><site name="tip"/>
        <body name="hand" pos="0 0 0.2"><joint name="slide" type="slide" stiffness="3" springref="0.1" frictionloss="0.2"/>
          <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.02"/>
          <body name="finger"><joint name="ball_joint" type="ball"/><geom type="mesh" mesh="part"/></body></body></body>
      <frame pos="0 1 0"><body name="tail"><joint name="t"/>
        <inertial pos="0 0 0" mass="1" fullinertia="1 1 1 0.1 0 0"/></body></frame></body>
    <replicate count="2" offset="1 0 0"><body name="copy"><joint/><geom size="0.1"/></body></replicate>
  </worldbody>
  <contact><exclude body1="torso" body2="arm"/></contact>
  <tendon><fixed name="both"><joint joint="hinge" coef="1"/></fixed></tendon>
  <actuator><motor name="a" joint="hinge"/><general joint="slide" dyntype="none"/></actuator>
  <sensor><jointpos joint="hinge"/><gyro site="tip"/></sensor>
  <keyframe><key name="home" time="0"/></keyframe>
  <custom><numeric name="n" data="1 2"/><text name="x" data="hello"/></custom>
</mujoco>
"""
PENDULUM = (
    '<mujoco><worldbody><body name="arm"><joint name="hinge"/><geom name="ball" size="0.1" mass="1"/></body></worldbody></mujoco>'
)
TETRAHEDRON = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
COLLADA = """<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_effects><effect id="e"><profile_COMMON><technique sid="c"><phong><diffuse><color>1 0 0 1</color></diffuse></phong>
</technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array>
<technique_common><accessor source="#a" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4" material="m"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles></mesh></geometry>
</library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="m" target="#m"/></technique_common></bind_material></instance_geometry></node></visual_scene>
</library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""
_LOOK = (
    '<visual><origin xyz="0 0 0.1" rpy="0.1 0 0"/><geometry>{}</geometry><material name="m"><color rgba="1 0 0 1"/></material>'
    "</visual>"
)
SEEN_URDF = (
    f'<robot name="arm"><link name="base">{_LOOK.format("""<box size="0.2 0.2 0.1"/>""")}</link>'
    f'<link name="l1">{_INERTIAL}{_LOOK.format("""<mesh filename="MESH" scale="0.1 0.1 0.1"/>""")}'
    f"{_LOOK.format('''<cylinder radius="0.1" length="0.3"/>''')}</link>{_JOINT.format(1, 'base', 'l1', 'revolute')}</robot>"
)
SEEN_MJCF = """<mujoco><asset><mesh name="part" file="MESH" scale="0.1 0.1 0.1"/><material name="m" rgba="1 0 0 1"/></asset>
<worldbody><geom type="plane" size="1 1 1"/>
  <body name="arm"><joint name="hinge"/><geom name="ball" size="0.1" mass="1" material="m"/>
    <geom type="mesh" mesh="part" mass="0"/><geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.02" rgba="0 1 0 1"/>
    <geom type="ellipsoid" size="0.1 0.2 0.3"/><geom type="cylinder" size="0.1 0.2"/><geom type="box" size="0.1 0.1 0.1"/></body>
</worldbody></mujoco>"""
# What an MJCF of the seeds finds beside it.
BESIDE = {"meshes/part.obj": TETRAHEDRON, "more.xml": b'<mujoco><option gravity="0 0 -1"/></mujoco>'}
JOINTS = ("shoulder", "elbow")
CONFIGURATION = """[log]
joints = ["shoulder", "elbow"]
rows = [1, 200]
bad_rows = "drop"
delimiter = ";"
[log.columns]
time = "t"
position = ["a", "b"]
[log.units]
position = "deg"
effort = [1.0, 2.0]
[motion]
cutoff = 10.0
resampling = "none"
trim = 0.5
[locked]
wrist = 0.3
[drives]
gain = 2.0
[[unknown]]
leaf = "damping"
of = ["shoulder"]
bounds = [0.0, 5.0]
prior = { gaussian = 0.1, relative = true }
[identify]
stages = ["inverse dynamics"]
seed = 3
[simulation]
windows = [0.5, "none"]
[output]
title = "arm"
report = false
"""
TASK = """robot = "arm.xml"
duration = [0.5, 2.0]
gravity = [0.0, 0.0, -9.81]
[start]
q = [0.0]
u = 0.0
[goal]
q = { hinge = 1.0 }
u = "free"
[limits]
q = 3.0
u = [5.0]
[costs]
torque = 1.0
speed = { weights = 0.1 }
[costs.energy]
weight = 0.1
[constraints.plane_clearance]
body = "arm"
radius = 0.1
normal = [0.0, 0.0, 1.0]
offset = -5.0
[solver]
steps = 10
integrator = "midpoint"
tolerance = 1e-6
[output]
report = false
"""


STUDY = """trajectories = 4
duration = 0.1
times = 3
seed = 1
[initial]
q = { distribution = "uniform", low = -1.0, high = [1.0] }
u = { distribution = "normal", std = 0.5 }
[forces]
distribution = "normal"
std = 5.0
period = 0.05
interpolation = "linear"
[parameters]
density = { distribution = "log-normal", sigma = 0.1 }
damping = { distribution = "uniform", low = 0.0, high = 0.5, how = "added" }
[solver]
method = "tsit5"
dt0 = 0.05
max_steps = 4096
joint_limits = false
"""


def stl() -> bytes:
    """The tetrahedron as a binary STL."""
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *CORNERS[row].ravel(), 0) for row in TRIANGLES)
    return bytes(80) + struct.pack("<I", len(TRIANGLES)) + rows


def study() -> kj.Study:
    """Four trajectories of the pendulum, for data sets."""
    return kj.Study(kj.load(PENDULUM), np.linspace(0.0, 0.1, 3), 4, u0=kj.distributions.Normal(), options={"dt0": 0.05})


@functools.cache
def data_set() -> dict[str, bytes]:
    """Files of a store of the study, empty where zarr is not installed."""
    if importlib.util.find_spec("zarr") is None:
        return {}
    with tempfile.TemporaryDirectory() as folder:
        store = kj.write_study(study(), pathlib.Path(folder) / "runs.zarr", chunk=2, threads=1)
        return {str(file.relative_to(store)): file.read_bytes() for file in sorted(store.rglob("*")) if file.is_file()}


@functools.cache
def urdfs() -> tuple[str, ...]:
    """Ours, and small ones of example-robot-data where that is installed."""
    specification = importlib.util.find_spec("cmeel")
    folders = [pathlib.Path(path).parent for path in (specification.submodule_search_locations or [])] if specification else []
    files = sorted(file for folder in folders for file in folder.glob("cmeel.prefix/share/example-robot-data/**/*.urdf"))
    return URDF, *(file.read_text() for file in files if file.stat().st_size < 12_000)


def columns(rows: int = 12) -> tuple[list[str], np.ndarray]:
    """Names and numbers of a log of two joints."""
    values = np.random.default_rng(0).normal(size=(rows, 4))
    names = ["time", *(f"{quantity}_{joint}" for quantity in ("position", "effort") for joint in JOINTS)]
    return names, np.column_stack((0.01 * np.arange(rows), values))


def csv() -> bytes:
    """A log as text."""
    names, values = columns()
    return "".join(",".join(map(str, row)) + "\n" for row in (names, *values.tolist())).encode()


def npz() -> bytes:
    """A log as NumPy's archive."""
    names, values = columns()
    stream = io.BytesIO()
    np.savez(stream, **dict(zip(names, values.T, strict=True)))
    return stream.getvalue()


def parquet() -> bytes | None:
    """A log as Parquet, None where pyarrow is not installed."""
    if importlib.util.find_spec("pyarrow") is None:
        return None
    import pyarrow
    import pyarrow.parquet

    names, values = columns()
    stream = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(dict(zip(names, values.T, strict=True))), stream)
    return stream.getvalue()


def mcap() -> bytes | None:
    """A log as MCAP with messages in JSON, None where mcap is not installed."""
    if importlib.util.find_spec("mcap") is None:
        return None
    import json

    from mcap.writer import Writer

    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    schema = writer.register_schema("JointState", "jsonschema", b"{}")
    channel = writer.register_channel("/arm", "json", schema)
    for row in columns()[1].tolist():
        stamp = {"sec": 1, "nanosec": int(row[0] * 1e9)}
        message = {"header": {"stamp": stamp}, "name": list(JOINTS), "position": row[1:3], "effort": row[3:]}
        writer.add_message(channel, int(row[0] * 1e9), json.dumps(message).encode(), int(row[0] * 1e9))
    writer.finish()
    return stream.getvalue()
