"""``python -m tests.fuzz``: run mutated files through all commands, and keep those that something is wrong with."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from tests.fuzz.seeds import make_seeds
from tests.fuzz.trial import Trials, Verdict, begin, run_case
from tests.helpers.forked_commands import SCRATCH, import_commands


def main() -> int:
    """Exit code 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=200, help="number of cases")
    parser.add_argument("--seed", type=int, default=0, help="case i is made of (seed, i) alone")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--keep", type=Path, default=Path("out/fuzz"), help="folder for the cases that fail")
    parser.add_argument("--minutes", type=float, default=np.inf, help="end after that time")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes; the cases are the same")
    options = parser.parse_args()
    import_commands()
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir=SCRATCH) as folder:
        return fuzz(Path(folder), options)


def fuzz(folder: Path, options: argparse.Namespace) -> int:
    """Run the cases in ``folder``; what was wrong is printed as it is found, and counted at the end."""
    (folder / "seeds").mkdir()
    trials = Trials(make_seeds(folder / "seeds"), options.seed, folder, options.keep.resolve())
    tally = _Tally()
    numbers = range(options.first, options.first + options.count)
    fork = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(options.workers, fork, begin, (trials,)) as pool:
        for verdict in pool.map(run_case, numbers):
            tally.add(verdict)
            if tally.seconds > 60.0 * options.minutes:
                pool.shutdown(cancel_futures=True)
                break
    tally.show()
    return int(bool(tally.complaints))


class _Tally:
    """What became of all cases so far, in the order of their numbers."""

    def __init__(self) -> None:
        self.complaints: Counter[str] = Counter()
        self._codes: Counter[int] = Counter()
        self._slowest_s, self._largest_bytes = 0.0, 0
        self._started = time.monotonic()

    @property
    def seconds(self) -> float:
        return time.monotonic() - self._started

    def add(self, verdict: Verdict) -> None:
        self._codes[verdict.code] += 1
        self._slowest_s = max(self._slowest_s, verdict.seconds)
        self._largest_bytes = max(self._largest_bytes, verdict.peak_bytes)
        for complaint in verdict.complaints:
            self.complaints[complaint] += 1
            print(f"{verdict.number}: {complaint}  [{' '.join(verdict.arguments)[:200]}]", flush=True)
        if self._codes.total() % 1000 == 0:
            print(f"{verdict.number + 1}: {self._codes.total()} cases in {self.seconds:.0f} s", flush=True)

    def show(self) -> None:
        codes = dict(sorted(self._codes.items()))
        largest = f"largest {self._largest_bytes / 1e6:.0f} MB above what is imported"
        print(f"\n{self._codes.total()} cases in {self.seconds:.0f} s; exit codes {codes}; slowest "
              f"{self._slowest_s:.1f} s, {largest}")  # fmt: skip
        for complaint, count in self.complaints.most_common():
            print(f"{count:6d}  {complaint}")


if __name__ == "__main__":
    sys.exit(main())
