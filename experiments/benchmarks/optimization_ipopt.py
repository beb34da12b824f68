"""CasADi and IPOPT on a task: multiple shooting with exact second derivatives, in two ways of which the faster counts.

"SX": the whole problem as one expression, in CasADi's virtual machine, differentiated by CasADi. "C": derivatives of one stage as
expressions, mapped over the stages and compiled by gcc, so that sparse blocks need no colouring. Runs with the peers' interpreter.
"""

import statistics
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from experiments.benchmarks.optimization_dynamics import check, mechanism
from experiments.benchmarks.optimization_transcription import bounds_and_guess, last_cost, one_stage

OPTIONS = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.linear_solver": "mumps",
    "ipopt.tol": 1e-8,
    "ipopt.max_iter": 1000,
}
FLAGS = ["-O3", "-march=native"]


def solved(task: dict[str, Any], repeats: int) -> list[dict[str, Any]]:
    """A task in both ways."""
    check(mechanism(task))
    found = []
    for way, build in WAYS.items():
        start = time.perf_counter()
        solver = build(task, ())
        built = time.perf_counter() - start
        found.append({"way": way, "build": built, **_timed(solver, task, (), repeats)})
    return found


def solved_in_turn(tasks: list[dict[str, Any]]) -> dict[str, Any]:
    """Tasks that differ in numbers, one after another by one solver, in C."""
    varied = tuple(name for name in ("mass", "com") if any(task[name] != tasks[0][name] for task in tasks))
    solver = WAYS["C"](tasks[0], varied)
    each = [_timed(solver, task, varied, 1) for task in tasks]
    names = ("seconds", "cost", "converged", "iterations")
    return {name: [one[name] for one in each] for name in names}


def _timed(solver: ca.Function, task: dict[str, Any], varied: tuple[str, ...], repeats: int) -> dict[str, Any]:
    bounds, seconds = bounds_and_guess(task, varied)._asdict(), []
    for _ in range(repeats):
        start = time.perf_counter()
        found = solver(**bounds)
        seconds.append(time.perf_counter() - start)
    told = solver.stats()
    g = np.array(found["g"])[:, 0]
    violation = float(max(np.max(bounds["lbg"] - g), np.max(g - bounds["ubg"]), 0.0))
    return {
        "seconds": statistics.median(seconds),
        "iterations": int(told["iter_count"]),
        "converged": told["return_status"] in ("Solve_Succeeded", "Solved_To_Acceptable_Level"),
        "status": told["return_status"],
        "cost": float(found["f"]),
        "violation": violation,
        "in_functions": sum(value for name, value in told.items() if name.startswith("t_wall_nlp_")),
    }


def _as_one_expression(task: dict[str, Any], varied: tuple[str, ...]) -> ca.Function:
    stage, steps = one_stage(task, varied), task["steps"]
    step = ca.Function("step", [stage.x, stage.w, stage.p], [stage.after, stage.cost, stage.rows])
    xs = [ca.SX.sym(f"x{k}", *stage.x.shape) for k in range(steps + 1)]
    ws = [ca.SX.sym(f"w{k}", *stage.w.shape) for k in range(steps)]
    cost, rows = ca.SX(last_cost(task, xs[-1])), []
    for k in range(steps):
        after, share, limited = step(xs[k], ws[k], stage.p)
        cost, rows = cost + share, [*rows, after - xs[k + 1], limited]
    unknown = ca.vertcat(*(each for pair in zip(xs[:-1], ws, strict=True) for each in pair), xs[-1])
    return ca.nlpsol("solver", "ipopt", {"x": unknown, "p": stage.p, "f": cost, "g": ca.vertcat(*rows)}, OPTIONS)


