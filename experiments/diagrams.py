"""The diagrams of docs/concepts.md, drawn from poses and partial velocities that the library computes.

`python experiments/diagrams.py` writes docs/diagrams/*.svg, the same bytes every time.
"""

import contextlib
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

import kanejax as kj

FOLDER = Path(__file__).parents[1] / "docs" / "diagrams"
# Okabe and Ito's colours, which the colour-blind tell apart.
INK, QUIET, STEEL, PAPER = "#22262e", "#6b7280", "#b9c0cb", "#ffffff"
BLUE, ORANGE, GREEN, PURPLE = "#0072b2", "#d55e00", "#009e73", "#aa4499"
STYLE = {"svg.hashsalt": "kanejax", "svg.fonttype": "path", "font.size": 11, "mathtext.fontset": "dejavusans", "text.color": INK}
# A pendulum's rod, and a body with an anchored hinge on a parent: small enough to draw all that a model says of them.
PENDULUM = """<mujoco><compiler angle="radian"/><worldbody><body name="rod"><joint name="pivot" axis="0 1 0"/>
  <inertial pos="0 0 -1" mass="2" diaginertia=".1 .1 .01"/></body></worldbody></mujoco>"""
LINK = """<mujoco><compiler angle="radian"/><worldbody><body name="parent"><joint name="base" axis="0 0 1"/>
  <inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>
  <body name="child" pos=".1 .95 .2" euler=".1 -.15 .35"><joint name="elbow" axis=".5 -.45 1" pos="-.1 .3 .16"/>
    <inertial pos=".0 .95 .3" quat=".95 .1 .05 .3" mass="2" diaginertia=".05 .042 .012"/></body></body></worldbody></mujoco>"""
TREE = """<mujoco><worldbody><body name="trunk"><freejoint name="base"/><inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/>
  <body name="thigh"><joint name="hip" type="ball"/><inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
    <body name="shank"><joint name="knee" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <body name="foot"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body></body>
  <body name="mast"><joint name="lift" type="slide"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <body name="camera"><joint name="pan" axis="0 0 1"/><joint name="tilt" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body></body></worldbody></mujoco>"""


class Sketch:
    """Points of space drawn as seen from afar."""

    def __init__(self, axes: Any, azimuth: float, elevation: float) -> None:
        """Look at the origin from an azimuth about z and an elevation above the horizon [degrees]."""
        a, e = np.radians((azimuth, elevation))
        self.axes = axes
        self.view = np.array([[-np.sin(a), np.cos(a), 0.0], [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)]])
        axes.set_aspect("equal")
        axes.set_axis_off()

    def place(self, point: Any) -> np.ndarray:
        """Where a point is on the paper."""
        return self.view @ np.asarray(point, float)

    def line(self, *points: Any, color: str = INK, width: float = 1.2, dash: Any = "-", order: int = 2) -> None:
        """A line through points."""
        x, y = np.array([self.place(point) for point in points]).T
        self.axes.plot(x, y, color=color, linewidth=width, linestyle=dash, solid_capstyle="round", zorder=order)

    def dot(self, point: Any, color: str = INK, size: float = 5.0, edge: str = PAPER) -> None:
        """A dot on a point."""
        self.axes.plot(*self.place(point), "o", color=color, markersize=size, markeredgecolor=edge, zorder=8)

    def text(self, point: Any, words: str, shift: tuple[float, float] = (6, 4), color: str = INK, **options: Any) -> None:
        """Words beside a point."""
        place = self.place(point)
        self.axes.annotate(words, place, shift, textcoords="offset points", color=color, zorder=9, **options)

    def arrow(
        self, start: Any, vector: Any, color: str, words: str = "", shift: tuple[float, float] = (5, 3), **style: Any
    ) -> None:
        """A vector from a point."""
        start, end = np.asarray(start, float), np.asarray(start, float) + np.asarray(vector, float)
        style = {"arrowstyle": "-|>,head_width=3,head_length=6", "linewidth": 1.9, "shrinkA": 0, "shrinkB": 0} | style
        self.axes.add_patch(FancyArrowPatch(self.place(start), self.place(end), color=color, zorder=7, **style))
        self.axes.update_datalim([self.place(start), self.place(end)])
        if words:
            self.text(end, words, shift, color)

    def turn(self, center: Any, axis: Any, radius: float, color: str, words: str = "", shift: tuple[float, float] = (5, 3)) -> None:
        """An arrow around an axis, in the sense of a right-handed screw."""
        axis = np.asarray(axis, float) / np.linalg.norm(axis)
        side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        side /= np.linalg.norm(side)
        angles = np.radians(np.linspace(-60.0, 215.0, 60))[:, None]
        points = np.asarray(center, float) + radius * (np.cos(angles) * side + np.sin(angles) * np.cross(axis, side))
        self.line(*points, color=color, width=1.9, order=6)
        self.arrow(points[-2], points[-1] - points[-2], color, words, shift)

    def frame(self, origin: Any, rotation: Any, length: float, names: Sequence[str], color: str = QUIET) -> None:
        """The axes of a frame; the columns of the rotation are their directions."""
        for direction, name in zip(np.asarray(rotation).T, names, strict=True):
            # Beside the head, on the side that it points to.
            ahead = self.view @ direction
            shift = (9.0 * ahead[0] / np.linalg.norm(ahead) - 3.0, 9.0 * ahead[1] / np.linalg.norm(ahead) - 4.0)
            self.arrow(origin, length * direction, color, name, shift, linewidth=1.2)


