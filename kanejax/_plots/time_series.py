"""Coordinates, speeds and forces of a motion over time, a panel for each joint."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from kanejax._model.generalized_speeds import AnyModel
from kanejax._plots.arrays import Series, checked_series, limits_of, series
from kanejax._plots.drawing import draw_limits, draw_reference, draw_series, explain, grid_of, limits_of_panel
from kanejax._plots.panels import panels_of
from kanejax._plots.style import LIMIT_LINE, PAPER, REFERENCE_LINE, on_paper

if TYPE_CHECKING:
    import matplotlib.figure


def coordinates(
    model: AnyModel, path: Any, *, reference: Any = None, joints: str | Iterable[str] | None = None
) -> "matplotlib.figure.Figure":
    """Coordinates over time, a panel for each joint, with the joints' ranges.

    A ball joint's panel has the four numbers of its quaternion; a free joint has two panels, for translation and rotation. Limits
    that are near are dashed lines, others are told in words, so that the motion does not look flat.

    Args:
        model: the mechanism.
        path: one motion: what `simulate` or `optimize` returns, or anything else with times ts (n,) [s] and coordinates q (n, nq).
        reference: another motion, drawn dashed, such as the one that was to be followed; its times may be others.
        joints: names of the joints to draw, by default all.

    Raises:
        PlotError: there are several motions, or they are not the model's.
        UnknownNameError: a joint is not in the model; the message lists those that are.
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    found = series(model, path, "q", "path")
    other = None if reference is None else series(model, reference, "q", "reference")
    return _figure(model, "q", found, other, None, joints)


def speeds(
    model: AnyModel, path: Any, *, limits: Any = None, reference: Any = None, joints: str | Iterable[str] | None = None
) -> "matplotlib.figure.Figure":
    """Generalized speeds over time, a panel for each joint.

    A ball joint's are its angular velocity in body axes; a free joint has two panels, for the velocity of its origin in world axes
    and its angular velocity in body axes.

    Args:
        model: the mechanism.
        path: one motion, with times ts (n,) [s] and speeds u (n, nv).
        limits: `Limits`, whose `u` counts, or a number, (nv,), or a pair (least, greatest) of these.
        reference: another motion, drawn dashed.
        joints: names of the joints to draw, by default all.

    Raises:
        PlotError: there are several motions, they or the limits are not the model's, or the model has chosen speeds.
        UnknownNameError: a joint is not in the model; the message lists those that are.
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    found = series(model, path, "u", "path")
    other = None if reference is None else series(model, reference, "u", "reference")
    return _figure(model, "u", found, other, limits, joints)


def torques(
    model: AnyModel, ts: Any, tau: Any = None, *, limits: Any = None, joints: str | Iterable[str] | None = None
) -> "matplotlib.figure.Figure":
    """Torques and forces at the joints over time, a panel for each joint: `torques(model, motion)` or `torques(model, ts, tau)`.

    Args:
        model: the mechanism.
        ts: times [s], (n,); or an `OptimalMotion`, which has its forces.
        tau: forces [N] and torques [N m] on the generalized speeds. With (n, nv) those at the times, joined by lines; with
            (n - 1, nv) each row holds until the next time, and is drawn as steps.
        limits: `Limits`, whose `tau` counts, or a number, (nv,), or a pair (least, greatest) of these.
        joints: names of the joints to draw, by default all.

    Raises:
        PlotError: there are several motions, or they or the limits are not the model's.
        UnknownNameError: a joint is not in the model; the message lists those that are.
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    found = series(model, ts, "tau", "ts") if tau is None else checked_series(model, ts, tau, "tau", ("ts", "tau"))
    return _figure(model, "tau", found, None, limits, joints)


@on_paper()
def _figure(
    model: AnyModel, field: str, found: Series, reference: Series | None, limits: Any, joints: str | Iterable[str] | None
) -> "matplotlib.figure.Figure":
    panels, pair = panels_of(model.tree, joints), limits_of(model, field, limits)
    figure, everyone = grid_of(panels)
    limited = False
    for axes, panel in zip(everyone, panels, strict=True):
        quantity = getattr(panel, field)
        drawn = found.values[:, quantity.columns]
        draw_series(axes, found, quantity, PAPER)
        if reference is not None:
            draw_reference(axes, reference, quantity)
            drawn = np.concatenate((drawn, reference.values[:, quantity.columns]))
        limited |= draw_limits(axes, drawn, limits_of_panel(pair, panel, field), PAPER, inside=bool(quantity.parts))
    named = [("reference", REFERENCE_LINE)] if reference is not None else []
    explain(figure, [*named, *([("limit", {"color": PAPER["nominal"], **LIMIT_LINE})] if limited else [])])
    figure.align_ylabels()
    return figure
