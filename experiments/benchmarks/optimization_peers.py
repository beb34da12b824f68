"""CasADi with IPOPT, and Crocoddyl: `python -m experiments.benchmarks.optimization_peers FILE`, by an interpreter that has them.

The file has tasks as `optimization_problems.exported` writes them: {"task": one, "repeats": 5}, or {"tasks": [...]} that differ in
numbers, which are solved one after another. It prints JSON. It needs casadi, crocoddyl and pin, and gcc; neither jax nor kanejax.
"""

import json
import sys
from pathlib import Path
from typing import Any

import casadi
import crocoddyl
import numpy
import pinocchio

from experiments.benchmarks import optimization_crocoddyl, optimization_ipopt


def main(path: str) -> None:
    """Read what is asked for, solve it, and print what came out."""
    asked = json.loads(Path(path).read_text())
    found = _one(asked["task"], asked["repeats"]) if "task" in asked else _in_turn(asked["tasks"])
    versions = {each.__name__: each.__version__ for each in (casadi, crocoddyl, pinocchio, numpy)}
    print(json.dumps(found | {"versions": versions}))


def _one(task: dict[str, Any], repeats: int) -> dict[str, Any]:
    fddp = None
    if optimization_crocoddyl.is_possible(task):
        fddp = [optimization_crocoddyl.solved(task, repeats, threads) for threads in (1, 2)]
    return {"ipopt": optimization_ipopt.solved(task, repeats), "crocoddyl": fddp}


def _in_turn(tasks: list[dict[str, Any]]) -> dict[str, Any]:
    fddp = None
    if all(map(optimization_crocoddyl.is_possible, tasks)):
        fddp = [optimization_crocoddyl.solved(task, 1) for task in tasks]
    return {"ipopt": optimization_ipopt.solved_in_turn(tasks), "crocoddyl": fddp}


if __name__ == "__main__":
    main(sys.argv[1])
