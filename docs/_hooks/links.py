"""After the build: every link of every page leads somewhere, and no page needs another host to be shown."""

import html.parser
import logging
import urllib.parse
from pathlib import Path
from typing import Any

LOG = logging.getLogger("mkdocs.plugins.links")
# What a browser fetches by itself.
FETCHED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href"}


class Page(html.parser.HTMLParser):
    """The anchors of a page, and where it leads."""

    def __init__(self, text: str) -> None:
        """Read the text of a page."""
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[tuple[str, str]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what a tag has of them."""
        found = dict(attrs)
        self.anchors |= {value for name in ("id", "name") if (value := found.get(name))}
        self.links += [(tag, value) for name in ("href", "src") if (value := found.get(name))]


def problems(site: Path) -> list[str]:
    """What is wrong with the links of a built site, one sentence each."""
    pages = {path: Page(path.read_text()) for path in sorted(site.rglob("*.html"))}
    found = []
    for path, page in pages.items():
        for tag, link in page.links:
            parts = urllib.parse.urlsplit(link)
            name = path.relative_to(site)
            if parts.scheme or parts.netloc:
                if tag in FETCHED and parts.scheme != "data":
                    found.append(f"{name} fetches {link} from another host")
                continue
            place = urllib.parse.unquote(parts.path)
            target = (site / place.lstrip("/") if place.startswith("/") else path.parent / place).resolve() if place else path
            target = target / "index.html" if target.is_dir() else target
            if not target.is_file():
                found.append(f"{name} leads to {link}, which does not exist")
            elif parts.fragment and target in pages and urllib.parse.unquote(parts.fragment) not in pages[target].anchors:
                found.append(f"{name} leads to {link}, and that page has no such anchor")
    return sorted(set(found))


def on_post_build(config: Any, **_: Any) -> None:
    """Warn of what is wrong, which ends a strict build."""
    for problem in problems(Path(config.site_dir).resolve()):
        LOG.warning(problem)
