"""The files that an MJCF file names: those that MuJoCo may read, and what is in those that are MJCF too.

Files are read from the folder of the file that the user named, and from below it; of a file that is a link, also from the folder
that it links to. What leads elsewhere, by an absolute path, by "..", or by a link, is refused: a robot from somebody else
must not read what it likes. XML text has no folder and reads nothing.
"""

import dataclasses
import os
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

from kanejax._errors import ModelFileError, UnsupportedModelError
from kanejax._io.mjcf_size import MjcfDocument, check_size
from kanejax._io.xml_text import check_encoding, parsed_xml

_REMEDY = "copy it there, or read the model with mujoco.MjSpec.from_file and load the spec"


@dataclasses.dataclass(frozen=True)
class Folders:
    """Where files may lie, `roots`, none for XML text; and `bases`, from which MuJoCo looks for the files of a model's parts."""

    roots: tuple[Path, ...]
    bases: tuple[Path, ...] = ()


def folders_of(path: Path | None) -> Folders:
    """The folders of a file that the user named; None for XML text."""
    if path is None:
        return Folders(())
    return Folders(tuple(dict.fromkeys((path.parent.resolve(), path.resolve().parent))), (path.absolute().parent,))


def permitted_file(name: str, bases: Iterable[Path], roots: tuple[Path, ...], owner: str) -> Path | None:
    """The file called `name` in the first of `bases` that has it, None if there is none.

    Raises ModelFileError if it lies outside of `roots`, or is no file: devices and pipes never end.
    """
    if not roots:
        raise ModelFileError(
            f"{owner} names the file {name!r}, but XML text reads no files; write it to a file beside those it needs"
        )
    # MuJoCo takes either slash for one.
    candidates = [base / name.replace("\\", "/") for base in bases]
    inside = [candidate for candidate in candidates if _is_below(candidate, roots)]
    found = [candidate for candidate in candidates if os.path.lexists(candidate)]
    outside = [candidate for candidate in found if candidate not in inside]
    if outside or not inside:
        raise ModelFileError(f"{owner} names the file {name!r}, which lies outside of {str(roots[0])!r}; {_REMEDY}")
    if found and not found[0].is_file():
        raise ModelFileError(f"{owner} names {name!r}, which is no file; correct the name")
    return found[0] if found else None


def checked_mjcf(root: ElementTree.Element, folders: Folders, origin: str) -> Folders:
    """Check an MJCF, the files that it includes or takes parts from, and how large all of it is; return all folders to look in.

    Files that are not there are left for MuJoCo to report. Raises ModelFileError for a file outside of the folder, or that
    `parsed_xml` refuses, for parts that contain themselves, and for a model that is too large.
    """
    reader = _Reader(folders, {})
    base = folders.bases[0] if folders.bases else Path()
    document = reader.document(root, base, origin, ())
    check_size(document, origin)
    return Folders(folders.roots, tuple(dict.fromkeys([*folders.bases, *reader.documents_folders()])))


@dataclasses.dataclass
class _Reader:
    """Reads MJCF files, each once; `models` are those that others take parts from, by path."""

    folders: Folders
    models: dict[Path, MjcfDocument]

    def documents_folders(self) -> list[Path]:
        return [path.parent for path in self.models]

    def document(self, root: ElementTree.Element, base: Path, origin: str, within: tuple[Path, ...]) -> MjcfDocument:
        """Read what `root` includes, and then the models that it names; `within` are the files that take parts from it."""
        roots, seen = [root], set()
        for each in roots:
            for element in each.iter("include"):
                path = self._file(element, base, origin)
                # MuJoCo refuses files that are included twice.
                if path is not None and path not in seen:
                    seen.add(path)
                    roots.append(_parsed_file(path))
        models = {}
        for each in roots:
            for element in each.iter("flexcomp"):
                if element.get("file") is not None:
                    owner = f"{origin}: flexcomp {element.get('name', '')!r}"
                    raise UnsupportedModelError(f"{owner} is a deformable body from a file, which cannot be left out; remove it")
            for element in each.iter("model"):
                path = self._file(element, base, origin)
                if path is not None:
                    models[element.get("name", path.stem)] = self._model(path, origin, within)
        return MjcfDocument(tuple(roots), models)

    def _model(self, path: Path, origin: str, within: tuple[Path, ...]) -> MjcfDocument:
        path = path.resolve()
        if path in within:
            raise ModelFileError(f"{origin}: the model {str(path)!r} takes parts from itself; remove <model> or <attach>")
        if path not in self.models:
            root = _parsed_file(path)
            if root.tag != "mujoco":
                raise ModelFileError(f"{path}: the root element is <{root.tag}>; an MJCF starts with <mujoco>")
            self.models[path] = self.document(root, path.parent, str(path), (*within, path))
        return self.models[path]

    def _file(self, element: ElementTree.Element, base: Path, origin: str) -> Path | None:
        name = element.get("file", "")
        # MuJoCo says what is wrong with an element without a file.
        return permitted_file(name, (base,), self.folders.roots, f"{origin}: <{element.tag}>") if name else None


def _parsed_file(path: Path) -> ElementTree.Element:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ModelFileError(f"{path}: cannot be read ({error.strerror})") from error
    check_encoding(data, str(path))
    return parsed_xml(data, str(path))


def _is_below(path: Path, roots: tuple[Path, ...]) -> bool:
    try:
        # MuJoCo takes ".." for the folder above in the text of a path, the system for the one above in the files.
        resolved = [path.resolve(), Path(os.path.normpath(path)).resolve()]
    except (OSError, ValueError, RuntimeError):
        # Such as links in a circle, or a name with a null character.
        return False
    return all(any(each.is_relative_to(root) for root in roots) for each in resolved)
