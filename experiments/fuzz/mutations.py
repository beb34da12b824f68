"""Changes to text and bytes that no writer of files makes on purpose."""

import re

import numpy as np

NUMBERS = (
    *("nan", "inf", "-inf", "NaN", "1e308", "-1e308", "1e309", "1e-320", "-0", "0", "-1", "1", "1e15", "2147483648", "4294967297"),
    *(
        "",
        "abc",
        "0x10",
        "1_000",
        "1,5",
        "1e",
        "--1",
        "\u0661\u0662",
        "9" * 400,
        "0." + "3" * 3000,
        "1e99999",
        "true",
        "None",
        "\u00bd",
    ),
    *("100000000", "1000000000000", "3 4", "1 2 3 4 5 6 7 8 9", "[1, 2]", "1e-300", "180", "2.5"),
)
NAMES = (
    "",
    "world",
    "base",
    "..",
    "/",
    "a" * 5000,
    "\u00e9",
    "name with blanks",
    "%s%n",
    "{joint}",
    "\u202e",
    "0",
    "x/../y",
    "hinge",
)
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def number(random: np.random.Generator) -> str:
    """One that loaders may not expect."""
    return str(random.choice(NUMBERS))


def changed_numbers(data: bytes, random: np.random.Generator) -> bytes:
    """Replace some of the numbers in a text."""
    places = list(_NUMBER.finditer(data))
    for index in (
        sorted(random.choice(len(places), min(len(places), int(random.integers(1, 4))), replace=False), reverse=True)
        if places
        else ()
    ):
        begin, end = places[index].span()
        data = data[:begin] + number(random).encode() + data[end:]
    return data


def changed_bytes(data: bytes, random: np.random.Generator) -> bytes:
    """Cut, flip, insert, repeat, or encode a file as something else."""
    place, other = (int(random.integers(0, len(data) + 1)) for _ in range(2))
    begin, end = sorted((place, other))
    match int(random.integers(0, 12)):
        case 0:
            return data[:place]
        case 1:
            flipped = bytearray(data)
            for index in random.integers(0, max(len(data), 1), int(random.integers(1, 8))) if data else ():
                flipped[index] ^= 1 << int(random.integers(0, 8))
            return bytes(flipped)
        case 2:
            return data[:begin] + data[end:]
        case 3:
            return data[:place] + random.bytes(int(random.integers(1, 9))) + data[place:]
        case 4:
            return (
                data[:place]
                + bytes(random.choice([b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\x1a", b'"', b"&", b"<", b"\n"]))
                + data[place:]
            )
        case 5:
            return b"\xef\xbb\xbf" + data
        case 6:
            return data.decode("utf-8", "replace").encode(
                str(random.choice(["utf-16", "utf-16-le", "utf-32", "cp037", "utf-7"])), "replace"
            )
        case 7:
            return data.replace(b"\n", b"\r\n")
        case 8:
            return data[:end] + data[begin:end] + data[end:]
        case 9:
            return data[:begin] + data[begin:end] * int(random.integers(2, 50)) + data[end:] if end - begin < 2000 else data[begin:]
        case 10:
            return data[end:] + data[:begin]
        case _:
            return data[:place] + bytes(random.integers(128, 256, 3, dtype=np.uint8)) + data[place:]


def changed_lines(data: bytes, random: np.random.Generator) -> bytes:
    """Delete, double, exchange or join lines, or change a key in one."""
    lines = data.split(b"\n")
    first, second = (int(random.integers(0, len(lines))) for _ in range(2))
    match int(random.integers(0, 6)):
        case 0:
            del lines[first]
        case 1:
            lines.insert(second, lines[first])
        case 2:
            lines[first], lines[second] = lines[second], lines[first]
        case 3:
            lines[first] += lines[second]
        case 4:
            lines[first] = re.sub(rb"\w+", str(random.choice(NAMES)).encode(), lines[first], count=1) if lines[first] else b"x"
        case _:
            lines[first] = lines[first][: len(lines[first]) // 2]
    return b"\n".join(lines)
