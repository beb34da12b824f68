"""A figure that keeps its style wherever it is drawn later, and that a notebook shows by itself."""

import io
from typing import Any, final

import matplotlib.figure

from kanejax._plots.style import on_paper

# Pixels an inch of the picture in a notebook, and of its place there: fine lines on fine screens.
_PIXELS, _PLACE = 200, 100


@final
class PaperFigure(matplotlib.figure.Figure):
    """A figure on paper. Ticks are made when it is drawn, in the settings of that moment: so these are set each time."""

    def draw(self, renderer: Any) -> None:
        """Draw it."""
        with on_paper():
            super().draw(renderer)

    def savefig(self, fname: Any, **options: Any) -> None:
        """Write it to a file, see `matplotlib.figure.Figure.savefig`."""
        with on_paper():
            super().savefig(fname, **options)

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        """What a notebook shows where pyplot was never imported: matplotlib tells it of figures only then."""
        stream = io.BytesIO()
        self.savefig(stream, format="png", dpi=_PIXELS)
        width, height = (round(_PLACE * float(inches)) for inches in self.get_size_inches())
        return stream.getvalue(), {"width": width, "height": height}
