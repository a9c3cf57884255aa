"""Runs tests on a copy of the repository in which one file has another source."""

import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Sequence
from enum import Enum
from pathlib import Path

from tests.mutants.mutant import ROOT, Mutant

_SECONDS, _BYTES = 120, 6_000_000_000
_LEFT_OUT = shutil.ignore_patterns(".*", "out", "build", "dist", "__pycache__")


class Verdict(Enum):
    """What tests said; ``BROKEN``: they did not run, so that the mutant tells nothing."""

    CAUGHT = "caught"
    SURVIVED = "survived"
    BROKEN = "does not run"


def copy_repository(folder: Path) -> Path:
    """A copy of the repository in ``folder``, for :func:`run_tests`."""
    return Path(shutil.copytree(ROOT, folder / "repository", ignore=_LEFT_OUT))


def run_tests(repository: Path, tests: Sequence[str], mutant: Mutant | None = None) -> Verdict:
    """Run tests of a copy of the repository that are not slow, up to the first that fails.

    One that takes too long or too much memory fails.
    """
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-m", "not slow", *tests]
    environment = {**os.environ, "PYTHONPATH": str(repository), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    if mutant is not None:
        (repository / mutant.file).write_text(mutant.source(), encoding="utf-8")
    try:
        code = subprocess.run(
            command, cwd=repository, env=environment, timeout=_SECONDS, capture_output=True, preexec_fn=_limit_memory
        ).returncode
    except subprocess.TimeoutExpired:
        code = 1
    if mutant is not None:
        shutil.copy(ROOT / mutant.file, repository / mutant.file)
    if code == 0:
        return Verdict.SURVIVED
    return Verdict.CAUGHT if code == 1 or code < 0 else Verdict.BROKEN


def _limit_memory() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_BYTES, _BYTES))
