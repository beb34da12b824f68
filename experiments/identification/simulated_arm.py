"""A simulated study of identification: how well a Franka Emika Panda's parameters are found from ten seconds of noisy data.

Positions and torques are recorded, with white noise of 1e-4 rad and of 5 % of each joint's root mean square torque; speeds and
accelerations come from the filtered positions. The nominal arm is 10 to 30 % wrong. 500 recordings, or 30 with --quick, say
whether estimates are unbiased and whether 95 % intervals are what they say; others, how far masses alone are off, how exact
estimates from exact data are, whether random starts are physical and agree, and what a million samples take.
`python -m experiments.identification simulated_arm` writes results/identification/simulated_arm.png and .json; recordings that
were estimated before the study was cut off are kept beside them, and are not estimated again.
"""

import concurrent.futures
import multiprocessing
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.stats import norm

import kanejax as kj
from experiments.identification.excitation import Arm, panda
from experiments.identification.kept import kept_runs
from experiments.identification.simulated_arm_picture import QUANTILE, Errors, Masses, Shown, Values, picture
from experiments.thesis import record
from kanejax._parameters.pseudo_inertia import consistency
from kanejax._regression.compress import compress, residuals
from kanejax._regression.fit import fit_inverse_dynamics
from kanejax._regression.information import information
from kanejax._regression.linear_estimate import error_scale, identifiable, linear_estimate, signal_sizes
from kanejax._regression.linearization import Samples
from kanejax._regression.samples import samples_of

RESULTS = Path(__file__).parents[2] / "results" / "identification"
LINKS = tuple(f"panda_link{i}" for i in range(1, 8))
RATE, DURATION = 500.0, 10.0
TORQUE_NOISE, POSITION_NOISE, CORRELATION = 0.05, 1e-4, 0.9
RUNS, QUICK_RUNS = 500, 30
RANDOM_STARTS, FITTED_STARTS = 1000, 64
# Of the filter [Hz]: ten times the motion's greatest frequency. Noise of accelerations biases estimates, the more the higher it is.
CUTOFF = 10.0 * 5.0 / DURATION
# The nominal masses are at least so wrong: one that is known no better is not told.
WORST = 0.1
SAMPLES = (10_000, 100_000, 1_000_000)
MEMORY = 100
# Friction sets in within this speed [rad/s], as good as at once.
FRICTION_WIDTH = 2e-4
# What excitation.designed(arm, starts=4, steps=100) found, rounded: amplitudes of speed [rad/s], one joint a row.
OFFSET = (-0.753, -0.335, -1.389, -1.451, 0.764, 2.316, 0.293)
A = (
    (-0.104, -0.267, -0.236, 0.676, -0.068),
    (0.536, -0.417, 0.611, 0.472, -1.201),
    (-0.369, -0.603, 0.402, -0.190, 0.759),
    (0.033, -0.765, 0.107, 1.005, -0.380),
    (-0.746, -0.257, -0.103, 0.107, 0.999),
    (-0.470, -0.669, 0.253, 0.354, 0.533),
    (-0.843, -0.897, 0.098, 0.885, 0.757),
)
B = (
    (-0.357, -0.664, -0.725, 1.302, -0.269),
    (0.421, 0.388, 0.129, -0.074, -0.257),
    (-0.481, -0.429, -0.441, 0.898, -0.186),
    (-0.612, -0.436, -0.333, 0.591, 0.024),
    (-0.247, -1.113, 0.348, 0.301, 0.045),
    (-0.336, -0.054, -0.039, -1.123, 1.011),
    (0.509, -0.781, -0.085, 0.891, -0.451),
)


class Study(NamedTuple):
    """The arm as it is and as it is said to be, its motion without errors, and what is sought of it."""

    arm: Arm
    truth: kj.Plant
    nominal: kj.Model
    sought: kj.Parameterization
    base: kj.BaseParameters
    value: np.ndarray
    exact: kj.Motion


class Claim(NamedTuple):
    """What was measured, and what it should be; `holds` is None where there is no target."""

    name: str
    measured: str
    target: str
    holds: bool | None


