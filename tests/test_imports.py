"""Imports point one way along the flow: files, model, kinematics, dynamics, simulation."""

import ast
import pathlib

import kanejax

PACKAGE = pathlib.Path(kanejax.__file__).parent
# What each part may import, besides itself.
BELOW = {
    "_errors": set(),
    "_types": set(),
    "_scalar": {"_types"},
    "_batching": set(),
    "_model": {"_types", "_scalar", "_errors"},
    "_recursion": {"_types", "_scalar", "_model"},
    "_evaluate": {"_batching", "_model"},
    "_kinematics": {"_types", "_scalar", "_model", "_recursion", "_evaluate"},
    "_dynamics": {"_types", "_scalar", "_model", "_recursion", "_evaluate", "_kinematics"},
    "_simulate": {"_types", "_scalar", "_model", "_recursion", "_evaluate", "_kinematics", "_dynamics", "_errors"},
}


def imported(path: pathlib.Path) -> set[str]:
    parts = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("kanejax"):
            rest = (node.module or "").split(".")[1:]
            parts |= {rest[0]} if rest else {alias.name for alias in node.names}
    return parts


def test_imports_point_backwards():
    for part, allowed in BELOW.items():
        files = [PACKAGE / f"{part}.py"] if (PACKAGE / f"{part}.py").exists() else list((PACKAGE / part).rglob("*.py"))
        assert files, part
        for path in files:
            beyond = imported(path) - allowed - {part}
            assert not beyond, f"{path.relative_to(PACKAGE)} imports {', '.join(sorted(beyond))}"
