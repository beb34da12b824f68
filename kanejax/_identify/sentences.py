"""What one should know before trusting identified numbers, in words."""

from collections.abc import Iterable, Sequence

import numpy as np

from kanejax._identify.result import BaseEstimates, Determined, Stage
from kanejax._regression.base_parameters import BaseParameters

# Residuals this small beside the signals are rounding errors.
_PERFECT = 1e-6
# A body whose pseudo-inertia has an eigenvalue this small beside its trace is hardly one that can exist.
_EDGE = 1e-7
_SHOWN = 12


def determined(base: BaseParameters, index: int) -> Determined:
    """Whether motion can determine a parameter alone."""
    if base.alone(index) is not None:
        return "alone"
    return "in combination" if base.group(index) else "not at all"


def sentences(
    base: BaseParameters,
    estimates: BaseEstimates,
    weak: Sequence[dict[int, float]],
    unexcited: np.ndarray,
    stages: Sequence[Stage],
    relative_rms: float,
    consistency: np.ndarray,
    body_names: Sequence[str],
) -> tuple[str, ...]:
    """Sentences on an identification.

    Args:
        base: what motion can tell apart.
        estimates: of the base parameters.
        weak: changes of them that change no signal.
        unexcited: those that take part in such changes.
        stages: how they ended.
        relative_rms: of the residuals beside the signals.
        consistency: smallest eigenvalue of the pseudo-inertia over its trace, of bodies whose inertia was sought.
        body_names: their names.
    """
    said = [f"The stage {stage.name!r} did not converge: {stage.message}." for stage in stages if not stage.converged]
    kinds = [determined(base, i) for i in range(len(base.names))]
    together = [name for name, kind in zip(base.names, kinds, strict=True) if kind == "in combination"]
    nothing = [name for name, kind in zip(base.names, kinds, strict=True) if kind == "not at all"]
    loose = {name for i in range(len(base)) if unexcited[i] for name in [base.names[base.independent[i]]]}
    open_ = len({*together, *nothing, *loose})
    if relative_rms < _PERFECT and open_:
        said.append(
            f"The fit is perfect, and yet {open_} of {len(base.names)} parameters are not determined by it: others fit as well. "
            "Their values come from the nominal model and the priors."
        )
    for formula, own, row in zip(base.formulas, base.independent, base.matrix, strict=True):
        others = [base.names[i] for i in np.flatnonzero(row) if i != own]
        if others:
            verb = "enters" if len(others) == 1 else "enter"
            said.append(f"{_listed(others)} {verb} only together with {base.names[own]}: the data determine the sum {formula}.")
    if nothing:
        said.append(f"No signal depends on {_listed(nothing)}.")
    for shares in weak:
        named = _listed(f"{base.names[base.independent[i]]} by {share:.3g}" for i, share in shares.items())
        said.append(f"These data do not excite everything: changing {named} at once changes no signal.")
    zero = [
        formula
        for formula, value, std in zip(estimates.formulas, estimates.value, estimates.std, strict=True)
        if np.isfinite(std) and abs(value) < 1.96 * std
    ]
    if zero:
        said.append(f"{len(zero)} of {len(base)} base parameters cannot be told from zero: {_listed(zero)}.")
    vague = [
        f"{formula} ({value:.3g} +- {1.96 * std:.2g})"
        for formula, value, std, row in zip(estimates.formulas, estimates.value, estimates.std, base.matrix, strict=True)
        if np.count_nonzero(row) == 1 and formula.endswith((".mass", ".m")) and 1.96 * std > abs(value)
    ]
    if vague:
        said.append(f"Of these masses the data say next to nothing: {_listed(vague)}.")
    for name, eigenvalue in zip(body_names, consistency, strict=True):
        if 0 < eigenvalue < _EDGE:
            said.append(f"Body {name!r} is at the edge of what a rigid body can be: the data ask for less inertia than any has.")
    return tuple(said)


def _listed(names: Iterable[str]) -> str:
    names = list(names)
    shown = ", ".join(names[:_SHOWN])
    return shown if len(names) <= _SHOWN else f"{shown} and {len(names) - _SHOWN} more"
