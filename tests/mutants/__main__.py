"""``python -m tests.mutants``: break the estimator in random places and see whether its fast tests fail."""

import argparse
import difflib
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.mutants.mutant import Mutant, sample_mutants
from tests.mutants.trial import Verdict, copy_repository, run_tests

MIN_CAUGHT = 0.9


def main() -> int:
    """Exit code 1 if tests fail without a mutant, or if they catch less than ``MIN_CAUGHT`` of the mutants."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=60, help="mutants")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    options = parser.parse_args()
    mutants = sample_mutants(options.count, seed=options.seed)
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        return _run(mutants, copy_repository(Path(folder)))


def _run(mutants: list[Mutant], repository: Path) -> int:
    suites = dict.fromkeys(each.tests for each in mutants)
    broken = [tests for tests in suites if run_tests(repository, tests) != Verdict.SURVIVED]
    if broken:
        print(f"fail without any mutant: {broken}")
        return 1
    started = time.monotonic()
    verdicts: Counter[str] = Counter()
    for mutant in mutants:
        verdict = run_tests(repository, mutant.tests, mutant)
        verdicts[verdict.value] += 1
        if verdict != Verdict.CAUGHT:
            print(f"{verdict.value}: {mutant.name}\n{_difference(mutant)}", flush=True)
    share, seconds = verdicts[Verdict.CAUGHT.value] / max(verdicts.total(), 1), time.monotonic() - started
    print(f"\n{len(mutants)} mutants in {seconds:.0f} s, {100.0 * share:.1f} % caught; {dict(verdicts)}")
    return int(share < MIN_CAUGHT)


def _difference(mutant: Mutant) -> str:
    lines = list(difflib.unified_diff(mutant.original.splitlines(), mutant.source().splitlines(), n=0, lineterm=""))
    return "\n".join(f"    {line}" for line in lines[2:])


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
