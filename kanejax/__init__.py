"""Differentiable, batched rigid-body dynamics by Kane's method."""

__version__ = "0.1.0"

import importlib as _importlib
import typing as _typing

from kanejax import robots as robots
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
from kanejax._dynamics.regressor import regressor as regressor
from kanejax._dynamics.wrench import (
    Wrenches as Wrenches,
    external_force as external_force,
    joint_reactions as joint_reactions,
)
from kanejax._errors import (
    DatasetError as DatasetError,
    IgnoredFeatureWarning as IgnoredFeatureWarning,
    InvalidInertiaError as InvalidInertiaError,
    InvalidParameterError as InvalidParameterError,
    KanejaxError as KanejaxError,
    LogError as LogError,
    ModelFileError as ModelFileError,
    RepairedModelWarning as RepairedModelWarning,
    UnknownNameError as UnknownNameError,
    UnphysicalInertiaWarning as UnphysicalInertiaWarning,
    UnsupportedModelError as UnsupportedModelError,
)
from kanejax._io.check import check_model as check_model
from kanejax._io.dh import DHLink as DHLink, from_dh as from_dh
from kanejax._kinematics.change_of_speeds import (
    rates_from_speeds as rates_from_speeds,
    speed_conditioning as speed_conditioning,
    speeds_from_rates as speeds_from_rates,
)
from kanejax._kinematics.coordinate_rates import (
    coordinate_rates as coordinate_rates,
    tangent_gradient as tangent_gradient,
)
from kanejax._kinematics.link_speeds import LinkSpeeds as LinkSpeeds, link_speeds as link_speeds
from kanejax._kinematics.partial_velocity import (
    PartialVelocities as PartialVelocities,
    partial_velocities as partial_velocities,
    partial_velocity_rates as partial_velocity_rates,
)
from kanejax._kinematics.pose import Poses as Poses, poses as poses
from kanejax._mesh import batch_mesh as batch_mesh, replicate as replicate, shard_batch as shard_batch
from kanejax._model.generalized_speeds import (
    AbstractSpeeds as AbstractSpeeds,
    GeneralizedSpeeds as GeneralizedSpeeds,
    SpeedTerms as SpeedTerms,
    WithSpeeds as WithSpeeds,
    with_speeds as with_speeds,
)
from kanejax._model.inertia import (
    inertia_parameters as inertia_parameters,
    with_inertia_parameters as with_inertia_parameters,
)
from kanejax._model.model import Model as Model
from kanejax._model.specialized import Specialized as Specialized, specialize as specialize
from kanejax._model.tree import Tree as Tree
from kanejax._operation_count import OperationCount as OperationCount, operation_count as operation_count

# What needs MuJoCo, diffrax or rich is imported when it is first used: they take longer than all else here. Type checkers read
# the imports, Python reads the table.
if _typing.TYPE_CHECKING:
    from kanejax import constraints as constraints, costs as costs, distributions as distributions, plots as plots
    from kanejax._checkpoint import CheckpointError as CheckpointError, CheckpointWarning as CheckpointWarning
    from kanejax._dataset.study import (
        GivenForces as GivenForces,
        RandomForces as RandomForces,
        Randomized as Randomized,
        Study as Study,
    )
    from kanejax._dataset.write_study import StudyInterrupted as StudyInterrupted, write_study as write_study
    from kanejax._excitation.excitation import ExcitationDesign as ExcitationDesign, excitation as excitation
    from kanejax._excitation.fourier_motion import (
        FourierMotion as FourierMotion,
        motion_table as motion_table,
        write_csv as write_csv,
    )
    from kanejax._excitation.motion_information import (
        MotionInformation as MotionInformation,
        motion_information as motion_information,
    )
    from kanejax._identify.identify import identify as identify
    from kanejax._identify.report.page import write_report as write_report
    from kanejax._identify.result import (
        Comparison as Comparison,
        Estimate as Estimate,
        Identification as Identification,
        relative_error as relative_error,
    )
    from kanejax._io.export import to_mjcf as to_mjcf, to_mujoco as to_mujoco
    from kanejax._io.load import LoadReport as LoadReport, load as load, load_report as load_report
    from kanejax._io.mujoco import from_mujoco as from_mujoco
    from kanejax._io.urdf_inertials import to_urdf_inertials as to_urdf_inertials
    from kanejax._logs.columns import Columns as Columns, Units as Units
    from kanejax._logs.delay import Delay as Delay, estimated_delay as estimated_delay
    from kanejax._logs.log import Log as Log, Run as Run
    from kanejax._logs.motion import Motion as Motion, split as split
    from kanejax._logs.processing import motions as motions
    from kanejax._logs.read_log import read_log as read_log
    from kanejax._optimize.bent_guess import bent_guess as bent_guess
    from kanejax._optimize.feasibility import (
        InfeasibleTaskError as InfeasibleTaskError,
        NonFiniteTaskError as NonFiniteTaskError,
    )
    from kanejax._optimize.limits import Limits as Limits
    from kanejax._optimize.many import optimize_batch as optimize_batch
    from kanejax._optimize.moment import Constraint as Constraint, Cost as Cost, Moment as Moment
    from kanejax._optimize.motion import OptimalMotion as OptimalMotion
    from kanejax._optimize.optimize import (
        Guess as Guess,
        OptimizationError as OptimizationError,
        OptimizationInterrupted as OptimizationInterrupted,
        SolverNotInstalledError as SolverNotInstalledError,
        optimal_motion as optimal_motion,
        optimize as optimize,
        straight_guess as straight_guess,
    )
    from kanejax._optimize.task import Boundary as Boundary, MotionTask as MotionTask
    from kanejax._optimize.tracking import (
        Deviation as Deviation,
        Tracking as Tracking,
        replayed as replayed,
        replayed_by_mujoco as replayed_by_mujoco,
        tracking as tracking,
    )
    from kanejax._parameters.parameterization import (
        Parameterization as Parameterization,
        parameterization as parameterization,
    )
    from kanejax._parameters.payload import with_payload as with_payload
    from kanejax._parameters.plant import Drives as Drives, Plant as Plant, drive_force as drive_force, signal as signal
    from kanejax._parameters.priors import Entropic as Entropic, Gaussian as Gaussian, Geodesic as Geodesic
    from kanejax._parameters.unknowns import Unknown as Unknown
    from kanejax._regression.base_parameters import BaseParameters as BaseParameters, base_parameters as base_parameters
    from kanejax._regression.linear_estimate import (
        LinearEstimate as LinearEstimate,
        identifiable as identifiable,
        linear_estimate as linear_estimate,
    )
    from kanejax._simulate.batch import SimulationInterrupted as SimulationInterrupted, simulate_batch as simulate_batch
    from kanejax._simulate.beta_scheme import BetaScheme as BetaScheme
    from kanejax._simulate.control import TorqueTable as TorqueTable
    from kanejax._simulate.events import JointLimitBounce as JointLimitBounce, StateEvent as StateEvent
    from kanejax._simulate.simulate import simulate as simulate
    from kanejax._simulate.trajectory import (
        SimulationError as SimulationError,
        Status as Status,
        Trajectory as Trajectory,
    )
    from kanejax._simulation_fit.simulation_error import fit_simulation as fit_simulation
    from kanejax._simulation_fit.simulation_fit import FitInterrupted as FitInterrupted, SimulationFit as SimulationFit
    from kanejax._validate.report import ValidationReport as ValidationReport, ValidationRow as ValidationRow
    from kanejax._validate.validate import validate as validate
