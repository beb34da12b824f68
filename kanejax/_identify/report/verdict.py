"""What an identification is worth, in plain sentences."""

from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np

from kanejax._identify.report.numbers import percent
from kanejax._identify.report.signals import errors, sample_count, signal_names
from kanejax._identify.result import Identification

# A held-out error that is this many times the error of the fit says that the fit has learnt its own runs.
_OVERFITTED = 1.5


class Finding(NamedTuple):
    """A sentence, and whether it is good or bad news."""

    kind: Literal["good", "bad", "note"]
    text: str


def verdict(identification: Identification) -> tuple[Finding, ...]:
    """What one should know first: convergence, consistency, errors of held-out runs, and what is not determined."""
    findings = [
        *_convergence(identification),
        _consistency(identification),
        *_prediction(identification),
        _determined(identification),
    ]
    return tuple(findings)


def inconsistent_bodies(identification: Identification) -> tuple[str, ...]:
    """Names of the bodies whose mass distribution no rigid body can have; bodies without mass and inertia are none of them."""
    model = identification.plant.model
    rounding = 10 * np.finfo(model.dtype).eps
    empty = (np.asarray(model.mass) == 0) & ~np.any(np.asarray(model.central_inertia), axis=(1, 2))
    bad = ~(identification.consistency >= -rounding) & ~empty
    return tuple(name for name, is_bad in zip(model.tree.body_names, bad, strict=True) if is_bad)


def sentences_on_fit(identification: Identification, notes: Iterable[str]) -> list[str]:
    """The sentences of an identification, less what the verdict says, and what the notes say behind the name of a run."""
    told = {told for note in notes for told in (note, note.partition(": ")[2])}
    told |= {f"The stage {stage.name!r} did not converge: {stage.message}." for stage in identification.stages}
    return [sentence for sentence in identification.sentences if sentence not in told]


def _convergence(identification: Identification) -> list[Finding]:
    left = [Finding("bad", f"Stage {s.name!r} did not converge: {s.message}.") for s in identification.stages if not s.converged]
    if left:
        return left
    count = len(identification.stages)
    return [Finding("good", "The fit converged." if count == 1 else f"All {count} stages of the fit converged.")]


def _consistency(identification: Identification) -> Finding:
    bad = inconsistent_bodies(identification)
    if bad:
        return Finding("bad", f"No rigid body can have the mass distribution of {_listed(bad)}.")
    return Finding("good", "Every body has a mass distribution that a rigid body can have.")


def _prediction(identification: Identification) -> list[Finding]:
    fitted = errors(identification.training)
    if not identification.validation:
        text = f"On the runs that were fitted, {_spread(fitted.relative, fitted.nominal)} No run was held out"
        return [Finding("note", f"{text}, so nothing here says how well the plant predicts motion that it was not fitted to.")]
    held_out = errors(identification.validation)
    count, samples = len(identification.validation), sample_count(identification.validation)
    runs = f"{count} held-out run{'s' if count > 1 else ''} ({samples} samples)"
    better = bool(np.nanmedian(held_out.relative) < np.nanmedian(held_out.nominal))
    findings = [Finding("good" if better else "bad", f"On {runs}, {_spread(held_out.relative, held_out.nominal)}")]
    names = np.array(signal_names(identification))
    if (worse := names[held_out.relative >= held_out.nominal]).size:
        findings.append(Finding("note", f"Held-out signals of {_listed(worse)} are predicted no better than by the nominal plant."))
    if (learnt := names[held_out.relative > _OVERFITTED * fitted.relative]).size:
        text = f"Held-out errors of {_listed(learnt)} are more than {_OVERFITTED:g} times those of the fit"
        findings.append(Finding("note", f"{text}: the runs differ, or the fit has learnt what is particular to its own."))
    return findings


def _spread(found: np.ndarray, nominal: np.ndarray) -> str:
    ends = [percent(end(values)) for values in (found, nominal) for end in (np.nanmin, np.nanmax)]
    middle = [percent(np.nanmedian(values)) for values in (found, nominal)]
    if np.sum(~np.isnan(found)) == 1:
        return f"the residuals are {middle[0]} of the measured signal; the nominal plant has {middle[1]}."
    return (
        f"the residuals are {ends[0]} to {ends[1]} of the measured signals (median {middle[0]}); "
        f"the nominal plant has {ends[2]} to {ends[3]} (median {middle[1]})."
    )


def _determined(identification: Identification) -> Finding:
    ways = [estimate.determined for estimate in identification.estimates]
    counts = {way: ways.count(way) for way in ("alone", "in combination", "not at all", "not by these data")}
    base, quiet = identification.base, counts["not by these data"]
    unexcited = f"; {quiet} these data do not excite" if quiet else ""
    text = (
        f"Of {len(ways)} parameters the motion determines {counts['alone']} alone and {counts['in combination']} only in "
        f"combination with others; {counts['not at all']} it does not determine at all{unexcited}. It can tell apart "
        f"{len(base.formulas)} base parameters, with a condition number of {base.condition_number:.3g}."
    )
    return Finding("note" if counts["in combination"] or counts["not at all"] or quiet else "good", text)


def _listed(names: object) -> str:
    shown = [repr(str(name)) for name in np.atleast_1d(np.asarray(names))]
    return shown[0] if len(shown) == 1 else ", ".join(shown[:-1]) + " and " + shown[-1]
