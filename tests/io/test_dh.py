"""Arms from tables: Nie's Intelledex 605 with its reference torques, and each convention against MuJoCo."""

import copy
import dataclasses
import inspect
import re
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj

RIGHT = np.pi / 2
# Nie, Table 3, with L33 = L43 = L52 = L63 = 0.
L1, L2, L12, L13, L22, L31, L41 = 0.2794, 0.3226, 0.1397, 0.1588, 0.0127, 0.1880, 0.1727
INTELLEDEX = (
    kj.DHLink(18.1440, com=(0, -L12, L13), central_inertia=(0.18, 0.045, 0.135), alpha=RIGHT),
    kj.DHLink(12.2472, com=(0, -L22, 0), central_inertia=(0.03, 0.03, 0.0232), alpha=-RIGHT),
    kj.DHLink(8.6184, com=(L31, 0, 0), central_inertia=(0.1041, 0.1041, 0.026), next_origin=(L1, 0, 0)),
    kj.DHLink(4.9896, com=(L41, 0, 0), central_inertia=(0.0605, 0.0605, 0.026), next_origin=(L2, 0, 0)),
    kj.DHLink(1.3608, central_inertia=(0.0048, 0.0048, 0.0035), rotation=((1, 0, 0), (0, 0, 1), (0, -1, 0))),
    kj.DHLink(0.9072, central_inertia=(0.0040, 0.0040, 0.0030)),
)
# Torques at 0, 1 and 2 s, which the printed equations give once their misprints are corrected.
REFERENCE = [
    [0, 0, -51.41806886, -15.63086866, 0, 0],
    [-3.65240562, 23.80108726, -29.90338861, -4.44952941, 0.00752381, -0.00450906],
    [10.24418406, 7.55862433, 14.24269294, 9.76929291, 0, 0],
]


def motion(t: jax.Array) -> jax.Array:
    """Nie (3.60), with T = 2 s."""
    angle = jnp.pi * (t - jnp.sin(jnp.pi * t) / jnp.pi) / 6
    return jnp.stack([angle, jnp.pi / 2 - angle / 2, angle, angle, angle, angle])


def test_intelledex_torques() -> None:
    model = kj.from_dh(INTELLEDEX, convention="nie", gravity=(0, 9.81, 0))
    speed = jax.jacfwd(motion)
    times = jnp.array([0.0, 1.0, 2.0])
    state = jax.vmap(lambda t: (motion(t), speed(t), jax.jacfwd(speed)(t)))(times)
    torques = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))(model, *state)
    np.testing.assert_allclose(torques, REFERENCE, rtol=0, atol=6e-9)


# A revolute, prismatic, revolute arm in the standard convention, by hand: each body's frame is at the far end of its link.
STANFORD_LIKE = (
    kj.DHLink(3.0, (0.1, 0.2, 0.3), (0.3, 0.2, 0.25), alpha=-RIGHT, a=0.2, d=0.4, theta=0.3, damping=0.2),
    kj.DHLink(2.0, (0.0, 0.1, -0.2), (0.2, 0.15, 0.1), joint="prismatic", alpha=0.7, a=0.1, d=0.3, theta=-0.4, armature=0.1),
    kj.DHLink(1.0, (0.1, 0.0, 0.1), ((0.1, 0.01, 0), (0.01, 0.1, 0), (0, 0, 0.1)), alpha=0.2, a=0.3, d=0.1, theta=1.0),
)


