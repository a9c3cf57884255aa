"""Runs the commands of docs/results/*.md and writes what they print below them: ``make results``.

A block of commands is followed by ``<!-- output of NAME -->`` and ``<!-- end -->``; between these marks stand the
version, the date and what the commands print. ``README.md`` beside the pages lists the main figures, which are read
from these blocks. A block that was run before with the same commands is not run again, unless it is named.

The block ``demo`` tells whether the estimator has changed: it keeps its date while its figures stay the same, within
10 %, and then the date of the change before; changes of one day are one. ``--stale`` fails if its figures are others
than recorded, or if a block is older than the change before the last one. Its output stands in the quick start, too.
"""

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "results"
QUICK_START = ROOT / "docs" / "quick_start.md"
DEMO, TOLERANCE = "demo", 0.1
FIRST = "drives"
"""The page whose logs other pages use."""
_BLOCK = re.compile(
    r"^```\n(?P<commands>(?:(?!```)[^\n]*\n)+)```\n\n<!-- output of (?P<name>\S+) -->\n(?P<output>.*?)<!-- end -->",
    re.DOTALL | re.MULTILINE,
)
_DATE, _NUMBER = re.compile(r"\d{4}-\d\d-\d\d"), re.compile(r"\d+\.\d+")
_TABLE = re.compile(r"(?<=<!-- figures -->\n).*?(?=<!-- end -->)", re.DOTALL)


@dataclass(frozen=True)
class Block:
    """Commands of a page, and what they printed when they were last run."""

    page: Path
    name: str
    commands: str
    output: str = ""


@dataclass(frozen=True)
class Figure:
    """A figure of the summary: the group of the ``pattern`` in the output of a block.

    ``copies``: the row and the column of the same figure over ten copies of the drive, in the block ``copies``.
    """

    drive: str
    name: str
    block: str
    pattern: str
    copies: tuple[str, str] = ("", "")


ATE, ODOMETRY = r"ATE (\S+ m), odometry", r"ATE \S+ m, odometry (\S+ m)"
PRECISION, RECALL = r"accepted, precision (\S+ %)", r"recall (\S+ % of \d+)\s+revisits"
FIGURES = (
    Figure("KITTI 00", "ATE", "kitti00", ATE, ("kitti00", "ATE m")),
    Figure("", "ATE of the odometry", "kitti00", ODOMETRY),
    Figure("", "precision of closures", "kitti00", PRECISION, ("kitti00", "closures precision")),
    Figure("", "recall of revisits", "kitti00", RECALL, ("kitti00", "closures recall")),
    Figure("", "kidnapped robots found within 40 m, %", "relocalization-kitti00", r"everywhere +\d+ +(\S+)"),
    Figure(
        "",
        "places retrieved first, by descriptors alone, %",
        "retrieval",
        r"kitti00 \| descriptellation_lr \| \d+ \| (\S+)",
    ),
    Figure("hamburg", "ATE", "hamburg", ATE, ("hamburg", "ATE m")),
    Figure("", "ATE of the odometry", "hamburg", ODOMETRY),
    Figure("", "recall of revisits", "hamburg", RECALL, ("hamburg", "closures recall")),
    Figure(
        "",
        "precision of associations",
        "hamburg",
        r"associations +precision (\S+ %)",
        ("hamburg", "associations precision"),
    ),
    Figure("three cities", "kidnappings with P(lost) above 0.5 within 15 m", "kidnapping", r"kidnapping: (\d+ of \d+)"),
    Figure("mrclam6, robot 5", "ATE", "robot5", ATE, ("robot5", "ATE m")),
    Figure(
        "",
        "precision of associations",
        "robot5",
        r"associations +precision (\S+ %)",
        ("robot5", "associations precision"),
    ),
    Figure("forest evo", "ATE m", "forests", r"evo \| \S+ \| (\S+)", ("evo", "ATE m")),
    Figure("forest wild03", "ATE m", "forests", r"wild03 \| \S+ \| (\S+)", ("wild03", "ATE m")),
    Figure(
        "lost_in_the_woods", "ATE m", "robots", r"lost_in_the_woods \| \S+ \| (\S+)", ("lost_in_the_woods", "ATE m")
    ),
    Figure("helsinki, imported", "robots found within 40 m, %", "relocalization-city", r"everywhere +\d+ +(\S+)"),
    Figure(
        "10,000 street trees",
        "places retrieved first, %",
        "recall",
        r"descriptellation_lr \| 10000 of 20 \|[^|]+\| (\S+)",
    ),
    Figure("demo", "ATE", "demo", ATE, ("demo", "ATE m")),
    Figure("demo, 0.5 s late", "ATE m", "faults", r"time_offset=0.5 [^|]+\| (\S+)"),
)


def read_blocks(page: Path) -> list[Block]:
    """The blocks of a page, top to bottom."""
    found = _BLOCK.finditer(page.read_text(encoding="utf-8"))
    return [Block(page, each["name"], each["commands"], each["output"]) for each in found]


def all_blocks() -> list[Block]:
    """The blocks of all pages, in the order in which they can be run."""
    pages = sorted(PAGES.glob("*.md"), key=lambda page: (page.stem != FIRST, page.stem))
    return [block for page in pages for block in read_blocks(page)]


def run(block: Block, folder: Path, data: Path) -> str | None:
    """What the commands print, run in ``folder`` with ``$D`` set to ``data``; None if one of them failed."""
    environment = os.environ | {"D": str(data), "PYTHONPATH": str(ROOT)}
    environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment['PATH']}"
    command = ["bash", "-euo", "pipefail", "-c", block.commands]
    done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True)
    return done.stdout if done.returncode == 0 else None


