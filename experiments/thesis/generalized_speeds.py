"""Whose angular velocity should the generalized speeds be: operations, motions and singularities of the choices.

Nie, II.2: the components of the angular velocity of a link in the middle of the chain make the expressions shortest; for Figure
2.2 he counts the angular velocities of three links with each choice. His automatic generation has q_dot instead, and his
conclusions leave open what that loses. Here the equations are generated for every choice by `speed_program`, in the explicit form
that he derives by hand and as a recursion, and counted by `kanejax.operation_count`: common subexpressions count once.

- Figure 2.2, joints with perpendicular axes: angular velocities of all links, against the thesis's figures.
- Intelledex 605, with all lengths that the hand derivation has as symbols: all choices of link and of the rates that are replaced.
- Stanford arm: the same, with a prismatic joint.
- The motion of the Intelledex does not depend on the choice; (2.18) is singular at q2 = 0, and nearby it loses digits.
"""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import kanejax as kj
from experiments.thesis import record, speed_program as program
from kanejax.robots import intelledex_605, stanford_arm, three_revolute_arm

NAMED_BY_NIE = {"A": (9, 3), "B": (7, 3), "C": (11, 4)}
"""Multiplications and additions of the angular velocities of Figure 2.2, by base link; divisions count as multiplications."""
BY_HAND = (672, 404)
"""Of six torques of the Intelledex 605, chapter IV; the speeds are (2.18)."""
LENGTHS = {"l33": 0.05, "l43": 0.08, "l52": 0.03, "l63": 0.12}
RATES = "joint rates"
TASKS: dict[str, Callable[..., Any]] = {
    "angular_velocities": program.angular_velocities,
    "X_and_Y": program.explicit_equations,
    "torques_by_X_and_Y": program.explicit_torques,
    "torques_by_recursion": program.torques,
}
ARGUMENTS = {"angular_velocities": 2, "X_and_Y": 2, "torques_by_X_and_Y": 3, "torques_by_recursion": 3}


def choices(model: kj.Model) -> dict[str, program.Base | None]:
    """Joint rates, and every link with every set of rates that components of its angular velocity can replace."""
    chain, names = program.chain_of(model), model.tree.body_names
    q = random_states(model, 4)[0]
    turning = [k for k, link in enumerate(chain.links) if not link.slides]
    found: dict[str, program.Base | None] = {RATES: None}
    for number, last in enumerate(turning[1:], 2):
        movers = turning[:number]
        sets = [(pair, component) for pair in [tuple(movers)] * (number == 2) for component in (0, 1)]
        sets += [(triple, 0) for triple in itertools.combinations(movers, 3)]
        for replaced, component in sets:
            base = program.Base(last, replaced, component)
            matrix = jax.vmap(lambda q, base=base: program.speed_matrix(chain, base, q))(q)
            if np.abs(np.linalg.det(matrix)).max() > 1e-9:
                joints = "".join(str(k + 1) for k in replaced)
                found[f"link {names[last]} for q{joints}{' by y' * component}"] = base
    return found


def operations(model: kj.Model, base: program.Base | None) -> dict[str, dict[str, int]]:
    """Of each task with one choice of speeds."""
    chain = program.chain_of(model)
    state = [each[0] for each in random_states(model, 1)]
    counts = {}
    for task, function in TASKS.items():
        count = kj.operation_count(lambda _, *x, f=function: f(chain, base, *x), model, *state[: ARGUMENTS[task]])
        counts[task] = {name: getattr(count, name) for name in ("multiplications", "additions", "divisions")}
    return counts


def random_states(model: kj.Model, count: int) -> list[jax.Array]:
    """Coordinates, speeds and their rates, (count, nv) each."""
    rng = np.random.default_rng(record.SEED)
    return [jnp.asarray(rng.normal(size=(count, model.nv))) for _ in range(3)]


def total(count: dict[str, int]) -> int:
    """Operations of all kinds."""
    return sum(count.values())


class _Components(eqx.Module):
    """A choice of speeds as arrays, so that one program serves all choices; the matrix is from the library's partial velocities.

    Attributes:
        model: the mechanism.
        link: index of the base link.
        component: of its angular velocity, in place of each rate; -1 where the rate stays.
    """

    model: kj.Model
    link: jax.Array
    component: jax.Array

    def matrix(self, q: jax.Array, t: jax.Array) -> jax.Array:
        axes = kj.partial_velocities(self.model, q).angular[self.link] @ kj.poses(self.model, q).link_rotation[self.link]
        return jnp.where(self.component[:, None] >= 0, axes.T[self.component], jnp.eye(self.model.nv, dtype=q.dtype))


