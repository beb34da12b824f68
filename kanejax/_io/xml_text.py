"""Reading XML text safely: no DOCTYPE or ENTITY declarations, line numbers in errors, numbers checked by name."""

import math
import os
import xml.parsers.expat
from pathlib import Path
from xml.etree import ElementTree

from kanejax._errors import ModelFileError


def file_content(path: str | os.PathLike) -> bytes:
    """Read a file; raises ModelFileError if there is none."""
    try:
        return Path(path).read_bytes()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        # The path may be text of any length.
        name = str(path)[:200] or "an empty path"
        raise ModelFileError(f"{name}: cannot be read ({reason}); give a path to a URDF or MJCF file, or the XML itself") from error


def parsed_xml(data: bytes | str, origin: str) -> ElementTree.Element:
    """Parse XML from `data`; `origin` names the file in errors.

    Raises ModelFileError for malformed XML, with its line, and for any DOCTYPE: entity definitions can expand without
    bound.
    """

    def refuse_doctype(*_: object) -> None:
        raise ModelFileError(f"{origin}: the XML has a DOCTYPE declaration, which is not accepted; remove it")

    checker = xml.parsers.expat.ParserCreate()
    checker.StartDoctypeDeclHandler = refuse_doctype
    try:
        # The whole text is checked before the tree is built, so that no entity is ever expanded.
        checker.Parse(data, True)
    except xml.parsers.expat.ExpatError as error:
        reason = f"line {error.lineno}, column {error.offset} is not well-formed XML: {xml.parsers.expat.ErrorString(error.code)}"
        raise ModelFileError(f"{origin}: {reason}; correct it") from error
    return ElementTree.fromstring(data)


def check_included_files(root: ElementTree.Element, folder: Path) -> None:
    """Check the files that an MJCF includes, and those that they include, as `parsed_xml` does.

    MuJoCo looks for them from `folder`, that of the main file. Files that are not there are left for MuJoCo to report.
    """
    files = [element.get("file", "") for element in root.iter("include")]
    seen: set[Path] = set()
    while files:
        path = folder / files.pop()
        if path in seen or not path.is_file():
            continue
        seen.add(path)
        included = parsed_xml(path.read_bytes(), str(path))
        files += [element.get("file", "") for element in included.iter("include")]


def text_of(element: ElementTree.Element, attribute: str, owner: str) -> str:
    """Return a required attribute; `owner` names the element in the error."""
    value = element.get(attribute, "").strip()
    if not value:
        raise ModelFileError(f"{owner}: <{element.tag}> lacks {attribute}=...; write it")
    return value


def numbers_of(element: ElementTree.Element, attribute: str, count: int, owner: str) -> list[float]:
    """Return `count` finite numbers of a required attribute; `owner` names the element in the error."""
    value = text_of(element, attribute, owner)
    try:
        numbers = [float(word) for word in value.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        raise ModelFileError(f"{owner}: <{element.tag} {attribute}={value!r}> is not {expected}; correct it")
    return numbers
