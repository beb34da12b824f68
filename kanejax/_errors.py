"""The exceptions and warnings that the library raises."""

import os
import pathlib
import warnings
from collections.abc import Iterable
from typing import Any

_PACKAGE_FOLDER = str(pathlib.Path(__file__).parent) + os.sep


class KanejaxError(Exception):
    """Base of every exception that the library defines."""


class ModelFileError(KanejaxError, ValueError):
    """A model file is missing, malformed, or refused by MuJoCo's compiler."""


class UnsupportedModelError(KanejaxError, ValueError):
    """A model has a feature that enters its dynamics and that the library does not model."""


class InvalidInertiaError(KanejaxError, ValueError):
    """A body's mass or inertia cannot belong to a rigid body, or leaves the mass matrix singular."""


class InvalidParameterError(KanejaxError, ValueError):
    """A parameter of a model is not finite, or lies where the dynamics are not defined."""


class LogError(KanejaxError, ValueError):
    """A log of a robot's motion is missing, malformed, or cannot be what is asked of it."""


class DatasetError(KanejaxError, ValueError):
    """A data set on disk is not that which is asked for, or is damaged."""


class UnknownNameError(KanejaxError, KeyError):
    """A name is not in the model; the message lists the names that are."""

    def __init__(self, kind: str, name: str, valid_names: Iterable[str]) -> None:
        """Say that no `kind` (such as "body") is called `name`, and list the `valid_names`."""
        listed = ", ".join(repr(valid) for valid in valid_names) or "none"
        self.message: str = f"no {kind} is named {name!r}; the names are: {listed}"
        super().__init__(self.message)

    def __str__(self) -> str:
        """Return the message as it is: KeyError would show its repr."""
        return self.message

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by message: the constructor's arguments are not the exception's."""
        return _rebuild_unknown_name, (self.message,)


class UnphysicalInertiaWarning(UserWarning):
    """A body's inertia breaks a physical inequality and was kept at the caller's request."""


class IgnoredFeatureWarning(UserWarning):
    """A model has a feature that enters its dynamics, and it was left out at the caller's request."""


class RepairedModelWarning(UserWarning):
    """Numbers of a model differ from those that its file states."""


def warn_caller(message: str, category: type[Warning]) -> None:
    """Warn at the line, outside of the library, that called it."""
    warnings.warn(message, category, stacklevel=2, skip_file_prefixes=(_PACKAGE_FOLDER,))


def _rebuild_unknown_name(message: str) -> UnknownNameError:
    error = UnknownNameError.__new__(UnknownNameError, message)
    error.message = message
    return error