def in_speeds(model: kj.Model, base: program.Base | None) -> kj.WithSpeeds:
    """The model in the speeds of a choice."""
    component = np.full(model.nv, -1)
    if base is not None:
        component[list(base.replaced)] = base.components
    chosen = _Components(model, jnp.asarray(0 if base is None else base.link), jnp.asarray(component))
    return kj.with_speeds(model, kj.GeneralizedSpeeds(chosen.matrix))


class Equations(NamedTuple):
    """X, Y and the joint rates at speeds u; torques for rates u_dot of the speeds, and for u and u_dot as joint rates' own."""

    X: jax.Array
    Y: jax.Array
    rates: jax.Array
    torques: jax.Array
    torques_from_rates: jax.Array


def generated_equations(model: kj.Model, base: program.Base | None, *states: jax.Array) -> Equations:
    """By `speed_program`, (count, ...) each; operation by operation, which takes less time than compiling thousands of them."""
    chain = program.chain_of(model)

    def one(q: jax.Array, u: jax.Array, u_dot: jax.Array) -> Equations:
        explicit = program.explicit_equations(chain, base, q, u)
        by_recursion, by_X_and_Y = program.torques(chain, base, q, u, u_dot), program.explicit_torques(chain, base, q, u, u_dot)
        return Equations(*explicit, by_recursion, by_X_and_Y)

    return jax.vmap(one)(*states)


@jax.jit
def library_equations(arm: kj.WithSpeeds, *states: jax.Array) -> Equations:
    """By the library, (count, ...) each."""

    def one(q: jax.Array, u: jax.Array, u_dot: jax.Array) -> Equations:
        explicit = kj.mass_matrix(arm, q), kj.bias_force(arm, q, u), kj.rates_from_speeds(arm, q, u)
        return Equations(*explicit, kj.inverse_dynamics(arm, q, u, u_dot), kj.inverse_dynamics(arm.model, q, u, u_dot))

    return jax.vmap(one)(*states)


def disagreement(model: kj.Model, base: program.Base | None, count: int = 100) -> float:
    """Of the generated equations and torques with the library's in the same speeds: median over states of the relative errors."""
    states = random_states(model, count)
    errors = []
    for x, y in zip(generated_equations(model, base, *states), library_equations(in_speeds(model, base), *states), strict=True):
        found, expected = np.asarray(x).reshape(count, -1), np.asarray(y).reshape(count, -1)
        errors.append(np.abs(found - expected).max(1) / np.abs(expected).max(1))
    return float(np.median(errors, axis=1).max())


def same_motion(model: kj.Model, speeds: kj.LinkSpeeds, count: int = 101) -> dict[str, Any]:
    """Swinging torques on joints with damping, in joint rates and in chosen speeds; and how far the two motions are apart."""
    model = model.replace(damping=jnp.array([2.0, 2.0, 1.0, 0.5, 0.05, 0.03]))
    arm, ts = kj.with_speeds(model, speeds), np.linspace(0.0, 2.0, count)
    q, rates = jnp.array([0.0, 0.5 * np.pi, 0.0, 0.0, 0.0, 0.0]), jnp.array([1.0, -0.3, 0.5, -0.8, 0.4, 0.7])

    def control(t: jax.Array, q: jax.Array, u: jax.Array) -> jax.Array:
        return jnp.array([8.0, 6.0, 4.0, 2.0, 1.0, 0.5]) * jnp.sin(4.0 * t + jnp.arange(6.0)) - kj.gravity_force(model, q)

    options = {"control": control, "rtol": 1e-12, "atol": 1e-13, "max_steps": 20_000, "throw": True}
    plain = kj.simulate(model, q, rates, ts, **options)
    chosen = kj.simulate(arm, q, kj.speeds_from_rates(arm, q, rates), ts, **options)
    difference = np.abs(np.asarray(plain.q - chosen.q)).max(1)
    return {"ts": ts, "plain": plain, "chosen": chosen, "difference": difference}


def lost_digits(model: kj.Model, speeds: kj.LinkSpeeds, angles: np.ndarray) -> dict[str, np.ndarray]:
    """What is left of joint rates of 1 rad/s after turning them into speeds and back, against q2."""
    errors = {}
    for name in ("float32", "float64"):
        arm = kj.with_speeds(model.astype(name), speeds)
        _, rates, _ = (each.astype(name) for each in random_states(model, 64))

        def one(angle: jax.Array, rates: jax.Array, arm: kj.WithSpeeds = arm) -> jax.Array:
            q = jnp.full(6, 0.4, angle.dtype).at[1].set(angle)
            return jnp.abs(kj.rates_from_speeds(arm, q, kj.speeds_from_rates(arm, q, rates)) - rates).max()

        over = jax.jit(jax.vmap(jax.vmap(one, (None, 0)), (0, None)))
        errors[name] = np.asarray(over(jnp.asarray(angles, name), rates).max(1), float)
    return errors