def study() -> Study:
    """The true arm has friction and offsets; the nominal one has masses, centres of mass and inertias that are wrong."""
    arm, rng = panda(), np.random.default_rng(record.SEED)
    tree, nv = arm.model.tree, arm.model.nv
    friction = {name: jnp.asarray(rng.uniform(0.3, 2.0, nv)) for name in ("damping", "coulomb_friction")}
    model = arm.model.astype(jnp.float64).replace(**friction, friction_width=jnp.full(nv, FRICTION_WIDTH))
    truth = kj.Plant(model, kj.Drives.ideal(model).replace(offset=jnp.asarray(rng.uniform(-0.5, 0.5, nv))))
    rows = np.array([tree.body(name) for name in LINKS])

    def wrong(count: tuple[int, ...]) -> jax.Array:
        return jnp.asarray(1.0 + rng.choice([-1.0, 1.0], count) * rng.uniform(0.1, 0.3, count))

    nominal = model.replace(
        mass=model.mass.at[rows].multiply(wrong((7,))),
        com=model.com.at[rows].multiply(wrong((7, 3))),
        central_inertia=model.central_inertia.at[rows].multiply(wrong((7, 1, 1))),
        damping=jnp.full(nv, 1.0),
        coulomb_friction=jnp.full(nv, 1.0),
    )
    unknowns = [kj.Unknown("inertia", LINKS, prior=kj.Entropic(3.0)), "damping", "coulomb_friction", "offset"]
    sought = kj.parameterization(kj.Plant(nominal, kj.Drives.ideal(nominal)), unknowns)
    base = identifiable(sought)
    phi = jnp.concatenate((kj.inertia_parameters(model)[rows].ravel(), *friction.values(), truth.drives.offset))
    return Study(arm, truth, nominal, sought, base, base.matrix @ np.asarray(phi), exact_motion(truth))


def exact_motion(truth: kj.Plant) -> kj.Motion:
    fourier = kj.FourierMotion(truth.model.tree.joint_names, DURATION, np.array(OFFSET), np.array(A), np.array(B))
    ts = np.arange(round(RATE * DURATION)) / RATE
    q, u, u_dot = (jax.jit(jax.vmap(f))(jnp.asarray(ts)) for f in (fourier.q, fourier.u, fourier.u_dot))
    return kj.Motion(ts, q, u, u_dot, jax.jit(jax.vmap(kj.signal, (None, 0, 0, 0)))(truth, q, u, u_dot))


def recording(study: Study, seed: int, correlation: float = 0.0) -> kj.Log:
    """Positions and torques with noise; that of the torques has this correlation from sample to sample."""
    rng, exact = np.random.default_rng(seed), study.exact
    torque = np.asarray(exact.effort)
    noise = rng.normal(size=torque.shape)
    for k in range(1, len(noise) if correlation else 0):
        noise[k] = correlation * noise[k - 1] + np.sqrt(1.0 - correlation**2) * noise[k]
    noise *= TORQUE_NOISE * np.sqrt(np.mean(torque**2, 0))
    q = np.asarray(exact.q) + POSITION_NOISE * rng.normal(size=exact.q.shape)
    return kj.Log(study.nominal.tree.joint_names, kj.Run("noisy", np.asarray(exact.ts), q, torque + noise))


def samples(study: Study, seed: int, correlation: float = 0.0) -> Samples:
    return samples_of(kj.motions(recording(study, seed, correlation), study.nominal, cutoff=CUTOFF))


def errors(study: Study, runs: int, *, correlation: float = 0.0, fitted: bool = True, keep: Path | None = None) -> Errors:
    """Estimate from many recordings; without `fitted` the last two are those of the linear estimate."""

    def of_one(seed: int) -> Errors:
        data = samples(study, seed, correlation)
        linear = linear_estimate(study.sought, data, base=study.base)
        std, white = deviations(study.sought, study.base, linear.phi, linear.sigma, data)
        found = linear.value - study.value
        if not fitted:
            return Errors(found, std, white, found, std)
        fit = fit_inverse_dynamics(study.sought, data)
        sigma = error_scale(fit.compressed, fit.phi, len(study.base), signal_sizes(data))
        fit_std, _ = deviations(study.sought, study.base, fit.phi, sigma, data)
        return Errors(found, std, white, study.base.matrix @ np.asarray(fit.phi) - study.value, fit_std)

    return kept_runs(Errors, of_one, runs, keep, "coloured noise" if correlation else "white noise")


