import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax._simulate.step_size import FiniteSteps

TS = np.linspace(0.0, 0.5, 6)
COUNT = 16


def law(t, q, u, how):
    """Feedback, and a value from a time on."""
    gain, value, start = how
    return gain * u + jnp.where(t >= start, value, 0.0)


def healthy(model):
    """Leaves, states and controls of a batch in which all goes well."""
    rng = np.random.default_rng(0)
    leaves = jax.tree.map(lambda x: np.repeat(np.asarray(x)[None], COUNT, 0), model)
    leaves.mass[...] *= rng.uniform(0.8, 1.2, leaves.mass.shape)
    how = [np.full(COUNT, -0.1), np.zeros(COUNT), np.full(COUNT, 0.2)]
    return leaves, rng.uniform(-1, 1, (COUNT, 2)), rng.uniform(-1, 1, (COUNT, 2)), how


# What each fault changes in trajectory i, and the statuses with adaptive and with equal steps.
FAULTS = {
    "tip without mass": (lambda m, q, u, h, i: (zero(m.mass, (i, 1)), zero(m.central_inertia, (i, 1))), "MIN_STEP", "NON_FINITE"),
    "NaN for a mass": (lambda m, q, u, h, i: put(m.mass, (i, 1), np.nan), "MIN_STEP", "NON_FINITE"),
    "NaN in q0": (lambda m, q, u, h, i: put(q, (i, 0), np.nan), "NON_FINITE", "NON_FINITE"),
    "infinity in u0": (lambda m, q, u, h, i: put(u, (i, 1), np.inf), "NON_FINITE", "NON_FINITE"),
    "far coordinate": (lambda m, q, u, h, i: put(q, (i, 0), 1e8), "SUCCESSFUL", "SUCCESSFUL"),
    "far too fast": (lambda m, q, u, h, i: put(u, (i, 1), 1e9), "MAX_STEPS", "NON_FINITE"),
    "stiff spring": (lambda m, q, u, h, i: put(m.stiffness, (i, 1), 1e6), "MAX_STEPS", "NON_FINITE"),
    "unstable feedback": (lambda m, q, u, h, i: put(h[0], i, 1e3), "MAX_STEPS", "NON_FINITE"),
    "NaN from the control": (lambda m, q, u, h, i: put(h[1], i, np.nan), "MIN_STEP", "NON_FINITE"),
    "jump of the control": (lambda m, q, u, h, i: put(h[1], i, 3.0), "SUCCESSFUL", "SUCCESSFUL"),
}


def put(values, where, value):
    values[where] = value


def zero(values, where):
    values[where] = 0.0


def with_faults(model):
    """The healthy batch with every other trajectory spoilt, from the first fault to the last."""
    case = healthy(model)
    for k, (change, *_) in enumerate(FAULTS.values()):
        change(*case, row(k))
    return case


def row(k):
    """Faults come first at even places, and when these are full, at odd ones."""
    return 2 * k if k < COUNT // 2 else 2 * (k - COUNT // 2) + 1


def run(case, options):
    model, q, u, how = case
    return kj.simulate_batch(model, q, u, TS, control=(law, how), control_axis=0, batch_size=COUNT, threads=1, **options)


@pytest.mark.parametrize(("options", "which"), [({"max_steps": 300}, 0), ({"dt0": 0.01}, 1)], ids=["adaptive", "equal"])
def test_every_fault_has_its_status_and_harms_no_other(pendulum, options, which):
    found, without = run(with_faults(pendulum), options), run(healthy(pendulum), options)
    faulty = [row(k) for k in range(len(FAULTS))]
    statuses = {name: kj.Status(int(found.status[i])).name for name, i in zip(FAULTS, faulty, strict=True)}
    assert statuses == {name: expected[which] for name, (_, *expected) in FAULTS.items()}
    others = np.setdiff1d(np.arange(COUNT), faulty)
    assert (without.status == kj.Status.SUCCESSFUL).all()
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(without), strict=True):
        np.testing.assert_array_equal(a[others], b[others])
    reached = np.asarray(found.reached)
    assert np.isfinite(found.q[reached]).all()
    assert np.isnan(found.q[~reached][:, 0]).any()
    nan_control = faulty[list(FAULTS).index("NaN from the control")]
    np.testing.assert_allclose(found.t_end[nan_control], 0.2 if which == 0 else 0.1, atol=1e-3)
    assert np.isfinite(found.q_end[nan_control]).all()
    not_a_number = faulty[list(FAULTS).index("NaN in q0")]
    assert not reached[not_a_number].any()
    if which == 0:
        assert found.stats["num_steps"][not_a_number] == 0


