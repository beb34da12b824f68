"""What a file asks MuJoCo's compiler to change of the inertias that it states: sentences, so that it does not go unsaid."""

import mujoco
import numpy as np


def stated_numbers(bodies: list[tuple[mujoco.MjsBody, bool]]) -> list[dict[str, np.ndarray]]:
    """Copy what a spec states of each body, before anything is written into it."""
    return [{"boundmass": np.array(body.mass), "boundinertia": np.array(body.inertia)} for body, _ in bodies]


def bounded_bodies(
    mj_model: mujoco.MjModel, bodies: list[tuple[mujoco.MjsBody, bool]], stated: list[dict[str, np.ndarray]]
) -> list[str]:
    """Say which moving bodies boundmass or boundinertia raised to the least that they allow.

    `bodies` are those of the spec in the order of their ids, each with whether it moves; `stated` is from `stated_numbers`.
    """
    sentences = []
    for setting, values in (("boundmass", mj_model.body_mass), ("boundinertia", mj_model.body_inertia)):
        bounds = [float(getattr(body.compiler, setting)) if moves else 0.0 for body, moves in bodies]
        # MuJoCo raises what is below a bound to the bound itself.
        raised = [
            index
            for index, bound in enumerate(bounds)
            if bound > 0 and np.any(values[index] == bound) and not np.any(stated[index][setting] == bound)
        ]
        if raised:
            listed = ", ".join(repr(mj_model.body(index).name or f"number {index}") for index in raised)
            sentences.append(f"body {listed}: raised to the compiler's {setting} = {bounds[raised[0]]:g}, as the file asks")
    return sentences


def balanced_body(label: str) -> str:
    """Say that the principal moments of a body became their mean."""
    return f"{label}: principal moments replaced by their mean, as the file asks with balanceinertia"
