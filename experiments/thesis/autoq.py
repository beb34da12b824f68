"""AUTOQ: the coordinates back from AUTOTF's torques, Nie's Figures 3.9-3.14, and the order of each of its integration schemes.

The torques are given as a table over time, as AUTOQ reads them from a file. Two choices keep the table's own error out of the
comparison. Its times are the multiples of 2^-15 s, half of the shortest step here, so that the beta schemes, whose steps are
powers of two and which ask for the torques at the beginning, middle or end of a step, only ask at times that are in the table.
Runge-Kutta methods also ask between, where piecewise cubics are within 1e-12 N m of the exact torques: less than what those
methods themselves do wrong, down to the steps they are shown with.

The motion is unstable: on its way a deviation from it grows by many orders of magnitude, and so does what a scheme does wrong in
its first steps. Hence two experiments. Over the whole 2 s the coordinates are recovered with steps as short as that takes, and
AUTOQ's three schemes are shown beside them with the shortest steps that its output's format can tell apart. The orders of
convergence are measured over windows of 0.25 s, each starting on the motion, where the growth is mild.
"""

from pathlib import Path
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import kanejax as kj
from experiments.thesis import record
from experiments.thesis.autotf import torques
from experiments.thesis.motion import DURATION, motion, motions
from kanejax.robots import intelledex_605

TABLE_STEP = 2.0**-15
WINDOW = 0.25
# Of the equations of implicit steps, well below the errors that are measured.
RTOL, ATOL = 1e-10, 1e-12


class Scheme(NamedTuple):
    """A scheme, and the numbers of steps a window with which its order is measured."""

    title: str
    solver: diffrax.AbstractSolver
    steps: tuple[int, ...]

    @property
    def order(self) -> int:
        """What theory says."""
        order = self.solver.order(diffrax.ODETerm(lambda t, y, args: y))
        assert order is not None
        return order


_BETA_STEPS = (16, 32, 64, 128, 256)
SCHEMES = {
    "explicit": Scheme("explicit, beta = 0", kj.BetaScheme(0.0), _BETA_STEPS),
    "implicit": Scheme("implicit, beta = 1", kj.BetaScheme(1.0), _BETA_STEPS),
    "crank_nelson": Scheme('"Crank-Nelson", beta = 1/2', kj.BetaScheme(0.5), _BETA_STEPS),
    "implicit_three_point": Scheme("AUTOQ, beta = 1", kj.BetaScheme(1.0, three_point=True), _BETA_STEPS),
    "crank_nelson_three_point": Scheme("AUTOQ, beta = 1/2", kj.BetaScheme(0.5, three_point=True), _BETA_STEPS),
    "bogacki_shampine": Scheme("Runge-Kutta, Bogacki-Shampine", diffrax.Bosh3(), (4, 8, 16, 32, 64)),
    "tsitouras": Scheme("Runge-Kutta, Tsitouras", diffrax.Tsit5(), (8, 12, 16, 24)),
}
# What recovers the coordinates over the whole motion, and with which step [s].
RECOVERED = {"tsitouras": 2.0**-10, "crank_nelson": 2.0**-14, "implicit_three_point": 2.0**-14}
# AUTOQ's settings, "explicit", "implicit" and between, with its difference quotient, and its shortest step [s]: it prints times
# to three decimals.
AUTOQ = {
    "beta = 0": kj.BetaScheme(0.0, three_point=True),
    "beta = 1": kj.BetaScheme(1.0, three_point=True),
    "beta = 1/2": kj.BetaScheme(0.5, three_point=True),
}
AUTOQ_STEP = 1e-3
# Beyond this [rad] a curve has visibly left the motion.
VISIBLE = 0.02


def table(step: float = TABLE_STEP, decimals: int | None = None) -> kj.TorqueTable:
    """AUTOTF's torques over time, in rows of so many seconds, rounded to some decimals or not."""
    ts = jnp.asarray(np.arange(round(DURATION / step) + 1) * step)
    values = torques(ts)
    return kj.TorqueTable(ts, values if decimals is None else jnp.round(values, decimals), "cubic")


