"""``dslam``: the command line. Commands parse, call one library function and print; only here are errors caught."""

import contextlib
import logging
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module
from typing import Annotated

import typer

from logs.container.names import visible
from tools import main as main


class VisibleFormatter(logging.Formatter):
    """Messages of the log, in which the names of a file stand."""

    def format(self, record: logging.LogRecord) -> str:
        """One message, tracebacks included."""
        return visible(super().format(record))


BAD_INPUT, INTERNAL_ERROR = 2, 70
"""Exit codes of a command that did not end well; 1 is of a requirement that is not met."""

_ANYWHERE = ("--debug", "--verbose", "-v")
_PREFIX = __name__.removesuffix("tools.cli")
"""Of the names of our packages: "dslam." in a wheel."""

_EXTRA_OF = {"matplotlib": "pictures", "torch": "learn", "foxglove": "live", "osmium": "osm"}
"""The extra that installs each module which is not needed by all commands."""

_COMMANDS = {
    "simulate": "simulate:simulate",
    "degrade": "degrade:degrade",
    "import": "import_logs:app",
    "info": "inspection.info:info",
    "calibrate": "settings.calibrate:calibrate",
    "replay": "replay:replay",
    "live": "live:live",
    "relocalize": "relocalize:relocalize",
    "fleet": "fleet:app",
    "evaluate": "evaluation.evaluate:evaluate",
    "sweep": "lab.commands.sweep:sweep",
    "view": "results.view:view",
    "export": "results.export:export",
    "config": "settings.config:config",
    "train": "train:train",
    "benchmark": "lab.commands.app:app",
}
"""Module of this package and function, or group of commands, of each command, in the order of the help."""


def make_app(arguments: Sequence[str] = ()) -> typer.Typer:
    """The command line; with ``arguments`` only of the command that they name, as all others take time to import."""
    app = typer.Typer(
        name="dslam",
        help="Semantic SLAM: a log of odometry and object detections becomes a trajectory and an object map.",
        epilog="--verbose and --debug may also stand after the command. Exit codes: 0 success, 1 a requirement was "
        "not met, 2 invalid input.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_global_options)
    named = next((argument for argument in arguments if not argument.startswith("-")), None)
    for name in (named,) if named in _COMMANDS else _COMMANDS:
        module, _, attribute = _COMMANDS[name].partition(":")
        command = getattr(import_module(f".{module}", __package__), attribute)
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name)(command)
    return app


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"dslam {version('descriptellation-slam')}")
        raise typer.Exit


def _global_options(
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log progress to standard error.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Log every detail, and show tracebacks.")] = False,
    _version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    if verbose or debug:
        level = logging.DEBUG if debug else logging.INFO
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(VisibleFormatter("%(levelname)s %(name)s: %(message)s"))
        logging.basicConfig(level=logging.INFO, handlers=[handler])
        for package in ("slam", "logs", "descriptors", "tools"):
            logging.getLogger(f"{_PREFIX}{package}").setLevel(level)


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; any error is one line on standard error."""
    debug = "--debug" in arguments
    moved = [argument for argument in arguments if argument in _ANYWHERE]
    rest = [argument for argument in arguments if argument not in _ANYWHERE]
    if logging.lastResort is not None:
        logging.lastResort.setFormatter(VisibleFormatter("%(message)s"))
    try:
        code = make_app(rest)(args=[*moved, *rest], prog_name="dslam", standalone_mode=False)
        sys.stdout.flush()
    except typer.TyperException as error:
        message = error.format_message().rstrip(".")
        if not message:  # no command was given, and the help has been printed
            return BAD_INPUT
        context = getattr(error, "ctx", None)
        return _fail(f"{message}; see '{context.command_path if context else 'dslam'} --help'", BAD_INPUT)
    except Exception as error:
        from descriptors.errors import DescriptorError
        from logs.errors import LogError
        from slam.common.errors import SlamError

        if debug:
            traceback.print_exc()
        if isinstance(error, (LogError, SlamError, DescriptorError, OSError)):
            return _fail("; ".join([str(error), *getattr(error, "__notes__", ())]), BAD_INPUT)
        if isinstance(error, ModuleNotFoundError) and (extra := _EXTRA_OF.get((error.name or "").partition(".")[0])):
            return _fail(f"this needs {error.name}: pip install 'descriptellation-slam[{extra}]'", BAD_INPUT)
        if isinstance(error, MemoryError):
            return _fail("out of memory; give a smaller log, or lower memory_mb", BAD_INPUT)
        what = f"{type(error).__name__}: {error}"
        remedy = "please report it with the traceback above" if debug else "please report it with the output of --debug"
        return _fail(f"this should not happen: {what}; {remedy}", INTERNAL_ERROR)
    return code if isinstance(code, int) else 0


def _fail(message: str, code: int) -> int:
    line = visible(" ".join(message.split()))
    if len(line) > 1000:
        line = f"{line[:500]} ... {line[-500:]}"
    with contextlib.suppress(OSError):  # there is nobody to tell
        print(f"dslam: {line}", file=sys.stderr)
    return code


if __name__ == "__main__":
    main()
