"""Progress of a search: a line on the terminal, and lines in a file."""

from collections.abc import Callable
from types import TracebackType

from rich.console import Console
from rich.text import Text

from kanejax._optimize.motion import OptimalMotion


class SearchLine:
    """A line that is drawn anew as the search goes on; `shown` says whether it is drawn at all."""

    def __init__(self, guesses: int, say: Callable[[str], None], *, shown: bool) -> None:
        """Begin to wait."""
        self._guesses, self._say = guesses, say
        self._line = Console(stderr=True).status(Text("compiling")) if shown else None

    def __enter__(self) -> "SearchLine":
        """Show the line."""
        if self._line is not None:
            self._line.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Take it away."""
        if self._line is not None:
            self._line.stop()

    def __call__(self, guess: int, motion: OptimalMotion) -> None:
        """The search from a guess has come to a motion."""
        errors = motion.errors
        text = (
            f"iteration {int(motion.iterations)}, cost {float(motion.cost):.7g}, violation {float(errors.violation):.1e}, "
            f"slope {float(errors.slope):.1e}"
        )
        text = f"guess {guess + 1} of {self._guesses}: {text}" if self._guesses > 1 else text
        self._say(text)
        if self._line is not None:
            self._line.update(Text(text))
