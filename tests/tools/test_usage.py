"""Help, version and wrong usage."""

import pytest
import typer
from typer.main import get_command

from tests.tools.runs import Run, assert_refused, assert_well
from tools.cli import make_app


def commands(group: typer.core.TyperGroup, *names: str) -> list[tuple[str, ...]]:
    """The words of each command."""
    found = []
    for name, command in group.commands.items():
        inner = commands(command, *names, name) if isinstance(command, typer.core.TyperGroup) else [(*names, name)]
        found += inner
    return found


COMMANDS = commands(get_command(make_app()))


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_explains_itself_by_an_example(dslam: Run, command: tuple[str, ...]) -> None:
    result = assert_well(dslam(*command, "--help"))
    assert f"Example: dslam {' '.join(command)}" in result.text


def test_the_root_lists_the_commands_and_the_version(dslam: Run) -> None:
    result = dslam("--help")
    assert result.code == 0
    assert all(f" {command[0]} " in result.out for command in COMMANDS)
    assert dslam("--version").out.startswith("dslam ")
    assert dslam().code == 2


@pytest.mark.parametrize(
    "arguments", [("fly",), ("info",), ("info", "a", "b"), ("info", "a", "--fast"), ("replay", "a")]
)
def test_wrong_usage_is_one_line(dslam: Run, arguments: tuple[str, ...]) -> None:
    assert_refused(dslam(*arguments), "--help")
