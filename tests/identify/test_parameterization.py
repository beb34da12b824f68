"""From unknowns to plants: names, selections, ties, bounds, starts, priors, and what is said of mistakes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from helpers.mechanisms import relative

import kanejax as kj
from kanejax._parameters.leaves import LEAVES
from kanejax._parameters.parameterization import parameterization
from kanejax._parameters.payload import with_payload
from kanejax._parameters.plant import Drives, Plant, signal
from kanejax._parameters.priors import Entropic, Gaussian, Geodesic
from kanejax._parameters.pseudo_inertia import pseudo_inertia
from kanejax._parameters.unknowns import Unknown

XML = """<mujoco><compiler angle="radian"/><worldbody><body name="base"><inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/>
<body name="arm" pos="0 0 1" quat="1 0.1 0.2 0.3"><inertial pos="0.2 0.1 0" mass="2" diaginertia="0.1 0.2 0.25"/>
  <joint name="yaw" axis="0 1 2" pos="0.1 0 0" damping="0.3" stiffness="4" armature="0.2" frictionloss="0.5"/>
  <body name="wrist1" pos="0.5 0 0"><inertial pos="0 0.1 0" mass="1" diaginertia="0.02 0.02 0.03"/>
    <joint name="lift" type="slide" damping="0.1"/>
    <body name="wrist2" pos="0 0 0.2"><inertial pos="0 0 0.1" mass="0.5" diaginertia="0.01 0.015 0.02"/>
      <joint name="roll" axis="1 0 0" damping="0.5"/>
      <body name="frame" pos="0 0 0.1"/></body></body></body></body></worldbody></mujoco>"""
BALL = """<mujoco><worldbody><body name="float"><freejoint name="free"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<body name="head"><joint name="neck" type="ball"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body>
</worldbody></mujoco>"""
# Leaves that need no more than a nominal value to be perturbed together.
GEOMETRY = ("body_position", "body_quaternion", "joint_axis", "joint_anchor", "coordinate_reference")
OTHERS = ("armature", "damping", "coulomb_friction", "friction_width", "stiffness", "spring_reference", "gravity", "gain", "offset")
OTHERS += ("stribeck_friction", "stribeck_speed", "load_friction", "delay")


def ideal(model: kj.Model) -> Plant:
    return Plant(model, Drives.ideal(model))


@pytest.fixture(scope="module")
def plant() -> Plant:
    return ideal(kj.load(XML))


def state(model: kj.Model):
    rng = np.random.default_rng(1)
    return tuple(jnp.asarray(rng.normal(size=size), model.dtype) for size in (model.nq, model.nv, model.nv))


def test_names_units_and_numbers_of_the_given_plant(plant):
    p = parameterization(plant, [Unknown("inertia", "arm"), "damping", "delay", "gravity", Unknown("com", "wrist*"), "joint_axis"])
    assert p.names[:2] == ("arm.m", "arm.mcx")
    assert p.names[10:17] == ("yaw.damping", "lift.damping", "roll.damping", "delay", "gravity.x", "gravity.y", "gravity.z")
    assert p.names[17:21] == ("wrist1.com.x", "wrist1.com.y", "wrist1.com.z", "wrist2.com.x")
    assert p.names[-2:] == ("roll.joint_axis.1", "roll.joint_axis.2")
    assert p.units[:5] == ("kg", "kg m", "kg m", "kg m", "kg m^2")
    assert p.units[10:14] == ("N m s/rad", "N s/m", "N m s/rad", "s")
    np.testing.assert_allclose(p.phi0[:10], kj.inertia_parameters(plant.model)[1], rtol=1e-15)
    np.testing.assert_allclose(p.phi0[10:17], [0.3, 0.1, 0.5, 0, *plant.model.gravity], rtol=1e-15)
    np.testing.assert_allclose(p.phi(p.theta0), p.phi0, rtol=0, atol=1e-14)
    assert p.notes == ()
    assert p.tree is plant.model.tree
    assert [unknown.leaf for unknown in p.unknowns] == ["inertia", "damping", "delay", "gravity", "com", "joint_axis"]


def test_names_of_joints_with_several_speeds():
    p = parameterization(ideal(kj.load(BALL)), ["offset", Unknown("damping", "neck")])
    assert p.names[:6] == tuple(f"free.offset.{part}" for part in ("x", "y", "z", "about_x", "about_y", "about_z"))
    assert p.names[6:] == tuple(
        f"neck.{name}" for name in ("offset.x", "offset.y", "offset.z", "damping.x", "damping.y", "damping.z")
    )
    assert p.units == (*("N",) * 3, *("N m",) * 6, *("N m s/rad",) * 3)


def test_selections(plant):
    def owners(*args) -> list[str]:
        return [name.split(".")[0] for name in parameterization(plant, [Unknown(*args)]).names]

    assert owners("mass") == ["arm", "wrist1", "wrist2"]
    assert owners("mass", "base") == ["base"]
    assert owners("mass", ("wrist*", "arm")) == ["arm", "wrist1", "wrist2"]
    assert owners("mass", lambda name: name.endswith("2")) == ["wrist2"]
    assert owners("offset", ["roll", "yaw"]) == ["yaw", "roll"]
    assert owners("body_position")[::3] == ["arm", "wrist1", "wrist2", "frame"]
    named = with_payload(plant.model, "arm", "tool[1]", mass=1.0, central_inertia=np.eye(3))
    assert parameterization(ideal(named), [Unknown("mass", "tool[1]")]).names == ("tool[1].mass",)


def test_frames_without_mass_are_left_out_unless_they_are_named(plant):
    p = parameterization(plant, ["inertia"])
    assert {name.split(".")[0] for name in p.names} == {"arm", "wrist1", "wrist2"}
    assert p.notes == ("inertia of frame is left out: without mass and inertia, a frame; name it to seek it",)
    both = parameterization(plant, ["inertia", Unknown("inertia", "frame", scale=(2.0, 0.3))])
    assert len(both.names) == 40
    np.testing.assert_array_equal(both.phi0[30:], np.zeros(10))
    expected = [2.0, 0, 0, 0, *np.full(3, 2.0 * 0.3**2), 0, 0, 0]
    np.testing.assert_allclose(both.phi(both.theta0)[30:], expected, rtol=0, atol=1e-14)
    assert "body 'frame' starts with a mass of 2 kg in place of 0 kg and the inertia of a ball" in both.notes[1]


@pytest.mark.parametrize(("dtype", "tolerance"), [(jnp.float64, 1e-10), (jnp.float32, 1e-4)])
def test_every_leaf_can_be_sought_and_set(plant, dtype, tolerance):
    """At random coordinates: numbers there and back, the leaf in the plant, finite derivatives, and float32."""
    given = jax.tree.map(lambda x: x.astype(dtype), plant)
    p = parameterization(given, ["inertia", *GEOMETRY, *OTHERS])
    assert set(LEAVES) - {unknown.leaf for unknown in p.unknowns} == {"mass", "com", "central_inertia"}
    theta = p.starts(jax.random.key(0), 3)[2]
    phi = eqx.filter_jit(p.phi)(theta)
    assert (theta.dtype, phi.dtype) == (dtype, dtype)
    assert relative(eqx.filter_jit(p.theta_of)(phi), theta) < 10 * tolerance
    found = eqx.filter_jit(p.plant)(theta)
    assert relative(kj.inertia_parameters(found.model)[1:4], phi[:30].reshape(3, 10)) < tolerance
    numbers = dict(zip(p.names, np.asarray(phi), strict=True))
    for name in (*OTHERS, "coordinate_reference"):
        leaf = getattr(found.drives, name) if hasattr(found.drives, name) else getattr(found.model, name)
        ours = [numbers[key] for key in p.names if name in key.split(".")]
        np.testing.assert_array_equal(np.ravel(leaf), ours)
    np.testing.assert_allclose(found.model.body_position[2], [numbers[f"wrist1.body_position.{x}"] for x in "xyz"], rtol=1e-6)
    assert all(leaf.dtype == dtype for leaf in jax.tree.leaves(found))
    derivatives = jax.jit(jax.jacfwd(p.phi))(theta), jax.jit(jax.jacrev(p.theta_of))(eqx.filter_jit(p.phi)(p.theta0))
    assert all(np.isfinite(x).all() for x in derivatives)
    # No coordinate is superfluous.
    assert np.linalg.matrix_rank(derivatives[0].astype(float)) == len(theta)
    batch = jax.jit(jax.vmap(p.phi))(jnp.stack((theta, p.theta0)))
    assert relative(batch[0], phi) < tolerance


def test_assembled_plants_predict_what_found_plants_do(plant):
    p = parameterization(plant, ["inertia", *GEOMETRY, *OTHERS])
    theta = p.starts(jax.random.key(1), 2)[1]
    assembled, parameters = p.assemble(p.phi(theta))
    found = p.plant(theta)
    np.testing.assert_allclose(parameters, kj.inertia_parameters(found.model), rtol=0, atol=1e-13)
    np.testing.assert_array_equal(found.model.mass[0], plant.model.mass[0])
    np.testing.assert_array_equal(found.model.com[jnp.array([0, 4])], plant.model.com[jnp.array([0, 4])])
    q, u, u_dot = state(plant.model)
    assert relative(signal(assembled, q, u, u_dot, parameters), signal(found, q, u, u_dot)) < 1e-11


def test_mass_centre_and_inertia_of_their_own(plant):
    """Physical for all coordinates, and the ten parameters follow."""
    p = parameterization(plant, [Unknown("mass", "arm"), Unknown("com", "arm"), Unknown("central_inertia", "arm")])
    np.testing.assert_allclose(p.phi(p.theta0), p.phi0, rtol=0, atol=1e-14)
    for theta in p.starts(jax.random.key(2), 5, 1.5):
        phi = p.phi(theta)
        np.testing.assert_allclose(p.theta_of(phi), theta, rtol=0, atol=1e-8)
        assembled, parameters = p.assemble(phi)
        arm = assembled.model.body("arm")
        np.testing.assert_array_equal(phi, [arm.mass, *arm.com, *arm.central_inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])
        np.testing.assert_array_equal(parameters, kj.inertia_parameters(assembled.model))
        assert np.linalg.eigvalsh(pseudo_inertia(parameters[1]))[0] > 0


def test_signals_are_affine_in_phi_where_that_is_said(plant):
    affine = [
        "inertia",
        Unknown("mass", "base"),
        "armature",
        "damping",
        "coulomb_friction",
        "stiffness",
        "offset",
        "stribeck_friction",
    ]
    p = parameterization(plant, affine)
    assert p.linear
    q, u, u_dot = state(plant.model)

    def predicted(phi):
        assembled, parameters = p.assemble(phi)
        return signal(assembled, q, u, u_dot, parameters)

    a, b = (jnp.asarray(np.random.default_rng(seed).normal(size=len(p.phi0))) for seed in (0, 1))
    between = 0.3 * predicted(a) + 0.7 * predicted(b)
    assert relative(predicted(0.3 * a + 0.7 * b), between) < 1e-12
    for other in ("com", "gain", "load_friction", "friction_width", "stribeck_speed", "delay", "central_inertia", *GEOMETRY):
        assert not parameterization(plant, ["damping", other]).linear
    loaded = Plant(plant.model, plant.drives.replace(load_friction=0.1))
    assert not parameterization(loaded, ["damping"]).linear


def test_rotations_and_tilts_are_what_they_say(plant):
    """Quaternions turn by rotation vectors in the body's axes, axes tilt by their angle; lengths stay, phi = 0 is nominal."""
    p = parameterization(plant, [Unknown("body_quaternion", "arm"), Unknown("joint_axis", "yaw")])
    np.testing.assert_array_equal(p.phi0, np.zeros(5))
    still = p.assemble(p.phi0)[0].model
    np.testing.assert_allclose(still.body_quaternion, plant.model.body_quaternion, rtol=0, atol=1e-15)
    np.testing.assert_allclose(still.joint_axis, plant.model.joint_axis, rtol=0, atol=1e-15)
    angle, direction = 0.8, np.array([2.0, -1.0, 2.0]) / 3
    phi = jnp.concatenate((jnp.asarray(2 * np.tan(angle / 2) * direction), jnp.array([0.3, 0.4])))
    moved = p.assemble(phi)[0].model
    matrices = [kj.poses(model, jnp.zeros(3)).rotation[1] for model in (plant.model, moved)]
    x, y, z = angle * direction
    turn = scipy.linalg.expm(np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    np.testing.assert_allclose(matrices[1], matrices[0] @ turn, rtol=0, atol=1e-14)
    given, axis = np.asarray(plant.model.joint_axis[0]), np.asarray(moved.joint_axis[0])
    np.testing.assert_allclose(np.linalg.norm(axis), np.linalg.norm(given), rtol=1e-14)
    np.testing.assert_allclose(given @ axis / (given @ given), np.cos(np.arctan(0.5)), rtol=1e-14)
    np.testing.assert_array_equal(moved.body_quaternion[2:], plant.model.body_quaternion[2:])


def test_ties_are_one_number(plant):
    p = parameterization(plant, [Unknown("damping", ["yaw", "roll"], tied=True)])
    assert (p.names, p.units) == (("yaw,roll.damping",), ("N m s/rad",))
    assert p.notes == ("damping is tied, but goes from 0.3 to 0.5 in the given plant: it starts at the mean, 0.4",)
    np.testing.assert_allclose(p.phi(p.theta0), [0.4], rtol=1e-14)
    np.testing.assert_array_equal(p.assemble(jnp.array([7.0]))[0].model.damping, [7.0, 0.1, 7.0])
    one = parameterization(plant, [Unknown("damping", "lift", tied=True)])
    assert (one.names, one.notes) == (("lift.damping",), ())


@jax.jit
def numbers_and_back(p, thetas, near, outside):
    """Numbers and their derivatives, there and back, and derivatives of the way back: one program."""
    phi, slopes = jax.vmap(p.phi)(thetas)[:, 0], jax.vmap(jax.jacfwd(p.phi))(thetas)
    back = jax.vmap(lambda x: p.theta_of(p.phi(x)))(near)
    return phi, slopes, back, jax.vmap(jax.jacrev(p.theta_of))(outside), p.phi(p.theta0)


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
@pytest.mark.parametrize(("low", "high"), [(-1.0, np.inf), (-np.inf, 2.0), (-1.0, 2.0), (-np.inf, np.inf)])
def test_bounds_hold_for_all_coordinates(plant, low, high, dtype):
    given = jax.tree.map(lambda x: x.astype(dtype), plant)
    bounds = tuple(None if bound == -np.inf else bound for bound in (low, high))
    p = parameterization(given, [Unknown("offset", "yaw", bounds=bounds)])
    single = dtype == jnp.float32
    thetas = jnp.linspace(-40.0, 40.0, 41, dtype=dtype)[:, None]
    near = jnp.linspace(-3.0, 3.0, 7, dtype=dtype)[:, None]
    outside = jnp.asarray([-1e3, 1e3, -1.0, 2.0, 0.0], dtype)[:, None]
    phi, slopes, back, slopes_back, first = map(np.asarray, numbers_and_back(p, thetas, near, outside))
    assert ((phi >= low) & (phi <= high)).all()
    assert (np.diff(phi) >= 0).all()
    # All of what is within bounds is reached.
    assert phi[0] < max(low + 1e-6, -30.0)
    assert phi[-1] > min(high - 1e-6, 30.0)
    np.testing.assert_allclose(back, near, rtol=0, atol=1e-4 if single else 1e-12)
    np.testing.assert_allclose(first, [0.0], rtol=0, atol=1e-6 if single else 1e-15)
    assert np.isfinite(slopes_back).all()
    assert np.isfinite(slopes).all()


@jax.jit
def before_and_after(p, thetas, shares):
    """Steps that are shares of those allowed, of 5 where there is no limit; where they lead, and where derivatives do."""

    def of(theta, share):
        least, greatest = p.step_limits(theta)
        step = jnp.where(share < 0, -jnp.maximum(least, -5.0), jnp.minimum(greatest, 5.0)) * share
        phi, change = jax.jvp(p.phi, (theta,), (step,))
        new = p.moved(theta, step)
        return jnp.concatenate((least, greatest, step, phi, change, new, p.phi(new)))

    return jax.vmap(lambda theta: jax.vmap(lambda share: of(theta, share))(shares))(thetas)


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
@pytest.mark.parametrize(("low", "high"), [(-1.0, np.inf), (-np.inf, 2.0), (-1.0, 2.0), (-np.inf, np.inf)])
def test_numbers_move_as_their_derivatives_say_and_not_up_to_a_bound(plant, low, high, dtype):
    given = jax.tree.map(lambda x: x.astype(dtype), plant)
    bounds = tuple(None if np.isinf(bound) else bound for bound in (low, high))
    p = parameterization(given, [Unknown("offset", "yaw", bounds=bounds)])
    thetas = jnp.asarray([-60.0, -25.0, -19.9, -3.0, -0.5, 0.4, 6.0, 19.9, 25.0, 60.0], dtype)[:, None]
    found = np.asarray(before_and_after(p, thetas, jnp.asarray([-1.0, -0.5, -1e-3, 1e-3, 0.5, 1.0], dtype)))
    least, greatest, step, phi, change, new, reached = np.moveaxis(found, -1, 0)
    assert np.isinf(least).all() if low == -np.inf else (least[:4] > -5.0).all()
    assert np.isinf(greatest).all() if high == np.inf else (greatest[-4:] < 5.0).all()
    assert np.isfinite(new).all()
    assert (np.sign(new - thetas) == np.sign(step))[np.abs(change) > 1e-6].all()
    tolerance = 100 * float(jnp.finfo(dtype).eps)
    np.testing.assert_allclose(reached, phi + change, rtol=tolerance, atol=tolerance)
    # A tenth of the distance from a bound is left, however small it is.
    for bound, side in ((low, -1.0), (high, 1.0)):
        if np.isfinite(bound):
            far = np.abs(bound - phi)
            assert (np.abs(bound - reached) >= 0.099 * far - tolerance).all()
            assert (side * (bound - reached) >= 0).all()


def test_bounds_of_each_number(plant):
    low, high = [0.1, 0.0, -0.1], [0.3, 0.2, 0.1]
    p = parameterization(plant, [Unknown("com", "arm", bounds=(low, high))])
    np.testing.assert_allclose(p.phi(jnp.full(3, -50.0)), low, rtol=0, atol=1e-15)
    np.testing.assert_allclose(p.phi(jnp.full(3, 50.0)), high, rtol=0, atol=1e-15)
    np.testing.assert_allclose(p.phi(jnp.zeros(3)), [0.2, 0.1, 0.0], rtol=0, atol=1e-15)


def test_what_cannot_be_negative_is_positive_by_default(plant):
    positive = [name for name, leaf in LEAVES.items() if leaf.positive]
    assert set(positive) >= {"mass", "armature", "damping", "coulomb_friction", "stribeck_friction", "load_friction", "gain"}
    p = parameterization(plant, positive)
    assert (p.phi(jnp.full(len(p.phi0), -30.0)) >= 0).all()
    turned = Plant(plant.model, plant.drives.replace(gain=[-2.0, 1.0, -1.0]))
    gains = parameterization(turned, ["gain"])
    np.testing.assert_allclose(gains.phi(gains.theta0), [-2.0, 1.0, -1.0], rtol=1e-14)
    np.testing.assert_array_equal(np.sign(gains.phi(jnp.full(3, 3.0))), [-1, 1, -1])
    free = parameterization(plant, [Unknown("damping", bounds=(None, None))])
    assert (free.phi(jnp.full(3, -30.0)) < 0).all()


@pytest.mark.parametrize("tiny", [0.0, 1e-8])
def test_starts_at_a_bound_are_moved_where_they_can_move(plant, tiny):
    given = Plant(plant.model.replace(damping=[tiny, 0.3, 5.0]), plant.drives)
    p = parameterization(
        given, ["damping", Unknown("offset", "yaw", bounds=(-tiny, 50.0)), Unknown("armature", "lift", scale=0.02)]
    )
    np.testing.assert_allclose(p.phi(p.theta0), [0.1, 0.3, 5.0, 0.5, 0.002], rtol=1e-7)
    assert p.notes[0] == f"yaw.damping: starts at 0.1 N m s/rad in place of {tiny:.3g}; so near to a bound it would hardly move"
    assert p.notes[1].startswith("yaw.offset: starts at 0.5 N m in place of 0;")
    assert len(p.notes) == 3
    slope = np.diag(jax.jacfwd(p.phi)(p.theta0))
    assert (slope > 0.09 * np.array([1, 1, 1, 5, 0.02])).all()
    np.testing.assert_allclose(p.phi0[:3], [tiny, 0.3, 5.0], rtol=1e-15)


def test_what_is_at_a_border(plant):
    sought = [
        Unknown("inertia", "arm"),
        Unknown("central_inertia", "wrist1"),
        "damping",
        Unknown("offset", bounds=(-1.0, 3.0)),
        "delay",
    ]
    p = parameterization(plant, sought)
    assert not p.at_border(p.theta0).any()
    slices = {"arm": slice(0, 10), "wrist1": slice(10, 16)}
    for body, numbers in slices.items():
        flat = p.at_border(p.theta0.at[numbers.start].set(-7.0))
        np.testing.assert_array_equal(np.flatnonzero(flat), np.arange(len(flat))[numbers], err_msg=body)
    theta = p.theta0.at[16].set(-8.0).at[19].set(-8.0).at[20].set(8.0).at[22].set(-50.0)
    assert [p.names[i] for i in np.flatnonzero(p.at_border(theta))] == ["yaw.damping", "yaw.offset", "lift.offset"]


def test_starts(plant):
    p = parameterization(plant, ["inertia", "damping"])
    thetas = p.starts(jax.random.key(0), 200, 0.5)
    np.testing.assert_array_equal(thetas[0], p.theta0)
    np.testing.assert_allclose(np.std(thetas[1:] - p.theta0[None]), 0.5, rtol=0.05)
    assert (np.linalg.eigvalsh(pseudo_inertia(jax.vmap(p.phi)(thetas)[:, :10]))[:, 0] > 0).all()


def test_what_cannot_exist_starts_at_the_nearest_body():
    """A model whose inertia breaks the triangle inequality keeps it in phi0, and starts at another."""
    model = kj.load(XML)
    model = model.body("arm").set(central_inertia=np.diag([0.1, 0.1, 0.5]))
    p = parameterization(ideal(model), [Unknown("inertia", "arm")])
    np.testing.assert_allclose(p.phi0, kj.inertia_parameters(model)[1], rtol=1e-15)
    assert p.notes[0].startswith("body 'arm' starts with second moments of at least 0.0001 of the largest about the mass centre")
    start = p.phi(p.theta0)
    assert np.linalg.eigvalsh(pseudo_inertia(start))[0] > 0
    np.testing.assert_allclose(start[:4], p.phi0[:4], rtol=1e-14)
    # What linear least squares would return has the nearest coordinates too.
    again = p.phi(p.theta_of(p.phi0))
    assert np.linalg.eigvalsh(pseudo_inertia(again))[0] > 0
    assert np.isfinite(jax.jacrev(p.theta_of)(p.phi0)).all()


def test_priors(plant):
    sought = [
        Unknown("inertia", "arm", prior=Entropic(0.5)),
        Unknown("inertia", "wrist1", prior=Geodesic(0.25)),
        Unknown("inertia", "wrist2", prior=Gaussian([0.1] + [0.2] * 3 + [0.3] * 6)),
        Unknown("damping", prior=Gaussian(0.1, relative=True)),
        Unknown("com", "base", prior=Gaussian((0.1, 0.2, 0.3))),
        Unknown("offset", prior=Gaussian(2.0)),
        "coulomb_friction",
    ]
    p = parameterization(plant, sought)
    assert p.prior(p.theta0).shape == (39,)
    np.testing.assert_allclose(p.prior(p.theta0), 0.0, rtol=0, atol=1e-12)
    theta = p.starts(jax.random.key(3), 2)[1]
    residuals, phi = np.asarray(p.prior(theta)), np.asarray(p.phi(theta))
    given, found = (np.asarray(pseudo_inertia(jnp.asarray(x[:20]).reshape(2, 10))) for x in (p.phi0, phi))
    values = [scipy.linalg.eigvals(np.linalg.solve(*pair)).real for pair in zip(given, found, strict=True)]
    np.testing.assert_allclose(np.sum(residuals[:10] ** 2), np.sum(values[0] - np.log(values[0]) - 1) / 0.5**2, rtol=1e-9)
    np.testing.assert_allclose(np.sum(residuals[10:20] ** 2), 0.5 * np.sum(np.log(values[1]) ** 2) / 0.25**2, rtol=1e-9)
    std = [0.1] + [0.2] * 3 + [0.3] * 6 + [0.03, 0.01, 0.05] + [0.1, 0.2, 0.3] + [2.0] * 3
    np.testing.assert_allclose(residuals[20:], (phi - np.asarray(p.phi0))[20:39] / std, rtol=1e-10, atol=1e-13)
    assert parameterization(plant, ["damping"]).prior(jnp.zeros(3)).shape == (0,)
    assert np.isfinite(jax.jit(jax.hessian(lambda x: jnp.sum(p.prior(x) ** 2)))(p.theta0)).all()


def test_other_numbers_do_not_compile_again(plant):
    """One program for plants, bounds, scales and priors with other numbers, whatever is to be noted of them."""
    count = 0

    @jax.jit
    def evaluated(p, theta):
        nonlocal count
        count += 1
        return p.phi(theta), p.prior(theta)

    heavier = Plant(plant.model.replace(mass=2 * plant.model.mass, damping=np.zeros(3)), plant.drives)
    for given, std in ((plant, 1.0), (heavier, 2.0)):
        sought = [Unknown("inertia", prior=Entropic(std)), Unknown("damping", bounds=(0.0, 2.0 * std), prior=Gaussian(std))]
        p = parameterization(given, sought)
        theta = p.theta0.at[0].add(0.5)
        phi, residuals = evaluated(p, theta)
        np.testing.assert_allclose(phi, p.phi(theta), rtol=0, atol=1e-13)
        np.testing.assert_allclose(residuals, p.prior(theta), rtol=0, atol=1e-13)
        np.testing.assert_allclose(residuals[0], np.sqrt(np.e - 2) / std, rtol=1e-12)
        assert p.unknowns[0].prior == Entropic(std)
    assert count == 1
    assert any("yaw.damping" in note for note in p.notes)
