"""What is public says what its arguments and fields are: the pages of the API have nothing else to show."""

import dataclasses
import importlib
import inspect
import re

import pytest
from test_api_pages import public_names


def section(definition, title):
    """Names that a section of a docstring explains."""
    text = inspect.cleandoc(definition.__doc__ or "")
    found = re.search(rf"^{title}:\n((?: {{4}}.*\n?|\n)+)", text, re.MULTILINE)
    return set(re.findall(r"^ {4}\*{0,2}(\w+):", found[1], re.MULTILINE)) if found else set()


def resolved(name):
    module, _, own = name.rpartition(".")
    return getattr(importlib.import_module(module), own)


def arguments(function):
    return {name for name in inspect.signature(function).parameters if name not in ("self", "cls")}


def fields(record):
    names = record._fields if hasattr(record, "_fields") else [each.name for each in dataclasses.fields(record)]
    return {name for name in names if not name.startswith("_")}


FUNCTIONS = [name for name in sorted(public_names()) if inspect.isfunction(resolved(name))]
CLASSES = [name for name in sorted(public_names()) if inspect.isclass(resolved(name))]
RECORDS = [name for name in CLASSES if dataclasses.is_dataclass(resolved(name)) or hasattr(resolved(name), "_fields")]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_explain_their_arguments(name):
    assert section(resolved(name), "Args") == arguments(resolved(name))


@pytest.mark.parametrize("name", RECORDS)
def test_records_explain_their_fields(name):
    assert section(resolved(name), "Attributes") >= fields(resolved(name))


@pytest.mark.parametrize("name", CLASSES)
def test_methods_explain_several_arguments(name):
    own, *parents = resolved(name).__mro__
    for key, value in vars(own).items():
        if any(key in vars(parent) for parent in parents):
            continue  # explained there
        method = value.__func__ if isinstance(value, classmethod | staticmethod) else value
        if not key.startswith("_") and inspect.isfunction(method) and len(arguments(method)) > 1:
            assert section(method, "Args") == arguments(method), key
