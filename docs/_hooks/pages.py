"""Pages that are not in docs/: files of the root, parts of the README, and the notebooks."""

import posixpath
import re
from pathlib import Path
from typing import Any

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter

ROOT = Path(__file__).parents[2]
NOTEBOOKS = "notebooks/"
# Pages made of whole files, which are left out while there is no such file.
WHOLE = {"errata.md": "experiments/errata.md", "changelog.md": "CHANGELOG.md", "contributing.md": "CONTRIBUTING.md"}
# Pages whose tables need the room of what stands beside pages.
WIDE = ("validation.md",)
# `<!-- README: Performance -->` becomes what the README has under that heading.
INCLUDED = re.compile(r"<!-- README: (.+?) -->")
# Where links to files of the repository, and to parts of the README, lead here.
PAGES = {file: page for page, file in WHOLE.items()} | {"README.md": "index.md"}
PARTS = {
    "README.md#identification": "identification.md",
    "README.md#optimal-motions": "optimization.md",
    "README.md#many-trajectories-many-devices": "scale.md",
    "README.md#performance": "performance.md",
}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """List the notebooks where the navigation has their folder, and leave out pages whose file is missing."""
    config.nav = _with_what_there_is(config.nav or [])
    return config


def _with_what_there_is(nav: list[Any]) -> list[Any]:
    entries: list[Any] = []
    for entry in nav:
        ((title, pages),) = entry.items() if isinstance(entry, dict) else (("", entry),)
        if pages == NOTEBOOKS:
            notebooks = [{_title(path): f"{NOTEBOOKS}{path.stem}.md"} for path in _notebooks()]
            entries += [{title: notebooks}] if notebooks else []
        elif isinstance(pages, list):
            entries.append({title: _with_what_there_is(pages)})
        elif pages not in WHOLE or (ROOT / WHOLE[pages]).is_file():
            entries.append(entry)
    return entries


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages."""
    for page, file in WHOLE.items():
        if (ROOT / file).is_file():
            files.append(File.generated(config, page, content=(ROOT / file).read_text()))
    for path in _notebooks():
        for name, content in _converted(path).items():
            files.append(File.generated(config, NOTEBOOKS + name, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Put parts of the README in their place, and lead links to files of the repository to their pages."""
    uri = page.file.src_uri
    if uri in WIDE:
        page.meta["hide"] = ["navigation", "toc"]
    written_in = "" if uri in WHOLE else posixpath.dirname(uri if uri.startswith(NOTEBOOKS) else f"docs/{uri}")
    markdown = _with_links(markdown, written_in, uri)
    return INCLUDED.sub(lambda match: _with_links(_section(match[1]), "", uri, "README.md"), markdown)


def _notebooks() -> list[Path]:
    return sorted((ROOT / "notebooks").glob("*.ipynb"))


def _title(path: Path) -> str:
    """The notebook's first heading."""
    for cell in nbformat.read(path, as_version=4).cells:
        found = re.search(r"^# (.+)", cell.source, re.MULTILINE) if cell.cell_type == "markdown" else None
        if found:
            return found[1]
    raise PluginError(f"{path} has no heading; its first cell of Markdown must begin with '# '")


def _converted(path: Path) -> dict[str, str | bytes]:
    """The page of an executed notebook, and its pictures."""
    text, resources = MarkdownExporter().from_filename(str(path), resources={"output_files_dir": f"{path.stem}_files"})
    return {f"{path.stem}.md": text} | resources.get("outputs", {})


def _section(heading: str) -> str:
    """What the README has between a heading of level two and the next."""
    found = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", (ROOT / "README.md").read_text(), re.DOTALL | re.MULTILINE)
    if not found:
        raise PluginError(f"the README has no heading {heading!r}")
    return found[1].strip()


def _with_links(markdown: str, folder: str, uri: str, file: str = "") -> str:
    """Lead links that are written in a folder of the repository to pages, as seen from the page `uri`.

    Files that are no pages lose the link. Links to `#part` are those of `file`, if it is given.
    """

    def link(match: re.Match[str]) -> str:
        text, target, anchor = match[1], match[2] or "", match[3] or ""
        if not target and not file:
            return match[0]
        meant = posixpath.normpath(posixpath.join(folder, target)) if target else file
        if meant + anchor in PARTS:
            meant, anchor = PARTS[meant + anchor], ""
        elif meant in PAGES:
            meant = PAGES[meant]
        elif meant.startswith("docs/"):
            meant = meant.removeprefix("docs/")
        elif meant.startswith(NOTEBOOKS):
            meant = meant.replace(".ipynb", ".md")
        elif (ROOT / meant).exists():
            return text
        else:
            return match[0]
        return f"[{text}]({posixpath.relpath(meant, posixpath.dirname(uri) or '.')}{anchor})"

    return re.sub(r"\[([^\]]*)\]\(([\w./-]+)?(#[\w-]+)?\)", link, markdown)