def link_and_joint(figure: Any) -> None:
    """What a model says of one body and its joint, and the link's frame."""
    model = kj.load(LINK)
    at = jax.tree.map(np.asarray, kj.poses(model, jnp.zeros(2)))
    child, sketch = 1, Sketch(figure.add_axes((0, 0, 1, 1)), 28, 24)
    body, anchor, com = at.rotation[child], at.link_origin[child], at.com[child]
    axis = at.link_rotation[child][:, 2]
    moments, principal = np.linalg.eigh(np.asarray(model.central_inertia[child]))
    sketch.line(at.origin[0], at.origin[0] + (0, 0.15, 0.62), anchor, color=STEEL, width=16, order=0)
    sketch.line(anchor, com, com + 0.4 * (com - anchor), color="#d8dde5", width=30, order=1)
    sketch.frame(at.origin[0], at.rotation[0], 0.3, ("x", "y", "z"))
    sketch.text(at.origin[0], "frame of the\nparent body", (-100, -8), QUIET)
    sketch.arrow(at.origin[0], at.origin[child] - at.origin[0], BLUE, linewidth=1.4)
    sketch.text(0.5 * (at.origin[0] + at.origin[child]), "body_position,\nbody_quaternion", (-46, -42), BLUE)
    sketch.frame(at.origin[child], body, 0.26, ("x", "y", "z"))
    sketch.text(at.origin[child], "frame of the body", (-22, -48), QUIET)
    sketch.line(anchor - 0.35 * axis, anchor + 0.15 * axis, color=ORANGE, width=1.2, dash=(0, (5, 3)), order=5)
    sketch.arrow(anchor, 0.42 * axis, ORANGE)
    sketch.text(anchor + 0.42 * axis, "joint_axis: z of the link's frame", (-30, 8), ORANGE)
    sketch.turn(anchor + 0.2 * axis, axis, 0.1, ORANGE, "q", (-34, 8))
    sketch.dot(anchor, ORANGE, 8)
    aside = anchor + np.array([0.0, 0.16, -0.38])
    sketch.line(anchor, aside, color=ORANGE, width=0.8, order=6)
    sketch.text(aside, "joint_anchor:\norigin of the link's frame", (2, -26), ORANGE)
    sketch.arrow(at.origin[child], com - at.origin[child], GREEN, linewidth=1.4)
    sketch.dot(com, GREEN, 9)
    sketch.text(com, "com", (-6, -24), GREEN)
    for moment, direction in zip(moments, (body @ principal).T, strict=True):
        # As long as the radius of gyration of a mass that lies along that line.
        reach = 2.4 * np.sqrt(max(0.5 * moments.sum() - moment, 0.0) / 2.0)
        sketch.line(com - reach * direction, com + reach * direction, color=PURPLE, width=2.2, order=6)
    sketch.text(com, "principal axes of\ncentral_inertia", (22, 34), PURPLE)
    sketch.axes.set(xlim=(-0.5, 2.5), ylim=(-0.55, 0.95))