def deviations(
    sought: kj.Parameterization, base: kj.BaseParameters, phi: jax.Array, sigma: jax.Array, data: Samples
) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of base parameters as the library gives them, and as they were if errors were independent."""
    said = information(sought, phi, sigma, base, [data], [residuals(sought, phi, data)], 1.0 / RATE)
    return np.sqrt(np.diag(said.covariance)), np.sqrt(np.diag(said.white))


def bias(name: str, error: np.ndarray, *, expected: bool) -> tuple[Claim, dict]:
    """Mean errors in their standard errors; were estimates unbiased, as may be `expected`, the greatest would be normal ones'."""
    runs, count = error.shape
    spread = error.std(0, ddof=1)
    scores = np.sqrt(runs) * np.abs(error.mean(0)) / spread
    limit = float(norm.isf((1.0 - 0.99 ** (1.0 / count)) / 2.0))
    share, relative = float(np.mean(scores > QUANTILE)), float(np.max(np.abs(error.mean(0)) / spread))
    text = f"{scores.max():.2f}; {100 * share:.0f} % above 1.96; at most {relative:.3f} of a standard deviation"
    holds = bool(scores.max() < limit) if expected else None
    claim = Claim(f"{name}: greatest mean error of {count}, in standard errors", text, f"< {limit:.2f}" if expected else "", holds)
    return claim, {"greatest": float(scores.max()), "limit": limit, "share_above_196": share, "greatest_in_std": relative}


def coverage(name: str, error: np.ndarray, std: np.ndarray, target: tuple[float, float] | None) -> tuple[Claim, dict]:
    """How often the 95 % intervals hold the true values."""
    inside = np.abs(error) < QUANTILE * std
    each, every = inside.mean(0), inside.mean()
    # Parameters of one run depend on each other: the spread is that between runs.
    spread, one = inside.mean(1).std(ddof=1) / np.sqrt(len(inside)), np.sqrt(0.95 * 0.05 / len(inside))
    least, most = each.min(), each.max()
    text = f"{100 * every:.1f} +- {100 * spread:.1f} %; each {100 * least:.1f} to {100 * most:.1f} +- {100 * one:.1f} %"
    holds = None if target is None else bool(target[0] <= every <= target[1])
    said = "" if target is None else f"{100 * target[0]:.0f} to {100 * target[1]:.0f} %"
    numbers = {"all": float(every), "sampling_error": float(spread), "each": each.tolist(), "sampling_error_of_each": float(one)}
    return Claim(f"{name}: 95 % intervals that hold the truth", text, said, holds), numbers


class _MassErrors(NamedTuple):
    """Relative errors and standard deviations of one recording, or of many."""

    errors: np.ndarray
    std: np.ndarray


def masses(study: Study, runs: int, keep: Path | None = None) -> Masses:
    """Seek masses, friction and offsets, where centres of mass and inertias are known."""
    nominal = study.truth.model.replace(
        mass=study.nominal.mass, damping=study.nominal.damping, coulomb_friction=study.nominal.coulomb_friction
    )
    plant = kj.Plant(nominal, kj.Drives.ideal(nominal))
    sought = kj.parameterization(plant, [kj.Unknown("mass", LINKS), "damping", "coulomb_friction", "offset"])
    base = identifiable(sought)
    alone = {i: own for i in range(len(LINKS)) if (own := base.alone(i)) is not None}
    truth = np.asarray(study.truth.model.mass)[[nominal.tree.body(LINKS[i]) for i in alone]]
    own = list(alone.values())

    def of_one(seed: int) -> _MassErrors:
        data = samples(study, seed)
        linear = linear_estimate(sought, data, base=base)
        std, _ = deviations(sought, base, linear.phi, linear.sigma, data)
        return _MassErrors(linear.value[own] / truth - 1.0, std[own] / truth)

    return Masses(tuple(LINKS[i] for i in alone), *kept_runs(_MassErrors, of_one, runs, keep, "masses"))


def claims_of_masses(found: Masses) -> tuple[list[Claim], dict]:
    """All that are determined alone, and those that these data tell better than the nominal values, by the library's own word."""
    mean = np.abs(found.errors).mean(0)
    told = np.median(found.std, axis=0) < WORST
    covered = float(np.mean(np.abs(found.errors) < QUANTILE * found.std))
    text = f"{100 * mean.mean():.2f} %; links {', '.join(f'{100 * value:.2g}' for value in mean)} %"
    better = float(mean[told].mean())
    numbers = {
        "mean": float(mean.mean()),
        "mean_of_told": better,
        "each": dict(zip(found.names, mean.tolist(), strict=True)),
        "median_std": dict(zip(found.names, np.median(found.std, axis=0).tolist(), strict=True)),
        "coverage": covered,
    }
    few = f"masses alone, {told.sum()} links with standard deviations below {100 * WORST:.0f} %"
    return [
        # The first two hang near the axes that turn them, and their masses do next to nothing.
        Claim(f"masses alone, {len(mean)} links: mean relative error", text, "", None),
        Claim(f"{few}: mean relative error", f"{100 * better:.2f} %; intervals hold {100 * covered:.1f} %", "< 1 %", better < 0.01),
    ], numbers