def recovered(solver: diffrax.AbstractSolver, step: float, ts: np.ndarray, control: kj.TorqueTable) -> np.ndarray:
    """Coordinates [rad] at times [s] from the start of the motion on, (n, 6), by equal steps [s]."""
    start = motion(jnp.asarray(float(ts[0])))
    path = kj.simulate(intelledex_605(), start.q, start.u, ts, control=control, solver=solver, dt0=step, rtol=RTOL, atol=ATOL)
    # A step that is too long may lead to where the equations of a step have no solution, or to infinity; the curve ends there.
    return np.asarray(path.q)


def step_sizes(scheme: Scheme) -> np.ndarray:
    """Steps [s] with which a scheme's order is measured."""
    return WINDOW / np.array(scheme.steps)


def window_errors(scheme: Scheme, control: kj.TorqueTable) -> np.ndarray:
    """Root mean square error [rad] at the end of the windows, for each of the scheme's steps."""
    model = intelledex_605()

    def squared_error(start: jax.Array, step: jax.Array) -> jax.Array:
        q, u, _ = motion(start)
        ts = jnp.stack((start, start + WINDOW))
        # Times and step are traced, so that one program serves all of them.
        path = kj.simulate(model, q, u, ts, control=control, solver=scheme.solver, dt0=step, rtol=RTOL, atol=ATOL)
        return jnp.where(path.ok, jnp.mean((path.q_end - motion(start + WINDOW).q) ** 2), jnp.nan)

    starts = jnp.arange(0.0, DURATION, WINDOW)
    errors = jax.jit(jax.vmap(squared_error, (0, None)))
    return np.array([float(jnp.sqrt(jnp.mean(errors(starts, jnp.asarray(step))))) for step in step_sizes(scheme)])


def fitted_order(scheme: Scheme, errors: np.ndarray) -> float:
    """Slope of log(error) against log(step) over the three shortest steps."""
    return float(np.polyfit(np.log(step_sizes(scheme)[-3:]), np.log(errors[-3:]), 1)[0])


def growth(control: kj.TorqueTable) -> float:
    """By how much a deviation in the coordinates at the start is multiplied at the end: the 2-norm of dq(T)/dq(0)."""
    model, start = intelledex_605(), motion(jnp.asarray(0.0))
    ts = np.array([0.0, DURATION])

    def end(q0: jax.Array) -> jax.Array:
        return jnp.asarray(kj.simulate(model, q0, start.u, ts, control=control, dt0=2.0**-8).q_end)

    return float(jnp.linalg.norm(jax.jacfwd(end)(start.q), 2))


def run(directory: Path) -> dict:
    """Recover the coordinates and measure the orders; fails where an order is off by more than 0.1, or a curve off the motion."""
    control, ts = table(), np.linspace(0.0, DURATION, 201)
    specified = np.asarray(motions(jnp.asarray(ts)).q)
    # Equal steps fit between times that are multiples of all of them.
    coarse = np.linspace(0.0, DURATION, 65)
    at_coarse = np.asarray(motions(jnp.asarray(coarse)).q)
    exact = {name: recovered(SCHEMES[name].solver, step, coarse, control) for name, step in RECOVERED.items()}
    autoq = {name: recovered(solver, AUTOQ_STEP, ts, control) for name, solver in AUTOQ.items()}
    # AUTOTF prints torques to five decimals.
    rounded = recovered(SCHEMES["tsitouras"].solver, RECOVERED["tsitouras"], coarse, table(AUTOQ_STEP, decimals=5))
    errors = {name: window_errors(scheme, control) for name, scheme in SCHEMES.items()}
    orders = {name: fitted_order(scheme, errors[name]) for name, scheme in SCHEMES.items()}
    between = control.ts[:-1] + 0.3 * TABLE_STEP
    worst = {name: float(np.abs(q - at_coarse).max()) for name, q in exact.items()}
    numbers = {
        **{f"largest_error_{name}_rad": value for name, value in worst.items()},
        "growth_of_deviations_in_2_s": growth(control),
        "error_with_torques_printed_by_AUTOTF_rad": float(np.abs(rounded - at_coarse).max()),
        "error_of_table_between_times_Nm": float(jnp.max(jnp.abs(jax.vmap(control)(between) - torques(between)))),
        "steps_s": dict(RECOVERED),
        "orders": orders,
        "theoretical_orders": {name: scheme.order for name, scheme in SCHEMES.items()},
        "errors_over_windows_rad": {name: values.tolist() for name, values in errors.items()},
        "window_steps_s": {name: step_sizes(scheme).tolist() for name, scheme in SCHEMES.items()},
        "autoq_leaves_the_motion_at_s": {name: _left_at(ts, q, specified) for name, q in autoq.items()},
    }
    record.save(directory, "autoq", _curves(ts, specified, autoq, coarse, exact))
    record.save(directory, "autoq_orders", _orders(errors, orders))
    record.write(directory, "autoq", numbers)
    record.require(max(worst.values()) < 0.05, "the coordinates are recovered within 0.05 rad")
    off = {name: order - SCHEMES[name].order for name, order in orders.items()}
    record.require(max(map(abs, off.values())) < 0.1, f"measured and theoretical orders agree, but they differ by {off}")
    return numbers