def tree(figure: Any) -> None:
    """Bodies, joints, and where the coordinates and speeds of each joint lie."""
    shape = kj.load(TREE).tree
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set(xlim=(-0.6, 5.2), ylim=(-0.75, 2.75))
    rows = {"trunk": (1, 1), "thigh": (2, 2), "shank": (3, 2), "foot": (4, 2), "mast": (2, 0), "camera": (3, 0)}
    places = {"world": np.array([0.0, 1.0])} | {name: np.array(place, float) * (1.12, 1) for name, place in rows.items()}
    link_of = dict(zip(shape.body_names, shape.body_links, strict=True))
    welded = {name for name in shape.body_names if not any(b == shape.body_names.index(name) for b in shape.joint_bodies)}
    for body, name in enumerate(shape.body_names):
        parent = shape.body_parents[body]
        start, end = places["world" if parent < 0 else shape.body_names[parent]], places[name]
        reach = np.array([0.36, 0.0])
        axes.add_patch(FancyArrowPatch(start + reach, end - reach, arrowstyle="-|>,head_width=3,head_length=6", color=QUIET))
        joints = [j for j, moved in enumerate(shape.joint_bodies) if moved == body]
        words = "\n".join(f"{shape.joint_names[j]}: {shape.joint_types[j]}\n{_slices(shape, j)}" for j in joints) or "welded"
        middle = 0.5 * (start + end)
        slanted = abs(end[1] - start[1]) > 0.1
        above = end[1] >= start[1]
        shift = (-0.42 if slanted else 0.0, (0.32 if above else -0.32) if slanted else (0.25 if above else -0.25))
        edge = "bottom" if above and not slanted else "center"
        axes.text(*(middle + shift), words, ha="center", va=edge, fontsize=8.5, color=ORANGE if joints else QUIET)
    for name, place in places.items():
        color = STEEL if name == "world" else "#dbe9f4" if name not in welded else "#f3e3d3"
        box = FancyBboxPatch(place - (0.3, 0.14), 0.6, 0.28, boxstyle="round,pad=0.05", facecolor=color, edgecolor=INK)
        axes.add_patch(box)
        index = "" if name == "world" else f"\nbody {shape.body_names.index(name)}, link {link_of[name]}"
        axes.text(*place, f"$\\bf{{{name}}}${index}", ha="center", va="center", fontsize=8.5, zorder=3)


def _slices(shape: kj.Tree, joint: int) -> str:
    ends = [(*starts, size)[joint + 1] for starts, size in ((shape.q_start, shape.nq), (shape.v_start, shape.nv))]
    parts = [(shape.q_start[joint], ends[0]), (shape.v_start[joint], ends[1])]
    return "  ".join(f"{name}[{a}:{b}]" if b > a + 1 else f"{name}[{a}]" for name, (a, b) in zip("qu", parts, strict=True))


