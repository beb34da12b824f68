"""Links of the README and of docs/ lead to files and headings that exist, and the check of the built pages sees what it should."""

import importlib.util
import pathlib
import re

import pytest

import kanejax

ROOT = pathlib.Path(kanejax.__file__).parents[1]
FILES = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "experiments/errata.md")]
PAGES = [path for path in (*FILES, *sorted((ROOT / "docs").rglob("*.md"))) if path.is_file()]


def without_code(path):
    return re.sub(
        r"```.*?```|`[^`\n]*`",
        lambda match: "" if match[0].startswith("```") else match[0][1:-1],
        path.read_text(),
        flags=re.DOTALL,
    )


def anchors(path):
    """Of the headings, as GitHub and MkDocs both make them."""
    headings = re.findall(r"^#+ (.+)", without_code(path), re.MULTILINE)
    return {re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", heading.lower()).strip()) for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_of_the_sources_lead_somewhere(page):
    # `[x](y)` inside code is none, and neither is what the page of the API makes of `[x][kanejax.y]`.
    text = re.sub(r"```.*?```|`[^`\n]*`", "code", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"\w+:", target):
            continue
        file, _, anchor = target.partition("#")
        found = (page.parent / file).resolve() if file else page
        assert found.exists(), target
        assert not anchor or anchor in anchors(found), target


def test_a_reference_to_the_api_is_to_what_there_is():
    found = [(page, name) for page in PAGES for name in re.findall(r"\]\[kanejax\.([\w.]+)\]", page.read_text())]
    assert len(found) > 10
    for page, name in found:
        thing = kanejax
        for part in name.split("."):
            assert hasattr(thing, part), (page, name)
            thing = getattr(thing, part)


@pytest.fixture(scope="module")
def links():
    spec = importlib.util.spec_from_file_location("links", ROOT / "docs" / "_hooks" / "links.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_check_of_built_pages(links, tmp_path):
    (tmp_path / "api").mkdir()
    (tmp_path / "style.css").write_text("")
    (tmp_path / "index.html").write_text(
        '<link href="style.css"><h1 id="top"></h1><a href="api/a.html#b">x</a><a href="#top">y</a>'
    )
    (tmp_path / "api" / "a.html").write_text('<p id="b"></p><a href="../index.html">z</a><a href="https://example.org">far</a>')
    assert links.problems(tmp_path) == []
    bad = (
        '<a href="b.html">1</a><a href="../index.html#no">2</a><a href="#no">3</a><script src="https://example.org/a.js"></script>'
    )
    (tmp_path / "api" / "a.html").write_text(bad)
    found = links.problems(tmp_path)
    assert len(found) == 5
    assert sum("does not exist" in sentence for sentence in found) == 1
    assert sum("no such anchor" in sentence for sentence in found) == 3
    assert sum("another host" in sentence for sentence in found) == 1


def test_diagrams_are_those_of_the_script():
    from experiments import diagrams

    pages = (ROOT / "docs" / "concepts.md").read_text()
    assert set(re.findall(r"\(diagrams/(\w+)\.svg\)", pages)) == set(diagrams.DIAGRAMS)
    assert {path.stem for path in (ROOT / "docs" / "diagrams").glob("*.svg")} == {*diagrams.DIAGRAMS, "motion"}
    assert all(path.stat().st_size < 100_000 for path in (ROOT / "docs" / "diagrams").iterdir())
