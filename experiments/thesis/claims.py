"""Claims of Nie's chapter IV: F is symmetric, non-working forces cancel but can be had, and the time of an evaluation.

- F of F u_dot + Z = K + tau is symmetric, as chapter III proves, and as a kinetic energy's matrix positive definite. Checked on F
  column by column, as the rate of the torques of inverse dynamics with u_dot, where nothing makes it symmetric by construction, and
  body by body, on Kane's sum over partial velocities.
- The wrench between two links contributes to the generalized force F_r what it does on the one link less what it does on the
  other, and in the sum over the links all but the working torques cancel, Nie (2.55).
- "Brought into evidence", a wrench's other five components are the generalized forces of five further speeds, along which
  the joint could move but does not. `joint_reactions`, which sums Newton's and Euler's laws, must give the same.
- AUTOTF took 0.28 s for six torques on an IBM AT.
"""

import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import jax
import jax.numpy as jnp
import numpy as np

import kanejax as kj
from experiments.thesis import record
from experiments.thesis.motion import DURATION, motions
from kanejax.robots import intelledex_605, rrp_arm, stanford_arm, three_revolute_arm

IBM_AT = 0.28
"""Seconds that Nie's AUTOTF took for six torques, chapter IV."""
ROBOTS: dict[str, Callable[[], kj.Model]] = {
    "intelledex_605": intelledex_605,
    "stanford_arm": stanford_arm,
    "three_revolute_arm": three_revolute_arm,
    "rrp_arm": lambda: rrp_arm(load="fused"),
}
STATES = 2000
BATCH = 4096


class States(NamedTuple):
    """Random coordinates, speeds and their rates, (count, nv) each."""

    q: jax.Array
    u: jax.Array
    u_dot: jax.Array


class Reactions(NamedTuple):
    """What the wrench between a link and the one before contributes to each generalized force, (njoint, nv) in N m or N.

    Attributes:
        net: on both links together.
        on_link: on the outer link alone.
    """

    net: jax.Array
    on_link: jax.Array


def random_states(model: kj.Model, count: int) -> States:
    """Any angles, and distances of 0.1 to 1.3 m."""
    random = np.random.default_rng(record.SEED)
    prismatic = np.array([kind == "prismatic" for kind in model.tree.joint_types])
    angles, distances = random.uniform(-np.pi, np.pi, (count, model.nq)), random.uniform(0.1, 1.3, (count, model.nq))
    u, u_dot = random.normal(size=(2, count, model.nv))
    return States(jnp.asarray(np.where(prismatic, distances, angles)), jnp.asarray(u), jnp.asarray(u_dot))


