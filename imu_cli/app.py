"""The Typer app: finds commands in their folder, and is the only map from errors to exit codes."""

from __future__ import annotations

import ast
import gc
import io
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from imu_cli.process import prepare

COMMANDS = Path(__file__).parent / "commands"

EXIT_CODES = """\
Exit codes: 0 done · 1 a bug in imu-cal · 2 wrong usage · 3 recording refused · 4 no calibration
possible · 5 partial calibration · 6 a check said no (verify, --strict, FAIL) · 7 device ·
8 flash failed, old values restored · 9 flash failed, device state changed · 10 calibration file
refused · 11 a run of the line ended in ERROR · 130 interrupted · 143, 129 ended by SIGTERM or
SIGHUP"""

CANNOT_WRITE = 3
"""As of a recording that cannot be written."""


class LazyGroup(TyperGroup):
    """Imports a command's module only when that command is used: ``--help`` stays fast."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the verbs, from the files in ``commands/``."""
        return sorted(
            path.stem.rstrip("_").replace("_", "-")
            for path in COMMANDS.glob("*.py")
            if not path.stem.startswith("_")
        )

    def get_command(self, ctx: Any, name: str) -> Any:
        """Import the module of one verb and return its command."""
        path = _module_path(name)
        if path is None:
            return None
        import importlib

        module = importlib.import_module(f"imu_cli.commands.{path.stem}")
        verb: Any = getattr(module, path.stem)
        app = typer.Typer(add_completion=False, rich_markup_mode=None)
        app.command(name)(verb)
        command = typer.main.get_command(app)
        command.name = name
        return command

    def invoke(self, ctx: Any) -> Any:
        """Run the command; here, and only here, errors become exit codes."""
        from calib.errors import ImuError

        try:
            return super().invoke(ctx)
        except ImuError as error:
            with suppress(OSError):  # if nobody reads it, the exit code still says it
                typer.echo(f"imu-cal: {error}", err=True)
            ctx.exit(error.exit_code)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of verbs without importing any of them."""
        rows = []
        for name in self.list_commands(ctx):
            path = _module_path(name)
            if path is not None:
                rows.append((name, _first_line(path)))
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def _module_path(name: str) -> Path | None:
    stem = name.replace("-", "_")
    for candidate in (stem, f"{stem}_"):
        path = COMMANDS / f"{candidate}.py"
        if path.is_file() and not stem.startswith("_"):
            return path
    return None


def _first_line(path: Path) -> str:
    return (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n")[0]


app = typer.Typer(
    cls=LazyGroup,
    add_completion=True,
    rich_markup_mode=None,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Calibrate an IMU, and find the physics that the calibration left out.",
    epilog=EXIT_CODES,
    context_settings={"help_option_names": ["-h", "--help"]},
)


SIGNALLED = 128
"""Added to the number of a signal, what a shell shows of a command that it ended."""


def _version(value: bool) -> None:  # noqa: FBT001 - Typer calls it with the option's value
    if value:
        from importlib.metadata import version

        typer.echo(f"imu-cal {version('imu-cal')}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(  # noqa: FBT001
        False, "--version", callback=_version, is_eager=True, help="Print the version and end."
    ),
) -> None:
    pass


def main() -> NoReturn:
    """Run the command line."""
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal that knows no ± still shows numbers
    prepare()
    _end_on_signals()
    try:
        try:
            app()
        finally:
            # Python ends by SIGINT if one interrupted what `exec` ran, as dataclasses and named
            # tuples are made, caught or not; unless something else was run by it since.
            exec("")
            sys.stdout.flush()
            # Nor is anything looked for in what the end of the process frees.
            gc.freeze()
    except KeyboardInterrupt:
        sys.exit(130)
    except RuntimeError as error:
        # Python before 3.12 wraps what interrupts the making of a class, as modules are imported.
        if isinstance(error.__cause__, KeyboardInterrupt):
            sys.exit(130)
        if isinstance(error.__cause__, SystemExit):
            sys.exit(error.__cause__.code)
        raise
    except SystemExit as end:
        # Rich and click end with 1, which says a bug, when the reader of our output went away.
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        _drop_output()
    except BrokenPipeError:
        # The reader of our output went away (`| head`): end without a traceback at exit.
        _drop_output()
    except OSError as error:
        if not _is_stuck():
            raise
        typer.echo(f"imu-cal: standard output cannot be written: {error.strerror}", err=True)
        _drop_output()
        sys.exit(CANNOT_WRITE)
    sys.exit(0)


def _end_on_signals() -> None:
    """Let SIGTERM and a terminal that is closed end a command as an error would.

    Files that are half written are taken away then, ports closed. Those that are ignored stay so.
    """

    def end(number: int, frame: FrameType | None) -> NoReturn:
        sys.exit(SIGNALLED + number)

    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # one of them is not known everywhere
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, end)


def _is_stuck() -> bool:
    """Return whether standard output takes no more, not even a line end."""
    try:
        sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError:
        return True
    return False


def _drop_output() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