def _left_at(ts: np.ndarray, q: np.ndarray, specified: np.ndarray) -> float | None:
    """First time [s] at which a coordinate is visibly off, or None."""
    off = ~(np.abs(q - specified).max(axis=1) < VISIBLE)
    return round(float(ts[np.argmax(off)]), 6) if off.any() else None


def _curves(
    ts: np.ndarray, specified: np.ndarray, autoq: dict[str, np.ndarray], coarse: np.ndarray, exact: dict[str, np.ndarray]
) -> record.Figure:
    title = "AUTOQ: coordinates of the Intelledex 605 from the torques of AUTOTF (Nie 1988, Figures 3.9-3.14)"
    figure, axes = record.figure_of(2, 3, size=(11, 6.2), title=title)
    for joint, each in enumerate(axes):
        each.plot(ts, specified[:, joint], color="#c9d7e2", linewidth=7, solid_capstyle="round", label="specified")
        for (name, q), color in zip(autoq.items(), record.COLORS[1:4], strict=True):
            shown = np.where(np.abs(q - specified).max(axis=1, keepdims=True) < 3.0, q, np.nan)
            each.plot(ts, shown[:, joint], "--", color=color, linewidth=1.1, label=f"AUTOQ's {name}, 1 ms steps")
        for k, ((name, q), marker) in enumerate(zip(exact.items(), "os^", strict=True)):
            style = {"markersize": 4, "markerfacecolor": "none", "linestyle": "none", "color": "#1d3557"}
            label = f"{SCHEMES[name].title}, {_step(RECOVERED[name])}"
            each.plot(coarse[2 * k :: 6], q[2 * k :: 6, joint], marker, label=label, **style)
        low, high = specified[:, joint].min(), specified[:, joint].max()
        each.set_ylim(low - 0.35 * (high - low), high + 0.35 * (high - low))
        each.set_ylabel(rf"$q_{joint + 1}$ [rad]")
        each.set_title(f"Figure 3.{9 + joint}", fontsize=9, color="#666666", loc="left")
    for each in axes[3:]:
        each.set_xlabel("t [s]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return figure


def _step(step: float) -> str:
    return f"steps of 1/{round(1 / step)} s"


def _orders(errors: dict[str, np.ndarray], orders: dict[str, float]) -> record.Figure:
    title = "AUTOQ: error after 0.25 s, over eight windows of the specified motion"
    figure, axes = record.figure_of(1, 1, size=(8.4, 6.8), title=title)
    each = axes[0]
    for (name, scheme), color, marker in zip(SCHEMES.items(), (*record.COLORS, "#d98594"), "ovsD^Pp", strict=True):
        steps, order = step_sizes(scheme), scheme.order
        label = f"{scheme.title}: order {orders[name]:.2f} (theory {order})"
        each.loglog(steps, errors[name], marker, color=color, markersize=6, label=label, base=10)
        # The line that theory draws through the shortest step.
        each.loglog(steps, errors[name][-1] * (steps / steps[-1]) ** order, color=color, linewidth=1.2, alpha=0.7)
    each.set_xlabel("step [s]")
    each.set_ylabel("root mean square error of the coordinates [rad]")
    figure.legend(*each.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure
