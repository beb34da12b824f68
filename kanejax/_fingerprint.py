"""Whether two computations, maybe of different processes, start from the same."""

import dataclasses
import dis
import enum
import functools
import hashlib
import os
import sys
import types
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer


def fingerprint_of(*values: Any) -> str:
    """A hash of values of any kind: numbers, names, arrays, records of them, and functions with what they refer to."""
    import kanejax

    return _Hashes().of((kanejax.__version__, *values)).hex()


class _Hashes:
    """Of values, and of what they are made of; whatever is met twice is looked through once."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[bytes, Any]] = {}

    def of(self, value: Any) -> bytes:
        """Hash of a value with its kind, so that no two values of different kinds are the same."""
        if value is None or isinstance(value, str | bytes | bool | int | float | complex | enum.Enum | types.EllipsisType):
            return _joined(type(value).__name__, repr(value))
        if isinstance(value, Tracer):
            return _joined("traced", str(value.aval))  # Left behind by a function's side effect; it has no number.
        if isinstance(value, jax.Array | np.ndarray | np.generic | jax.ShapeDtypeStruct):
            return _of_array(value)
        if id(value) not in self._known:
            # A value that refers to itself is met again before its own hash is known. It is kept, so that no other gets its place.
            self._known[id(value)] = _joined("refers to itself"), value
            self._known[id(value)] = self._of_compound(value), value
        return self._known[id(value)][0]

    def _of_compound(self, value: Any) -> bytes:
        if isinstance(value, Mapping):
            return self._of_all("mapping", [part for key in sorted(value, key=repr) for part in (key, value[key])])
        if isinstance(value, list | tuple):
            return self._of_all(type(value).__name__, value)
        if isinstance(value, set | frozenset):
            return self._of_all("set", sorted(value, key=repr))
        if isinstance(value, types.FunctionType):
            return self._of_function(value)
        if isinstance(value, types.CodeType):
            return self._of_all("code", (value.co_code, value.co_names, value.co_varnames, value.co_consts))
        if isinstance(value, types.MethodType):
            return self._of_all("method", (value.__func__, value.__self__))
        if isinstance(value, functools.partial):
            return self._of_all("partial", (value.func, value.args, value.keywords))
        if hasattr(value, "__wrapped__"):
            return self._of_all("wrapped", (value.__wrapped__,))
        if hasattr(value, "__qualname__"):
            return _joined("name", _name(value))
        return self._of_all(_name(type(value)), (_attributes(value) or _without_address(value),))

    def _of_all(self, kind: str, values: Sequence[Any]) -> bytes:
        return _joined(kind, *(self.of(value) for value in values))

    def _of_function(self, function: types.FunctionType) -> bytes:
        """Of its code, defaults, and the values of variables from outside of it."""
        cells = [cell.cell_contents for cell in function.__closure__ or () if _is_filled(cell)]
        outside = [] if _is_of_library(function.__module__) else list(_globals(function, function.__code__))
        return self._of_all(_name(function), (function.__code__, function.__defaults__, function.__kwdefaults__, cells, outside))


def _joined(*parts: str | bytes) -> bytes:
    return hashlib.sha256(repr(parts).encode()).digest()


def _of_array(value: Any) -> bytes:
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        value = jax.random.key_data(value)
    content = b"" if isinstance(value, jax.ShapeDtypeStruct) else hashlib.sha256(np.asarray(value).tobytes()).digest()
    return _joined("array", str(value.dtype), str(value.shape), content)


def _name(value: Any) -> str:
    return f"{getattr(value, '__module__', None)}.{value.__qualname__}"


def _globals(function: types.FunctionType, code: types.CodeType) -> Iterator[tuple[str, Any]]:
    """Global variables of a function, but for modules, and functions and classes of other modules."""
    for name in sorted({each.argval for each in dis.get_instructions(code) if each.opname == "LOAD_GLOBAL"}):
        value = function.__globals__.get(name)
        foreign = hasattr(value, "__qualname__") and getattr(value, "__module__", None) != function.__module__
        if not isinstance(value, types.ModuleType):
            yield name, _name(value) if foreign else value
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _globals(function, constant)


def _is_of_library(module: str | None) -> bool:
    """Whether a module is this library's or an installed one, whose global variables are not followed."""
    module = module or ""
    file = getattr(sys.modules.get(module), "__file__", None) or ""
    return module.startswith("kanejax.") or "site-packages" in file or file.startswith(os.path.dirname(os.__file__) + os.sep)


def _is_filled(cell: types.CellType) -> bool:
    try:
        cell.cell_contents  # noqa: B018
    except ValueError:
        return False
    return True


def _attributes(value: Any) -> dict[str, Any]:
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value) if hasattr(value, field.name)}
    slots = [name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ()) if hasattr(value, name)]
    return {name: getattr(value, name) for name in slots if not name.startswith("__")} | getattr(value, "__dict__", {})


def _without_address(value: Any) -> str:
    """How a value prints, unless that says where in memory it is."""
    printed = repr(value)
    return "" if " at 0x" in printed else printed
