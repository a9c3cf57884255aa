"""Runs the commands of docs/results/*.md again, block by block: ``make results``.

A block is skipped when its output is there and its commands are the same, so that an interrupted run continues where it
was. Outputs are in out/results/PAGE-NUMBER.txt; the tables of the pages are written from them.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_FIRST = ("replay", "loop_closure", "evaluation")
PAGES = sorted(
    (path.stem for path in (ROOT / "docs" / "results").glob("*.md")),
    key=lambda page: (_FIRST.index(page) if page in _FIRST else len(_FIRST), page),
)
"""All of them; the first ones make logs that others use."""
_BLOCK = re.compile(r"^```\n(.*?)^```", re.DOTALL | re.MULTILINE)
_DATA = re.compile(r"`D=(\.\./[\w/]+)`")


@dataclass(frozen=True)
class Block:
    """Commands of one page, and the folder ``$D`` that they read."""

    name: str
    commands: str
    data: Path


def read_blocks(page: str) -> list[Block]:
    """The fenced blocks of ``docs/results/PAGE.md``, top to bottom."""
    text = (ROOT / "docs" / "results" / f"{page}.md").read_text(encoding="utf-8")
    found = _DATA.search(text)
    data = (ROOT / (found[1] if found else "../shared/data")).resolve()
    return [Block(f"{page}-{number}", commands, data) for number, commands in enumerate(_BLOCK.findall(text), start=1)]


def run(block: Block, folder: Path, *, again: bool = False) -> int:
    """Run the commands, if they were not run before or are wanted ``again``; returns the exit code.

    The commands stand above their output.
    """
    done, part = folder / f"{block.name}.txt", folder / f"{block.name}.part"
    head = f"{block.commands}\n----\n"
    if not again and done.is_file() and done.read_text(encoding="utf-8").startswith(head):
        print(f"{block.name}: there already")
        return 0
    print(f"{block.name}: {done}", flush=True)
    environment = os.environ | {"D": str(block.data), "PYTHONPATH": str(ROOT)}
    environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment['PATH']}"
    with part.open("w", encoding="utf-8") as out:
        out.write(head)
        out.flush()
        command = ["bash", "-euo", "pipefail", "-c", block.commands]
        code = subprocess.run(command, cwd=folder, env=environment, stdout=out, stderr=subprocess.STDOUT).returncode
    if code == 0:
        part.rename(done)
    return code


def main(arguments: Sequence[str] | None = None) -> int:
    """Run or list the blocks; 1 if any failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pages", nargs="*", choices=[[], *PAGES], default=[], help="all by default")
    parser.add_argument("--list", action="store_true", help="print the commands instead")
    parser.add_argument("--again", action="store_true", help="run also what was run before")
    chosen = parser.parse_args(arguments)
    blocks = [block for page in chosen.pages or PAGES for block in read_blocks(page)]
    if chosen.list:
        for block in blocks:
            print(f"# {block.name}\n{block.commands}")
        return 0
    folder = ROOT / "out" / "results"
    folder.mkdir(parents=True, exist_ok=True)
    failed = [block.name for block in blocks if run(block, folder, again=chosen.again) != 0]
    if failed:
        print(f"failed: {', '.join(failed)}; their output is in {folder}/NAME.part", file=sys.stderr)
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
