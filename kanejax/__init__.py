"""Differentiable, batched rigid-body dynamics by Kane's method."""

__version__ = "0.1.0"

from kanejax._dynamics.equations_of_motion import (
    bias_force as bias_force,
    forward_dynamics as forward_dynamics,
    generalized_active_force as generalized_active_force,
    generalized_inertia_force as generalized_inertia_force,
    gravity_force as gravity_force,
    inverse_dynamics as inverse_dynamics,
    passive_force as passive_force,
)
from kanejax._errors import (
    InvalidInertiaError as InvalidInertiaError,
    KanejaxError as KanejaxError,
    ModelFileError as ModelFileError,
    UnknownNameError as UnknownNameError,
    UnphysicalInertiaWarning as UnphysicalInertiaWarning,
    UnsupportedModelError as UnsupportedModelError,
)
from kanejax._model.model import Model as Model
from kanejax._model.tree import Tree as Tree
