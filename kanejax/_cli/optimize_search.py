"""The search for an optimal motion from one or many guesses, which can be cut off and go on."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from kanejax._cli.optimize_kept import KeptSearch
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


def searched(file: TaskFile, kept: KeptSearch, progress: Callable[[int, OptimalMotion], None]) -> Found:
    """Search from every guess, beginning where the kept search ended.

    Args:
        file: what is sought.
        kept: where an earlier search ended, and what takes down where this one is.
        progress: called with the number of the guess and the motion so far, every ten iterations.

    Raises:
        InfeasibleTaskError: boundary values are beyond limits, or too far from each other.
        NonFiniteTaskError: something is infinite or not a number at the first guess.
        OptimizationInterrupted: on Ctrl-C.
    """

    def from_guess(number: int, *, resume: bool) -> Outcome | None:
        def shown(motion: OptimalMotion) -> None:
            kept.shown(motion)
            progress(number, motion)

        line = file.guess or straight_guess(file.task)
        guess = line if number == 0 else bent_guess(file.task, _heights(file, number), line)
        search = kept.search if resume else None
        try:
            motion = optimize(file.task, guess, progress=shown, keep=kept.at, search=search, **file.options)
        except OptimizationError as error:
            return Outcome(number, error.motion, str(error))
        except NonFiniteTaskError:
            # A bent guess may lie where a cost is not defined.
            if number == 0:
                raise
            return None
        return Outcome(number, motion, "")

    best: Outcome | None = None
    for number in range(len(kept.costs), file.guesses):
        outcome = from_guess(number, resume=True)
        if file.guesses > 1:
            kept.done(math.inf if outcome is None else outcome.cost)
        if outcome is not None and (best is None or outcome.cost < best.cost):
            best = outcome
    wanted = int(np.argmin(kept.costs)) if kept.costs else 0
    if best is None or best.guess != wanted:
        # It was found before an interruption, which kept its cost alone.
        best = from_guess(wanted, resume=False)
    assert best is not None, "the first guess has a motion, and the best one has"
    return Found(best, kept.costs or [best.cost])


def _heights(file: "TaskFile", number: int) -> np.ndarray:
    """Of the waves of a guess; the same for the same seed."""
    return file.bend * np.random.default_rng((file.seed, number)).normal(size=(2, 3, file.task.model.nv))
