"""Differentiable, batched rigid-body dynamics by Kane's method."""

__version__ = "0.1.0"

from kanejax._dynamics.energy import (
    Momentum as Momentum,
    center_of_mass as center_of_mass,
    kinetic_energy as kinetic_energy,
    momentum as momentum,
    potential_energy as potential_energy,
)
from kanejax._dynamics.equations_of_motion import (
    bias_force as bias_force,
    forward_dynamics as forward_dynamics,
    generalized_active_force as generalized_active_force,
    generalized_inertia_force as generalized_inertia_force,
    gravity_force as gravity_force,
    inverse_dynamics as inverse_dynamics,
    mass_matrix as mass_matrix,
    passive_force as passive_force,
)
from kanejax._dynamics.kane import KaneEquations as KaneEquations, kane_equations as kane_equations
from kanejax._dynamics.wrench import (
    Wrenches as Wrenches,
    external_force as external_force,
    joint_reactions as joint_reactions,
)
from kanejax._errors import (
    InvalidInertiaError as InvalidInertiaError,
    KanejaxError as KanejaxError,
    ModelFileError as ModelFileError,
    UnknownNameError as UnknownNameError,
    UnphysicalInertiaWarning as UnphysicalInertiaWarning,
    UnsupportedModelError as UnsupportedModelError,
)
from kanejax._kinematics.partial_velocity import (
    PartialVelocities as PartialVelocities,
    partial_velocities as partial_velocities,
    partial_velocity_rates as partial_velocity_rates,
)
from kanejax._kinematics.pose import Poses as Poses, poses as poses
from kanejax._model.model import Model as Model
from kanejax._model.tree import Tree as Tree
