"""Random mechanisms as MJCF, and random states of them."""

import mujoco
import numpy as np

KINDS = ("hinge", "slide", "ball", "free", "weld", "two")


def _numbers(rng: np.random.Generator, scale: float = 1.0, size: int = 3) -> str:
    return " ".join(repr(float(x)) for x in rng.normal(size=size) * scale)


def _joint(rng: np.random.Generator, kind: str) -> str:
    extras = f'armature="{rng.uniform(0.05, 0.2)}" damping="{rng.uniform(0, 0.5)}" stiffness="{rng.uniform(0, 3)}"'
    if kind == "ball":
        return f'<joint type="ball" pos="{_numbers(rng, 0.2)}" {extras}/>'
    reference = f'ref="{rng.normal() * 0.3}" springref="{rng.normal() * 0.3}"'
    return f'<joint type="{kind}" axis="{_numbers(rng)}" pos="{_numbers(rng, 0.2)}" {extras} {reference}/>'


def _inertial(rng: np.random.Generator) -> str:
    second = rng.uniform(0.02, 0.1, 3)
    moments = second.sum() - second
    where = f'pos="{_numbers(rng, 0.1)}" quat="{_numbers(rng, size=4)}" mass="{rng.uniform(0.5, 2.0)}"'
    return f'<inertial {where} diaginertia="{moments[0]} {moments[1]} {moments[2]}"/>'


def random_tree(seed: int, bodies: int, kinds: tuple[str, ...] = KINDS, chain: bool = False) -> str:
    """MJCF of a random tree (or chain) with joint anchors, armature, damping and springs; the first body is jointed."""
    rng = np.random.default_rng(seed)
    children: dict[int, list[int]] = {body: [] for body in range(-1, bodies)}
    for body in range(bodies):
        children[body - 1 if chain else int(rng.integers(-1, body)) if body else -1].append(body)

    def element(body: int, on_world: bool) -> str:
        kind = str(rng.choice([k for k in kinds if (k != "free" or on_world) and (k != "weld" or body > 0)]))
        if kind == "two":
            joints = "".join(_joint(rng, str(k)) for k in rng.choice(["hinge", "slide"], 2))
        elif kind == "weld":
            joints = ""
        else:
            joints = "<freejoint/>" if kind == "free" else _joint(rng, kind)
        inner = "".join(element(child, False) for child in children[body])
        where = f'pos="{_numbers(rng, 0.3)}" quat="{_numbers(rng, size=4)}"'
        return f'<body name="b{body}" {where}>{joints}{_inertial(rng)}{inner}</body>'

    options = '<option><flag contact="disable" energy="enable"/></option>'
    return f"<mujoco>{options}<worldbody>{''.join(element(b, True) for b in children[-1])}</worldbody></mujoco>"


def random_states(mj: mujoco.MjModel, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates with unit quaternions, and two sets of speeds, rates or forces."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(count, mj.nq))
    for row in q:
        mujoco.mj_normalizeQuat(mj, row)
    return q, rng.normal(size=(count, mj.nv)), rng.normal(size=(count, mj.nv))


def relative(value, expected) -> float:
    """Largest difference over the largest magnitude expected."""
    expected = np.asarray(expected, np.float64)
    return float(np.abs(np.asarray(value, np.float64) - expected).max() / (np.abs(expected).max() or 1.0))
