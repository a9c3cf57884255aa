"""What dslam evaluate has to tell, of one log, of several or of a sweep, and telling it."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from rich.console import RenderableType

    from slam.evaluation.requirements import Requirement

FELL_SHORT = 1


@dataclass(frozen=True, slots=True)
class Findings:
    """``results`` as one JSON object, ``parts`` for people; requirements hold of each of ``runs``, by name.

    ``failures``: what could not be evaluated at all.
    """

    results: Mapping[str, Any]
    parts: Sequence[RenderableType]
    runs: Mapping[str, Mapping[str, Any]]
    failures: Sequence[str] = field(default_factory=tuple)


def tell(
    findings: Findings, requirements: Sequence[Requirement], *, as_json: bool, with_rules: bool, json_file: Path | None
) -> None:
    """Print the findings, write them to a file, and name what fell short.

    Raises:
        Exit: with code 1, something fell short or failed.
        UnwritableLogError: the file cannot be written.
    """
    from logs.errors import UnwritableLogError
    from slam.evaluation.inputs.protocol import Protocol
    from slam.evaluation.report.text_tables import pairs_table
    from tools import console

    if as_json:
        console.show_json(findings.results)
    else:
        rules = [pairs_table("Rules", Protocol().describe())] if with_rules else []
        console.show(*findings.parts, *rules)
    if json_file is not None:
        try:
            json_file.write_text(json.dumps(findings.results, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise UnwritableLogError(f"cannot write {json_file}: {error.strerror}") from error
    shortfalls = [
        f"{name}: {text}" if name else text
        for name, results in findings.runs.items()
        for requirement in requirements
        if (text := requirement.shortfall(results))
    ]
    lines = [f"{what}: {'; '.join(texts)}" for what, texts in
             (("failed", findings.failures), ("fell short", shortfalls)) if texts]  # fmt: skip
    if lines:
        sys.stdout.flush()
        print(f"dslam: {' '.join('; '.join(lines).split())}", file=sys.stderr)
        raise typer.Exit(FELL_SHORT)
