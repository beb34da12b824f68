"""Figures of matplotlib as SVG elements for a page of HTML, from which they take their colours and type."""

import base64
import contextlib
import html
import io
import re
from collections.abc import Iterator
from typing import Any

from kanejax._plots.style import PAPER, needed_package, settings

# What matplotlib is told to draw with, and the variable of the page that it stands for. Parts of one quantity differ by
# their dashes alone.
_VARIABLES = ("ink", "faint", "grid", "measured", "predicted", "nominal")
COLORS = {name: f"#0102{i + 16:02x}" for i, name in enumerate(_VARIABLES)}
COLORS |= dict.fromkeys(set(PAPER) - set(COLORS), COLORS["predicted"])
_SETTINGS = {
    **settings(COLORS, "none"),
    "svg.fonttype": "none",
    "svg.hashsalt": "kanejax",
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
}


@contextlib.contextmanager
def drawing() -> Iterator[None]:
    """Within, figures are made with the page's style; figures go through `matplotlib.figure`, so that no window opens.

    Raises:
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    matplotlib = report_package("matplotlib")
    with matplotlib.rc_context(_SETTINGS):
        yield


def report_package(name: str) -> Any:
    """Import a package that only reports need.

    Raises:
        ImportError: it is not installed; the message says how to install it.
    """
    return needed_package(name, "a report", "report")


def svg(figure: Any, label: str, key: str) -> str:
    """The element <svg> of a figure; `label` says in words what it shows, `key` keeps its names apart from those of others."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*|<!--.*?-->\s*", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns(?::xlink)?="[^"]*"', "", text).replace("xlink:href", "href")
    text = _with_short_numbers(_with_own_names(text, key))
    text = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font: \1 var(--sans)", text)
    for name in _VARIABLES:
        text = text.replace(COLORS[name], f"var(--{name})")
    size = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text)
    assert size is not None, "matplotlib writes a viewBox"
    opening = f'<svg viewBox="{size[0][9:-1]}" role="img" aria-label="{html.escape(label)}"'
    text = re.sub(r"^<svg[^>]*", lambda _: opening, text)
    return re.sub(r"\n\s*", "\n", text).strip()


def png_address(image: bytes) -> str:
    """A PNG file as an address that holds all of it."""
    return "data:image/png;base64," + base64.b64encode(image).decode()


def _with_own_names(text: str, key: str) -> str:
    """Names that nothing refers to are dropped, the others begin with the key: a page must not have one twice."""
    used = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', text))
    text = re.sub(r' id="([^"]+)"', lambda m: f' id="{key}-{m[1]}"' if m[1] in used else "", text)
    return re.sub(r'(url\(#|href="#)', rf"\g<1>{key}-", text)


def _with_short_numbers(text: str) -> str:
    """Paths to a tenth of a point, where matplotlib writes six digits."""

    def path(match: re.Match) -> str:
        short = re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.1f}".removesuffix(".0"), match[1])
        return f' d="{" ".join(short.split())}"'

    return re.sub(r' d="([^"]*)"', path, text)
