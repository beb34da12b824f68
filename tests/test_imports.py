"""Imports point one way along the flow, from files and models to simulation and identification; heavy ones wait for their use."""

import ast
import pathlib
import subprocess
import sys

import kanejax

PACKAGE = pathlib.Path(kanejax.__file__).parent
MODEL = {"_types", "_model", "_evaluate", "_dynamics", "_kinematics"}
# What each part may import, besides itself.
BELOW = {
    "_errors": set(),
    "_types": set(),
    "_scalar": {"_types"},
    "_sharding": set(),
    "_lanes": set(),
    "_fingerprint": set(),
    "_whole_file": set(),
    "_checkpoint": {"_fingerprint", "_whole_file", "_errors"},
    "_kernels": set(),
    "_batching": {"_kernels", "_sharding"},
    "_expressions": set(),
    "_symbolic": {"_expressions", "_batching"},
    "_operation_count": {"_expressions", "_symbolic", "_model"},
    "_model": {"_types", "_scalar", "_errors"},
    "_recursion": {"_types", "_scalar", "_model"},
    "_evaluate": {"_batching", "_model"},
    "_kinematics": {"_types", "_scalar", "_model", "_recursion", "_evaluate"},
    "_dynamics": {"_types", "_scalar", "_model", "_recursion", "_evaluate", "_kinematics"},
    "_simulate": {"_types", "_scalar", "_model", "_recursion", "_evaluate", "_kinematics", "_dynamics", "_lanes", "_errors"},
    "_mesh": set(),
    "distributions": set(),
    "_dataset": {"distributions", "_simulate", "_model", "_dynamics", "_lanes"}
    | {"_fingerprint", "_whole_file", "_toml", "_errors", "__version__"},
    "_logs": {"_model", "_errors"},
    "_parameters": {"_types", "_scalar", "_model", "_evaluate", "_dynamics", "_errors"},
    "_regression": {"_checkpoint", "_logs", "_parameters", "_model", "_evaluate", "_dynamics", "_errors"},
    "_excitation": {"_regression", "_types", "_model", "_evaluate", "_dynamics", "_errors"},
    "_simulation_fit": {"_checkpoint", "_logs", "_parameters", "_regression", "_model", "_dynamics", "_simulate", "_errors"},
    "_optimal_control": set(),
    "_optimize": {"_checkpoint", "_optimal_control"} | MODEL | {"_simulate", "_lanes", "_io", "_errors"},
    "costs": {"_optimize", "_kinematics"},
    "constraints": {"_optimize", "_kinematics"},
    "_plots": {"_logs", "_optimize", "_model", "_dynamics", "_errors"},
    "_toml": {"_errors"},
    "_identify": {"_checkpoint", "_logs", "_parameters", "_regression", "_simulation_fit", "_plots", "_model", "_toml", "_errors"},
    "plots": {"_plots", "_identify"},
    "_motion_task": {
        "_optimize",
        "costs",
        "constraints",
        "_plots",
        "_identify",
        "_model",
        "_kinematics",
        "_io",
        "_toml",
        "_errors",
    },
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


def run(program: str) -> None:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_import_is_light():
    heavy = {
        "mujoco",
        "diffrax",
        "optimistix",
        "lineax",
        "rich",
        "typer",
        "scipy.signal",
        "optax",
        "matplotlib",
        "jinja2",
        "cyipopt",
        "zarr",
    }
    run(f"import sys, kanejax; assert not {heavy} & set(sys.modules)")


def test_names_imported_on_use_are_found_in_every_way():
    run("from kanejax import simulate, validate; import kanejax; assert kanejax.simulate is simulate; assert callable(validate)")
    assert {"load", "simulate", "mass_matrix"} <= set(dir(kanejax))
    assert all(hasattr(kanejax, name) for name in dir(kanejax))
    assert not hasattr(kanejax, "simulat")


def test_type_checkers_see_the_names_imported_on_use():
    (branch,) = (node for node in ast.parse((PACKAGE / "__init__.py").read_text()).body if isinstance(node, ast.If))
    seen = {alias.name: node.module for node in branch.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert seen == vars(kanejax)["_MODULES"]
