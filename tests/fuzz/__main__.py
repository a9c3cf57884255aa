"""``python -m tests.fuzz``: run mutated files through all commands, and keep those that something is wrong with."""

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
    parser.add_argument("--minutes", type=float, default=np.inf, help="end after that time")
    options = parser.parse_args()
    import_commands()
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir=SCRATCH) as folder:
        return fuzz(Path(folder), options)


def fuzz(folder: Path, options: argparse.Namespace) -> int:
    """Run the cases in ``folder``; what was wrong is printed as it is found, and counted at the end."""
    (folder / "seeds").mkdir()
    trials = Trials(make_seeds(folder / "seeds"), options.seed, folder, Path("out/fuzz").resolve())
    verdicts = list[Verdict]()
    started = time.monotonic()
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("fork"), begin, (trials,)) as pool:
        for verdict in pool.map(run_case, range(options.count)):
            verdicts.append(verdict)
            for complaint in verdict.complaints:
                print(f"{verdict.number}: {complaint}  [{' '.join(verdict.arguments)[:200]}]", flush=True)
            if time.monotonic() - started > 60.0 * options.minutes:
                pool.shutdown(cancel_futures=True)
                break
    codes = dict(sorted(Counter(each.code for each in verdicts).items()))
    slowest_s, largest_bytes = max(each.seconds for each in verdicts), max(each.peak_bytes for each in verdicts)
    print(f"\n{len(verdicts)} cases in {time.monotonic() - started:.0f} s; exit codes {codes}; slowest "
          f"{slowest_s:.1f} s, largest {largest_bytes / 1e6:.0f} MB above what is imported")  # fmt: skip
    complaints = Counter(complaint for each in verdicts for complaint in each.complaints)
    for complaint, count in complaints.most_common():
        print(f"{count:6d}  {complaint}")
    return int(bool(complaints))


if __name__ == "__main__":
    sys.exit(main())
