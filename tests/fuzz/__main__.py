"""``python -m tests.fuzz``: run mutated files through all commands, and keep those that something is wrong with."""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from tests.fuzz.cases import FAMILIES, make_case
from tests.fuzz.judgement import judge
from tests.fuzz.sandbox import Limits, run
from tests.fuzz.seeds import make_seeds
from tools.cli import make_app

_IMPORTED = ("slam.replay", "slam.evaluation.evaluate", "slam.evaluation.html_report.page", "logs.summary",
             "slam.visualization.map_plot", "slam.backend.pose_graph.robust_optimization", "rich.table",
             "matplotlib.pyplot", "slam.object_map.map_io", "slam.formats.g2o", "tools.console", "plotly.graph_objects",
             "descriptors.learned.network_descriptor", "descriptors.towers.training", "slam.simulation.faults.registry",
             "slam.simulation.degraded_log", "logs.importers.text_log", "logs.importers.detection_tables", "osmium",
             "logs.importers.maps.osm", "slam.map_joining.joint_map", "slam.evaluation.comparison", "slam.sweeps.sweep",
             "slam.localization.imported_map_editing", "slam.evaluation.report.text", "tools.evaluation.evaluate",
             "tools.evaluation.compare", "multiprocessing.pool", "encodings.idna", "_strptime")  # fmt: skip
"""What children would import again and again."""
_SCRATCH = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""Outputs are flushed to the disk before they get their names, which takes longer than the rest of most cases."""


def main() -> int:
    """Exit code 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=200, help="number of cases")
    parser.add_argument("--seed", type=int, default=0, help="case i is made of (seed, i) alone")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--family", choices=FAMILIES, default="", help="only those")
    parser.add_argument("--keep", type=Path, default=Path("out/fuzz"), help="folder for the cases that fail")
    parser.add_argument("--minutes", type=float, default=np.inf, help="end after that time")
    options = parser.parse_args()
    for module in _IMPORTED:
        with contextlib.suppress(ModuleNotFoundError):
            __import__(module)
    make_app()
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir=_SCRATCH) as folder:
        return fuzz(Path(folder), options)


def fuzz(folder: Path, options: argparse.Namespace) -> int:
    """Run the cases in ``folder``; what was wrong is printed as it is found, and counted at the end."""
    (folder / "seeds").mkdir()
    seeds = make_seeds(folder / "seeds")
    limits = Limits()
    codes: Counter[int] = Counter()
    complaints: Counter[str] = Counter()
    started = time.monotonic()
    done = 0
    slowest, largest = 0.0, 0
    for number in range(options.first, options.first + options.count):
        if time.monotonic() - started > 60.0 * options.minutes:
            break
        case_folder = folder / "case"
        case_folder.mkdir()
        case = make_case(seeds, case_folder, np.random.default_rng([options.seed, number]), options.family)
        outcome = run(case.arguments, case_folder, limits)
        codes[outcome.code] += 1
        done += 1
        if done % 1000 == 0:
            print(f"{number + 1}: {done} cases in {time.monotonic() - started:.0f} s", flush=True)
        slowest, largest = max(slowest, outcome.seconds), max(largest, outcome.peak_bytes)
        found = judge(case.arguments, case.outputs, outcome, limits)
        for complaint in found:
            complaints[complaint] += 1
            print(f"{number}: {complaint}  [{' '.join(case.arguments)[:200]}]", flush=True)
        if found:
            _keep(case_folder, options.keep / f"{options.seed}-{number}", case.arguments)
        shutil.rmtree(case_folder)
    seconds = time.monotonic() - started
    print(f"\n{done} cases in {seconds:.0f} s; exit codes {dict(sorted(codes.items()))}; slowest {slowest:.1f} s, "
          f"largest {largest / 1e6:.0f} MB above the {len(seeds.logs)} seeds' own")  # fmt: skip
    for complaint, count in complaints.most_common():
        print(f"{count:6d}  {complaint}")
    return int(bool(complaints))


def _keep(case_folder: Path, target: Path, arguments: list[str]) -> None:
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(case_folder, target, symlinks=True, ignore=_pipes)
    (target / "arguments.json").write_text(json.dumps(arguments))


def _pipes(folder: str, names: list[str]) -> list[str]:
    return [name for name in names if (Path(folder) / name).is_fifo()]


if __name__ == "__main__":
    sys.exit(main())
