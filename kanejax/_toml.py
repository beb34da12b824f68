"""TOML files whose every key is known: what a value must be, in words, and errors of one line."""

import math
import os
import sys
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from kanejax._errors import KanejaxError


class ConfigurationError(KanejaxError, ValueError):
    """A configuration is no TOML, or has a key or a value that means nothing."""


class Kind(NamedTuple):
    """What a value must be, in words; whether one is; and what is made of it."""

    words: str
    accepts: Callable[[Any], bool]
    made: Callable[[Any], Any] = lambda value: value

    def or_else(self, other: "Kind") -> "Kind":
        """Either."""
        return Kind(
            f"{self.words}, or {other.words}",
            lambda value: self.accepts(value) or other.accepts(value),
            lambda value: (self if self.accepts(value) else other).made(value),
        )


def choice(*values: Any) -> Kind:
    """One of these."""
    words = " or ".join(", ".join(each) for each in ([written(value) for value in values[:-1]], [written(values[-1])]) if each)
    return Kind(words, lambda value: any(value == each and type(value) is type(each) for each in values))


def list_of(kind: Kind, words: str, length: int | None = None) -> Kind:
    """Tuples are made of lists, so that what has them can be hashed."""
    return Kind(
        words,
        lambda value: isinstance(value, list) and length in (None, len(value)) and all(kind.accepts(each) for each in value),
        lambda value: tuple(kind.made(each) for each in value),
    )


def table_of(kind: Kind, words: str) -> Kind:
    """Any keys, and values of a kind."""
    return Kind(
        f"a table of {words}",
        lambda value: isinstance(value, dict) and all(kind.accepts(each) for each in value.values()),
        lambda value: {key: kind.made(each) for key, each in value.items()},
    )


def number(words: str, accepts: Callable[[float], bool] = lambda _: True) -> Kind:
    """A number, whole or not."""
    return Kind(words, lambda value: _is_number(value) and accepts(value), float)


def _is_number(value: Any) -> bool:
    """Infinite ones are, such as bounds; NaN is not, nor what no float can hold."""
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) <= sys.float_info.max
    return isinstance(value, float) and not math.isnan(value)


def whole(words: str, least: int | None = None, most: int = 2**63 - 1) -> Kind:
    """A whole number, which 64 bits hold."""
    least = -(2**63) if least is None else least
    return Kind(words, lambda value: isinstance(value, int) and not isinstance(value, bool) and least <= value <= most)


NUMBER = number("a number")
POSITIVE = number("a positive number", lambda value: value > 0)
FROM_ZERO = number("a number from 0 on", lambda value: value >= 0)
COUNT, SEED = whole("a whole number from 1 on", 1), whole("a whole number from 0 on", 0)
TEXT = Kind("a text", lambda value: isinstance(value, str))
FLAG = Kind("true or false", lambda value: isinstance(value, bool))
TABLE = Kind("a table", lambda value: isinstance(value, dict))
TEXTS = list_of(TEXT, "a list of texts")


def written(value: Any) -> str:
    """A value as TOML writes it."""
    return f'"{value}"' if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else repr(value)


def file_text(path: str | os.PathLike[str]) -> str:
    """The text of a file.

    Raises:
        ConfigurationError: it is no text.
        OSError: the file cannot be read.
    """
    try:
        return Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{path}: not a text in UTF-8: {error}") from error


def parsed_toml(text: str, origin: str) -> dict[str, Any]:
    """The values of a TOML file; `origin` is what messages call it.

    Raises:
        ConfigurationError: it is no TOML.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        # Numbers of too many digits are a ValueError of their own, and tables in tables without end a RecursionError.
        hint = "; that is XML, such as a robot: give a TOML file, --example prints one" if text.lstrip().startswith("<") else ""
        raise ConfigurationError(f"{origin}: not TOML: {error}{hint}") from error


def checked(origin: str, label: str, table: Mapping[str, Any], keys: Mapping[str, Kind]) -> dict[str, Any]:
    """What is made of the values of a table.

    Raises:
        ConfigurationError: a key or value means nothing; the message says what may stand there.
    """
    for key, value in table.items():
        if key not in keys:
            refuse(origin, f"{label} has no key {key!r}; the keys are: {', '.join(keys)}")
        if not keys[key].accepts(value):
            refuse(origin, f"{label} {key} is {written(value)}; it must be {keys[key].words}")
    return {key: keys[key].made(value) for key, value in table.items()}


def refuse(origin: str, problem: str) -> NoReturn:
    """Raise a ConfigurationError."""
    raise ConfigurationError(f"{origin}: {problem}")
