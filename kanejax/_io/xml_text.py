"""Reading XML text safely: no DOCTYPE, no endless nesting, line numbers in errors, numbers checked by name."""

import math
import os
import re
import xml.parsers.expat
from pathlib import Path
from xml.etree import ElementTree

from kanejax._errors import ModelFileError

# As deep as MuJoCo's reader of XML goes.
_DEEPEST = 500


def file_content(path: str | os.PathLike[str]) -> bytes:
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

    Names keep their prefixes, as MuJoCo reads them: with namespaces carried out, elements could be hidden from our checks.

    Raises ModelFileError for malformed XML, with its line, for elements nested more than 500 deep, as MuJoCo does, and for any
    DOCTYPE: entity definitions can expand without bound, and name other files.
    """
    parser, builder = xml.parsers.expat.ParserCreate(), ElementTree.TreeBuilder()
    depth = 0

    def refuse_doctype(*_: object) -> None:
        raise ModelFileError(f"{origin}: the XML has a DOCTYPE declaration, which is not accepted; remove it")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            line = parser.CurrentLineNumber
            raise ModelFileError(f"{origin}: line {line}: <{tag}> is nested more than {_DEEPEST} elements deep; flatten the file")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, builder.data
    try:
        parser.Parse(data, True)
    except xml.parsers.expat.ExpatError as error:
        reason = f"line {error.lineno}, column {error.offset} is not well-formed XML: {xml.parsers.expat.ErrorString(error.code)}"
        raise ModelFileError(f"{origin}: {reason}; correct it") from error
    except (ValueError, LookupError) as error:
        # Of encodings; a named error of ours is a ValueError too.
        if isinstance(error, ModelFileError):
            raise
        raise ModelFileError(f"{origin}: its text cannot be decoded ({error}); write it in UTF-8") from error
    return builder.close()


def check_encoding(data: bytes, origin: str) -> None:
    """Refuse what MuJoCo, which takes every text for UTF-8, would read as another text than `parsed_xml`."""
    declared = re.match(rb"""[^>]*?encoding\s*=\s*["']([^"']*)["']""", data[: data.find(b"?>") + 1])
    name = declared[1].decode("ascii", "replace").lower() if declared else "utf-8"
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ModelFileError(f"{origin}: it is not in UTF-8 ({error}), which MuJoCo needs; convert it") from error
    if name not in ("utf-8", "utf8", "us-ascii", "ascii") or b"\0" in data:
        raise ModelFileError(f"{origin}: its encoding is {name!r}, but MuJoCo needs UTF-8; convert it")


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
