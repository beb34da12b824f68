"""Compiling a MuJoCo spec without reading the mesh, texture and height field files that the dynamics do not need.

They need such a file only where a moving body takes its inertia from a mesh. Every other one is not read, whether it is
there or not: its shape is replaced by a massless sphere that cannot collide, so that names which sensors and contact pairs
refer to stay.
"""

import contextlib
import math
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path

import mujoco

from kanejax._errors import ModelFileError
from kanejax._io.mjcf_files import Folders, permitted_file

_COMPILE_ERRORS = (ValueError, RuntimeError, mujoco.FatalError)
_MOST_NAMES = 8
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


def without_unneeded_files(spec: mujoco.MjSpec) -> tuple[dict[str, str], list[str]]:
    """Delete from `spec`, in place, shapes and pictures from files, and all pictures, but meshes that an inertia needs.

    Returns the names of the meshes that are left, each with the name of a body whose inertia depends on it, and in a sentence
    what was deleted.
    """
    needed = _meshes_for_inertia(spec)
    files = [file for file in _files(spec) if file not in {spec.mesh(mesh).file for mesh in needed}]
    _drop_files(spec, set(needed))
    listed = ", ".join(repr(file) for file in files[:_MOST_NAMES]) + (", ..." if len(files) > _MOST_NAMES else "")
    return needed, [f"shapes and pictures from files are not read, as no inertia needs them: {listed}"] if files else []


def check_needed_files(spec: mujoco.MjSpec, needed: dict[str, str], folders: Folders, origin: str) -> None:
    """Refuse mesh files that inertias need and that lie outside of the model's folder; `needed` is from the function above."""
    for name, body in needed.items():
        mesh = spec.mesh(name)
        if mesh.file and mesh.file not in spec.assets:
            bases = [base / mesh.compiler.meshdir for base in folders.bases]
            # Of parts from other files it is not known whether they strip paths.
            stripped = spec.strippath and len(bases) == 1
            for file in (Path(mesh.file).name,) if stripped else (mesh.file, Path(mesh.file).name):
                permitted_file(file, bases, folders.roots, f"{origin}: body {body!r}, whose inertia is that of mesh {name!r},")


def compiled(spec: mujoco.MjSpec, origin: str) -> tuple[mujoco.MjModel, list[str]]:
    """Compile `spec`, and say in sentences what was warned of.

    Raises ModelFileError with MuJoCo's message, and with the body and file where an inertia depends on an unreadable
    file.
    """
    # A spec cannot be read after it failed to compile.
    files = {spec.mesh(mesh).file: body for mesh, body in _meshes_for_inertia(spec).items()} if spec.meshes else {}
    try:
        with mujoco_warnings() as warned:
            return spec.compile(), warned
    except _COMPILE_ERRORS as error:
        message = one_line(error)
        for file, body in files.items():
            if file and file in message:
                raise ModelFileError(
                    f"{origin}: body {body!r} takes its inertia from mesh file {file!r}, which cannot be read; "
                    f"provide the file or write an <inertial>: {message}"
                ) from error
        raise ModelFileError(f"{origin}: MuJoCo cannot compile the model: {message}") from error


def one_line(message: Exception | str) -> str:
    """Return a message on one line."""
    return ", ".join(line.strip() for line in str(message).splitlines() if line.strip())


def bodies_and_motion(spec: mujoco.MjSpec) -> list[tuple[mujoco.MjsBody, bool]]:
    """Return the bodies in the order of their ids after compiling, each with whether any joint moves it."""
    found: list[tuple[mujoco.MjsBody, bool]] = []
    # A chain of bodies may be longer than Python's functions can call one another.
    waiting = [(spec.worldbody, False)]
    while waiting:
        body, moves = waiting.pop()
        found.append((body, moves))
        waiting += [(child, moves or bool(child.joints)) for child in reversed(body.bodies)]
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
    # Of names that mean no mesh, MuJoCo tells.
    names = {mesh.name for mesh in spec.meshes}
    for index, (body, moves) in enumerate(bodies_and_motion(spec)):
        if moves and takes_inertia_from_geoms(body):
            for geom in body.geoms:
                if geom.meshname in names and _has_mass(geom, body.compiler):
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
