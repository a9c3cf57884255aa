"""One case after the other in a process of a pool, each in a folder and a child of its own."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.fuzz.cases import make_case
from tests.fuzz.judgement import judge
from tests.fuzz.sandbox import run
from tests.fuzz.seeds import Seeds


@dataclass(frozen=True)
class Trials:
    """What all cases have in common: ``folder`` is where they run, ``keep`` where those that fail stay."""

    seeds: Seeds
    seed: int
    folder: Path
    keep: Path


@dataclass(frozen=True)
class Verdict:
    """What became of case ``number``; ``seconds`` and ``peak_bytes`` as in :class:`tests.fuzz.sandbox.Outcome`."""

    number: int
    arguments: list[str]
    code: int
    seconds: float
    peak_bytes: int
    complaints: list[str]


_trials: Trials | None = None


def begin(trials: Trials) -> None:
    """Let this process run cases of ``trials``: they are inherited, and not sent with every case."""
    global _trials
    _trials = trials


def run_case(number: int) -> Verdict:
    """Make the case, run it, and judge what became of it."""
    folder = _trials.folder / f"case-{number}"
    folder.mkdir()
    case = make_case(_trials.seeds, folder, np.random.default_rng([_trials.seed, number]))
    outcome = run(case.arguments, folder)
    complaints = judge(case.arguments, case.outputs, outcome)
    if complaints:
        _keep(folder, _trials.keep / f"{_trials.seed}-{number}", case.arguments)
    shutil.rmtree(folder)
    return Verdict(number, case.arguments, outcome.code, outcome.seconds, outcome.peak_bytes, complaints)


def _keep(case_folder: Path, target: Path, arguments: list[str]) -> None:
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(case_folder, target, symlinks=True, ignore=_pipes)
    (target / "arguments.json").write_text(json.dumps(arguments))


def _pipes(folder: str, names: list[str]) -> list[str]:
    return [name for name in names if (Path(folder) / name).is_fifo()]
