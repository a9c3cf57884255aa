"""``python -m tests.soak``: simulate many laps of a town, replay them in one go, print memory and time per lap."""

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from slam.common.config import Config
from slam.replay import replay
from slam.simulation.config import DriveConfig, SimulationConfig
from slam.simulation.simulation import write_simulation
from slam.simulation.street_grid import generate_street_grid
from slam.simulation.world import World
from tests.fuzz.sandbox import status_bytes

FLAT = 0.1
"""Memory may grow by that share after the first lap."""


def main() -> int:
    """Exit code 1 if the memory of the last lap is more than ``FLAT`` above that of the first."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("--laps", type=int, default=40)
    parser.add_argument("--hours", type=float, default=24.0, help="length of the drive, at 10 scans a second")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    world = town(options.laps, seed=options.seed)
    speed_mps = world.tour_length_m / (3600.0 * options.hours)
    with tempfile.TemporaryDirectory(prefix="soak-") as folder:
        log = Path(folder) / "drive.mcap"
        config = SimulationConfig(drive=DriveConfig(speed_mps=speed_mps))
        summary = write_simulation(log, world, config, seed=options.seed)
        print(
            f"{world.tour_length_m / 1000.0:.1f} km in {summary.duration_s / 3600.0:.2f} h, {options.laps} laps, "
            f"{len(world.object_ids)} objects in the town, log of {log.stat().st_size / 1e6:.0f} MB",
            flush=True,
        )
        laps = Laps(options.laps)
        result = replay(log, Path(folder) / "map.mcap", Config(), progress=laps.note)
        laps.note(1.0)
    confirmed = result.counters["landmarks_confirmed"]
    print(f"{confirmed} landmarks confirmed, {result.counters['closures_accepted']} closures accepted; the end took "
          f"{time.perf_counter() - laps.ended:.0f} s and {1e-6 * status_bytes('VmHWM'):.0f} MB at most")  # fmt: skip
    return int(laps.megabytes[-1] > (1.0 + FLAT) * laps.megabytes[0])


def town(laps: int, *, seed: int) -> World:
    """A town whose tour of 1.5 to 2 km is driven to and fro, ``laps`` times in all."""
    world = generate_street_grid(rng=np.random.default_rng(seed))
    back = world.tour[::-1]
    tour = [world.tour] + [(back if lap % 2 else world.tour)[1:] for lap in range(1, laps)]
    return replace(world, name="town", tour=np.concatenate(tour))


class Laps:
    """Memory and time at the end of each lap."""

    def __init__(self, count: int) -> None:
        self._count = count
        self.megabytes: list[float] = []
        self.ended = 0.0
        self._cpu_started = time.process_time()

    def note(self, done: float) -> None:
        """Called with the share of the drive that is done."""
        if int(done * self._count + 1e-9) <= len(self.megabytes) or len(self.megabytes) >= self._count:
            return
        now = time.process_time()
        self.megabytes.append(1e-6 * status_bytes("VmRSS"))
        print(f"lap {len(self.megabytes):3d}: {self.megabytes[-1]:6.0f} MB, {now - self._cpu_started:6.1f} s of "
              "processor time", flush=True)  # fmt: skip
        self._cpu_started, self.ended = now, time.perf_counter()


if __name__ == "__main__":
    sys.exit(main())