def symmetry(model: kj.Model, count: int = STATES) -> dict[str, float]:
    """Largest asymmetries of F, relative to its largest element, its least eigenvalue, and the spread of the eigenvalues."""
    q, u, _ = random_states(model, count)

    def matrices(q: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        rate = jax.jacfwd(lambda u_dot: kj.inverse_dynamics(model, q, u, u_dot))
        return rate(jnp.zeros_like(u)), kj.kane_equations(model, q, u).mass_matrix

    by_column, by_body = jax.jit(jax.vmap(matrices))(q, u)
    eigenvalues = np.linalg.eigvalsh(np.asarray(by_column))
    return {
        "asymmetry_by_column": _asymmetry(by_column),
        "asymmetry_by_body": _asymmetry(by_body),
        "difference_of_both": float(jnp.max(jnp.abs(by_column - by_body) / _largest(by_body))),
        "least_eigenvalue": float(eigenvalues.min()),
        "greatest_condition_number": float((eigenvalues[:, -1] / eigenvalues[:, 0]).max()),
    }


def _largest(matrices: jax.Array) -> jax.Array:
    return jnp.max(jnp.abs(matrices), axis=(1, 2), keepdims=True)


def _asymmetry(matrices: jax.Array) -> float:
    return float(jnp.max(jnp.abs(matrices - matrices.mT) / _largest(matrices)))


def reaction_forces(model: kj.Model, q: jax.Array, u: jax.Array, u_dot: jax.Array) -> Reactions:
    """Contributions of all reaction wrenches to the generalized forces, for a model with a joint a body."""
    tree, at, partial = model.tree, kj.poses(model, q), kj.partial_velocities(model, q)
    wrench = kj.joint_reactions(model, q, u, u_dot)
    # Row -1 is the ground, which does not move.
    angular = jnp.concatenate((partial.angular, jnp.zeros((1, model.nv, 3))))
    linear = jnp.concatenate((partial.linear, jnp.zeros((1, model.nv, 3))))
    com = jnp.concatenate((at.com, jnp.zeros((1, 3))))

    def on(bodies: np.ndarray) -> jax.Array:
        arm = at.link_origin - com[bodies]
        of_point = linear[bodies] + jnp.cross(angular[bodies], arm[:, None, :])
        return jnp.einsum("jri,ji->jr", of_point, wrench.force) + jnp.einsum("jri,ji->jr", angular[bodies], wrench.moment)

    outer = np.array(tree.joint_bodies)
    inner = np.array(tree.body_parents)[outer]
    return Reactions(on(outer) - on(inner), on(outer))


def cancellation(model: kj.Model, count: int = STATES) -> dict[str, float]:
    """What is left of the reactions where they do no work, and how they differ from the torques where they do."""
    states = random_states(model, count)
    net, on_link = jax.jit(jax.vmap(lambda *state: reaction_forces(model, *state)))(*states)
    tau = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))(model, *states)
    scale = jnp.max(jnp.abs(on_link), axis=(1, 2), keepdims=True)
    working = jnp.diagonal(net, axis1=1, axis2=2)
    return {
        "non_working": float(jnp.max(jnp.abs(net - working[:, :, None] * jnp.eye(model.nv)[None]) / scale)),
        "working_less_torque": float(jnp.max(jnp.abs(working - tau) / scale[:, 0])),
    }


def evidence(model: kj.Model, joint: int, count: int = 64) -> float:
    """How far five extra speeds and `joint_reactions` differ on the wrench at a joint, relative to its largest component."""
    q, u, u_dot = random_states(model, count)
    freed, axes = _freed(model, joint)
    # The extra joints come right after the joint itself, at rest.
    still = [np.insert(np.asarray(each), [joint + 1] * 5, 0.0, axis=1) for each in (q, u, u_dot)]
    extra = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))(freed, *still)[:, joint + 1 : joint + 6]

    def components(q: jax.Array, u: jax.Array, u_dot: jax.Array) -> jax.Array:
        turn = kj.poses(model, q).rotation[model.tree.joint_bodies[joint]]
        wrench = kj.joint_reactions(model, q, u, u_dot)
        along = {"slide": turn.T @ wrench.force[joint], "hinge": turn.T @ wrench.moment[joint]}
        return jnp.stack([axis @ along[kind] for kind, axis in axes])

    expected = jax.jit(jax.vmap(components))(q, u, u_dot)
    return float(jnp.max(jnp.abs(extra - expected)) / jnp.max(jnp.abs(expected)))


def _freed(model: kj.Model, joint: int) -> tuple[kj.Model, list[tuple[str, np.ndarray]]]:
    """The model whose joint can move in all six directions, and the kinds and axes of the five that are new."""
    root = ElementTree.fromstring(kj.to_mjcf(model))
    body = next(element for element in root.iter("body") if element.get("name") == model.tree.body_names[joint])
    own = body.find("joint")
    assert own is not None
    axis = np.asarray(model.joint_axis[joint])
    _, _, directions = np.linalg.svd(axis[None])
    axes = [(kind, each) for kind in ("slide", "hinge") for each in (*directions[1:], axis)]
    # The last of the slides or hinges is the joint's own.
    del axes[5 if own.get("type") == "hinge" else 2]
    for number, (kind, each) in enumerate(axes):
        new = {"name": f"extra{number}", "type": kind, "axis": " ".join(map(repr, each.tolist())), "pos": own.get("pos", "0 0 0")}
        body.insert(list(body).index(own) + 1 + number, ElementTree.Element("joint", new))
    return kj.load(ElementTree.tostring(root, encoding="unicode")), axes


