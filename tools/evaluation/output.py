"""Options, results and output that evaluate, compare and sweep share."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import RenderableType

    from slam.evaluation.requirements import Requirement

Reference = Annotated[
    Path | None,
    typer.Option(
        metavar="LOG|POSES",
        help="Ground truth: a log, or poses of the body (TUM, KITTI, EuRoC or CSV, also .gz).",
        show_default=False,
    ),
]
Times = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Seconds of each pose in KITTI's format; not needed with one pose per odometry message.",
        show_default=False,
    ),
]
Calib = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="KITTI's calib.txt, if references in its format are of the left camera.",
        show_default=False,
    ),
]
MapRun = Annotated[
    Path | None,
    typer.Option(metavar="OUT.mcap", help="The drive that made the map of this relocalization.", show_default=False),
]
JsonFile = Annotated[Path | None, typer.Option("--json-file", metavar="FILE", help="Write the JSON object to a file.")]
Require = Annotated[
    list[str] | None,
    typer.Option(
        metavar="KEY<=NUMBER", help="Exit with 1 unless this condition (<= >= == < >) holds for every run. Repeatable."
    ),
]
Protocols = Annotated[
    list[str] | None,
    typer.Option(
        "--protocol",
        metavar="NAME=NUMBER",
        help="A threshold of the evaluation (--rules lists them), e.g. closure_translation_m=4. Repeatable.",
        show_default=False,
    ),
]
Rules = Annotated[bool, typer.Option("--rules", help="Also print the rules of the evaluation.")]


@dataclass(frozen=True, slots=True)
class Findings:
    """``results`` as one JSON object, ``parts`` for people; requirements hold of each of ``runs``, by name.

    ``failures``: what could not be evaluated at all. ``rules``: by which everything was measured.
    """

    results: Mapping[str, Any]
    parts: Sequence[RenderableType]
    runs: Mapping[str, Mapping[str, Any]]
    failures: Sequence[str] = field(default_factory=tuple)
    rules: Mapping[str, str] = field(default_factory=dict)


def report(
    findings: Findings, requirements: Sequence[Requirement], *, as_json: bool, with_rules: bool, json_file: Path | None
) -> None:
    """Print the findings, write them to a file, and say which requirements are met and which are not.

    Raises:
        Exit: with code 1, a requirement is not met or a run failed.
        UnwritableLogError: the file cannot be written.
    """
    from logs.storage.placement import write_text
    from tools import console

    if json_file is not None:
        write_text(json_file, json.dumps(findings.results, indent=2, allow_nan=False) + "\n")
    met, unmet = _check(findings.runs, requirements)
    if as_json:
        console.show_json(findings.results)
    else:
        rules = [console.pairs(dict(findings.rules), title="\nrules")] if with_rules else []
        console.show(*findings.parts, *rules, *(f"met: {text}" for text in met))
    lines = [f"{what}: {'; '.join(texts)}" for what, texts in
             (("failed", findings.failures), ("not met", unmet)) if texts]  # fmt: skip
    if lines:
        sys.stdout.flush()
        print(f"dslam: {' '.join('; '.join(lines).split())}", file=sys.stderr)
        raise typer.Exit(1)


def parse_thresholds(texts: Sequence[str] | None) -> dict[str, float]:
    """Thresholds by name, of texts like "closure_translation_m=4".

    Raises:
        EvaluationError: one of another form.
    """
    from slam.common.errors import EvaluationError

    thresholds: dict[str, float] = {}
    for text in texts or ():
        name, _, number = text.partition("=")
        try:
            thresholds[name.strip()] = float(number)
        except ValueError:
            raise EvaluationError(f"--protocol {text}: give NAME=NUMBER, e.g. closure_translation_m=4") from None
    return thresholds


def _check(runs: Mapping[str, Mapping[str, Any]], requirements: Sequence[Requirement]) -> tuple[list[str], list[str]]:
    """Which requirements are met and which are not, with the values, of each run."""
    texts: dict[bool, list[str]] = {True: [], False: []}
    for name, results in runs.items():
        for requirement in requirements:
            is_met, text = requirement.check(results)
            texts[is_met].append(f"{name}: {text}" if name else text)
    return texts[True], texts[False]
