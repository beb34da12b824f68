"""Identification in one call: what it finds, what it says of it, and what it refuses."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.robot_logs import OFFSETS, arm, efforts, motion_of_arm, recorded_arm

import kanejax as kj
from kanejax._checkpoint import CheckpointError

# Where the number of links is not the matter: fewer of them compile faster.
TWO_LINKS = """<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/>
<inertial pos="0.2 0.02 0.01" mass="2" fullinertia="0.01 0.05 0.05 0.001 0.002 -0.001"/>
<body name="fore" pos="0.4 0 0"><joint name="elbow" axis="0 1 0.3"/>
<inertial pos="0.15 -0.01 0.02" mass="1" fullinertia="0.005 0.02 0.02 0.0005 0.001 0.0002"/></body></body>
</worldbody></mujoco>"""
inverse_dynamics = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))


@functools.cache
def two_links() -> kj.Model:
    return kj.load(TWO_LINKS).replace(damping=[0.5, 0.3], coulomb_friction=[0.4, 0.2], friction_width=jnp.full(2, 0.02))


def plant_of_two_links(model: kj.Model, **drives) -> kj.Plant:
    return kj.Plant(model, kj.Drives.ideal(model).replace(offset=OFFSETS[:2], **drives))


def motion_of_two_links(rate: float = 100.0, duration: float = 7.5) -> tuple[np.ndarray, ...]:
    ts, *state = motion_of_arm(rate, duration)
    return ts, *(x[:, :2] for x in state)


def efforts_of_two_links(model: kj.Model, *state: np.ndarray) -> np.ndarray:
    return np.asarray(inverse_dynamics(model, *map(jnp.asarray, state))) + OFFSETS[:2]


@functools.cache
def recorded(noise: float = 0.0, seed: int = 0) -> kj.Motion:
    """As many samples as the fixture fits, so that fits share their compiled programs."""
    return recorded_arm(noise, seed, duration=7.5)


def nominal() -> kj.Model:
    model = arm()
    return model.replace(mass=model.mass * jnp.array([1.3, 0.7, 1.2]), damping=jnp.full(3, 0.1), coulomb_friction=jnp.full(3, 0.1))


def same_forces(model, expected, tolerance):
    """At random states, but for the friction that both have at rest."""
    state = [jnp.asarray(x) for x in np.random.default_rng(3).normal(size=(3, model.nv))]
    value, right = (kj.inverse_dynamics(m, *state) for m in (model, expected))
    assert float(jnp.abs(value - right).max()) < tolerance * float(jnp.abs(right).max())


@pytest.fixture(scope="module")
def exact():
    return kj.identify(nominal(), [recorded_arm()], friction_width=None, validation=0.25)


def test_exact_data_give_the_plant_back(exact):
    assert exact.converged
    same_forces(exact.model, arm(), 1e-7)
    np.testing.assert_allclose(exact.drives.offset, OFFSETS, atol=1e-8)
    assert exact["elbow.damping"].value == pytest.approx(0.3, abs=1e-8)
    assert exact.consistency.min() > 0
    for run in (*exact.training, *exact.validation):
        assert np.all(kj.relative_error(run) < 1e-8)
        assert np.all(kj.relative_error(run, run.nominal) > 1e-2)


def test_a_perfect_fit_says_what_it_does_not_determine(exact):
    """The masses are wrong by up to 30 % and the fit is perfect: nobody must trust them."""
    said = "\n".join(exact.sentences)
    assert "The fit is perfect, and yet" in said
    assert exact["fore.m"].determined == "in combination"
    assert np.isnan(exact["fore.m"].std)
    assert "fore.m" in said
    assert "enter only together with" in said
    assert "No signal depends on base_link.m" in said
    assert exact["fore.mcx"].determined == "alone"


def test_every_sum_that_is_said_to_be_determined_is(exact):
    truth = dict(zip(exact.parameterization.names, np.asarray(exact.phi), strict=True))
    names = [
        f"{body}.{name}"
        for body in arm().tree.body_names
        for name in ("m", "mcx", "mcy", "mcz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
    ]
    truth |= dict(zip(names, np.asarray(kj.inertia_parameters(arm())).ravel(), strict=True))
    truth |= {f"{joint}.offset": x for joint, x in zip(arm().tree.joint_names, OFFSETS, strict=True)}
    truth |= {f"{j}.damping": float(x) for j, x in zip(arm().tree.joint_names, arm().damping, strict=True)}
    truth |= {f"{j}.coulomb_friction": float(x) for j, x in zip(arm().tree.joint_names, arm().coulomb_friction, strict=True)}
    for formula, value in zip(exact.base.formulas, exact.base.value, strict=True):
        words = formula.replace("- ", "-").replace("+ ", "+").split()
        total, factor = 0.0, 1.0
        for word in words:
            sign = -1.0 if word.startswith("-") else 1.0
            bare = word.lstrip("+-")
            if bare in truth:
                total += (sign if word[0] in "+-" else 1.0) * factor * truth[bare] if factor == 1.0 else factor * truth[bare]
                factor = 1.0
            else:
                factor = sign * float(bare)
        # Formulas show four digits.
        assert value == pytest.approx(total, abs=3e-4)


def test_intervals_and_errors_of_noisy_data():
    found = kj.identify(nominal(), [recorded(0.05)], friction_width=None, validation=[recorded(0.0, seed=1)])
    alone = [e for e in found.estimates if e.determined == "alone"]
    assert len(alone) > 10
    assert all(e.lower < e.value < e.upper and e.std > 0 for e in alone)
    assert found["elbow.damping"].lower < 0.3 < found["elbow.damping"].upper
    np.testing.assert_allclose(kj.relative_error(found.training[0]), 0.05, rtol=0.1)
    assert np.all(kj.relative_error(found.validation[0]) < 0.02)
    np.testing.assert_allclose(np.diag(found.base.correlation), 1.0)


def test_from_a_log_of_positions_alone():
    """Speeds and accelerations by filtering and central differences; positions and torques with noise."""
    ts, q, u, u_dot = motion_of_arm(100.0, 7.5)
    rng, torque = np.random.default_rng(0), efforts(arm(), q, u, u_dot)
    log = kj.Log(
        arm().tree.joint_names, kj.Run("noisy", ts, q + 1e-4 * rng.normal(size=q.shape), torque + 0.1 * rng.normal(size=q.shape))
    )
    found = kj.identify(nominal(), log, friction_width=None, motion_options={"cutoff": 8.0}, validation=log)
    assert found.converged
    errors = np.abs(found.base.value - _base_values(found))
    assert np.mean(errors < 2.5 * found.base.std) > 0.9
    assert any("low-passed at 8 Hz" in sentence for sentence in found.sentences)


def _base_values(found):
    truth = np.asarray(found.phi).copy()
    truth[: 10 * arm().nbody] = np.asarray(kj.inertia_parameters(arm())).ravel()
    truth[10 * arm().nbody :] = np.concatenate((arm().damping, arm().coulomb_friction, OFFSETS))
    from kanejax._regression.linear_estimate import identifiable

    return identifiable(found.parameterization).matrix @ truth


def test_a_delay_is_found():
    joint = '<joint name="shoulder" axis="0 1 0" damping="0.5" frictionloss="0.4"/>'
    inertial = '<inertial pos="0.2 0.02 0.01" mass="2" fullinertia="0.01 0.05 0.05 0.001 0.002 -0.001"/>'
    truth = kj.load(f'<mujoco><worldbody><body name="link">{joint}{inertial}</body></worldbody></mujoco>')
    truth = truth.replace(friction_width=jnp.full(1, 0.02))
    shift = 0.0123
    fine, *states = motion_of_arm(2000.0, 7.5)
    ts, *sampled = motion_of_arm(200.0, 7.5)
    torque = np.asarray(inverse_dynamics(truth, *(jnp.asarray(x[:, 1:2]) for x in states)))[:, 0] + 0.3
    late = np.interp(ts - shift, fine, torque)[:, None]
    q, u, u_dot = (x[:, 1:2] for x in sampled)
    motion = kj.Motion(ts, q, u, u_dot, late)
    start = truth.replace(mass=1.3 * truth.mass, damping=jnp.full(1, 0.1), coulomb_friction=jnp.full(1, 0.1))
    found = kj.identify(start, [motion[20:]], ("inertia", "damping", "coulomb_friction", "offset", "delay"), friction_width=None)
    assert found["delay"].value == pytest.approx(shift, abs=1e-4)
    assert found.converged


def test_a_payload_is_found_with_the_arm_known():
    truth = kj.with_payload(two_links(), "fore", name="payload")
    row = truth.tree.body("payload")
    loaded = truth.replace(
        mass=truth.mass.at[row].set(0.8),
        com=truth.com.at[row].set(jnp.array([0.3, 0.0, 0.05])),
        central_inertia=truth.central_inertia.at[row].set(jnp.diag(jnp.array([1e-3, 2e-3, 2e-3]))),
    )
    ts, q, u, u_dot = motion_of_two_links()
    motion = kj.Motion(ts, q, u, u_dot, efforts_of_two_links(loaded, q, u, u_dot))
    unknown = kj.Unknown("inertia", "payload", scale=(1.0, 0.1), prior=kj.Entropic(10.0))
    found = kj.identify(plant_of_two_links(truth), [motion], [unknown], friction_width=None)
    same_forces(found.model, loaded, 1e-6)


def test_stages_that_were_finished_are_not_fitted_again(tmp_path):
    motion, told, path = recorded(0.02), [], tmp_path / "fit.npz"
    options: dict[str, Any] = {"friction_width": None, "checkpoint": path, "progress": lambda stage, _: told.append(stage)}
    first = kj.identify(nominal(), [motion], **options)
    assert set(told) == {"inverse dynamics"}
    told.clear()
    again = kj.identify(nominal(), [motion], **options)
    assert not told
    np.testing.assert_array_equal(again.phi, first.phi)
    with pytest.raises(CheckpointError, match=r"fit\.npz belongs to other inputs; remove it to begin anew, or give another path"):
        kj.identify(nominal(), [motion], **{**options, "seed": 1})


def test_simulation_goes_on_from_inverse_dynamics():
    """Torques are the input of the simulation, so they are exact, and the positions are noisy."""
    ts, q, u, u_dot = motion_of_two_links(duration=2.0)
    noisy = q + 1e-3 * np.random.default_rng(0).normal(size=q.shape)
    motion = kj.Motion(ts, noisy, u, u_dot, efforts_of_two_links(two_links(), q, u, u_dot))
    heavy = plant_of_two_links(two_links().replace(mass=two_links().mass * 1.2))
    found = kj.identify(
        heavy,
        [motion],
        ("mass", "coulomb_friction"),
        stages=("inverse dynamics", "simulation"),
        simulation_options={"windows": (0.5, None), "substeps": 2},
        anneal=(3.0,),
    )
    assert [stage.name for stage in found.stages] == ["linear", "inverse dynamics", "simulation"]
    assert found.converged, found.stages
    np.testing.assert_allclose(found.model.friction_width, two_links().friction_width)
    for name, mass in (("upper.m", 2.0), ("fore.m", 1.0)):
        name = name.replace(".m", ".mass")
        assert abs(found[name].value - mass) < 4 * found[name].std < 0.1 * mass


def test_single_precision_models_are_identified_in_double():
    model, motion = nominal().astype(jnp.float32), recorded()
    with jax.enable_x64(False):
        found = kj.identify(model, [motion], friction_width=None)
    assert found.model.dtype == jnp.float32
    same_forces(found.model.astype(jnp.float64), arm(), 1e-4)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stages": ("simulation", "inverse dynamics")}, "in this order"),
        ({"stages": ()}, "give one or both of"),
        ({"starts": 0}, "starts is 0; give 1 or more"),
        ({"anneal": (10.0, 0.0)}, "give positive factors"),
    ],
)
def test_options_that_mean_nothing(options, message):
    with pytest.raises(ValueError, match=message):
        kj.identify(nominal(), [recorded()], **options)


def test_nothing_to_fit():
    with pytest.raises(kj.LogError, match="there is no motion to fit"):
        kj.identify(nominal(), [])


def test_unknown_parameters_are_listed(exact):
    with pytest.raises(kj.UnknownNameError, match=r"no identified parameter is named 'mass'; the names are: 'base_link.m'"):
        exact["mass"]


def test_robust_intervals_are_those_of_the_robust_estimate():
    motion = recorded(0.02)
    effort = np.array(motion.effort)
    effort[::20] += 50.0
    bad = kj.Motion(motion.ts, motion.q, motion.u, motion.u_dot, effort)
    options = {"friction_width": None, "robust": True}
    clean, robust = (kj.identify(nominal(), data, **options) for data in (motion, bad))
    assert np.median(robust.base.std / clean.base.std) < 1.5
    truth = _base_values(robust)
    assert np.mean(np.abs(robust.base.value - truth) < 3 * robust.base.std) > 0.8


def test_what_has_no_effect_at_the_start_may_have_one_at_the_end():
    """The Stribeck speed does not matter as long as there is no Stribeck friction."""
    plant = plant_of_two_links(two_links(), stribeck_friction=0.5, stribeck_speed=0.2)
    ts, q, u, u_dot = motion_of_two_links()
    signals = jax.jit(jax.vmap(kj.signal, (None, 0, 0, 0)))(plant, *map(jnp.asarray, (q, u, u_dot)))
    start = plant_of_two_links(two_links())
    found = kj.identify(start, kj.Motion(ts, q, u, u_dot, signals), ("stribeck_friction", "stribeck_speed"))
    assert found.converged, found.stages
    assert found["elbow.stribeck_speed"].value == pytest.approx(0.2, rel=1e-4)
    assert found["elbow.stribeck_speed"].determined == "alone"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"effort": lambda x: x.at[3, 1].set(jnp.nan)}, r"effort\[3, 1\] is nan; remove the sample, or give it weight 0"),
        ({"q": lambda x: x.at[3, 1].set(jnp.inf)}, r"q\[3, 1\] is inf; remove the sample$"),
        ({"weight": lambda x: 0.5 * x}, "weights must be 0 or 1"),
        ({"weight": jnp.zeros_like}, "no signal of any motion counts"),
    ],
)
def test_data_that_no_fit_can_use(change, message):
    motion = recorded()
    arrays = {name: getattr(motion, name) for name in ("ts", "q", "u", "u_dot", "effort", "weight")}
    arrays |= {name: function(arrays[name]) for name, function in change.items()}
    with pytest.raises(kj.LogError, match=message):
        kj.identify(nominal(), kj.Motion(**arrays))


def test_different_periods():
    with pytest.raises(kj.LogError, match="different periods"):
        kj.identify(nominal(), [recorded(), recorded()[::2]])