def partial_velocities(figure: Any) -> None:
    """The RRP arm of Kane and Levinson: what each generalized speed does to every body."""
    model = kj.robots.rrp_arm(load="fused")
    q = jnp.array([0.15, 0.85, 0.35])
    at = jax.tree.map(np.asarray, kj.poses(model, q))
    angular, linear = (np.asarray(x) for x in kj.partial_velocities(model, q))
    titles = ("$u_1 = 1$ rad/s, about the vertical", "$u_2 = 1$ rad/s, about the elbow", "$u_3 = 1$ m/s, along the slide")
    tip = at.link_origin[2] + 0.75 * at.link_rotation[2][:, 2]
    for r, title in enumerate(titles):
        sketch = Sketch(figure.add_axes((r / 3, 0.0, 1 / 3, 0.92)), 45, 28)
        base = np.array([0.0, 0.0, -0.55])
        sketch.line(base, at.link_origin[0], color=STEEL, width=12, order=0)
        sketch.line(at.link_origin[0], at.link_origin[1], color="#9fb8cf", width=10, order=1)
        sketch.line(at.link_origin[1], at.link_origin[2], color="#b7d3c4", width=9, order=2)
        sketch.line(at.link_origin[2] - 0.15 * at.link_rotation[2][:, 2], tip, color="#e6c9a8", width=6, order=3)
        for joint in range(2):
            z = 0.09 * at.link_rotation[joint][:, 2]
            sketch.line(at.link_origin[joint] - z, at.link_origin[joint] + z, color=INK, width=9, order=4)
        for body in range(3):
            if np.linalg.norm(linear[body, r]) > 1e-6:
                label = f"$\\mathbf{{v}}_{r + 1}^{body + 1}$"
                sketch.arrow(at.com[body], 0.45 * linear[body, r], BLUE, label, (3, 4))
            sketch.dot(at.com[body], GREEN, 7)
        held = at.link_origin[2] + np.dot(at.com[2] - at.link_origin[2], at.link_rotation[2][:, 2]) * at.link_rotation[2][:, 2]
        sketch.line(held, at.com[2], color="#e6c9a8", width=3, order=3)
        if np.linalg.norm(angular[2, r]) > 1e-6:
            start = at.link_origin[r]
            sketch.arrow(start, 0.75 * angular[2, r], ORANGE, f"$\\mathbf{{w}}_{r + 1}$", (4, -12) if r else (-22, -6))
            sketch.turn(start + 0.45 * angular[2, r], angular[2, r], 0.13, ORANGE)
        sketch.axes.set(xlim=(-0.5, 2.3), ylim=(-0.8, 1.25))
        sketch.axes.set_title(title, fontsize=11, y=0.97)


def recursion(figure: Any) -> None:
    """Motion goes from the base outwards, forces come back."""
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set(xlim=(-0.75, 6.75), ylim=(-1.12, 1.12))
    for k in range(4):
        x, name = 2.0 * k, ("world", "link 1", "link 2", "link 3")[k]
        color = STEEL if k == 0 else "#dbe9f4"
        axes.add_patch(FancyBboxPatch((x - 0.42, -0.16), 0.84, 0.32, boxstyle="round,pad=0.06", facecolor=color, edgecolor=INK))
        axes.text(x, 0, name, ha="center", va="center", weight="bold")
        if k == 3:
            continue
        for height, ends, color, words in (
            (0.27, (x + 0.3, x + 1.7), BLUE, f"$\\mathbf{{w}}, \\alpha, \\mathbf{{a}}$ of {name}"),
            (-0.27, (x + 1.7, x + 0.3), ORANGE, f"force and moment\non link {k + 1} and beyond"),
        ):
            style = {"arrowstyle": "-|>,head_width=4,head_length=8", "linewidth": 2, "color": color}
            axes.add_patch(FancyArrowPatch((ends[0], height), (ends[1], height), connectionstyle="arc3,rad=-0.28", **style))
            axes.text(x + 1, 0.62 if height > 0 else -0.86, words, ha="center", color=color, fontsize=10)
        joint = f"joint {k + 1}\n$u_{k + 1}, \\dot{{u}}_{k + 1}$ in, $\\tau_{k + 1}$ out"
        axes.text(x + 1, 0, joint, ha="center", va="center", fontsize=8.5, color=INK)
    axes.text(-0.7, 0.95, "base to tip: motion", color=BLUE, weight="bold")
    axes.text(-0.7, -1.08, "tip to base: forces, projected on each joint's axis", color=ORANGE, weight="bold")


