"""Speeds after the thesis's advice: components of the angular velocity of a link, Nie II.2."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax import robots
from tests.helpers.mechanisms import random_tree, relative

UR_LIKE = """<mujoco><compiler angle="radian"/><worldbody>{}</worldbody></mujoco>""".format(
    "".join(
        f'<body name="b{i}" pos="0.1 0.2 0.3"><joint name="j{i}" axis="{axis}"/>'
        '<inertial pos="0.1 0 0.2" mass="1" diaginertia="0.1 0.12 0.15"/>'
        for i, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0"))
    )
    + "</body>" * 6
)


def states(model, seed=0):
    rng = np.random.default_rng(seed)
    return tuple(jnp.asarray(rng.uniform(-1.4, 1.4, model.nv)) for _ in range(3))


def own_components(model, body, q, rates):
    """A body's angular velocity in its own axes."""
    w = jnp.einsum("kri,r->ki", kj.partial_velocities(model, q).angular, rates)
    at = model.tree.body(body)
    return kj.poses(model, q).rotation[at].T @ w[at]


@pytest.fixture(scope="module")
def intelledex():
    return robots.intelledex_605(l33=0.1, l43=-0.05, l52=0.07, l63=0.02)


def test_the_default_is_the_choice_of_the_thesis(intelledex):
    """(2.18) of Nie, with link C, and its inverse (2.19)."""
    speeds = kj.link_speeds(intelledex)
    assert speeds == kj.link_speeds(intelledex, "C", joints=intelledex.tree.joint_names[:3], components=("x", "y", "z"))
    arm = kj.with_speeds(intelledex, speeds)
    q, rates, u = states(intelledex)
    (s2, s3), (c2, c3), (q1, q2, q3) = np.sin(q[1:3]), np.cos(q[1:3]), np.asarray(rates[:3])
    expected = [s2 * c3 * q1 - s3 * q2, -s2 * s3 * q1 - c3 * q2, c2 * q1 + q3, *rates[3:]]
    assert relative(kj.speeds_from_rates(arm, q, rates), expected) < 1e-14
    assert relative(own_components(intelledex, "C", q, rates), expected[:3]) < 1e-14
    u1, u2, u3 = np.asarray(u[:3])
    expected = [(c3 * u1 - s3 * u2) / s2, -s3 * u1 - c3 * u2, u3 + (s3 * u2 - c3 * u1) * c2 / s2, *u[3:]]
    assert relative(kj.rates_from_speeds(arm, q, u), expected) < 1e-13


def test_the_partial_angular_velocities_of_the_chosen_link_are_its_axes(intelledex):
    arm = kj.with_speeds(intelledex, kj.link_speeds(intelledex))
    q, _, u = states(intelledex)
    partial, rotation = kj.partial_velocities(arm, q), kj.poses(intelledex, q).rotation[2]
    expected = np.concatenate((rotation.T, np.zeros((3, 3))))
    assert np.abs(np.asarray(partial.angular[2]) - expected).max() < 1e-14
    assert relative(own_components(intelledex, "C", q, kj.rates_from_speeds(arm, q, u)), u[:3]) < 1e-14


def test_singular_where_the_thesis_says(intelledex):
    arm = kj.with_speeds(intelledex, kj.link_speeds(intelledex))
    q, rates, _ = states(intelledex)
    conditioning = jax.jit(jax.vmap(lambda q2: kj.speed_conditioning(arm, q.at[1].set(q2))))
    for crossed in (0.0, np.pi):
        here, before, after = conditioning(jnp.array([crossed, crossed - 0.1, crossed + 0.1]))
        assert abs(here) < 1e-15
        assert float(before * after) < 0.0
        for function in (kj.speeds_from_rates, kj.rates_from_speeds):
            with pytest.raises(ValueError, match="the chosen speeds do not determine the motion at q = "):
                function(arm, q.at[1].set(crossed), rates)
    # The axes of the first and the third joint include the angle q2: extreme singular values sqrt(1 +- |c2|), and ones.
    angles = jnp.linspace(0.1, 3.0, 7)
    expected = np.sqrt((1 - np.abs(np.cos(angles))) / (1 + np.abs(np.cos(angles))))
    assert relative(np.abs(conditioning(angles)), expected) < 1e-13


@pytest.mark.parametrize("body", ["A", "B", "C"])
def test_choices_of_the_base_link(body):
    """Of Figure 2.2 of Nie: as many components as joints turn the link, and the same torques for each link."""
    model = robots.three_revolute_arm(origins=((0.0, 0.1, 0.2), (0.3, 0.0, 0.1)))
    speeds = kj.link_speeds(model, body)
    count = "ABC".index(body) + 1
    assert speeds.slots == tuple(range(count))
    arm = kj.with_speeds(model, speeds)
    q, rates, tau = states(model)
    u = kj.speeds_from_rates(arm, q, rates)
    assert relative(own_components(model, body, q, rates)[np.array(speeds.components)], u[:count]) < 1e-14
    q_ddot = kj.forward_dynamics(model, q, rates, tau)
    u_dot = kj.forward_dynamics(arm, q, u, tau)
    # The rates of the speeds along the motion with these accelerations.
    expected = jax.jvp(lambda *state: kj.speeds_from_rates(arm, *state), (q, rates), (rates, q_ddot))[1]
    assert relative(u_dot, expected) < 1e-12
    assert relative(kj.inverse_dynamics(arm, q, u, u_dot), tau) < 1e-12


def test_the_middle_link_of_three_revolute_joints():
    model = robots.three_revolute_arm()
    assert kj.link_speeds(model) == kj.link_speeds(model, "B")


