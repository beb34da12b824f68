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

    def file(self, name: str, owner: str) -> Path:
        """The file that a URDF calls `name`: a path, file:// or package://.

        A package is a folder of its name above the robot's file, or one that the user named, or one in that.

        Raises:
            ModelFileError: there is none, or it lies outside of these folders.
        """
        if name.startswith(_PACKAGE):
            package, _, rest = name[len(_PACKAGE) :].partition("/")
            bases = self._package(package)
            if not bases:
                raise ModelFileError(f"{owner} needs {name!r}, and no folder of packages has {package!r}; give one with packages=")
            roots = tuple(base.resolve() for base in bases)
        else:
            rest = unquote(urlsplit(name).path) if name.startswith("file://") else name
            beside = folders_of(self.robot)
            bases = (*beside.bases, *self.packages)
            roots = (*beside.roots, *(folder.resolve() for folder in self.packages))
        # One of several folders may have it, and from another the name may lead out of all of them.
        found = next((each for each in (_found(rest, base, roots, owner) for base in bases) if each), None)
        found = found or permitted_file(rest, bases, roots, owner)
        if found is None:
            raise ModelFileError(f"{owner} needs {name!r}, which is not there")
        return found

    def _package(self, package: str) -> tuple[Path, ...]:
        if package in ("", os.curdir, os.pardir):
            return ()
        named = [folder for each in self.packages for folder in (each, each / package) if folder.absolute().name == package]
        above = [] if self.robot is None else [each for each in self.robot.absolute().parents if each.name == package]
        return tuple(folder for folder in (*named, *above) if folder.is_dir())


def _found(name: str, base: Path, roots: tuple[Path, ...], owner: str) -> Path | None:
    try:
        return permitted_file(name, (base,), roots, owner)
    except ModelFileError:
        return None
