"""Small mechanisms to simulate."""

import pytest

import kanejax as kj

PENDULUM = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" range="-1 0.5" limited="true"/>
    <inertial pos="0 0 -0.4" mass="1.2" diaginertia="0.02 0.03 0.01"/>
    <body name="lower" pos="0 0 -0.8"><joint name="elbow" axis="0 1 0.3"/>
      <inertial pos="0.05 0 -0.3" mass="0.7" diaginertia="0.01 0.015 0.005"/></body></body>
</worldbody></mujoco>"""

FLOATING = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="base" pos="0 0 1"><freejoint name="float"/>
    <inertial pos="0.02 0.01 -0.03" mass="2" diaginertia="0.03 0.02 0.04"/>
    <body name="arm" pos="0.2 0 0"><joint name="hip" type="ball"/>
      <inertial pos="0.1 0.02 0" mass="0.7" diaginertia="0.004 0.006 0.005"/>
      <body name="hand" pos="0.25 0 0"><joint name="knee" axis="0 1 0" damping="0.01"/>
        <inertial pos="0.1 0 0.01" mass="0.3" diaginertia="0.001 0.002 0.002"/></body></body></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="session")
def pendulum():
    """Two links with skew hinges, without losses; the first has a range."""
    return kj.load(PENDULUM)


@pytest.fixture(scope="session")
def floating_xml():
    """A floating base that carries a ball joint and a hinge."""
    return FLOATING


@pytest.fixture(scope="session")
def floating():
    """The model of floating_xml."""
    return kj.load(FLOATING)
