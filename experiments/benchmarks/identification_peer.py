"""mujoco.sysid on one problem: `python identification_peer.py problem.npz`, by an interpreter that has it; prints JSON.

It needs mujoco[sysid] and numpy 2.3 (2.5 breaks InertiaType.Mass), so maybe an environment of its own; imports nothing of kanejax.
"""

import json
import logging
import sys
import time

import mujoco
import numpy as np
from mujoco import sysid


def main(path: str) -> None:
    """Read the problem, solve it, and print what came out."""
    logging.disable(logging.CRITICAL)
    problem = np.load(path, allow_pickle=False)
    spec = mujoco.MjSpec.from_string(str(problem["xml"]))
    parameters = _parameters(spec, [str(name) for name in problem["bodies"]], problem["scales"], str(problem["kind"]))
    start = time.perf_counter()
    for window in problem["windows"]:
        residual = sysid.build_residual_fn(
            models_sequences=[_sequences(spec, problem, int(window))],
            resample_true=False,
            sensor_weights={str(name): float(w) for name, w in zip(problem["sensors"], problem["weights"], strict=True)},
        )
        try:
            parameters, _ = sysid.optimize(parameters, residual, optimizer="mujoco", verbose=False)
        except ValueError as error:
            # A candidate with which the simulation is unstable ends the fit.
            print(json.dumps({"seconds": time.perf_counter() - start, "failure": str(error)}))
            return
    seconds = time.perf_counter() - start
    for parameter in parameters.values():
        parameter.apply_modifier(spec)
    model = spec.compile()
    moving = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, str(name)) for name in problem["bodies"]]
    names = ("body_mass", "body_ipos", "body_inertia", "body_iquat")
    print(json.dumps({"seconds": seconds, **{name: getattr(model, name)[moving].tolist() for name in names}}))


def _parameters(spec: mujoco.MjSpec, bodies: list[str], scales: np.ndarray, kind: str) -> sysid.ParameterDict:
    """All masses, or all inertia parameters, of a spec that has the true ones, started `scales` off."""
    parameters = sysid.ParameterDict()
    for name, scale in zip(bodies, scales, strict=True):
        body = spec.body(name)
        body.mass, body.inertia = body.mass * scale, body.inertia * (scale if kind == "inertia" else 1.0)
    model = spec.compile()
    for name in bodies:
        if kind == "mass":
            parameters.add(sysid.body_inertia_param(spec, model, name, sysid.InertiaType.Mass))
        else:
            parameters.add(sysid.body_inertia_param(spec, model, name, sysid.InertiaType.Pseudo, modifier=_with_axes(name)))
    return parameters


def _with_axes(name: str) -> object:
    """The peer's own way to write a body's inertia, but with axes that its compiler accepts."""

    def modifier(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        sysid.apply_body_inertia(spec, name, parameter)
        spec.body(name).iquat = [1, 0, 0, 0]

    return modifier


def _sequences(spec: mujoco.MjSpec, problem: np.lib.npyio.NpzFile, window: int) -> sysid.ModelSequences:
    """A run, or windows of so many steps, from their true initial states."""
    model = spec.compile()
    ctrl, sensed, ts = problem["ctrl"], problem["sensed"], problem["ts"]
    steps = len(sensed) if window == 0 else window
    firsts = range(0, len(sensed) - steps + 1, steps)
    states, controls, sensors = [], [], []
    for first in firsts:
        states.append(sysid.create_initial_state(model, *problem["states"][first]))
        controls.append(sysid.TimeSeries(ts[: steps + 1], ctrl[first : first + steps + 1]))
        # The first row stands for the initial condition, which it leaves out.
        rows = np.concatenate((sensed[first : first + 1], sensed[first : first + steps]))
        sensors.append(sysid.TimeSeries.from_names(ts[: steps + 1], rows, model))
    names = [f"run{first}" for first in firsts]
    return sysid.ModelSequences("model", spec, names, states, controls, sensors)


if __name__ == "__main__":
    main(sys.argv[1])
