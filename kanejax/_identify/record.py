"""What an identification found, as dictionaries and lists that JSON has."""

import dataclasses
import importlib.metadata
import math
import platform
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np

from kanejax._identify.result import Comparison, Identification, relative_error

_PACKAGES = ("kanejax", "jax", "jaxlib", "numpy", "scipy", "optimistix", "diffrax", "equinox")
_UNITS = "SI units and radians; efforts in the unit of the log"


def identification_record(identification: Identification, details: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Everything but the signals over time, for `json.dump`.

    Numbers that JSON lacks are None: nan where there is nothing to say, such as the deviation of a parameter that the data do not
    determine alone, and infinity where there is no limit.

    Args:
        identification: what `identify` returned.
        details: more to record, such as files and seeds; under their own keys, before the rest.

    Returns:
        "versions", "units", "converged", "stages", "parameters", "base_parameters", "sentences", "runs" with errors by joint,
        "noise", "consistency" by body, and "nominal" and "identified" with all leaves of model and drives.
    """
    tree = identification.plant.model.tree
    record = {
        **dict(details or {}),
        "versions": versions(),
        "units": _UNITS,
        "converged": identification.converged,
        "stages": [stage._asdict() for stage in identification.stages],
        "parameters": [estimate._asdict() for estimate in identification.estimates],
        "base_parameters": identification.base._asdict(),
        "sentences": identification.sentences,
        "runs": [
            _run(comparison, use)
            for use, comparisons in (("training", identification.training), ("validation", identification.validation))
            for comparison in comparisons
        ],
        "noise": identification.noise._asdict(),
        "consistency": dict(zip(tree.body_names, identification.consistency, strict=True)),
        "bodies": tree.body_names,
        "joints": tree.joint_names,
        "nominal": _leaves(identification.nominal),
        "identified": _leaves(identification.plant),
    }
    return plain(record)


def _run(comparison: Comparison, use: str) -> dict[str, Any]:
    return {
        "name": comparison.name,
        "use": use,
        "samples": len(comparison.ts),
        "relative_error": relative_error(comparison),
        "nominal_relative_error": relative_error(comparison, comparison.nominal),
    }


def _leaves(plant: eqx.Module) -> dict[str, Any]:
    """The arrays of a module by name, those of modules within it in dictionaries."""
    fields = {field.name: getattr(plant, field.name) for field in dataclasses.fields(plant)}
    return {
        name: _leaves(value) if isinstance(value, eqx.Module) else value for name, value in fields.items() if _has_arrays(value)
    }


def _has_arrays(value: Any) -> bool:
    return isinstance(value, eqx.Module) or eqx.is_array(value)


def versions() -> dict[str, str]:
    """Of Python and what computes."""
    return {"python": platform.python_version()} | {package: importlib.metadata.version(package) for package in _PACKAGES}


def plain(value: Any) -> Any:
    """Dictionaries, lists, numbers and text of anything that is made of them and of arrays; None for numbers that JSON lacks."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, str | bool | int) or value is None:
        return value
    array = np.asarray(value)
    if array.ndim:
        return [plain(item) for item in array]
    number = array.item()
    return number if not isinstance(number, float) or math.isfinite(number) else None
