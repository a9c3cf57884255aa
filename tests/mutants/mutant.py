"""A mutant: a source file with one rule changed, and the tests that are to fail with it."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Mutant:
    """``original`` stands once in ``file`` and becomes ``mutated``; ``rule``: what that turns off or round.

    ``equivalent``: why no test can tell the two apart, empty where one can.
    """

    file: str
    tests: tuple[str, ...]
    rule: str
    original: str
    mutated: str
    equivalent: str = ""

    @property
    def module(self) -> str:
        return self.file.removesuffix(".py").replace("/", ".")

    def source(self) -> str:
        """The text of the file with the change; ValueError if there is not one place for it."""
        text = (ROOT / self.file).read_text(encoding="utf-8")
        if text.count(self.original) != 1:
            raise ValueError(f"{self.file} has {text.count(self.original)} times, not once: {self.original}")
        return text.replace(self.original, self.mutated)


def read_mutants() -> list[Mutant]:
    """All mutants of the tables beside this file: for each source file its tests and [rule, original, mutated]."""
    found = []
    for table in sorted(Path(__file__).parent.glob("*.toml")):
        for file, entry in tomllib.loads(table.read_text(encoding="utf-8")).items():
            found += [Mutant(file, tuple(entry["tests"]), *twin) for twin in entry["twins"]]
    return found