def by_hand(convention: str) -> mujoco.MjModel:
    """The arm of STANFORD_LIKE from nested frames of MJCF that follow the convention's definition, letter by letter."""
    text, closing = "", ""
    for number, link in enumerate(STANFORD_LIKE, start=1):
        inertia = np.asarray(link.central_inertia, float)
        inertia = np.diag(inertia) if inertia.ndim == 1 else inertia
        full = " ".join(map(repr, inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist()))
        kind = "slide" if link.joint == "prismatic" else "hinge"
        joint = f'<joint name="j{number}" type="{kind}" axis="0 0 1" damping="{link.damping}" armature="{link.armature}"/>'
        # A frame in MJCF cannot come between a body and its joint, so bodies without mass stand for frames.
        turn_z, turn_x = f'axisangle="0 0 1 {link.theta!r}"', f'axisangle="1 0 0 {link.alpha!r}"'
        along_z, along_x = f'pos="0 0 {link.d!r}"', f'pos="{link.a!r} 0 0"'
        steps = {
            "standard": ("", joint, turn_z, along_z, along_x, turn_x),
            "nie": ("", joint, turn_z, turn_x),
            "modified": (turn_x, along_x, "", joint, turn_z, along_z),
        }[convention]
        for step in steps:
            if step.startswith("<joint"):
                text = text.removesuffix(">") + ">" + step + '<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>'
            else:
                text, closing = text + f"<body {step}>", closing + "</body>"
        com = " ".join(map(str, link.com))
        text += f'<body name="link{number}"><inertial pos="{com}" mass="{link.mass}" fullinertia="{full}"/></body>'
        if convention == "nie":
            offset = np.array([link.a, link.d * np.sin(link.alpha), link.d * np.cos(link.alpha)])
            text, closing = text + f'<body pos="{" ".join(map(repr, offset.tolist()))}">', closing + "</body>"
    base = '<body pos="0.1 0.2 0.3" quat="1 0 0 1">'
    option = '<compiler angle="radian"/><option gravity="1 2 -9"/>'
    mj_model = mujoco.MjModel.from_xml_string(f"<mujoco>{option}<worldbody>{base}{text}{closing}</body></worldbody></mujoco>")
    # The inertia that MuJoCo asks of a body with a joint; without it the arm is exactly that of the table.
    for index in np.flatnonzero(mj_model.body_jntnum):
        mj_model.body_mass[index], mj_model.body_inertia[index] = 0.0, 0.0
    return mj_model


@pytest.mark.parametrize("convention", ["standard", "modified", "nie"])
def test_conventions_against_mujoco(convention: Any) -> None:
    turn = ((0, -1, 0), (1, 0, 0), (0, 0, 1))
    model = kj.from_dh(STANFORD_LIKE, convention=convention, base_position=(0.1, 0.2, 0.3), base_rotation=turn, gravity=(1, 2, -9))
    mj_model = by_hand(convention)
    mj_data, random = mujoco.MjData(mj_model), np.random.default_rng(1)
    q, u, u_dot = random.normal(size=(3, 5, 3))
    expected = []
    for row in zip(q, u, u_dot, strict=True):
        mj_data.qpos[:], mj_data.qvel[:], mj_data.qacc[:] = row
        mujoco.mj_inverse(mj_model, mj_data)
        expected.append(mj_data.qfrc_inverse.copy())
    actual = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))(model, q, u, u_dot)
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_rotation_and_angles_are_the_same() -> None:
    cosine, sine = np.cos(0.3), np.sin(0.3)
    turned = dataclasses.replace(
        STANFORD_LIKE[0], alpha=0.0, theta=0.0, rotation=((cosine, 0, -sine), (sine, 0, cosine), (0, -1, 0))
    )
    for convention in ("standard", "nie"):
        models = [kj.from_dh([link], convention=convention) for link in (STANFORD_LIKE[0], turned)]
        jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-15), *models)


def test_names_and_options() -> None:
    link = kj.DHLink(1.0, (1, 0, 0), name="boom", joint_name="hoist", joint_range=(-1, 2), coulomb_friction=0.5)
    model = kj.from_dh([kj.DHLink(1.0, (1, 0, 0)), link])
    assert model.tree.body_names == ("link1", "boom")
    assert model.tree.joint_names == ("joint1", "hoist")
    np.testing.assert_array_equal(model.joint_range, [[-np.inf, np.inf], [-1, 2]])
    assert model.joint("hoist").coulomb_friction == 0.5
    assert kj.from_dh([]).nv == 0


def changed(link: kj.DHLink, change: dict[str, Any]) -> kj.DHLink:
    """Without the type checks of the tests, which would come before those of `from_dh`."""
    link = copy.copy(link)
    for name, value in change.items():
        object.__setattr__(link, name, value)
    return link


