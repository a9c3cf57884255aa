"""``python -m tests.fleet_cost 1 10 100 300``: processor time and memory of what follows the mapping of so many logs.

The maps are those of drives of 250 m at random places of one town, made without replays. Each number of logs is
measured in a process of its own.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import sys
import time

import numpy as np

from slam.common.config import Config
from slam.fleet.changes import detect_changes
from slam.map_joining.acceptance import judge_pairs
from slam.map_joining.condensed_map import condense_map, stretch_length_m
from slam.map_joining.joins import find_joins
from slam.map_joining.joint_map import join_maps
from slam.map_joining.place_index import make_place_index
from slam.object_map.map_io import SavedMap
from tests.helpers.driven_maps import driven_map, town

LENGTH_M = 250.0
DAY_NS = 86_400_000_000_000
COLUMNS = ("logs", "landmarks", "joins", "index s", "places s", "joint map s", "changes s", "of one town", "MB")


def main() -> int:
    """Prints a table."""
    parser = argparse.ArgumentParser(prog="python -m tests.fleet_cost", description=__doc__)
    parser.add_argument("logs", type=int, nargs="+")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print("| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS), flush=True)
    for count in options.logs:
        with multiprocessing.get_context("fork").Pool(1) as pool:
            row = pool.apply(measure, (count, options.seed))
        print("| " + " | ".join(row) + " |", flush=True)
    return 0


def measure(count: int, seed: int) -> list[str]:
    """One row of the table."""
    config = Config()
    maps = sessions(count, seed=seed, stretch_m=stretch_length_m(config))
    marks = [time.process_time()]
    index = make_place_index(maps, sigma_m=config.calibration.objects.landmark_sigma_m)
    marks.append(time.process_time())
    joins = [join for number, each in enumerate(maps) for join in find_joins(each, number, index, config)]
    landmarks = sum(len(each.objects.ids) for each in maps)
    pairs = judge_pairs(maps, joins, config, penalty=float(np.log(landmarks)))
    marks.append(time.process_time())
    parts = join_maps(dict(enumerate(maps)), pairs, config)
    marks.append(time.process_time())
    for part in parts:
        detect_changes(part, [number * DAY_NS for number in part.members])
    marks.append(time.process_time())
    seconds = [f"{each:.2f}" for each in np.diff(marks)]
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    return [str(count), str(landmarks), str(len(joins)), *seconds, str(len(parts[0].members)), str(peak_mb)]


def sessions(count: int, *, seed: int, stretch_m: float) -> list[SavedMap]:
    """Condensed maps of drives through one town."""
    world, rng = town(), np.random.default_rng(seed)
    tour_m = float(np.linalg.norm(np.diff(world.tour, axis=0), axis=1).sum())
    starts_m = rng.uniform(0.0, tour_m - LENGTH_M, count).tolist()
    drives = (
        driven_map(world, start_m, start_m + LENGTH_M, seed=number, stamp_ns=number * DAY_NS)
        for number, start_m in enumerate(starts_m)
    )
    return [condense_map(drive, stretch_m=stretch_m) for drive in drives]


if __name__ == "__main__":
    sys.exit(main())
