"""The search for an optimal motion from one or many guesses, which can be cut off and go on."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kanejax._checkpoint import Checkpoint, opened
from kanejax._fingerprint import fingerprint_of
from kanejax._motion_task.task_file import TaskFile
from kanejax._optimize.bent_guess import bent_guess
from kanejax._optimize.feasibility import NonFiniteTaskError
from kanejax._optimize.motion import OptimalMotion
from kanejax._optimize.optimize import OptimizationError, optimize, straight_guess


class Outcome(NamedTuple):
    """Where the search from a guess ended, and why, if it found no optimum.

    Attributes:
        guess: its number, from 0 on.
        motion: the motion.
        problem: a sentence, empty where the motion is optimal.
    """

    guess: int
    motion: OptimalMotion
    problem: str

    @property
    def cost(self) -> float:
        """Infinite where there is no optimum."""
        return float(self.motion.cost) if not self.problem else math.inf


class Found(NamedTuple):
    """The best motion, and the costs from all guesses, infinite where there is none."""

    best: Outcome
    costs: list[float]


def searched(
    file: TaskFile, progress: Callable[[int, OptimalMotion], None], *, checkpoint: Path, checkpoint_interval: float
) -> Found:
    """Search from every guess.

    Args:
        file: what is sought.
        progress: called with the number of the guess and the motion so far, every ten iterations.
        checkpoint: path of the file to go on from, and to keep the searches in.
        checkpoint_interval: time between two writings of it [s].

    Raises:
        CheckpointError: the checkpoint belongs to another task, is none, or cannot be written.
        InfeasibleTaskError: boundary values are beyond limits, or too far from each other.
        NonFiniteTaskError: something is infinite or not a number at the first guess.
        OptimizationInterrupted: on Ctrl-C.
    """
    with opened(checkpoint, checkpoint_interval, fingerprint(file)) as kept:
        outcomes = [_from_guess(file, number, progress, kept.part(f"guess {number}")) for number in range(file.guesses)]
    costs = [math.inf if outcome is None else outcome.cost for outcome in outcomes]
    best = outcomes[int(np.argmin(costs))]
    assert best is not None, "the first guess has a motion, and the best one has"
    return Found(best, costs)


def fingerprint(file: TaskFile) -> str:
    """A hash of all that the motion depends on, but for how many iterations it may take."""
    options = {name: value for name, value in file.options.items() if name != "max_iterations"}
    return fingerprint_of(file.task, file.guess, file.guesses, file.bend, file.seed, options)


def _from_guess(
    file: TaskFile, number: int, progress: Callable[[int, OptimalMotion], None], checkpoint: Checkpoint
) -> Outcome | None:
    """Where the search from a guess ends, or None where a cost is not defined at the guess."""
    line = file.guess or straight_guess(file.task)
    guess = line if number == 0 else bent_guess(file.task, _heights(file, number), line)
    try:
        motion = optimize(file.task, guess, progress=lambda motion: progress(number, motion), checkpoint=checkpoint, **file.options)
    except OptimizationError as error:
        return Outcome(number, error.motion, str(error))
    except NonFiniteTaskError:
        if number == 0:
            raise
        return None
    return Outcome(number, motion, "")


def _heights(file: TaskFile, number: int) -> np.ndarray:
    """Of the waves of a guess; the same for the same seed."""
    return file.bend * np.random.default_rng((file.seed, number)).normal(size=(2, 3, file.task.model.nv))
