"""Where the mesh files of a robot are looked for: beside it, in its packages, and nowhere else."""

import dataclasses
import os
from pathlib import Path
from urllib.parse import unquote, urlsplit

from kanejax._errors import ModelFileError
from kanejax._io.mjcf_files import folders_of, permitted_file

_PACKAGE = "package://"


@dataclasses.dataclass(frozen=True)
class MeshFolders:
    """Folders that mesh files may be read from.

    Attributes:
        robot: the file of the robot; None for XML text, which reads nothing.
        packages: folders that hold packages of ROS, or are one, and that the user named.
    """

    robot: Path | None
    packages: tuple[Path, ...] = ()

    def file(self, name: str) -> Path:
        """The file that a URDF calls `name`: a path, file:// or package://.

        A package is a folder of its name above the robot's file, or one that the user named, or one in that.

        Raises:
            ModelFileError: there is none, or it lies outside of these folders.
        """
        if name.startswith(_PACKAGE):
            package, _, rest = name[len(_PACKAGE) :].lstrip("/").partition("/")
            bases = self._package(package)
            if not bases:
                raise ModelFileError(f"the package {package!r} of meshes is not found; name its folder with packages=")
            roots = tuple(base.resolve() for base in bases)
        else:
            rest = unquote(urlsplit(name).path) if name.startswith("file://") else name
            beside = folders_of(self.robot)
            bases = (*beside.bases, *self.packages)
            roots = (*beside.roots, *(folder.resolve() for folder in self.packages))
        # One of several folders may have it, and from another the name may lead out of all of them.
        answers = [_answer(rest, base, roots) for base in bases]
        found = next((each for each in answers if isinstance(each, Path)), None)
        if found is not None:
            return found
        if any(answers):
            listed = ", ".join(f"{str(root)!r}" for root in roots)
            raise ModelFileError(f"{name!r} is no file in {listed}; copy it there, or name its folder with packages=")
        raise ModelFileError(f"{name!r} is not there")

    def _package(self, package: str) -> tuple[Path, ...]:
        if package in ("", os.curdir, os.pardir):
            return ()
        named = [folder for each in self.packages for folder in (each, each / package) if folder.absolute().name == package]
        above = [] if self.robot is None else [each for each in self.robot.absolute().parents if each.name == package]
        return tuple(folder for folder in (*named, *above) if folder.is_dir())


def _answer(name: str, base: Path, roots: tuple[Path, ...]) -> Path | str:
    """A file, nothing if there is none, or why it may not be read."""
    try:
        return permitted_file(name, (base,), roots, "a visual") or ""
    except ModelFileError as error:
        return str(error)
