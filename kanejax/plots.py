"""Figures of motions and identifications: `kanejax.plots.coordinates(model, path)` and others.

Every function returns a `matplotlib.figure.Figure`, which a notebook shows by itself and `figure.savefig("name.svg")` writes. They
need matplotlib: `pip install 'kanejax[plots]'`.
"""

from kanejax._identify.report.figures import (
    parameters as parameters,
    residuals as residuals,
    torque_fit as torque_fit,
)
from kanejax._plots.arrays import PlotError as PlotError
from kanejax._plots.energies import energies as energies
from kanejax._plots.motion import motion as motion
from kanejax._plots.phase_portrait import phase_portrait as phase_portrait
from kanejax._plots.quantiles import quantiles as quantiles
from kanejax._plots.time_series import coordinates as coordinates, speeds as speeds, torques as torques

__all__ = [
    "PlotError",
    "coordinates",
    "energies",
    "motion",
    "parameters",
    "phase_portrait",
    "quantiles",
    "residuals",
    "speeds",
    "torque_fit",
    "torques",
]
