"""Loading URDF and MJCF files and strings, and saying what of them is not in the model."""

import dataclasses
import logging
import os
from typing import final

import mujoco

from kanejax._errors import IgnoredFeatureWarning, RepairedModelWarning, warn_caller
from kanejax._io.check import check_numbers
from kanejax._io.convert import model_from_compiled
from kanejax._io.source import compile_source
from kanejax._model.model import Model

_LOGGER = logging.getLogger("kanejax")


@final
@dataclasses.dataclass(frozen=True)
class LoadReport:
    """A loaded model, and in sentences how it differs from its file.

    Attributes:
        model: what was loaded.
        origin: the path, or what else the sentences are about.
        ignored: features that enter the dynamics and are left out; empty unless loaded with strict=False.
        unmodelled: what is left out and does not enter the equations of motion: contacts, actuators, sensors, shapes; also
            what MuJoCo warns of, such as deprecated attributes, which are carried out all the same.
        repaired: numbers that differ from those of the file.
    """

    model: Model
    origin: str
    ignored: tuple[str, ...]
    unmodelled: tuple[str, ...]
    repaired: tuple[str, ...]

    def __str__(self) -> str:
        """List the sentences under headings."""
        tree = self.model.tree
        lines = [f"{self.origin}: {tree.nbody} bodies, {tree.njoint} joints, {tree.nq} coordinates, {tree.nv} speeds"]
        headings = {
            "ignored, though it enters the dynamics": self.ignored,
            "of no effect on the equations of motion": self.unmodelled,
            "changed": self.repaired,
        }
        for heading, sentences in headings.items():
            lines += [f"{heading}:", *(f"  - {sentence}" for sentence in sentences)] if sentences else []
        return "\n".join(lines)


def load(
    source: str | os.PathLike[str] | mujoco.MjSpec,
    *,
    strict: bool = True,
    repair: bool = False,
    allow_unphysical: bool = False,
) -> Model:
    """Load a URDF or MJCF file, or a string of such XML.

    What enters the dynamics and is left out, and numbers that differ from the file's, cause Python warnings; what does not
    enter the equations of motion (contacts, actuators, sensors, shapes) goes to the logger "kanejax". `load_report`
    returns all of it. Leaves are float64 if `jax_enable_x64` is set, otherwise float32.

    Of files that an MJCF names, only its includes, its parts, and the meshes that inertias need are read, and only from its own
    folder and below; text reads none. An MjSpec of `mujoco.MjSpec.from_file` may have read others.

    Args:
        source: a path, XML text, or an MjSpec, which is not changed.
        strict: refuse features that enter the dynamics and are not modelled; otherwise warn with IgnoredFeatureWarning.
        repair: change numbers that no mechanism can have by the least that helps, and warn with RepairedModelWarning.
        allow_unphysical: keep inertias that no rigid body can have, and warn with UnphysicalInertiaWarning.

    Returns:
        The model; its bodies are the links of the URDF or the bodies of the MJCF.

    Raises:
        ModelFileError: the file cannot be read or understood.
        UnsupportedModelError: a feature that enters the dynamics is not modelled.
        InvalidInertiaError: an inertia that no rigid body can have, or that leaves the mass matrix singular.
        InvalidParameterError: a number is not finite, or exceeds 1e100.
    """
    report = load_report(source, strict=strict, repair=repair, allow_unphysical=allow_unphysical)
    if report.ignored:
        message = f"{report.origin}: ignored, though it changes the dynamics: {'; '.join(report.ignored)}"
        warn_caller(message, IgnoredFeatureWarning)
    if report.repaired:
        warn_caller(f"{report.origin}: {'; '.join(report.repaired)}", RepairedModelWarning)
    for sentence in report.unmodelled:
        _LOGGER.info("%s: %s", report.origin, sentence)
    return report.model


def load_report(
    source: str | os.PathLike[str] | mujoco.MjSpec,
    *,
    strict: bool = True,
    repair: bool = False,
    allow_unphysical: bool = False,
) -> LoadReport:
    """Load like `load`, and return what was left out or changed instead of warning of it; `print` shows it as a list.

    Args:
        source: a path, XML text, or an MjSpec, which is not changed.
        strict: refuse features that enter the dynamics and are not modelled; otherwise list them.
        repair: change numbers that no mechanism can have by the least that helps, and list them.
        allow_unphysical: keep inertias that no rigid body can have, and list them.

    Returns:
        The model, and what was left out or changed.

    Raises:
        KanejaxError: one of those that `load` raises.
    """
    compiled = compile_source(source, strict=strict, repair=repair, allow_unphysical=allow_unphysical)
    model = model_from_compiled(compiled.mj_model)
    # The inertias were checked before compiling, with the wording of files.
    check_numbers(model)
    unmodelled = compiled.ignored[len(compiled.refused) :]
    return LoadReport(model, compiled.origin, compiled.refused, unmodelled, compiled.repaired)
