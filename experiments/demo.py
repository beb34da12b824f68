"""The demonstration, `make demo`: a Franka Emika Panda picks up loads that its controller does not know.

Loads the arm from its URDF, compares it with MuJoCo, simulates 2048 reaches, each from another posture and with another load in the
hand, differentiates the miss at the end through the simulation with respect to every link's mass, and draws all of it.
Writes results/demo.png and results/demo.json.
"""

import argparse
import importlib.metadata
import json
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from rich.text import Text

import kanejax as kj
from kanejax._report import model_tree

ROOT = Path(__file__).parents[1]
URDF = "panda_description/urdf/panda.urdf"
HAND = "panda_hand"
START = np.array([1.3, -0.9, 0.4, -2.2, -0.4, 1.6, 0.3, 0.02, 0.02])
TARGET = np.array([-0.5, 0.25, 0.0, -1.35, 0.0, 1.6, 0.8, 0.02, 0.02])
LOADS = (0.0, 4.0)
DURATION, STEP, FRAMES = 2.0, 0.01, 101
# The URDF has no inertia of motors and gears, which the controller of a real arm relies on; a plausible one, in kg m^2 and kg.
ROTOR_INERTIA = 0.2
# Angular frequency [rad/s] and damping ratio of the controller.
FREQUENCY, RATIO = 7.0, 0.7
# How many trajectories the gradient is averaged over.
DIFFERENTIATED = 256


class Controller(NamedTuple):
    """A posture to reach, and what every joint feels there with the load that the controller expects: inertia and weight."""

    posture: jax.Array
    inertia: jax.Array
    holding: jax.Array


class Reaches(NamedTuple):
    """Loads (batch,), times (frames,), coordinates (batch, frames, nq) and paths of the hand (batch, frames, 3)."""

    loads: np.ndarray
    ts: np.ndarray
    q: np.ndarray
    paths: np.ndarray


def control(t: jax.Array, q: jax.Array, u: jax.Array, params: Controller) -> jax.Array:
    """A spring and a damper in every joint."""
    return params.holding + params.inertia * (FREQUENCY**2 * (params.posture - q) - 2.0 * RATIO * FREQUENCY * u)


def with_load(model: kj.Model, load: Any) -> kj.Model:
    """The model with a mass in its hand; an array of loads gives an array of models."""
    hand = model.tree.body(HAND)
    mass = model.mass + jnp.asarray(load)[..., None] * (jnp.arange(model.nbody) == hand)
    return eqx.tree_at(lambda m: m.mass, model, mass)


def controller(model: kj.Model) -> Controller:
    expected, posture = with_load(model, sum(LOADS) / 2), jnp.asarray(TARGET)
    return Controller(posture, jnp.diagonal(kj.mass_matrix(expected, posture)), -kj.gravity_force(expected, posture))


def hand_position(model: kj.Model, q: jax.Array) -> jax.Array:
    return kj.poses(model, q).origin[model.tree.body(HAND)]


def simulate(model: kj.Model, params: Controller, trajectories: int, seed: int) -> tuple[Reaches, kj.Trajectory]:
    random = np.random.default_rng(seed)
    q0 = START + random.normal(scale=[0.35, 0.3, 0.35, 0.3, 0.3, 0.3, 0.3, 0.0, 0.0], size=(trajectories, model.nq))
    loads = random.uniform(*LOADS, size=trajectories)
    ts = np.linspace(0.0, DURATION, FRAMES)
    u0 = np.zeros((trajectories, model.nv))
    result = kj.simulate_batch(with_load(model, loads), q0, u0, ts, control=(control, params), dt0=STEP, progress=True)
    paths = jax.jit(jax.vmap(jax.vmap(hand_position, (None, 0)), (None, 0)))(model, jnp.asarray(result.q))
    return Reaches(loads, ts, np.asarray(result.q), np.asarray(paths)), result


def miss(model: kj.Model, params: Controller, q0: jax.Array, loads: jax.Array) -> jax.Array:
    """Mean squared distance [m^2] between hand and target at the end."""
    target = hand_position(model, jnp.asarray(TARGET))
    ts = np.array([0.0, DURATION])

    def squared_distance(q0: jax.Array, load: jax.Array) -> jax.Array:
        loaded = with_load(model, load)
        end = kj.simulate(loaded, q0, jnp.zeros(model.nv), ts, control=(control, params), dt0=STEP).q_end
        return jnp.sum((hand_position(model, end) - target) ** 2)

    return jnp.mean(jax.vmap(squared_distance)(q0, loads))