def exactness(study: Study) -> tuple[list[Claim], dict]:
    """Base parameters from data without errors, each relative to itself; with a prior, the fit would be between it and the data."""
    data = samples_of([study.exact])
    unknowns = [kj.Unknown("inertia", LINKS), "damping", "coulomb_friction", "offset"]
    free = kj.parameterization(kj.Plant(study.nominal, kj.Drives.ideal(study.nominal)), unknowns)
    found = {
        "linear": linear_estimate(study.sought, data, base=study.base).value,
        "fit": study.base.matrix @ np.asarray(fit_inverse_dynamics(free, data).phi),
    }
    worst = {name: float(np.max(np.abs(value / study.value - 1.0))) for name, value in found.items()}
    claims = [
        Claim(f"{name}, exact data: greatest relative error", f"{value:.1e}", "< 1e-8", value < 1e-8)
        for name, value in worst.items()
    ]
    return claims, worst


def starts(study: Study, fitted: int) -> tuple[list[Claim], dict]:
    """Random starts, what is fitted from them, and what they cost."""
    thetas = study.sought.starts(jax.random.key(record.SEED), RANDOM_STARTS)
    least = jax.jit(jax.vmap(lambda theta: jnp.min(smallest_eigenvalues(study, theta))))
    data = samples(study, 0)
    sigma = linear_estimate(study.sought, data, base=study.base).sigma
    # With the same weights everywhere, costs can be compared.
    fits = [
        fit_inverse_dynamics(study.sought, data, starts=theta[None], sigma=sigma)
        for theta in track(thetas[:fitted], description="starts", transient=True)
    ]
    costs = np.array([fit.history[-1].cost for fit in fits])
    values = np.array([study.base.matrix @ np.asarray(fit.phi) for fit in fits])
    std, _ = deviations(study.sought, study.base, fits[0].phi, sigma, data)
    random = float(jnp.min(least(thetas)))
    after = float(jnp.min(least(jnp.stack([fit.theta for fit in fits]))))
    spread, apart = float(costs.max() / costs.min() - 1.0), float(np.max(np.ptp(values, axis=0) / std))
    one, many = (seconds_of_fit(study, data, thetas[:count]) for count in (1, FITTED_STARTS))
    numbers = {
        "least_eigenvalue_of_starts": random,
        "least_eigenvalue_of_fits": after,
        "spread_of_costs": spread,
        "greatest_difference_in_std": apart,
        "fitted_one_by_one": fitted,
        "seconds_1": one,
        f"seconds_{FITTED_STARTS}": many,
    }
    share = "least eigenvalue of a pseudo-inertia over its trace"
    return [
        Claim(f"{RANDOM_STARTS} random starts: {share}", f"{random:.1e}", "> 0", random > 0),
        Claim(f"fits of {fitted} of them: {share}", f"{after:.1e}", "> 0", after > 0),
        Claim("their costs: greatest over least, less 1", f"{spread:.1e}; {apart:.1e} std", "< 1e-6", spread < 1e-6),
        Claim(f"time of {FITTED_STARTS} starts over that of one", f"{many / one:.1f}; {many:.2f} s", "< 8", many / one < 8),
    ], numbers


def smallest_eigenvalues(study: Study, theta: jax.Array) -> jax.Array:
    """Of the links' pseudo-inertias, over their traces: positive for what a rigid body can have."""
    return consistency(study.sought.phi(theta)[: 10 * len(LINKS)].reshape(-1, 10))


def seconds_of_fit(study: Study, data: Samples, thetas: jax.Array, repeats: int = 3) -> float:
    """Median wall time, once it is compiled."""
    spent = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        fit_inverse_dynamics(study.sought, data, starts=thetas)
        spent.append(time.perf_counter() - begin)
    return float(np.median(spent[1:]))


class Cost(NamedTuple):
    """Of compressing so many samples: processor and wall time [s], and memory [MB] beyond that of the samples, which is `data`.

    Processor time, that of all threads, depends little on what else the machine does.
    """

    samples: int
    seconds: float
    wall: float
    memory: float
    data: float


