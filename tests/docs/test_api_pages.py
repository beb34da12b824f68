"""Every public name is on one page of the API, once."""

import collections
import importlib
import inspect
import pathlib
import pkgutil
import re

import kanejax

DOCS = pathlib.Path(kanejax.__file__).parents[1] / "docs"


def public_names():
    """Names of the package, and of its public modules but the command line, that are neither modules nor constants."""
    names = [name for name in dir(kanejax) if not name.startswith("_") and not inspect.ismodule(vars(kanejax).get(name))]
    found = {f"kanejax.{name}" for name in names}
    for module in pkgutil.iter_modules(kanejax.__path__):
        if module.name.startswith("_") or module.name == "cli":
            continue
        loaded = importlib.import_module(f"kanejax.{module.name}")
        names = {name for name, value in vars(loaded).items() if is_own(loaded, name, value)}
        found |= {f"kanejax.{module.name}.{name}" for name in names}
        found.discard(f"kanejax.{module.name}")
    return found


def is_own(module, name, value):
    """Functions and classes of a module, not what it imports for its own use or shares with the package."""
    if name.startswith("_") or not (inspect.isfunction(value) or inspect.isclass(value)):
        return False
    if module.__name__ in ("kanejax.plots", "kanejax.robots"):  # They gather what is defined elsewhere.
        return value.__module__.startswith("kanejax.")
    return value.__module__ == module.__name__


def documented():
    pages = sorted((DOCS / "api").glob("*.md"))
    return collections.Counter(name for page in pages for name in re.findall(r"^::: (\S+)", page.read_text(), re.MULTILINE))


def test_every_public_name_is_on_one_page():
    names = documented()
    public = {name for name in names if not any(part.startswith("_") for part in name.split("."))}
    assert public_names() - public == set(), "add them to a page of docs/api"
    assert public - public_names() == set(), "they are not public any more"
    assert [name for name, count in names.items() if count > 1] == []