def signs(figure: Any) -> None:
    """A pendulum: gravity, what holds it, and the bias force."""
    model, q = kj.load(PENDULUM), jnp.array([0.8])
    at = jax.tree.map(np.asarray, kj.poses(model, q))
    gravity, bias = float(kj.gravity_force(model, q)[0]), float(kj.bias_force(model, q, jnp.zeros(1))[0])
    hold = float(kj.inverse_dynamics(model, q, jnp.zeros(1), jnp.zeros(1))[0])
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set_aspect("equal")
    # Seen along the joint's axis y: x is to the right, and positive angles turn clockwise.
    bob = at.com[0][[0, 2]]
    axes.plot([0, 0], [0, -1.3], color=QUIET, linewidth=1, linestyle=(0, (5, 4)))
    axes.plot([0, bob[0]], [0, bob[1]], color=STEEL, linewidth=9, solid_capstyle="round")
    axes.plot(0, 0, "o", color=INK, markersize=9)
    axes.plot(*bob, "o", color=GREEN, markersize=15)
    style = {"arrowstyle": "-|>,head_width=4,head_length=8", "linewidth": 2.2, "shrinkA": 0, "shrinkB": 0}
    axes.add_patch(FancyArrowPatch(bob, bob - (0, 0.55), color=GREEN, **style))
    axes.text(bob[0] - 0.24, bob[1] - 0.5, "$m\\,\\mathbf{g}$", color=GREEN)
    _arc(axes, 0.42, 0.0, float(q[0]), INK, f"q = {float(q[0]):g} rad", (0.06, -0.36))
    _arc(axes, 0.72, float(q[0]) - 0.14, float(q[0]) - 0.5, BLUE, "", (0, 0))
    _arc(axes, 0.72, float(q[0]) + 0.14, float(q[0]) + 0.5, ORANGE, "", (0, 0))
    words = (
        (INK, "The axis y points away from you:\npositive q, u and tau turn clockwise."),
        (BLUE, f"gravity_force = {gravity:+.2f} N m\nthe torque of the weight; an active force, $K$"),
        (ORANGE, f"bias_force = {bias:+.2f} N m\nat rest minus that: what holds the rod still"),
        (INK, f"inverse_dynamics(q, 0, 0) = {hold:+.2f} N m\nthe tau that does hold it"),
    )
    for row, (color, sentence) in enumerate(words):
        axes.text(0.75, 0.12 - 0.42 * row, sentence, color=color, va="top", fontsize=10.5)
    axes.set(xlim=(-1.2, 3.2), ylim=(-1.55, 0.3))


def _arc(axes: Any, radius: float, start: float, end: float, color: str, words: str, place: tuple[float, float]) -> None:
    """An arrow around the pivot, from one angle of the rod to another."""
    angles = np.linspace(start, end, 40)
    # Where the bob of a rod at that angle is drawn.
    points = radius * np.stack((np.sin(angles), -np.cos(angles)), 1) * (-1, 1)
    axes.plot(*points[:-3].T, color=color, linewidth=2)
    style = {"arrowstyle": "-|>,head_width=4,head_length=8", "linewidth": 2, "shrinkA": 0, "shrinkB": 0}
    axes.add_patch(FancyArrowPatch(points[-5], points[-1], color=color, **style))
    axes.text(*place, words, color=color)


