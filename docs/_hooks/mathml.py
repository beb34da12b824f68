"""Equations as MathML, which browsers draw by themselves: pages need no script and no network."""

import html
import re
from typing import Any

from latex2mathml.converter import convert

MARKED = re.compile(r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL)


def on_page_content(content: str, **_: Any) -> str:
    """Turn what arithmatex marked into MathML."""

    def mathml(match: re.Match[str]) -> str:
        inline, block = match[2], match[3]
        made = convert(html.unescape(inline or block).strip(), display="inline" if inline else "block")
        return made if inline else f'<div class="equation">{made}</div>'

    return MARKED.sub(mathml, content)