def test_axes_in_one_plane_give_two_components():
    """The shoulder, elbow and first wrist axis of many arms are parallel: two of three rates can be replaced."""
    model = kj.load(UR_LIKE)
    speeds = kj.link_speeds(model)
    assert (speeds.body, len(speeds.slots)) == (2, 2)
    with pytest.raises(ValueError, match="never determine the rates of 'j0', 'j1', 'j2'"):
        kj.link_speeds(model, joints=("j0", "j1", "j2"))
    assert kj.link_speeds(model, "b4").slots[-1] == 4


def test_other_bodies_in_trees_and_on_floating_bases():
    model = kj.load(random_tree(566, 5, ("hinge", "free", "ball", "weld", "slide", "hinge", "hinge")))
    assert set(model.tree.joint_types) == {"free", "ball", "revolute", "prismatic"}
    assert len(set(model.tree.link_parents)) < model.njoint
    q = jax.random.normal(jax.random.key(0), (model.nq,), model.dtype)
    rates = jax.random.normal(jax.random.key(1), (model.nv,), model.dtype)
    movable = [b for b in range(model.nbody) if "revolute" in kinds_that_move(model.tree, b)]
    assert len(movable) > 1
    for body in movable:
        name = model.tree.body_names[body]
        speeds = kj.link_speeds(model, name)
        arm = kj.with_speeds(model, speeds)
        u = kj.speeds_from_rates(arm, q, rates)
        expected = np.array(rates)
        expected[list(speeds.slots)] = own_components(model, name, q, rates)[np.array(speeds.components)]
        assert relative(u, expected) < 1e-13
        assert relative(kj.rates_from_speeds(arm, q, u), rates) < 1e-11


def kinds_that_move(tree, body):
    return {tree.joint_types[j] for j in tree.speed_joints[tree.body_moved_by[body]]}


def test_the_choice_follows_the_leaves_of_the_model(intelledex):
    speeds = kj.link_speeds(intelledex)
    q, rates, _ = states(intelledex)
    tilted = intelledex.replace(joint_axis=intelledex.joint_axis.at[1, 0].add(0.3))
    u = kj.speeds_from_rates(kj.with_speeds(tilted, speeds), q, rates)
    assert relative(u[:3], own_components(tilted, "C", q, rates)) < 1e-14
    kept = kj.with_speeds(kj.specialize(intelledex, keep=("joint_axis",)).replace(joint_axis=tilted.joint_axis), speeds)
    assert relative(kj.speeds_from_rates(kept, q, rates), u) < 1e-13
    frozen = kj.with_speeds(kj.specialize(tilted), speeds)
    assert relative(jax.jit(kj.bias_force)(frozen, q, u), kj.bias_force(kj.with_speeds(tilted, speeds), q, u)) < 1e-12


def test_gradient_and_batch(intelledex):
    speeds = kj.link_speeds(intelledex)
    q, u, tau = states(intelledex)

    def loss(model, q):
        return jnp.sum(jnp.sin(kj.forward_dynamics(kj.with_speeds(model, speeds), q, u, tau)))

    value_and_slopes = jax.jit(jax.value_and_grad(loss, (0, 1)))
    by_model, by_q = value_and_slopes(intelledex, q)[1]
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(by_model))
    slopes = [(value_and_slopes(intelledex, q + s)[0] - value_and_slopes(intelledex, q - s)[0]) / 2e-6 for s in 1e-6 * np.eye(6)]
    assert relative(by_q, slopes) < 1e-7
    several = jnp.stack([q, q + 0.3, q - 0.4])
    batch = jax.jit(jax.vmap(loss, (None, 0)))(intelledex, several)
    assert relative(batch, [value_and_slopes(intelledex, row)[0] for row in several]) < 1e-12


def test_errors(intelledex):
    with pytest.raises(kj.UnknownNameError, match="no body is named 'G'; the names are: 'A', 'B'"):
        kj.link_speeds(intelledex, "G")
    names = intelledex.tree.joint_names
    with pytest.raises(ValueError, match=rf"joint '{names[4]}' is not a revolute joint that moves body 'C'"):
        kj.link_speeds(intelledex, "C", joints=names[3:6][1:])
    with pytest.raises(ValueError, match="component 'w' is unknown; give 'x', 'y' or 'z'"):
        kj.link_speeds(intelledex, "C", components=("w",))
    with pytest.raises(ValueError, match="2 components replace the rates of as many joints, but 3 are given"):
        kj.link_speeds(intelledex, "C", joints=names[:3], components=("x", "y"))
    with pytest.raises(ValueError, match="never determine the rates of"):
        kj.link_speeds(intelledex, "C", joints=names[2:3], components=("x",))
    with pytest.raises(ValueError, match="no values to choose by; give joints and components"):
        jax.jit(lambda m: kj.speed_conditioning(kj.with_speeds(m, kj.link_speeds(m)), jnp.ones(6)))(intelledex)
    chosen = {"joints": names[:3], "components": ("x", "y", "z")}
    found = jax.jit(lambda m: kj.speed_conditioning(kj.with_speeds(m, kj.link_speeds(m, **chosen)), jnp.ones(6)))(intelledex)
    assert 0.1 < abs(float(found)) < 1.0
    slider = kj.load('<mujoco><worldbody><body name="cart"><joint type="slide"/><geom size="1"/></body></worldbody></mujoco>')
    with pytest.raises(ValueError, match="a model without revolute joints"):
        kj.link_speeds(slider)
    with pytest.raises(ValueError, match="no revolute joint moves body 'cart'"):
        kj.link_speeds(slider, "cart")