def seconds(run: Callable[[], Any], least: float = 0.05, rounds: int = 9) -> float:
    """Median time of a call over several rounds, of at least so many seconds each, compilation excluded."""
    jax.block_until_ready(run())
    start = time.perf_counter()
    jax.block_until_ready(run())
    calls = max(1, round(least / (time.perf_counter() - start)))
    samples = []
    for _ in range(rounds):
        start = time.perf_counter()
        for _ in range(calls):
            jax.block_until_ready(run())
        samples.append((time.perf_counter() - start) / calls)
    return statistics.median(samples)


def timings(batch: int = BATCH) -> dict[str, float]:
    """Seconds for six torques of the Intelledex 605, in one call and in a batch."""
    model = intelledex_605()
    states = random_states(model, batch)
    first = [each[0] for each in states]
    one = jax.jit(lambda q, u, u_dot: kj.inverse_dynamics(model, q, u, u_dot))
    many = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))
    return {"one_call_s": seconds(lambda: one(*first)), "one_of_a_batch_s": seconds(lambda: many(model, *states)) / batch}


def run(directory: Path) -> dict:
    """Check the claims on four arms, and time AUTOTF's task; fails where a claim is off by more than rounding."""
    models = {name: make() for name, make in ROBOTS.items()}
    matrices = {name: symmetry(model) for name, model in models.items()}
    reactions = {name: cancellation(model) for name, model in models.items()}
    # The Stanford arm has joints of both types.
    shown = [evidence(models["stanford_arm"], joint) for joint in range(6)]
    times = timings()
    numbers = {
        "worst_asymmetry_of_F": max(max(row["asymmetry_by_column"], row["asymmetry_by_body"]) for row in matrices.values()),
        "least_eigenvalue_of_F": min(row["least_eigenvalue"] for row in matrices.values()),
        "non_working_left": max(row["non_working"] for row in reactions.values()),
        "evidence_error": max(shown),
        "one_call_s": times["one_call_s"],
        "one_of_a_batch_s": times["one_of_a_batch_s"],
        "times_faster_than_IBM_AT_one_call": IBM_AT / times["one_call_s"],
        "times_faster_than_IBM_AT_in_a_batch": IBM_AT / times["one_of_a_batch_s"],
        "batch": BATCH,
        "states": STATES,
        "F": matrices,
        "reactions": reactions,
        "evidence_error_by_joint_of_the_stanford_arm": shown,
    }
    record.save(directory, "claims", _picture(models["intelledex_605"], times))
    record.write(directory, "claims", numbers)
    record.require(numbers["worst_asymmetry_of_F"] < 1e-12, "F is symmetric")
    record.require(numbers["least_eigenvalue_of_F"] > 0, "F is positive definite")
    record.require(numbers["non_working_left"] < 1e-12, "non-working forces cancel")
    record.require(numbers["evidence_error"] < 1e-11, "extra speeds bring the reactions into evidence")
    return numbers


def _picture(model: kj.Model, times: dict[str, float]) -> record.Figure:
    figure, axes = record.figure_of(2, 2, size=(11, 8), title="Claims of Nie 1988, chapter IV, on the Intelledex 605")
    _draw_matrix(axes[0], model)
    _draw_reactions(axes[1], model)
    _draw_wrenches(axes[2], model)
    _draw_times(axes[3], times)
    return figure