else:
    _LATER = {
        "_dataset.study": ("GivenForces", "RandomForces", "Randomized", "Study"),
        "_dataset.write_study": ("StudyInterrupted", "write_study"),
        "_checkpoint": ("CheckpointError", "CheckpointWarning"),
        "_excitation.excitation": ("ExcitationDesign", "excitation"),
        "_excitation.fourier_motion": ("FourierMotion", "motion_table", "write_csv"),
        "_excitation.motion_information": ("MotionInformation", "motion_information"),
        "_identify.identify": ("identify",),
        "_identify.report.page": ("write_report",),
        "_identify.result": ("Comparison", "Estimate", "Identification", "relative_error"),
        "_io.export": ("to_mjcf", "to_mujoco"),
        "_io.load": ("LoadReport", "load", "load_report"),
        "_io.mujoco": ("from_mujoco",),
        "_io.urdf_inertials": ("to_urdf_inertials",),
        "_logs.columns": ("Columns", "Units"),
        "_logs.delay": ("Delay", "estimated_delay"),
        "_logs.log": ("Log", "Run"),
        "_logs.motion": ("Motion", "split"),
        "_logs.processing": ("motions",),
        "_logs.read_log": ("read_log",),
        "_optimize.bent_guess": ("bent_guess",),
        "_optimize.feasibility": ("InfeasibleTaskError", "NonFiniteTaskError"),
        "_optimize.limits": ("Limits",),
        "_optimize.moment": ("Constraint", "Cost", "Moment"),
        "_optimize.many": ("optimize_batch",),
        "_optimize.motion": ("OptimalMotion",),
        "_optimize.optimize": (
            "Guess",
            "OptimizationError",
            "OptimizationInterrupted",
            "SolverNotInstalledError",
            "optimal_motion",
            "optimize",
            "straight_guess",
        ),
        "_optimize.task": ("Boundary", "MotionTask"),
        "_optimize.tracking": ("Deviation", "Tracking", "replayed", "replayed_by_mujoco", "tracking"),
        "_parameters.parameterization": ("Parameterization", "parameterization"),
        "_parameters.payload": ("with_payload",),
        "_parameters.plant": ("Drives", "Plant", "drive_force", "signal"),
        "_parameters.priors": ("Entropic", "Gaussian", "Geodesic"),
        "_parameters.unknowns": ("Unknown",),
        "_regression.base_parameters": ("BaseParameters", "base_parameters"),
        "_regression.linear_estimate": ("LinearEstimate", "identifiable", "linear_estimate"),
        "_simulate.batch": ("SimulationInterrupted", "simulate_batch"),
        "_simulate.beta_scheme": ("BetaScheme",),
        "_simulate.control": ("TorqueTable",),
        "_simulate.events": ("JointLimitBounce", "StateEvent"),
        "_simulate.simulate": ("simulate",),
        "_simulate.trajectory": ("SimulationError", "Status", "Trajectory"),
        "_simulation_fit.simulation_error": ("fit_simulation",),
        "_simulation_fit.simulation_fit": ("FitInterrupted", "SimulationFit"),
        "_validate.report": ("ValidationReport", "ValidationRow"),
        "_validate.validate": ("validate",),
    }
    _MODULES = {name: f"{__name__}.{module}" for module, names in _LATER.items() for name in names}
    # These are modules themselves.
    _MODULES |= {"constraints": __name__, "costs": __name__, "distributions": __name__, "plots": __name__}

    def __getattr__(name: str) -> object:
        """Import a public name when it is first used."""
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        if _MODULES[name] == __name__:
            return _importlib.import_module(f"{__name__}.{name}")
        value = globals()[name] = getattr(_importlib.import_module(_MODULES[name]), name)
        return value

    def __dir__() -> list[str]:
        """All names, also those that are not imported yet."""
        return sorted({*globals(), *_MODULES})
