"""The documents: links lead somewhere, commands are ones that the program takes, and the site is built."""

import re
import runpy
import shlex
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from slam.common.config import Config
from slam.common.config_tree import load_tree
from slam.simulation.config import SimulationConfig
from tests.tools.runs import ROOT, run_python, text_of
from tools.cli import make_app

PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
]
NAMES = [page.relative_to(ROOT).as_posix() for page in PAGES]
GENERATED = {f"docs/reference/{name}.md" for name in ("commands", "settings", "json", "messages")}
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
SHELLS = ("", "sh", "bash", "console")
LINK = re.compile(r"!?\[[^]]*\]\(([^)\s]+)\)")
COMMAND = get_command(make_app())
ENDS = {";", "&&", "|", "||", "&", "(", ")", "do", "done", "then", "else"}


def anchors(page: Path) -> set[str]:
    """As GitHub and mkdocs make them of headings."""
    text = re.sub(r"```.*?```", "", text_of(page), flags=re.DOTALL)
    headings = re.findall(r"^#+ +(.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("name", NAMES)
def test_links_lead_to_files_and_headings(name: str) -> None:
    page = ROOT / name
    for target in LINK.findall(text_of(page)):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if file.relative_to(ROOT).as_posix() in GENERATED:
            continue
        assert file.exists(), f"{name}: {target}"
        assert not anchor or file.suffix != ".md" or anchor in anchors(file), f"{name}: {target}"


def reader_questions() -> list[str]:
    text = text_of("CONTRIBUTING.md")
    section = text.split("## Where to look\n")[1].split("\n## ")[0]
    return [line for line in section.splitlines()[3:] if line.startswith("|")]


@pytest.mark.parametrize("row", reader_questions(), ids=lambda row: row.split("|")[1].strip())
def test_answer_is_in_at_most_three_files(row: str) -> None:
    files = [text_of(target) for target in LINK.findall(row)]
    assert 1 <= len(files) <= 3
    for name in re.findall(r"`(\w+)`", row):
        assert re.search(rf"^ *(?:def|class) {name}\b", "\n".join(files), re.MULTILINE), name


def blocks_of(name: str) -> list[str]:
    """The fenced blocks of a page that are of no other language than shell."""
    text = text_of(name)
    return [block for language, block in FENCE.findall(text) if language in SHELLS]


def commands(block: str) -> Iterator[list[str]]:
    """Arguments of each ``dslam`` in a block of shell; its variables are 1."""
    block = re.sub(r"<<'END'.*?^END$", "", block, flags=re.DOTALL | re.MULTILINE).replace("\\\n", " ")
    for line in block.splitlines():
        lexer = shlex.shlex(re.sub(r"\$\{?\w+\}?", "1", line), posix=True, punctuation_chars=True)
        lexer.whitespace_split = True
        words: list[str] = []
        for word in [*lexer, ";"]:
            if word in ENDS or set(word) <= set("><"):
                if words[:1] == ["dslam"]:
                    yield words[1:]
                words = []
            else:
                words.append(word)


def parse(arguments: list[str]) -> Any:
    """The context of the command that they name; raises for a command, an option or a value that there is not."""
    command: Any = COMMAND
    context = None
    while True:
        context = command.make_context(command.name, list(arguments), parent=context)
        if not hasattr(command, "commands"):
            return context
        _, command, arguments = command.resolve_command(context, [*context._protected_args, *context.args])


@pytest.mark.parametrize("name", NAMES)
def test_commands_are_those_of_the_program(name: str) -> None:
    for block in blocks_of(name):
        for arguments in commands(block):
            if arguments[0].startswith("--"):  # options of dslam itself act while they are parsed
                continue
            try:
                settings = parse(arguments).params.get("settings") or ()
            except Exception as error:
                message = getattr(error, "format_message", lambda error=error: str(error))()
                pytest.fail(f"{name}: dslam {' '.join(arguments)}: {message}")
            load_tree(SimulationConfig if arguments[0] == "simulate" else Config, None, settings)


RUNNER = str(ROOT / "docs" / "run_results.py")


@pytest.fixture
def results(tmp_path: Path) -> dict[str, Any]:
    """The runner of docs/results, on pages of its own."""
    runner = runpy.run_path(RUNNER)
    (tmp_path / "drives.md").write_text(
        "```\nno output\n```\n\n```\necho $D\n```\n\n<!-- output of a -->\n<!-- end -->\ntext\n", encoding="utf-8"
    )
    return runner


def test_results_stand_below_the_commands_that_print_them(results: dict[str, Any], tmp_path: Path) -> None:
    page = tmp_path / "drives.md"
    (block,) = results["read_blocks"](page)
    assert (block.name, block.commands, block.output) == ("a", "echo $D\n", "")
    results["write_output"](block, results["run"](block, tmp_path, tmp_path / "data"))
    (written,) = results["read_blocks"](page)
    assert re.fullmatch(rf"Version \S+, [\d-]+:\n\n```text\n{tmp_path}/data\n```\n", written.output)
    assert text_of(page).endswith("<!-- end -->\ntext\n")
    assert results["run"](replace(block, commands="false\n"), tmp_path, tmp_path) is None


def test_outputs_older_than_the_change_before_the_last_are_stale(results: dict[str, Any], tmp_path: Path) -> None:
    figures = "ATE 0.086 m, 441 landmarks"
    head = "Version 0.1.0, 2026-05-01, before 2026-03-01:\n\n"
    demo = results["Block"](tmp_path, "demo", "", f"{head}```text\n{figures}\n```\n")
    blocks = [
        results["Block"](tmp_path, date, "", f"Version 0.1.0, {date}:\n") for date in ("2026-02-28", "2026-03-02")
    ]
    assert results["stale_blocks"]([*blocks, demo]) == ["2026-02-28"]
    assert not results["have_changed"](demo.output, figures.replace("441", "445"))
    assert results["have_changed"](demo.output, figures.replace("0.086", "0.186"))


def test_changes_of_one_day_are_one(results: dict[str, Any], tmp_path: Path) -> None:
    page, today = tmp_path / "drives.md", datetime.now(tz=UTC).date()
    results["write_output"].__globals__["QUICK_START"] = page
    for last, before in (
        (f"{today}, before 2026-03-01", "2026-03-01"),
        ("2026-05-01, before 2026-03-01", "2026-05-01"),
    ):
        output = f"Version 0.1.0, {last}:\n\n```text\nATE 0.086 m\n```\n"
        page.write_text(f"```\nx\n```\n\n<!-- output of demo -->\n{output}<!-- end -->\n", encoding="utf-8")
        results["write_output"](results["Block"](page, "demo", "x\n", output), "ATE 0.186 m")
        assert f", {today}, before {before}:\n\n```text\nATE 0.186 m" in text_of(page)


def test_summary_of_results_holds_the_figures_of_the_pages() -> None:
    results = runpy.run_path(RUNNER)
    blocks = {block.name: block for block in results["all_blocks"]()}
    rows = list(results["figure_rows"](blocks))
    assert len(rows) == 2 + sum(bool(blocks[figure.block].output) for figure in results["FIGURES"]) > 2
    assert "\n".join(rows) in text_of("docs/results/README.md")
    copies = "| drive | ATE m | least to greatest |\n| --- | ---: | ---: |\n| hamburg | 0.5 ± 0.1 | 0.4 to 0.6 |"
    with_copies = results["figure_rows"](blocks | {"copies": replace(blocks["copies"], output=copies)})
    assert next(row for row in with_copies if "| 0.5 ± 0.1 (0.4 to 0.6) |" in row).startswith("| hamburg | ATE |")
    with pytest.raises(ValueError, match="has no ATE of KITTI 00"):
        list(results["figure_rows"](blocks | {"kitti00": replace(blocks["kitti00"], output="nothing")}))


def test_reference_pages_hold_every_command_setting_and_key() -> None:
    pages = {name: make() for name, make in runpy.run_path(str(ROOT / "docs" / "reference.py"))["PAGES"].items()}
    assert {f"docs/reference/{name}.md" for name in pages} == GENERATED
    assert "## dslam benchmark robots" in pages["commands"]
    assert "`--save-map`" in pages["commands"]
    assert "`keyframe.distance_m`" in pages["settings"]
    assert "- `trajectory.ate_m`" in pages["json"]
    assert "message LoopClosure" in pages["messages"]


@pytest.mark.slow
@pytest.mark.skipif(find_spec("mkdocs") is None, reason="mkdocs is not installed: pip install '.[docs]'")
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    result = run_python("-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", tmp_path / "site")
    assert result.code == 0, result.err
    assert "dslam relocalize" in text_of(tmp_path / "site/reference/commands/index.html")