def free_joint(figure: Any) -> None:
    """Coordinates and speeds of a body that floats."""
    model = kj.load('<mujoco><worldbody><body name="b"><freejoint/><geom size=".1"/></body></worldbody></mujoco>')
    half = np.radians(42) / 2
    axis = np.array([0.35, 0.25, 0.9])
    q = np.concatenate(([0.55, 1.25, 0.75], [np.cos(half)], np.sin(half) * axis / np.linalg.norm(axis)))
    at = jax.tree.map(np.asarray, kj.poses(model, jnp.asarray(q, model.dtype)))
    rates = np.asarray(kj.partial_velocities(model, jnp.asarray(q, model.dtype)).linear[0])
    spins = np.asarray(kj.partial_velocities(model, jnp.asarray(q, model.dtype)).angular[0])
    sketch = Sketch(figure.add_axes((0, 0, 1, 1)), 32, 24)
    sketch.frame((0, 0, 0), np.eye(3), 0.45, ("x", "y", "z"), INK)
    sketch.text((0, 0, 0), "world", (-14, -16))
    corners = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]) * (0.2, 0.32, 0.12)
    box = at.origin[0] + corners @ at.rotation[0].T
    for i in range(8):
        for j in range(i):
            if np.sum(corners[i] != corners[j]) == 1:
                sketch.line(box[i], box[j], color=STEEL, width=2.2, order=0)
    sketch.line((0, 0, 0), at.origin[0], color=QUIET, width=1.1, dash=(0, (5, 3)))
    for r in range(3):
        sketch.arrow(at.origin[0], 0.5 * rates[r], BLUE, f"u[{r}]", ((-30, -8), (6, -3), (5, 3))[r])
        direction = spins[3 + r]
        sketch.arrow(at.origin[0], 0.62 * direction, ORANGE, f"u[{3 + r}]", ((7, -6), (2, 3), (-28, 2))[r])
        sketch.turn(at.origin[0] + 0.42 * direction, direction, 0.07, ORANGE)
    sketch.dot(at.origin[0], INK, 7)
    words = (
        (INK, "q[0:3]: position of the origin\nq[3:7]: quaternion (w, x, y, z)"),
        (BLUE, "u[0:3]: velocity of the origin,\nalong the world's axes"),
        (ORANGE, "u[3:6]: angular velocity,\nalong the body's axes"),
    )
    for row, (color, sentence) in enumerate(words):
        sketch.axes.text(0.7, 0.84 - 0.19 * row, sentence, color=color, transform=sketch.axes.transAxes)
    sketch.axes.margins(0.1)
    left, right = sketch.axes.get_xlim()
    sketch.axes.set_xlim(left - 0.1, right + 0.85)


DIAGRAMS: dict[str, tuple[tuple[float, float], Callable[[Any], None]]] = {
    "link_and_joint": ((8.6, 4.3), link_and_joint),
    "tree": ((9.6, 4.4), tree),
    "partial_velocities": ((11.0, 3.1), partial_velocities),
    "recursion": ((9.6, 3.0), recursion),
    "signs": ((8.6, 3.7), signs),
    "free_joint": ((8.0, 4.2), free_joint),
}


def draw(folder: Path) -> None:
    """Write every diagram into a folder, and the picture that the page for beginners makes."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (size, of) in DIAGRAMS.items():
        with plt.rc_context(STYLE):
            figure = plt.figure(figsize=size, facecolor=PAPER)
            of(figure)
            figure.savefig(folder / f"{name}.svg", metadata={"Date": None}, bbox_inches="tight", pad_inches=0.12)
            plt.close(figure)
    begin = (FOLDER.parent / "getting_started.md").read_text()
    with plt.rc_context(STYLE | {"axes.prop_cycle": mpl.cycler(color=[BLUE, ORANGE])}), contextlib.chdir(folder):
        exec(
            "".join(re.findall(r"```python\n(.*?)```", begin, re.DOTALL)).replace(
                '"motion.svg"', '"motion.svg", metadata={"Date": None}'
            ),
            {},
        )


if __name__ == "__main__":
    mpl.use("Agg")
    draw(FOLDER)