def _in_c(task: dict[str, Any], varied: tuple[str, ...]) -> ca.Function:
    """The problem and its derivatives, compiled."""
    with tempfile.TemporaryDirectory() as folder:
        generator = ca.CodeGenerator("nlp.c")
        for function in _derivatives(task, varied):
            generator.add(function)
        source, library = Path(generator.generate(f"{folder}/")), Path(folder) / "nlp.so"
        subprocess.run(["gcc", *FLAGS, "-w", "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
        return ca.nlpsol("solver", "ipopt", str(library), {**OPTIONS, "no_nlp_grad": True, "calc_lam_p": False})


def _derivatives(task: dict[str, Any], varied: tuple[str, ...]) -> list[ca.Function]:
    """The functions that IPOPT asks for. Their blocks are those of one stage, mapped over the stages."""
    stage, steps = one_stage(task, varied), task["steps"]
    nx, own, count = stage.x.numel(), stage.x.numel() + stage.w.numel(), stage.x.numel() + stage.rows.numel()
    v, multiplier, of_cost = ca.vertcat(stage.x, stage.w), ca.SX.sym("multiplier", count), ca.SX.sym("of_cost")
    g = ca.vertcat(stage.after, stage.rows)
    jacobian, slope = ca.jacobian(g, v), ca.densify(ca.gradient(stage.cost, v))
    hessian = ca.triu(ca.hessian(of_cost * stage.cost + ca.dot(multiplier, g), v)[0])
    z, p = ca.MX.sym("z", steps * own + nx), ca.MX.sym("p", stage.p.numel())
    of_f, of_g = ca.MX.sym("of_f"), ca.MX.sym("of_g", steps * count)
    vs, last, ps = ca.reshape(z[: steps * own], own, steps), z[steps * own :], ca.repmat(p, 1, steps)

    def mapped(inputs: list[ca.SX], outputs: list[ca.SX], *arguments: ca.MX) -> Any:
        return ca.Function("stages", inputs, outputs, {"cse": True}).map(steps)(*arguments)

    cost, rows = mapped([v, stage.p], [stage.cost, g], vs, ps)
    after = ca.vertcat(ca.horzcat(vs[:nx, 1:], last), ca.MX.zeros(count - nx, steps))
    f, constraints = ca.sum2(cost) + last_cost(task, last), ca.vec(rows - after)
    # The last cost is zero or the last number.
    of_last = ca.DM([0.0] * (nx - 1) + [float(task["cost"] == "duration")])
    gradient = ca.vertcat(ca.vec(mapped([v, stage.p], [slope], vs, ps)), of_last)
    blocks = ca.vec(mapped([v, stage.p], [ca.vertcat(*jacobian.nz)], vs, ps))
    following = [(k * count + i, (k + 1) * own + i) for k in range(steps) for i in range(nx)]
    minus = ca.DM.triplet(*map(list, zip(*following, strict=True)), ca.DM([-1.0] * len(following)), steps * count, z.numel())
    first = ca.MX(ca.diagcat(*[jacobian.sparsity()] * steps, ca.Sparsity(0, nx)), blocks) + minus
    arguments = vs, ps, ca.repmat(of_f, 1, steps), ca.reshape(of_g, count, steps)
    curved = mapped([v, stage.p, of_cost, multiplier], [ca.vertcat(*hessian.nz)], *arguments)
    second = ca.MX(ca.diagcat(*[hessian.sparsity()] * steps, ca.Sparsity(nx, nx)), ca.vec(curved))
    names = ["x", "p"]
    return [
        ca.Function("nlp", [z, p], [f, constraints], names, ["f", "g"]),
        ca.Function("nlp_f", [z, p], [f], names, ["f"]),
        ca.Function("nlp_g", [z, p], [constraints], names, ["g"]),
        ca.Function("nlp_grad_f", [z, p], [f, gradient], names, ["f", "grad_f_x"]),
        ca.Function("nlp_jac_g", [z, p], [constraints, first], names, ["g", "jac_g_x"]),
        ca.Function("nlp_hess_l", [z, p, of_f, of_g], [second], [*names, "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]),
    ]


WAYS = {"SX": _as_one_expression, "C": _in_c}
