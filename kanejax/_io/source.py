"""From a URDF or MJCF file, XML text or an MjSpec to a compiled MuJoCo model and a report of what was left out."""

import dataclasses
import os
from pathlib import Path

import mujoco

from kanejax._errors import ModelFileError, UnsupportedModelError
from kanejax._io.assets import check_needed_files, mujoco_warnings, one_line, without_unneeded_files
from kanejax._io.flags import with_flags_applied
from kanejax._io.inertial import Inertial
from kanejax._io.mjcf_files import Folders, checked_mjcf, folders_of
from kanejax._io.repair import compile_with_stated_inertias
from kanejax._io.unsupported import refused_features, unmodelled_features
from kanejax._io.urdf import prepared_urdf
from kanejax._io.xml_text import check_encoding, file_content, parsed_xml

_WITH_USER_DATA = ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")


@dataclasses.dataclass(frozen=True)
class CompiledSource:
    """A compiled model with every link of its file as a body, and what differs from the file.

    `mj_model` carries the masses and inertias that the file states, also where MuJoCo alone would refuse them;
    `inertials` repeats those, by body id. `ignored` has a sentence for each feature of the file that is not modelled, those
    that change the dynamics first, which are also in `refused`; `repaired` has one for each number that was changed.
    `origin` is the file or what else it was.
    """

    mj_model: mujoco.MjModel
    inertials: dict[int, Inertial]
    ignored: tuple[str, ...]
    repaired: tuple[str, ...]
    refused: tuple[str, ...] = ()
    origin: str = ""


@dataclasses.dataclass(frozen=True)
class _Opened:
    """A spec before compiling, the name of its origin for errors, and the sentences so far.

    `folders` are where its files may lie; None for a spec that the caller made, who knows what it reads.
    """

    spec: mujoco.MjSpec
    origin: str
    refused: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()
    repaired: tuple[str, ...] = ()
    folders: Folders | None = None


def compile_source(
    source: str | os.PathLike[str] | mujoco.MjSpec,
    *,
    strict: bool = True,
    repair: bool = False,
    allow_unphysical: bool = False,
) -> CompiledSource:
    """Compile a path to a URDF or MJCF file, a string of such XML, or an MjSpec, which is left as it is.

    With `strict`, a feature that changes the dynamics and is not modelled raises UnsupportedModelError; without, it is
    listed in `ignored`. A body's numbers that no rigid body can have, or that leave the mass matrix singular, raise
    InvalidInertiaError; `repair` changes them by the least that helps and lists each change, `allow_unphysical` keeps
    those that leave the mass matrix regular and warns with UnphysicalInertiaWarning. Raises ModelFileError for
    anything else that is wrong with the file. Mesh files are not read unless the inertia of a moving body comes from
    them, and no file is from outside of the folder of an MJCF.
    """
    opened = _opened(source, repair)
    spec = opened.spec
    spec.compiler.fusestatic = False
    _leave_out_sizes(spec)
    needed, unread = without_unneeded_files(spec)
    if opened.folders is not None:
        check_needed_files(spec, needed, opened.folders, opened.origin)
    result = compile_with_stated_inertias(spec, opened.origin, repair=repair, allow_unphysical=allow_unphysical)
    mj_model = with_flags_applied(result.mj_model)
    refused = (*opened.refused, *refused_features(mj_model))
    if strict and refused:
        raise UnsupportedModelError(
            f"{opened.origin}: {'; '.join(refused)}. Remove it from the file, or load with strict=False to ignore it"
        )
    ignored = (*refused, *opened.ignored, *unread, *result.ignored, *unmodelled_features(mj_model))
    repaired = (*opened.repaired, *result.repaired)
    return CompiledSource(mj_model, result.inertials, ignored, repaired, refused, opened.origin)


def _opened(source: str | os.PathLike[str] | mujoco.MjSpec, repair: bool) -> _Opened:
    if not isinstance(source, str | os.PathLike):
        if not isinstance(source, mujoco.MjSpec):
            raise TypeError(
                f"cannot load from {type(source).__name__}: give a path, XML text or an MjSpec; from_mujoco takes an MjModel"
            )
        return _Opened(source.copy(), "MjSpec")
    if isinstance(source, str) and source.lstrip().startswith("<"):
        data = _declaration_first(source)
        return _opened_xml(data, None, data, "XML string", repair)
    return _opened_xml(file_content(source), Path(source), "", str(source), repair)


def _opened_xml(data: bytes | str, path: Path | None, xml: str, origin: str, repair: bool) -> _Opened:
    """Let MuJoCo read an MJCF from `path`, or without one from `xml`, and a URDF from what is left of `data`."""
    root = parsed_xml(data, origin)
    if root.tag == "robot":
        prepared = prepared_urdf(root, origin, repair=repair)
        spec, warned = _spec(prepared.xml, None, origin)
        return _Opened(spec, origin, prepared.refused, (*prepared.ignored, *warned), prepared.repaired)
    if root.tag == "mujoco":
        if isinstance(data, bytes):
            check_encoding(data, origin)
        folders = checked_mjcf(root, folders_of(path), origin)
        spec, warned = _spec(xml, path, origin)
        return _Opened(spec, origin, ignored=tuple(warned), folders=folders)
    raise ModelFileError(f"{origin}: the root element is <{root.tag}>; a URDF starts with <robot>, an MJCF with <mujoco>")


def _leave_out_sizes(spec: mujoco.MjSpec) -> None:
    """Undo what a file says of memory, and of lengths of actuators, which take as long to find as the file likes."""
    for name in ("memory", "nemax", "njmax", "nconmax", "nstack", *(f"nuser_{of}" for of in _WITH_USER_DATA)):
        setattr(spec, name, 0 if name == "nemax" else -1)
    spec.nuserdata = spec.nkey = 0
    spec.compiler.LRopt.mode = mujoco.mjtLRMode.mjLRMODE_NONE


def _declaration_first(xml: str) -> str:
    """Remove what stands before an XML declaration; without one, keep the text, so that line numbers stay."""
    return xml.lstrip() if xml.lstrip().startswith("<?xml") else xml


def _spec(xml: str, path: Path | None, origin: str) -> tuple[mujoco.MjSpec, list[str]]:
    """Let MuJoCo read a file, so that it finds what the file includes, or else a string; also what it warns of."""
    try:
        with mujoco_warnings() as warned:
            # Of a path that is not absolute, MuJoCo forgets in places what it is relative to.
            return mujoco.MjSpec.from_string(xml) if path is None else mujoco.MjSpec.from_file(str(path.absolute())), warned
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise ModelFileError(f"{origin}: MuJoCo cannot read the model: {one_line(error)}") from error