def write_output(block: Block, printed: str) -> None:
    """Put what was printed below the commands, with version and date; tables in Markdown stay as they are."""
    date, printed = f"{datetime.now(tz=UTC).date()}", printed.strip()
    if block.name == DEMO and block.output:
        last, *earlier = _DATE.findall(block.output.splitlines()[0])
        if have_changed(block.output, printed):
            last, *earlier = date, *[day for day in (last, *earlier) if day != date][:1]
        date = ", before ".join([last, *earlier])
    shown = printed if "\n| ---" in printed else f"```text\n{printed}\n```"
    head = f"Version {version('descriptellation-slam')}, {date}:\n\n"
    begin = f"<!-- output of {block.name} -->\n"
    for page in (block.page, QUICK_START):
        before, mark, rest = page.read_text(encoding="utf-8").partition(begin)
        if mark:
            after = rest[rest.index("<!-- end -->") :]
            page.write_text(f"{before}{begin}{head}{shown}\n{after}", encoding="utf-8")


def have_changed(recorded: str, printed: str) -> bool:
    """Whether figures differ from those of a recorded output; counts do so from machine to machine."""
    old, new = (
        [float(figure) for figure in _NUMBER.findall(text)] for text in (recorded.partition("```text\n")[2], printed)
    )
    return len(old) != len(new) or any(abs(a - b) > TOLERANCE * max(a, b) for a, b in zip(old, new, strict=True))


def stale_blocks(blocks: Sequence[Block]) -> list[str]:
    """Names of the blocks that were run before the last change but one of the figures of the demo."""
    demo = next(block for block in blocks if block.name == DEMO)
    change = _DATE.findall(demo.output.splitlines()[0])[-1]
    return [block.name for block in blocks if block.output and _DATE.findall(block.output)[0] < change]


def report_stale(folder: Path, data: Path) -> int:
    """Run the demo and print what is out of date; 1 if anything is."""
    blocks = all_blocks()
    demo = next(block for block in blocks if block.name == DEMO)
    printed = run(demo, folder, data)
    if printed is None or have_changed(demo.output, printed):
        print(f"the figures of the demo have changed; run {DEMO} and the blocks that this concerns again:\n{printed}")
        return 1
    stale = stale_blocks(blocks)
    if stale:
        print(f"older than the change of the estimator before the last one: {', '.join(stale)}; run them again")
    return int(bool(stale))


def figure_rows(outputs: Mapping[str, Block]) -> Iterator[str]:
    """The summary as lines of Markdown: the figures of the blocks that were run.

    Raises:
        ValueError: the block of a figure does not hold it.
    """
    copies = table_cells(outputs["copies"].output)
    yield "| | figure | value | ten copies | made by |"
    yield "|---|---|---|---|---|"
    for figure in FIGURES:
        block = outputs[figure.block]
        if not block.output:
            continue
        found = re.search(figure.pattern, block.output)
        if found is None:
            raise ValueError(f"{block.page.name}: the output of {block.name} has no {figure.name} of {figure.drive}")
        commands = block.commands.replace("\\\n", " ").splitlines()
        command = " ".join(next(line for line in reversed(commands) if "dslam " in line).split()[:3])
        cells = (
            figure.drive,
            figure.name,
            found[1],
            copies.get(figure.copies, ""),
            f"`{command}`, [{block.page.stem}]({block.page.name})",
        )
        yield f"| {' | '.join(cells)} |"


def table_cells(output: str) -> dict[tuple[str, str], str]:
    """The cells of a table in Markdown by row and column; those of the ATE with its extremes."""
    rows = [
        [cell.strip().partition(" * ")[0] for cell in line.strip("| ").split("|")]
        for line in output.splitlines()
        if line[:1] == "|"
    ]
    cells = {(row[0], heading): cell for row in rows[2:] for heading, cell in zip(rows[0], row, strict=True)}
    extremes = {key[0]: cell for key, cell in cells.items() if key[1] == "least to greatest"}
    return {key: f"{cell} ({extremes[key[0]]})" if key[1] == "ATE m" else cell for key, cell in cells.items()}


def write_summary() -> None:
    """Collect the main figures from the blocks into ``README.md``."""
    page = PAGES / "README.md"
    rows = "\n".join(figure_rows({block.name: block for block in all_blocks()}))
    page.write_text(_TABLE.sub(f"\n{rows}\n\n", page.read_text(encoding="utf-8")), encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run blocks and write their output; 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="blocks to run, also those run before; all that were not, by default")
    parser.add_argument("--list", action="store_true", help="print the commands instead")
    parser.add_argument("--stale", action="store_true", help="run the demo, and fail if outputs are out of date")
    parser.add_argument("--check", action="store_true", help="print the output, and leave the pages as they are")
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data", help="the folder $D")
    chosen = parser.parse_args(arguments)
    if unknown := set(chosen.names) - {each.name for each in all_blocks()}:
        parser.error(f"no page has a block {', '.join(sorted(unknown))}")
    blocks = [each for each in all_blocks() if each.name in chosen.names or not (chosen.names or each.output)]
    folder = ROOT / "out" / "results"
    folder.mkdir(parents=True, exist_ok=True)
    if chosen.stale:
        return report_stale(folder, chosen.data.resolve())
    failed = []
    for block in blocks:
        print(f"# {block.name}\n{block.commands}", flush=True)
        printed = "" if chosen.list else run(block, folder, chosen.data.resolve())
        if printed is None:
            failed.append(block.name)
        elif chosen.check:
            print(printed)
        elif not chosen.list:
            write_output(block, printed)
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    elif not (chosen.list or chosen.check):
        write_summary()
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