def cost(count: int) -> Cost:
    """In a process of its own, whose memory is that of nothing else."""
    with jax.enable_x64(True):
        known = study()
        phi, few = known.sought.phi0, samples_of([known.exact])
        many = jax.block_until_ready(jax.tree.map(lambda x: jnp.resize(x, (count, *x.shape[1:])), few))
        data = sum(x.nbytes for x in jax.tree.leaves(many)) / 1e6
        # The first time compiles.
        jax.block_until_ready(compress(known.sought, phi, many))
        held, begin, wall = memory_from_now(), time.process_time(), time.perf_counter()
        repeats = max(SAMPLES[1] // count, 1)
        for _ in range(repeats):
            jax.block_until_ready(compress(known.sought, phi, many))
        seconds, wall = (time.process_time() - begin) / repeats, (time.perf_counter() - wall) / repeats
        return Cost(count, seconds, wall, greatest_memory() - held, data)


def memory_from_now() -> float:
    """Memory that the process holds [MB], and from now on the greatest; of Linux."""
    Path("/proc/self/clear_refs").write_text("5")
    return greatest_memory()


def greatest_memory() -> float:
    """The most memory that the process held since `memory_from_now` [MB]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM"))


def costs() -> list[Cost]:
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=context, max_tasks_per_child=1) as pool:
        return list(pool.map(cost, SAMPLES))


def claims_of_cost(found: list[Cost]) -> tuple[list[Claim], dict]:
    most, times = found[-1].samples / found[0].samples, [each.seconds for each in found]
    seconds, memory = times[-1] / times[0], max(each.memory for each in found)
    shown = ", ".join(f"{each.seconds:.2f} s" for each in found)
    beyond = ", ".join(f"{each.memory:.0f}" for each in found)
    name = f"{found[0].samples:.0e} to {found[-1].samples:.0e} samples: "
    return [
        Claim(
            f"{name}processor time, {most:.0f} times as many",
            f"{seconds:.0f} times ({shown})",
            f"< {1.25 * most:.0f}",
            seconds < 1.25 * most,
        ),
        Claim(f"{name}memory beyond the samples' own {found[-1].data:.0f} MB", f"{beyond} MB", f"< {MEMORY} MB", memory < MEMORY),
    ], {str(each.samples): each._asdict() for each in found}


def run(quick: bool = False, into: Path = RESULTS) -> dict:
    """Measure all claims; fails, once everything is written, where one does not hold."""
    with jax.enable_x64(True):
        claims, numbers, figure = measured(QUICK_RUNS if quick else RUNS, 8 if quick else FITTED_STARTS, into / "kept")
    Console().print(table(claims))
    record.save(into, "simulated_arm", figure)
    record.write(into, "simulated_arm", numbers)
    record.require(all(claim.holds is not False for claim in claims), "; ".join(c.name for c in claims if c.holds is False))
    return numbers


def measured(runs: int, fitted: int, keep: Path) -> tuple[list[Claim], dict[str, Any], record.Figure]:
    known = study()
    begin = time.perf_counter()
    white = errors(known, runs, keep=keep)
    coloured = errors(known, max(runs // 2, 20), correlation=CORRELATION, fitted=False, keep=keep)
    weighed = masses(known, runs, keep)
    wanted = (0.93, 0.97)
    parts = {
        "bias_linear": bias("linear estimate", white.linear, expected=True),
        # Where the data tell little, the prior and what bodies can have pull, as they are to.
        "bias_fit": bias("fit", white.fit, expected=False),
        "coverage_linear": coverage("linear estimate", white.linear, white.std, wanted),
        "coverage_fit": coverage("fit", white.fit, white.fit_std, wanted),
        "coverage_white_intervals": coverage("intervals for white noise", white.linear, white.white, None),
        "coverage_coloured": coverage("coloured noise, linear estimate", coloured.linear, coloured.std, wanted),
        "coverage_coloured_white_intervals": coverage(
            "coloured noise, intervals for white noise", coloured.linear, coloured.white, None
        ),
        "masses": claims_of_masses(weighed),
        "exact": exactness(known),
        "starts": starts(known, fitted),
        "cost": claims_of_cost(costs()),
    }
    claims = [claim for found, _ in parts.values() for claim in (found if isinstance(found, list) else [found])]
    numbers = {name: found for name, (_, found) in parts.items()}
    numbers |= {
        "runs": runs,
        "seconds": time.perf_counter() - begin,
        "base_parameters": list(known.base.formulas),
        "truth": known.value.tolist(),
        "std": white.std.mean(0).tolist(),
        "claims": [claim._asdict() for claim in claims],
    }
    nominal = known.base.matrix @ np.asarray(known.sought.phi0)
    values = Values(known.value, nominal, known.value + white.fit[0], QUANTILE * white.fit_std[0])
    return claims, numbers, picture(Shown(known.base), white, coloured, values, weighed)


def table(claims: list[Claim]) -> Table:
    shown = Table(title="A simulated Panda: 10 s, torque noise 5 %", title_justify="left")
    for header in ("claim", "measured", "target", "verdict"):
        shown.add_column(header)
    verdicts = {True: "[green]holds", False: "[bold red]DOES NOT HOLD", None: ""}
    for claim in claims:
        shown.add_row(claim.name, claim.measured, claim.target, verdicts[claim.holds])
    return shown