def test_the_first_state_is_saved_though_no_step_is_made(pendulum):
    q0, u0 = np.array([0.3, -0.8]), np.array([0.5, 1.0])
    found = kj.simulate(pendulum, q0, u0, TS, control=lambda t, q, u: jnp.nan * u)
    assert found.status == kj.Status.MIN_STEP
    np.testing.assert_array_equal(found.reached, np.arange(6) == 0)
    np.testing.assert_array_equal(found.q[0], q0)
    np.testing.assert_array_equal(found.u[0], u0)


@pytest.mark.parametrize("bad", [np.inf, np.nan])
def test_a_step_to_infinity_is_shortened(bad):
    """diffrax's controller alone compares an infinite error with an infinite state, and all further steps are of length NaN."""
    y0, y1 = jnp.zeros(2), jnp.array([1.0, bad])

    def next_step(kind):
        state = (jnp.asarray(1.0), jnp.asarray(1.0), jnp.asarray(False))
        kept, start, end, *_ = kind(rtol=1e-4, atol=1e-6).adapt_step_size(0.0, 1.0, y0, y1, None, y1, 5.0, state)
        return bool(kept), float(start), float(end)

    assert np.isnan(next_step(diffrax.PIDController)[2])
    assert next_step(FiniteSteps) == (False, 0.0, 0.2)


def test_a_first_step_that_cannot_be_estimated_is_the_whole_time():
    """Where the rates are NaN after the small step that diffrax's estimate makes."""

    def first_step(kind):
        def rates(terms, t, y, args):
            return jnp.where(y[0] > 1.0, jnp.nan, jnp.ones(2))

        terms = diffrax.ODETerm(lambda t, y, args: y)
        return kind(rtol=1e-4, atol=1e-6).init(terms, 0.0, 2.0, jnp.ones(2), None, None, rates, 5.0)[0]

    assert np.isnan(first_step(diffrax.PIDController))
    assert first_step(FiniteSteps) == 2


def test_steps_that_do_not_move_the_time_are_refused(pendulum):
    single = pendulum.astype("float32")
    state = np.zeros(2, np.float32), np.zeros(2, np.float32)
    with pytest.raises(ValueError, match=r"dt0 is 0.01, but float32 cannot tell times around 1e\+06 apart by less than 0.062"):
        kj.simulate(single, *state, np.array([1e6, 1e6 + 1]), dt0=0.01)
    with pytest.raises(ValueError, match="strictly increasing in float32"):
        kj.simulate(single, *state, np.array([1e9, 1e9 + 1]))
    late = kj.simulate(single, *state, np.array([1e6, 1e6 + 1]), control=lambda t, q, u: 1.0 + 0.0 * u)
    assert late.status == kj.Status.MIN_STEP


@pytest.mark.parametrize("options", [{"dt0": 0.02}, {"max_steps": 200}], ids=["equal", "adaptive"])
def test_gradients_leave_out_trajectories_that_fail(pendulum, options):
    """The way that docs/numerics.md recommends: those that fail give way to one that does not, before differentiating."""
    rng = np.random.default_rng(0)
    q0, u0 = rng.uniform(-1, 1, (4, 2)), rng.uniform(-1, 1, (4, 2))
    gains = np.array([0.0, 0.0, 1e4, 0.0])

    def simulated(mass, q0, u0, gains):
        model = pendulum.replace(mass=mass)
        return jax.vmap(lambda q, u, k: kj.simulate(model, q, u, TS, control=(lambda t, q, u, k: k * u, k), **options))(
            q0, u0, gains
        )

    @jax.jit
    def slope(mass, keep, *inputs):
        def loss(mass):
            end = simulated(mass, *inputs)
            return jnp.sum(jnp.where(keep[:, None], end.q_end, 0.0) ** 2)

        return jax.grad(loss)(mass)

    ok = simulated(pendulum.mass, q0, u0, gains).ok
    np.testing.assert_array_equal(ok, [True, True, False, True])
    good = jnp.where(ok, jnp.arange(4), jnp.argmax(ok))
    found = slope(pendulum.mass, ok, q0[good], u0[good], gains[good])
    three = np.array([0, 1, 3, 3])
    expected = slope(pendulum.mass, np.array([True, True, True, False]), q0[three], u0[three], gains[three])
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, expected, rtol=1e-9)