def into_the_singularity(model: kj.Model, speeds: kj.LinkSpeeds) -> dict[str, Any]:
    """Without torques but those against gravity, towards q2 = 0 in chosen speeds, with the default tolerance."""
    arm, ts = kj.with_speeds(model, speeds), np.linspace(0.0, 2.0, 101)
    q, rates = jnp.array([0.3, 1.2, -0.4, 0.2, 0.1, 0.5]), jnp.array([0.9, -1.5, 0.6, 0.1, -0.2, 0.3])
    against: dict[str, Any] = {"control": lambda t, q, u: -kj.gravity_force(model, q)}
    found = kj.simulate(arm, q, kj.speeds_from_rates(arm, q, rates), ts, **against)
    exact = kj.simulate(model, q, rates, ts, rtol=1e-11, atol=1e-12, max_steps=20_000, dense=True, **against)
    return {
        "status": kj.Status(int(found.status)).name,
        "t_end": float(found.t_end),
        "q2_end": float(found.q_end[1]),
        "error_of_q_end": float(jnp.abs(exact.evaluate(found.t_end)[0] - found.q_end).max()),
    }


def run(directory: Path) -> dict:
    """Count every choice, check the generated equations of each, and move the Intelledex in the speeds of the thesis."""
    arms = {
        "three_revolute_arm": three_revolute_arm(origins=((0.0, 0.1, 0.2), (0.3, 0.0, 0.1))),
        "intelledex_605": intelledex_605(**LENGTHS),
        "stanford_arm": stanford_arm(),
    }
    chosen = {name: choices(model) for name, model in arms.items()}
    counts = {name: {label: operations(arms[name], base) for label, base in chosen[name].items()} for name in arms}
    checked = {name: least_by_link(rows, "X_and_Y").values() for name, rows in counts.items()}
    errors = {f"{name}, {label}": disagreement(arms[name], chosen[name][label]) for name in arms for label in checked[name]}
    intelledex = arms["intelledex_605"]
    speeds = kj.link_speeds(intelledex)
    moved, angles = same_motion(intelledex, speeds), np.geomspace(1e-6, np.pi / 2, 40)
    lost = lost_digits(intelledex, speeds, angles)
    numbers = summary(counts) | {
        "largest_disagreement": max(errors.values()),
        "disagreement": errors,
        "motions_differ_by_rad": float(moved["difference"].max()),
        "steps_in_joint_rates": int(moved["plain"].stats["num_steps"]),
        "steps_in_chosen_speeds": int(moved["chosen"].stats["num_steps"]),
        "singularity": into_the_singularity(intelledex, speeds),
        "library": {name: library_counts(model) for name, model in arms.items()},
        "counts": counts,
    }
    record.save(directory, "generalized_speeds", _picture(counts, moved, angles, lost))
    record.write(directory, "generalized_speeds", numbers)
    record.require(numbers["largest_disagreement"] < 1e-11, "the generated equations agree with the library in the same speeds")
    record.require(numbers["motions_differ_by_rad"] < 1e-9, "the motion does not depend on the speeds")
    record.require(numbers["singularity"]["status"] == "SINGULAR_SPEEDS", "running into the singularity is noticed")
    return numbers


def summary(counts: dict[str, dict]) -> dict[str, Any]:
    """The figures that the thesis's advice stands on."""
    arm = counts["intelledex_605"]
    advised = arm["link C for q123"]
    best = {name: min(rows, key=lambda label, rows=rows: total(rows[label]["X_and_Y"])) for name, rows in counts.items()}
    return {
        "saved_by_link_C_in_X_and_Y": 1.0 - total(advised["X_and_Y"]) / total(arm[RATES]["X_and_Y"]),
        "saved_by_link_C_in_torques_by_X_and_Y": 1.0
        - total(advised["torques_by_X_and_Y"]) / total(arm[RATES]["torques_by_X_and_Y"]),
        "saved_by_link_C_in_torques_by_recursion": 1.0
        - total(advised["torques_by_recursion"]) / total(arm[RATES]["torques_by_recursion"]),
        "multiplications_of_torques_by_link_C": advised["torques_by_X_and_Y"]["multiplications"],
        "additions_of_torques_by_link_C": advised["torques_by_X_and_Y"]["additions"],
        "multiplications_by_hand": BY_HAND[0],
        "additions_by_hand": BY_HAND[1],
        "fewest_operations_of_X_and_Y": best,
        "best_saves": {
            name: 1.0 - total(rows[best[name]]["X_and_Y"]) / total(rows[RATES]["X_and_Y"]) for name, rows in counts.items()
        },
        "angular_velocities_of_figure_2_2": {
            "counted": {label: row["angular_velocities"] for label, row in counts["three_revolute_arm"].items()},
            "by_nie": {f"link {name}": list(pair) for name, pair in NAMED_BY_NIE.items()},
        },
    }