@pytest.mark.parametrize(
    ("change", "convention", "message"),
    [
        ({"joint": "ball"}, "nie", "link 'link1': joint 'ball' is unknown; the types are revolute, prismatic"),
        ({"mass": None}, "nie", "row 1, link 'link1': mass = None is not a finite number; give it in kg"),
        ({"mass": np.inf}, "nie", "row 1, link 'link1': mass = inf is not a finite number"),
        ({"alpha": None}, "standard", "row 1, link 'link1': alpha = None is not a finite number; give it in rad"),
        ({"theta": "right"}, "modified", "row 1, link 'link1': theta = 'right' is no array of numbers"),
        ({"d": np.nan}, "standard", "row 1, link 'link1': d = nan is not a finite number; give it in m"),
        ({"com": None}, "nie", "row 1, link 'link1': com has shape (), but needs (3,)"),
        ({"com": (1, 2)}, "nie", "link 'link1': com has shape (2,), but needs (3,)"),
        ({"com": ("a", 1, 2)}, "nie", "link 'link1': com = ('a', 1, 2) is no array of numbers; it needs the shape (3,)"),
        ({"joint_range": (1, 2, 3)}, "nie", "link 'link1': joint_range has shape (3,), but needs (2,)"),
        ({"central_inertia": (1, 1, 3)}, "nie", "body 'link1': principal moments 1, 1, 3 kg m^2 break the triangle inequality"),
        ({"central_inertia": np.full((3, 3), np.nan)}, "nie", "body 'link1': central_inertia = nan nan"),
        ({"central_inertia": (1, 2)}, "nie", "link 'link1': central_inertia has shape (2,)"),
        ({"central_inertia": ((1, 2, 0), (0, 1, 0), (0, 0, 1))}, "nie", "central_inertia is not symmetric"),
        ({"rotation": np.ones((3, 3))}, "nie", "link 'link1': rotation is not a rotation matrix"),
        ({"rotation": -np.eye(3)}, "nie", "link 'link1': rotation is not a rotation matrix"),
        ({"rotation": np.eye(3), "alpha": 1.0}, "nie", "give either rotation or alpha and theta"),
        ({"rotation": np.eye(3)}, "modified", "give either rotation or alpha and theta"),
        ({"next_origin": (1, 0, np.nan)}, "nie", "row 1, link 'link1': next_origin = 1 0 nan is not finite"),
        ({"next_origin": (1, 0, 0)}, "standard", "only convention='nie' takes the former"),
        ({"next_origin": (1, 0, 0), "d": 1.0}, "nie", "give either next_origin or a and d"),
        ({"mass": -1.0}, "nie", "body 'link1': mass -1 kg is negative"),
        ({"com": (0, 0, 1)}, "nie", "body 'link1': joint 'joint1' moves no inertia"),
        ({"com": (0, 0, np.nan)}, "nie", "body 'link1': com = 0 0 nan is not finite"),
    ],
)
def test_messages(change: dict[str, Any], convention: Any, message: str) -> None:
    link = changed(kj.DHLink(1.0, (1, 0, 0)), change)
    with pytest.raises((ValueError, kj.KanejaxError)) as raised:
        kj.from_dh([link], convention=convention)
    assert message in str(raised.value)


def test_messages_name_the_row_that_is_wrong() -> None:
    good = kj.DHLink(1.0, (1, 0, 0))
    for change, message in (
        ({"joint": "screw"}, "row 2, link 'boom': joint 'screw' is unknown"),
        ({"rotation": ((1, 0, 0), (0, 1, 0), (0, 0.1, 1))}, "row 2, link 'boom': rotation is not a rotation matrix"),
        ({"a": None}, "row 2, link 'boom': a = None is not a finite number"),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            kj.from_dh([good, changed(good, {"name": "boom", **change}), good])


def test_rows_of_another_type() -> None:
    # Without the type checks of the tests.
    with pytest.raises(TypeError, match="row 1 is of type tuple; give DHLink"):
        inspect.unwrap(kj.from_dh)([(0.1, 0.0, 0.2, 0.0)])


def test_unknown_convention() -> None:
    unknown: Any = "craig"
    with pytest.raises((ValueError, TypeError), match="craig"):
        kj.from_dh([kj.DHLink(1.0, (1, 0, 0))], convention=unknown)


def test_base_rotation_and_gravity_are_checked() -> None:
    with pytest.raises(ValueError, match="base_rotation has shape"):
        kj.from_dh([kj.DHLink(1.0, (1, 0, 0))], base_rotation=(1, 0, 0, 0))
    with pytest.raises(ValueError, match="gravity has shape"):
        kj.from_dh([kj.DHLink(1.0, (1, 0, 0))], gravity=(0, -9.81))
