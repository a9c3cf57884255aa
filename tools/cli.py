"""``dslam``: the command line. Commands parse, call one library function and print; only here are errors caught."""

from __future__ import annotations

import contextlib
import logging
import sys
import traceback
from collections.abc import Sequence
from typing import Annotated

import typer

from tools import (
    Stopped,
    config,
    degrade,
    import_logs,
    info,
    optimize,
    relocalize,
    replay,
    simulate,
    stopped,
    train,
)
from tools import main as main
from tools.benchmarks import commands as benchmark
from tools.evaluation import compare, evaluate, sweep
from tools.maps import commands as maps
from tools.results import export, view

BAD_INPUT = 2
INTERNAL_ERROR = 70
INTERRUPTED = 130

_LONGEST_MESSAGE = 1000

_ANYWHERE = ("--debug", "--verbose", "-v")
_PREFIX = __name__.removesuffix("tools.cli")
"""Of the names of our packages: "dslam." in a wheel."""

app = typer.Typer(
    name="dslam",
    help="Semantic SLAM: a log of odometry and object detections becomes a trajectory and an object map.",
    epilog="--verbose and --debug may also stand after the command. Exit codes: 0 done, 1 a required bar was not met, "
    "2 bad input.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(simulate.simulate)
app.command()(degrade.degrade)
app.add_typer(import_logs.app, name="import")
app.command()(info.info)
app.command()(replay.replay)
app.command()(relocalize.relocalize)
app.add_typer(maps.app, name="map")
app.command()(evaluate.evaluate)
app.command()(compare.compare)
app.command()(sweep.sweep)
app.command()(view.view)
app.command()(export.export)
app.command()(optimize.optimize)
app.command()(config.config)
app.command()(train.train)
app.add_typer(benchmark.app, name="benchmark")


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"dslam {version('descriptellation-slam')}")
        raise typer.Exit


@app.callback()
def _global_options(
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log what is done to standard error.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Log every detail, and show tracebacks.")] = False,
    _version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    if verbose or debug:
        level = logging.DEBUG if debug else logging.INFO
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(_message_format("%(levelname)s %(name)s: %(message)s"))
        logging.basicConfig(level=logging.INFO, handlers=[handler])
        for package in ("slam", "logs", "descriptors", "tools"):
            logging.getLogger(f"{_PREFIX}{package}").setLevel(level)


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; whatever goes wrong is one line on standard error."""
    debug = "--debug" in arguments
    moved = [argument for argument in arguments if argument in _ANYWHERE]
    rest = [argument for argument in arguments if argument not in _ANYWHERE]
    if logging.lastResort is not None:
        logging.lastResort.setFormatter(_message_format("%(message)s"))
    try:
        code = app(args=[*moved, *rest], prog_name="dslam", standalone_mode=False)
        sys.stdout.flush()
    except KeyboardInterrupt:
        code = INTERRUPTED
    except Stopped as error:
        return _fail(_with_notes(error), error.code)
    except typer.TyperException as error:
        message = error.format_message().rstrip(".")
        if not message:  # no command was given, and the help has been printed
            return BAD_INPUT
        context = getattr(error, "ctx", None)
        return _fail(f"{message}; see '{context.command_path if context else 'dslam'} --help'", BAD_INPUT)
    except Exception as error:
        if (stop := stopped()) is not None:  # it became another error on its way
            return _fail(str(stop), stop.code)
        if debug:
            traceback.print_exc()
        if _is_expected(error):
            return _fail(_with_notes(error), BAD_INPUT)
        if isinstance(error, MemoryError):
            return _fail("the memory does not suffice; give a smaller log, or lower the limits.* settings", BAD_INPUT)
        what = f"{type(error).__name__}: {error}"
        remedy = "please report it with the traceback above" if debug else "please report it with the output of --debug"
        return _fail(f"this should not happen: {what}; {remedy}", INTERNAL_ERROR)
    if code == INTERRUPTED:  # Typer makes it of a KeyboardInterrupt
        return _fail("interrupted", INTERRUPTED)
    return code if isinstance(code, int) else 0


def _is_expected(error: Exception) -> bool:
    from descriptors.errors import DescriptorError
    from logs.errors import LogError
    from slam.common.errors import SlamError

    return isinstance(error, (LogError, SlamError, DescriptorError, OSError))


def _message_format(pattern: str) -> logging.Formatter:
    from tools.console import VisibleFormatter

    return VisibleFormatter(pattern)


def _with_notes(error: BaseException) -> str:
    return "; ".join([str(error), *getattr(error, "__notes__", ())])


def _fail(message: str, code: int) -> int:
    from logs.container.names import visible

    line = visible(" ".join(message.split()))
    if len(line) > _LONGEST_MESSAGE:
        half = _LONGEST_MESSAGE // 2
        line = f"{line[:half]} ... {line[-half:]}"
    with contextlib.suppress(OSError):  # there is nobody to tell
        print(f"dslam: {line}", file=sys.stderr)
    return code


if __name__ == "__main__":
    main()
