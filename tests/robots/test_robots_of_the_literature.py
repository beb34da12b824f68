"""The arms as code: Nie's reference torques, MuJoCo's word on the exported models, and what their parameters do."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.oracle import ask

import kanejax as kj
from kanejax.robots import intelledex_605, stanford_arm, three_revolute_arm

LENGTHS = {"l33": 0.11, "l43": 0.07, "l52": 0.05, "l63": 0.13}
MOTORS = (0.953, 2.193, 0.782, 0.106, 0.097, 0.020)
FULL = ((0.5, 0.02, -0.03), (0.02, 0.6, 0.04), (-0.03, 0.04, 0.7))
ARMS: dict[str, Callable[[], kj.Model]] = {
    "intelledex": intelledex_605,
    "intelledex with all lengths": lambda: intelledex_605(**LENGTHS),
    "stanford": stanford_arm,
    "stanford with motors": lambda: stanford_arm(armatures=MOTORS, base_height=0.3, shoulder_offset=0.2),
    "three revolute": three_revolute_arm,
    "three revolute with lengths": lambda: three_revolute_arm(
        masses=(3.0, 2.0, 1.0),
        coms=((0.1, 0.2, 0.3), (-0.1, 0.2, 0.1), (0.2, 0.1, 0.3)),
        central_inertias=(FULL, FULL, FULL),
        origins=((0.1, 0.4, 0.0), (0.3, 0.1, 0.2)),
        gravity=(1.0, 2.0, -9.0),
    ),
}
# Torques [N m] at 0, 1 and 2 s, which the printed equations give once their misprints are corrected.
REFERENCE = [
    [0, 0, -51.41806886, -15.63086866, 0, 0],
    [-3.65240562, 23.80108726, -29.90338861, -4.44952941, 0.00752381, -0.00450906],
    [10.24418406, 7.55862433, 14.24269294, 9.76929291, 0, 0],
]


def test_intelledex_has_the_reference_torques() -> None:
    def q(t: jax.Array) -> jax.Array:
        angle = jnp.pi * (t - jnp.sin(jnp.pi * t) / jnp.pi) / 6
        return jnp.stack([angle, jnp.pi / 2 - angle / 2, angle, angle, angle, angle])

    u = jax.jacfwd(q)
    states = jax.vmap(lambda t: (q(t), u(t), jax.jacfwd(u)(t)))(jnp.array([0.0, 1.0, 2.0]))
    torques = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))(intelledex_605(), *states)
    np.testing.assert_allclose(torques, REFERENCE, rtol=0, atol=6e-9)


@pytest.mark.parametrize("arm", ARMS)
def test_dynamics_against_mujoco(arm: str) -> None:
    model = ARMS[arm]()
    mj_model = kj.to_mujoco(model).compile()
    random = np.random.default_rng(3)
    q, u, u_dot, tau = random.normal(size=(4, 6, model.nv)) * [[[2.0]], [[2.0]], [[5.0]], [[20.0]]]

    def everything(q: jax.Array, u: jax.Array, u_dot: jax.Array, tau: jax.Array) -> tuple[jax.Array, ...]:
        inverse, forward = kj.inverse_dynamics(model, q, u, u_dot), kj.forward_dynamics(model, q, u, tau)
        return inverse, forward, kj.mass_matrix(model, q), kj.bias_force(model, q, u)

    actual = jax.jit(jax.vmap(everything))(q, u, u_dot, tau)
    expected = [ask(mj_model, *state) for state in zip(q, u, u_dot, tau, strict=True)]
    for name, values in zip(("inverse", "forward", "mass_matrix", "bias"), actual, strict=True):
        reference = np.array([getattr(answer, name) for answer in expected])
        np.testing.assert_allclose(values, reference, rtol=0, atol=1e-11 * np.abs(reference).max(), err_msg=name)


@pytest.mark.parametrize("arm", ARMS)
def test_export_and_back(arm: str) -> None:
    model = ARMS[arm]()
    back = kj.load(kj.to_mjcf(model))
    assert back.tree == model.tree
    q = jnp.asarray(np.random.default_rng(4).normal(size=model.nq))
    expected = kj.mass_matrix(model, q)
    np.testing.assert_allclose(kj.mass_matrix(back, q), expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def test_intelledex_lengths_move_the_mass_centres_that_they_belong_to() -> None:
    """Nie, II.2: the vectors between mass centres and joints that his velocities contain."""
    q = jnp.array([0.3, 1.2, -0.4, 0.7, 0.2, 0.5])
    at, lengths = kj.poses(intelledex_605(**LENGTHS), q), LENGTHS
    wrist = at.link_origin[4]
    # P of (2.30) to D*: L41 d1 + L43 d3.
    to_d = at.rotation[3].T @ (at.com[3] - at.link_origin[3])
    np.testing.assert_allclose(to_d, [0.1727, 0.0, lengths["l43"]], atol=1e-15)
    # Link E's mass centre is L33 + L43 - L52 along its second axis, the wrist of link F L33 + L43.
    to_e, to_f = at.rotation[4].T @ (at.com[4] - wrist), at.rotation[4].T @ (at.link_origin[5] - wrist)
    both = lengths["l33"] + lengths["l43"]
    np.testing.assert_allclose(to_e, [0.0, both - lengths["l52"], 0.0], atol=1e-15)
    np.testing.assert_allclose(to_f, [0.0, both, 0.0], atol=1e-15)
    np.testing.assert_allclose(at.rotation[5].T @ (at.com[5] - at.link_origin[5]), [0.0, 0.0, lengths["l63"]], atol=1e-15)


def test_intelledex_angular_velocity_of_its_base_link() -> None:
    """Nie (2.17), which fixes the directions of the first three axes, also those of Figure 2.2."""
    q, u = jnp.array([0.3, 1.2, -0.4]), jnp.array([0.5, -0.7, 1.1])
    s2, c2, s3, c3 = jnp.sin(q[1]), jnp.cos(q[1]), jnp.sin(q[2]), jnp.cos(q[2])
    expected = jnp.stack([s2 * c3 * u[0] - s3 * u[1], -s2 * s3 * u[0] - c3 * u[1], c2 * u[0] + u[2]])
    still = jnp.zeros(3)
    for model, angles, speeds in (
        (three_revolute_arm(), q, u),
        (intelledex_605(), jnp.concatenate((q, still)), jnp.concatenate((u, still))),
    ):
        world = jnp.einsum("ri,r->i", kj.partial_velocities(model, angles).angular[2], speeds)
        np.testing.assert_allclose(kj.poses(model, angles).rotation[2].T @ world, expected, rtol=0, atol=1e-15)


def test_stanford_arm_reaches_along_its_boom() -> None:
    model = stanford_arm(base_height=0.3, shoulder_offset=0.2)
    assert model.tree.joint_types == ("revolute", "revolute", "prismatic", "revolute", "revolute", "revolute")
    # Upright boom: the wrist is q3 above the shoulder, beside the first axis by the offset.
    wrist = kj.poses(model, jnp.array([0.0, 0.0, 0.8, 0.4, 0.3, 0.2])).link_origin[4]
    np.testing.assert_allclose(wrist, [0.0, 0.2, 1.1], atol=1e-15)
    # Lowered by 90 degrees, it points along x.
    wrist = kj.poses(model, jnp.array([0.0, np.pi / 2, 0.8, 0.4, 0.3, 0.2])).link_origin[4]
    np.testing.assert_allclose(wrist, [0.8, 0.2, 0.3], atol=1e-15)


def test_stanford_inertias_are_about_the_axes_of_the_frames() -> None:
    model = stanford_arm()
    mass, com, central = (np.asarray(leaf[2]) for leaf in (model.mass, model.com, model.central_inertia))
    # A boom of 4.25 kg, with its mass centre 0.6447 m from the wrist.
    np.testing.assert_allclose(np.diag(central), [2.51 - mass * com[2] ** 2] * 2 + [0.006], rtol=1e-14)
    np.testing.assert_array_equal(stanford_arm(armatures=MOTORS).armature, MOTORS)
    large = np.full((6, 3), 9.0)
    full = stanford_arm(inertias=[np.diag(moments) for moments in large]).central_inertia
    np.testing.assert_array_equal(full, stanford_arm(inertias=large).central_inertia)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: stanford_arm(masses=(1.0, 2.0)), "masses has 2 rows; this arm needs 6"),
        (lambda: stanford_arm(armatures=(0.0,) * 5), "armatures has 5 rows; this arm needs 6"),
        (lambda: stanford_arm(coms=((0.0, 0.0),) * 6), "link 'A': com has shape (2,)"),
        (lambda: stanford_arm(inertias=((0.1, 0.1, 0.1),) * 6), "body 'C': principal moments"),
        (lambda: three_revolute_arm(coms=((0.0, 0.0, 0.1),) * 2), "coms has 2 rows; this arm needs 3"),
        (lambda: three_revolute_arm(origins=((0.0, 0.0, 0.1),) * 3), "origins has 3 rows; this arm needs 2"),
        (lambda: three_revolute_arm(coms=((0.0, 0.1),) * 3), "row 1, link 'A': com has shape (2,), but needs (3,)"),
        (lambda: intelledex_605(l33=float("nan")), "row 3, link 'C': next_origin = 0.2794 0 nan is not finite"),
    ],
)
def test_messages(build: Callable[[], kj.Model], message: str) -> None:
    with pytest.raises((ValueError, kj.KanejaxError)) as raised:
        build()
    assert message in str(raised.value)
