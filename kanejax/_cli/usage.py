"""How the command line is asked for: its commands in the order of the work, and wrong usage told in one line."""

import sys
from typing import Any

import typer
from typer.core import TyperGroup

from kanejax._cli.terminal import complain


class Commands(TyperGroup):
    """Commands whose usage errors are one line, as all other errors are: the cause, and where the remedy is told."""

    def main(self, *args: Any, standalone_mode: bool = True, **options: Any) -> Any:
        """Run a command; see `typer.core.TyperGroup.main`."""
        if not standalone_mode:
            return super().main(*args, standalone_mode=False, **options)
        try:
            code = super().main(*args, standalone_mode=False, **options)
        except Exception as error:
            # Typer has a copy of click in it, or click beside it, by its version: the errors are known by what they can.
            if not hasattr(error, "format_message"):
                raise
            if type(error).__name__ == "NoArgsIsHelpError":
                error.show()  # pyright: ignore[reportAttributeAccessIssue]
            else:
                complain(_sentence(error))
            code = error.exit_code  # pyright: ignore[reportAttributeAccessIssue]
        sys.exit(code if isinstance(code, int) else 0)


def print_version(wanted: bool) -> bool:
    """Print the versions of the package and of what its results depend on, and exit."""
    if wanted:
        from kanejax._identify.record import versions

        print(", ".join(f"{name} {version}" for name, version in versions().items()))
        raise typer.Exit
    return wanted


def _sentence(error: Any) -> str:
    message = error.format_message().strip().rstrip(".")
    context = getattr(error, "ctx", None)
    end = "" if message.endswith("?") else ";"
    usage = "" if context is None else f"{end} {context.command_path} --help tells the usage"
    return f"{message[0].lower()}{message[1:]}{usage}"
