"""Small robots with shapes, and their motions, for tests of what is seen."""

import numpy as np

TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.1]])
_FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))

URDF = """<robot name="arm">
  <mujoco><compiler discardvisual="false" fusestatic="false" strippath="false"/></mujoco>
  <material name="blue"><color rgba="0.1 0.2 0.9 1"/></material>
  <link name="base"><visual><origin xyz="0 0 0.1"/><geometry><cylinder radius="0.1" length="0.2"/></geometry>
    <material name="blue"/></visual></link>
  <link name="upper">
    <inertial><origin xyz="0.2 0 0"/><mass value="2"/>
      <inertia ixx="0.01" iyy="0.03" izz="0.035" ixy="0.002" ixz="0" iyz="0"/></inertial>
    <visual><origin xyz="0.2 0.01 0.02" rpy="0.3 -0.4 0.5"/><geometry><box size="0.4 0.1 0.05"/></geometry>
      <material name="red"><color rgba="0.9 0.1 0.1 1"/></material></visual>
    <visual><origin xyz="0.4 0 0"/><geometry><sphere radius="0.06"/></geometry></visual>
  </link>
  <link name="lower">
    <inertial><origin xyz="0.1 0.02 0"/><mass value="1"/>
      <inertia ixx="0.002" iyy="0.004" izz="0.005" ixy="0" ixz="0" iyz="0.0003"/></inertial>
    <visual><origin xyz="0.1 0 0" rpy="-0.2 0.1 0.7"/><geometry>
      <mesh filename="tetrahedron.stl" scale="0.6 0.5 0.7"/></geometry></visual>
  </link>
  <link name="tool">
    <inertial><mass value="0.3"/><inertia ixx="0.001" iyy="0.001" izz="0.0015" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.2" rpy="0.1 0.2 0.3"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="50" velocity="3"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0" rpy="0 0 0.4"/>
    <axis xyz="0 0.6 0.8"/></joint>
  <joint name="slide" type="prismatic"><parent link="lower"/><child link="tool"/><origin xyz="0.2 0 0"/>
    <axis xyz="1 0 0"/><limit lower="0.1" upper="0.3" effort="50" velocity="3"/></joint>
</robot>"""

MJCF = """<mujoco>
  <compiler angle="radian" meshdir="meshes"/>
  <default><default class="seen"><geom rgba="0.2 0.7 0.3 1" group="1"/></default></default>
  <asset>
    <material name="paint" rgba="0.8 0.3 0.1 1"/>
    <mesh name="kept" file="tetrahedron.stl" scale="0.5 -0.4 0.8" refpos="0.05 0.1 -0.02" refquat="0.8 0.2 -0.5 0.1"/>
    <mesh name="missing" file="gone.obj"/>
    <mesh name="own" vertex="0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"/>
  </asset>
  <worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <geom name="post" type="box" size="0.1 0.15 0.2" pos="1 0 0.2"/>
    <body name="ball" pos="0.3 0 1" quat="0.9 0.1 0.2 -0.3"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
      <geom name="ball" type="sphere" size="0.12" pos="0.1 0 0" class="seen"/>
      <geom name="egg" type="ellipsoid" size="0.1 0.2 0.3" euler="0.3 0.2 0.1" material="paint"/>
      <geom name="hidden" type="sphere" size="1" group="3"/>
      <geom name="invisible" type="sphere" size="1" rgba="1 1 1 0"/>
      <body name="arm" pos="0 0.2 0"><joint axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
        <geom name="rod" type="capsule" size="0.03" fromto="0 0 0 0.2 0.3 0.4"/>
        <geom name="can" type="cylinder" size="0.05 0.2" pos="0 0 0.3" axisangle="1 1 0 0.7"/>
        <geom name="kept" type="mesh" mesh="kept" pos="0.1 0.2 0.3" quat="0.3 0.4 0.5 0.6"/>
        <geom name="own" type="mesh" mesh="own" pos="0.1 0 0"/>
        <geom name="missing" type="mesh" mesh="missing"/>
      </body></body>
  </worldbody>
</mujoco>"""


def write_tetrahedron(path):
    """A mesh as binary STL."""
    path.parent.mkdir(parents=True, exist_ok=True)
    facets = np.zeros(len(_FACES), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["corners"] = TETRAHEDRON[np.array(_FACES)]
    path.write_bytes(bytes(80) + np.uint32(len(_FACES)).tobytes() + facets.tobytes())


def write_robots(folder):
    """Both robots with their mesh, in a folder."""
    (folder / "arm.urdf").write_text(URDF)
    write_tetrahedron(folder / "tetrahedron.stl")
    (folder / "ball.xml").write_text(MJCF)
    write_tetrahedron(folder / "meshes" / "tetrahedron.stl")


def swing(count=21, duration=1.0):
    """A motion of the URDF: times and coordinates."""
    ts = np.linspace(0.0, duration, count)
    return ts, np.stack((-np.sin(3.0 * ts), 2.0 * ts, 0.2 + 0.1 * np.sin(ts)), 1)