def gradient_of_miss(model: kj.Model, params: Controller, reaches: Reaches) -> tuple[float, np.ndarray]:
    """The miss, and its derivative with respect to the mass of each body [m^2/kg], the controller's forces held fixed."""
    chosen = slice(0, DIFFERENTIATED)

    def of_mass(mass: jax.Array) -> jax.Array:
        return miss(
            eqx.tree_at(lambda m: m.mass, model, mass),
            params,
            jnp.asarray(reaches.q[chosen, 0]),
            jnp.asarray(reaches.loads[chosen]),
        )

    value, gradient = jax.jit(jax.value_and_grad(of_mass))(model.mass)
    return float(value), np.asarray(gradient)


INK, QUIET, PAPER = "#1f2430", "#8a90a0", "#ffffff"
COLORS = mpl.colormaps["plasma"]


def draw(model: kj.Model, reaches: Reaches, gradient: np.ndarray, path: Path) -> None:
    style = {
        "font.size": 9,
        "axes.edgecolor": QUIET,
        "axes.labelcolor": INK,
        "xtick.color": QUIET,
        "ytick.color": QUIET,
        "text.color": INK,
    }
    with plt.rc_context({**style, "axes.spines.top": False, "axes.spines.right": False}):
        figure = plt.figure(figsize=(15, 8.4), dpi=130, facecolor=PAPER)
        grid = figure.add_gridspec(
            4, 4, width_ratios=(1.1, 1.1, 0.6, 0.6), hspace=0.55, wspace=0.32, left=0.0, right=0.975, top=0.87, bottom=0.075
        )
        draw_paths(figure, figure.add_axes((-0.02, -0.03, 0.6, 0.97), projection="3d"), model, reaches)
        for joint in range(4):
            axes = figure.add_subplot(grid[joint // 2, 2 + joint % 2])
            draw_bands(axes, reaches, (0, 1, 3, 5)[joint])
        draw_gradient(figure.add_subplot(grid[2:, 2:]), model, gradient)
        count = len(reaches.loads)
        figure.text(
            0.03, 0.945, f"{count} reaches of a Panda with loads that its controller does not know", fontsize=17, weight="bold"
        )
        expected = f"the controller expects {sum(LOADS) / 2:g} kg in the hand"
        caption = f"Each path is one simulation of {DURATION:g} s from a random posture; {expected}."
        figure.text(0.03, 0.913, caption, fontsize=10.5, color=QUIET)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, facecolor=PAPER)
        plt.close(figure)


def draw_paths(figure: Any, axes: Any, model: kj.Model, reaches: Reaches) -> None:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    shown = np.argsort(reaches.loads)[:: max(1, len(reaches.loads) // 420)]
    norm = mpl.colors.Normalize(*LOADS)
    order = np.random.default_rng(0).permutation(shown)
    lines = Line3DCollection(reaches.paths[order], colors=COLORS(norm(reaches.loads[order]) * 0.92), linewidths=0.7, alpha=0.5)
    axes.add_collection3d(lines)
    ends = reaches.paths[:, -1]
    axes.scatter(*ends.T, c=reaches.loads, cmap=COLORS, norm=norm, s=5, alpha=0.9, linewidths=0, depthshade=False)
    at = jax.jit(kj.poses)(model, jnp.asarray(TARGET))
    links = np.asarray(at.origin)[: model.tree.body(HAND) + 1]
    axes.plot(*links.T, color=INK, linewidth=5, alpha=0.85, solid_capstyle="round", zorder=10)
    axes.plot(*links.T, "o", color=PAPER, markeredgecolor=INK, markersize=6, markeredgewidth=1.4, zorder=11)
    low, high = reaches.paths[shown].reshape(-1, 3).min(0), reaches.paths[shown].reshape(-1, 3).max(0)
    low, high = np.minimum(low, links.min(0)), np.maximum(high, links.max(0))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.38)
    axes.view_init(elev=22, azim=-38)
    axes.set_axis_off()
    draw_floor(axes, low, high)
    place = figure.add_axes((0.035, 0.1, 0.15, 0.016))
    bar = figure.colorbar(mpl.cm.ScalarMappable(norm, COLORS), cax=place, orientation="horizontal")
    bar.set_label("load in the hand [kg]")
    bar.outline.set_visible(False)


def draw_floor(axes: Any, low: np.ndarray, high: np.ndarray) -> None:
    """Lines on the floor, 0.2 m apart."""
    floor = min(low[2], 0.0)
    for x in np.arange(np.floor(low[0] / 0.2) * 0.2, high[0] + 0.2, 0.2):
        axes.plot([x, x], [low[1], high[1]], [floor, floor], color=QUIET, linewidth=0.4, alpha=0.5)
    for y in np.arange(np.floor(low[1] / 0.2) * 0.2, high[1] + 0.2, 0.2):
        axes.plot([low[0], high[0]], [y, y], [floor, floor], color=QUIET, linewidth=0.4, alpha=0.5)


def draw_bands(axes: Any, reaches: Reaches, joint: int) -> None:
    """Quantiles of a joint's angle over all reaches."""
    angles = np.degrees(reaches.q[:, :, joint])
    for outer, alpha in ((0.02, 0.18), (0.1, 0.28), (0.25, 0.42)):
        low, high = np.quantile(angles, (outer, 1 - outer), axis=0)
        axes.fill_between(reaches.ts, low, high, color="#5b3fb0", alpha=alpha, linewidth=0)
    axes.plot(reaches.ts, np.median(angles, axis=0), color=INK, linewidth=1.2)
    axes.axhline(np.degrees(TARGET[joint]), color="#e8743b", linewidth=1.0, linestyle=(0, (4, 3)))
    axes.set_title(f"joint {joint + 1}, degrees", loc="left", fontsize=9.5)
    axes.set_xlim(0, DURATION)
    axes.set_xticks([0, 1, 2], ["0", "1", "2 s"])
    axes.margins(y=0.05)


def draw_gradient(axes: Any, model: kj.Model, gradient: np.ndarray) -> None:
    """How the miss changes with the mass of each body that moves."""
    moving = [body for body, link in enumerate(model.tree.body_links) if link >= 0 and model.mass[body] > 0]
    values = 1e4 * gradient[moving]
    names = [model.tree.body_names[body].removeprefix("panda_") for body in moving]
    colors = ["#c8453b" if value > 0 else "#2f7f9e" for value in values]
    axes.barh(range(len(moving)), values, color=colors, height=0.68)
    axes.set_yticks(range(len(moving)), names)
    axes.tick_params(axis="y", length=0, labelcolor=INK)
    axes.invert_yaxis()
    axes.axvline(0, color=INK, linewidth=0.8)
    axes.spines["left"].set_visible(False)
    axes.set_title("d(mean squared miss) / d(mass of the link), through the simulation", loc="left", fontsize=9.5)
    axes.set_xlabel("cm$^2$ per kg")
    axes.margins(x=0.12)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trajectories", type=int, default=2048)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "demo.png")
    options = parser.parse_args()
    mpl.use("Agg")
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", os.environ.get("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".cache" / "jax")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    console, seconds, begin = Console(), {}, time.perf_counter()

    def step(name: str) -> None:
        nonlocal begin
        seconds[name] = round(time.perf_counter() - begin, 2)
        console.print(Text(f"-- {name}: {seconds[name]:.1f} s", style="dim"))
        begin = time.perf_counter()

    urdf = kj.robots.example_file(URDF)
    loaded = kj.load_report(urdf, strict=False)
    model = loaded.model
    console.print(model_tree(model, "Franka Emika Panda"))
    for sentence in (*loaded.ignored, *loaded.unmodelled):
        console.print(Text(f"left out: {sentence}"))
    step("load")

    report = kj.validate(urdf, samples=50, strict=False)
    console.print(report.table())
    step("validate")

    model = replace(model, armature=jnp.full_like(model.armature, ROTOR_INERTIA))
    params = controller(model)
    reaches, result = simulate(model, params, options.trajectories, options.seed)
    reached = int(np.sum(result.ok))
    console.print(
        Text(f"{reached} of {options.trajectories} trajectories reached their end, {int(np.sum(result.stats['num_steps']))} steps")
    )
    step("simulate")

    value, gradient = gradient_of_miss(model, params, reaches)
    sensitive = model.tree.body_names[int(np.argmax(np.abs(gradient) * (model.mass > 0)))]
    console.print(Text(f"root mean squared miss {100 * value**0.5:.2f} cm; the mass of {sensitive} matters most"))
    step("gradient")

    draw(model, reaches, gradient, options.out)
    step("picture")
    facts = {
        "trajectories": options.trajectories,
        "reached": reached,
        "seed": options.seed,
        "seconds": seconds,
        "validation": report.as_dict() | {"robot": URDF},
        "mean_squared_miss": value,
        "gradient_by_mass": dict(zip(model.tree.body_names, gradient.tolist(), strict=True)),
        "device": str(jax.devices()[0]),
        "versions": {
            package: importlib.metadata.version(package) for package in ("jax", "diffrax", "mujoco", "example-robot-data")
        },
    }
    options.out.with_suffix(".json").write_text(json.dumps(facts, indent=1))
    console.print(Text(f"{options.out}: a picture of it; {sum(seconds.values()):.0f} s in all", style="bold"))


if __name__ == "__main__":
    main()
