"""Compiling a MuJoCo spec whose mesh, texture or height field files may be missing.

The dynamics need such a file only where a moving body takes its inertia from a mesh. Everywhere else an unreadable
file is no reason to refuse the model: its shape is replaced by a massless sphere that cannot collide, so that names
which sensors and contact pairs refer to stay.
"""

import contextlib
import math
import threading
import warnings
from collections.abc import Iterator

import mujoco

from kanejax._errors import ModelFileError

_COMPILE_ERRORS = (ValueError, RuntimeError, mujoco.FatalError)
# The function that MuJoCo calls with its warnings is one for the whole process.
_WARNINGS_LOCK = threading.Lock()


@contextlib.contextmanager
def mujoco_warnings() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings as sentences in a list, which is complete once the block is left.

    Otherwise some would be printed and written to a file in the working folder, and others, such as of deprecated
    attributes, would become Python warnings, and so exceptions for callers who ask for that; but the model is what its
    file says.
    """
    sentences: list[str] = []
    heard: list[str] = []
    with _WARNINGS_LOCK, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(heard.append)
        try:
            yield sentences
        finally:
            mujoco.set_mju_user_warning(before)
            messages = dict.fromkeys([*heard, *(str(warning.message) for warning in caught)])
            sentences += [f"MuJoCo warns: {one_line(message)}" for message in messages]


def compiled(spec: mujoco.MjSpec, origin: str) -> tuple[mujoco.MjModel, list[str]]:
    """Compile `spec`, and say in sentences what was dropped and warned of; `spec` is edited where files cannot be read.

    Raises ModelFileError with MuJoCo's message, and with the body and file where an inertia depends on an unreadable
    file.
    """
    with mujoco_warnings() as warned:
        mj_model, dropped = _compiled(spec, origin)
    return mj_model, dropped + warned


def _compiled(spec: mujoco.MjSpec, origin: str) -> tuple[mujoco.MjModel, list[str]]:
    try:
        # A spec cannot be read after it failed to compile, so the first try is on a copy.
        return spec.copy().compile(), []
    except _COMPILE_ERRORS as error:
        first_message = one_line(error)
        if not _files(spec):
            raise ModelFileError(f"{origin}: MuJoCo cannot compile the model: {first_message}") from error
    needed = _meshes_for_inertia(spec)
    _drop_files(spec, set(needed))
    try:
        mj_model = spec.compile()
    except _COMPILE_ERRORS as error:
        message = one_line(error)
        for mesh, body in needed.items():
            file = spec.mesh(mesh).file
            if message == first_message and file and file in message:
                raise ModelFileError(
                    f"{origin}: body {body!r} takes its inertia from mesh file {file!r}, which cannot be read; "
                    f"provide the file or write an <inertial>: {message}"
                ) from error
        raise ModelFileError(f"{origin}: MuJoCo cannot compile the model: {message}") from error
    return mj_model, [f"shapes from files are dropped, as not every file can be read; no inertia needs them: {first_message}"]


def one_line(message: Exception | str) -> str:
    """Return a message on one line."""
    return ", ".join(line.strip() for line in str(message).splitlines() if line.strip())


def bodies_and_motion(spec: mujoco.MjSpec) -> list[tuple[mujoco.MjsBody, bool]]:
    """Return the bodies in the order of their ids after compiling, each with whether any joint moves it."""
    found = [(spec.worldbody, False)]

    def visit(parent: mujoco.MjsBody, parent_moves: bool) -> None:
        for body in parent.bodies:
            moves = parent_moves or bool(body.joints)
            found.append((body, moves))
            visit(body, moves)

    visit(spec.worldbody, False)
    return found


def takes_inertia_from_geoms(body: mujoco.MjsBody) -> bool:
    """Return whether the compiler computes the inertia of a body from geoms that have mass."""
    rule = body.compiler.inertiafromgeom
    if rule == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE:
        return False
    # The position of the inertial frame is NaN until something states it.
    if rule == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO and not math.isnan(body.ipos[0]):
        return False
    return any(_has_mass(geom, body.compiler) for geom in body.geoms)


def _has_mass(geom: mujoco.MjsGeom, compiler: mujoco.MjsCompiler) -> bool:
    first_group, last_group = compiler.inertiagrouprange
    mass = geom.density if math.isnan(geom.mass) else geom.mass
    return bool(mass > 0 and first_group <= geom.group <= last_group)


def _files(spec: mujoco.MjSpec) -> list[str]:
    textures = [file for texture in spec.textures for file in (texture.file, *texture.cubefiles) if file]
    return [asset.file for asset in (*spec.meshes, *spec.hfields, *spec.skins) if asset.file] + textures


def _meshes_for_inertia(spec: mujoco.MjSpec) -> dict[str, str]:
    """Return the names of meshes that inertias of moving bodies depend on, each with the name of such a body."""
    needed: dict[str, str] = {}
    for index, (body, moves) in enumerate(bodies_and_motion(spec)):
        if moves and takes_inertia_from_geoms(body):
            for geom in body.geoms:
                if geom.meshname and _has_mass(geom, body.compiler):
                    needed.setdefault(geom.meshname, body.name or f"number {index}")
    return needed


def _drop_files(spec: mujoco.MjSpec, needed_meshes: set[str]) -> None:
    dropped_meshes = {mesh.name for mesh in spec.meshes if mesh.file} - needed_meshes
    for geom in spec.geoms:
        if geom.meshname in dropped_meshes or geom.hfieldname:
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [1e-3, 0, 0]
            geom.meshname = geom.hfieldname = ""
            geom.mass, geom.contype, geom.conaffinity = 0.0, 0, 0
    for site in spec.sites:
        if getattr(site, "meshname", "") in dropped_meshes:
            site.type, site.size, site.meshname = mujoco.mjtGeom.mjGEOM_SPHERE, [1e-3, 0, 0], ""
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    meshes = [mesh for mesh in spec.meshes if mesh.name in dropped_meshes]
    for asset in (*meshes, *spec.hfields, *spec.textures, *spec.skins):
        spec.delete(asset)
