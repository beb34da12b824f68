"""Files of real robots."""

import importlib.metadata
from pathlib import Path

from kanejax._errors import UnknownNameError

_PACKAGE = "example-robot-data"


def example_file(name: str) -> Path:
    """The path of a robot's URDF in the package example-robot-data, which `pip install 'kanejax[demo]'` brings.

    Args:
        name: of the file, such as "ur10_robot.urdf" or "panda.urdf", or the end of its path where several are called alike.

    Raises:
        UnknownNameError: there is none, or there are several; the message lists the names.
        ModuleNotFoundError: the package is not installed.
    """
    try:
        files = importlib.metadata.files(_PACKAGE) or []
    except importlib.metadata.PackageNotFoundError as error:
        raise ModuleNotFoundError(
            f"example robots need the package {_PACKAGE}: pip install 'kanejax[demo]'", name=_PACKAGE
        ) from error
    urdfs = sorted({str(file): file for file in files if file.suffix == ".urdf"}.items())
    wanted = Path(name).parts
    found = [file for path, file in urdfs if Path(path).parts[-len(wanted) :] == wanted]
    if len(found) != 1:
        known = [path for path, _ in urdfs if Path(path).name == Path(name).name] if found else [file.name for _, file in urdfs]
        raise UnknownNameError("example robot", name, known)
    return Path(str(found[0].locate())).resolve()
