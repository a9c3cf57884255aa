"""``python -m tests.mutants``: break one rule after the other and see whether its tests notice."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter

from tests.mutants.mutant import Mutant, read_mutants
from tests.mutants.trial import Verdict, import_libraries, run_tests

LEAST_CAUGHT = 0.95


def main() -> int:
    """Exit code 1 if the tests fail without a mutant, or if they catch less than ``LEAST_CAUGHT`` of the mutants."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--only", default="", help="those whose file or rule contains this")
    parser.add_argument("--list", action="store_true", help="print them and run nothing")
    options = parser.parse_args()
    mutants = [each for each in read_mutants() if options.only in f"{each.file}: {each.rule}"]
    if options.list:
        print("\n".join(f"{each.file}: {each.rule}" for each in mutants))
        return 0
    for mutant in mutants:
        mutant.source()  # in a child, a text that is not there would look like a test that fails
    import_libraries()
    broken = [tests for tests in dict.fromkeys(each.tests for each in mutants) if run_tests(tests) != Verdict.SURVIVED]
    if broken:
        print(f"fail without any mutant: {broken}")
        return 1
    return _run(mutants)


def _run(mutants: list[Mutant]) -> int:
    started = time.monotonic()
    verdicts: Counter[str] = Counter()
    for mutant in mutants:
        verdict = "equivalent" if mutant.equivalent else run_tests(mutant.tests, mutant).value
        verdicts[verdict] += 1
        if verdict != Verdict.CAUGHT.value:
            why = f" ({mutant.equivalent})" if mutant.equivalent else f"\n    {mutant.original}\n -> {mutant.mutated}"
            print(f"{verdict}: {mutant.file}: {mutant.rule}{why}", flush=True)
    tried = len(mutants) - verdicts["equivalent"]
    share = verdicts[Verdict.CAUGHT.value] / max(tried, 1)
    print(f"\n{tried} mutants in {time.monotonic() - started:.0f} s, {100.0 * share:.1f} % caught; {dict(verdicts)}")
    return int(share < LEAST_CAUGHT)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