def library_counts(model: kj.Model) -> dict[str, dict[str, int]]:
    """What the library's recursions take in joint rates, with regrouped parameters: to compare with."""
    tasks: dict[str, Callable[..., Any]] = {
        "X_and_Y": lambda model, q, u: (kj.mass_matrix(model, q), kj.bias_force(model, q, u)),
        "torques_by_recursion": kj.inverse_dynamics,
    }
    counts = {task: kj.operation_count(function, model) for task, function in tasks.items()}
    return {
        task: {"multiplications": x.multiplications, "additions": x.additions, "divisions": x.divisions}
        for task, x in counts.items()
    }


def _picture(counts: dict, moved: dict[str, Any], angles: np.ndarray, lost: dict[str, np.ndarray]) -> record.Figure:
    figure, axes = record.figure_of(2, 2, size=(12.5, 9), title="The choice of generalized speeds, after Nie 1988, II.2")
    _draw_counts(axes[0], counts["intelledex_605"], "Intelledex 605")
    _draw_counts(axes[1], counts["stanford_arm"], "Stanford arm")
    _draw_motion(axes[2], moved)
    _draw_lost(axes[3], angles, lost)
    return figure


def least_by_link(counts: dict[str, dict], task: str) -> dict[str, str]:
    """The choice with fewest operations for each base link."""
    least: dict[str, str] = {}
    for label in sorted(counts, key=lambda label: total(counts[label][task])):
        least.setdefault(label.split(" for ")[0], label)
    links = sorted(least, key=lambda link: (link != RATES, link))
    return {link: least[link] for link in links}


def _draw_counts(axes: record.Axes, counts: dict[str, dict], name: str) -> None:
    """Operations against the base link."""
    tasks = {
        "torques_by_X_and_Y": r"torques from $X_{rs}$, $Y_r$",
        "X_and_Y": r"$X_{rs}$ and $Y_r$",
        "torques_by_recursion": "torques by recursion",
    }
    for offset, ((task, label), color) in enumerate(zip(tasks.items(), record.COLORS, strict=False)):
        least = {link: total(counts[best][task]) for link, best in least_by_link(counts, task).items()}
        places = np.arange(len(least)) + (offset - 1) * 0.27
        bars = axes.bar(places, list(least.values()), 0.26, color=color, label=label)
        axes.bar_label(bars, fontsize=6.5, color="#555555", padding=1)
    axes.set_xticks(range(len(least)), [label.replace("joint rates", "joint\nrates") for label in least])
    axes.set(ylabel="operations", title=f"{name}: speeds from the angular velocity of")
    axes.set_ylim(0, 1.22 * axes.get_ylim()[1])
    axes.legend(frameon=False, ncols=3, fontsize=7.5, loc="upper left")


def _draw_motion(axes: record.Axes, moved: dict[str, Any]) -> None:
    """Coordinates in both speeds, and their difference."""
    ts = moved["ts"]
    for k, color in enumerate(record.COLORS):
        axes.plot(ts, np.degrees(moved["plain"].q[:, k]), color=color, lw=1.2, label=f"$q_{k + 1}$")
        axes.plot(ts[::10], np.degrees(moved["chosen"].q[::10, k]), "o", color=color, ms=3.5, mfc="none")
    axes.set(xlabel="time [s]", ylabel="coordinates [deg]", title="One motion: joint rates (lines), (2.18) (circles)")
    axes.legend(frameon=False, ncols=3, fontsize=8, loc="upper left")
    other = axes.twinx()
    other.semilogy(ts[1:], np.maximum(moved["difference"][1:], 1e-18), color="#999999", lw=0.8, ls=":")
    other.set(ylabel="difference [rad] (dotted)", ylim=(1e-18, 1e-3))
    other.spines["top"].set_visible(False)


def _draw_lost(axes: record.Axes, angles: np.ndarray, lost: dict[str, np.ndarray]) -> None:
    """Errors of the rates near the singularity."""
    for (name, errors), color in zip(lost.items(), record.COLORS, strict=False):
        axes.loglog(np.degrees(angles), errors, "o-", color=color, ms=3, lw=1, label=name)
        epsilon = float(jnp.finfo(name).eps)
        axes.loglog(np.degrees(angles), epsilon / np.sin(angles), color=color, lw=0.8, ls="--")
    axes.set(
        xlabel="$q_2$ [deg]",
        ylabel="error of rates of 1 rad/s [rad/s]",
        title=r"(2.18) is singular at $q_2 = 0$: rounding divided by $\sin q_2$ (dashed)",
    )
    axes.legend(frameon=False)