def _draw_matrix(axes: record.Axes, model: kj.Model) -> None:
    """Eigenvalues of F over random states."""
    states = random_states(model, STATES)
    eigenvalues = np.linalg.eigvalsh(np.asarray(jax.jit(jax.vmap(kj.mass_matrix, (None, 0)))(model, states.q)))
    bins = np.geomspace(eigenvalues.min() * 0.8, eigenvalues.max() * 1.2, 70).tolist()
    for k, color in enumerate(record.COLORS):
        axes.hist(eigenvalues[:, k], bins=bins, color=color, alpha=0.75, label=f"{k + 1}.")
    axes.set(
        xscale="log",
        xlabel=r"eigenvalues of $F$ [kg m$^2$]",
        ylabel=f"states of {STATES}",
        title="The mass matrix is positive definite",
    )
    axes.legend(frameon=False, ncols=2, fontsize=8)


def _draw_reactions(axes: record.Axes, model: kj.Model) -> None:
    """Contributions of each joint's wrench to each generalized force, at one state."""
    state = [each[0] for each in random_states(model, 1)]
    net, on_link = jax.jit(lambda *state: reaction_forces(model, *state))(*state)
    shown = np.log10(np.maximum(np.abs(np.asarray(net)), 1e-18))
    image = axes.imshow(shown, cmap="YlGnBu", vmin=-18, vmax=3, aspect="auto")
    for j, r in np.ndindex(*shown.shape):
        text = f"{float(net[j, r]):.2g}\nof {float(on_link[j, r]):.2g}" if on_link[j, r] else "0"
        axes.text(r, j, text, ha="center", va="center", fontsize=6, color="white" if shown[j, r] > -4 else "#333333")
    names = range(1, model.nv + 1)
    axes.set(xticks=range(model.nv), yticks=range(model.nv), xticklabels=names, yticklabels=names)
    axes.set(
        xlabel="generalized force r",
        ylabel="wrench at joint",
        title="Of the wrenches only the working torques remain\n(of what they contribute on the outer link alone)",
    )
    axes.grid(visible=False)
    axes.figure.colorbar(image, ax=axes, label=r"$\log_{10}$ |contribution| [N m]", shrink=0.85)


def _draw_wrenches(axes: record.Axes, model: kj.Model) -> None:
    """Moments across the joints' axes, which do no work, beside the torques, along the specified motion."""
    ts = jnp.linspace(0.0, DURATION, 201)
    states = motions(ts)
    wrenches = jax.jit(jax.vmap(kj.joint_reactions, (None, 0, 0, 0)))(model, *states)
    tau = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))(model, *states)
    across = np.sqrt(np.maximum(np.sum(np.asarray(wrenches.moment) ** 2, axis=2) - np.asarray(tau) ** 2, 0.0))
    for joint in range(4):
        color = record.COLORS[joint]
        axes.plot(ts, across[:, joint], color=color, linewidth=2, label=f"joint {joint + 1}")
        axes.plot(ts, np.abs(tau[:, joint]), ":", color=color, linewidth=1.6)
    axes.set(
        xlabel="t [s]",
        ylabel="moment [N m]",
        title="Brought into evidence: moments across the axes\n(dotted: along them, the torques)",
    )
    axes.legend(frameon=False, ncols=2, fontsize=8)


def _draw_times(axes: record.Axes, times: dict[str, float]) -> None:
    rows = {
        "IBM AT, AUTOTF": IBM_AT,
        "kanejax, one call": times["one_call_s"],
        f"kanejax, one of {BATCH}": times["one_of_a_batch_s"],
    }
    axes.barh(list(rows), list(rows.values()), color=[record.COLORS[k] for k in (5, 0, 2)], height=0.55)
    for row, value in enumerate(rows.values()):
        axes.text(value * 1.3, row, f"{IBM_AT / value:,.0f} times as fast" if row else "0.28 s", va="center", fontsize=9)
    axes.set(xscale="log", xlabel="time for six torques [s]", xlim=(1e-8, 30), title="Time of an evaluation")
    axes.invert_yaxis()
