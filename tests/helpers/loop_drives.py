"""Short drives with and without loops, replayed and measured."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from logs.messages import FactorGraphRecord, LoopClosureRecord
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.evaluation.evaluate import Evaluation
from slam.simulation.config import DriveConfig, KidnapConfig, SimulationConfig
from slam.simulation.world import World
from tests.helpers.short_drives import drive, records_of, run

CLASSES = ("bench", "bin", "hydrant", "lamp", "sign", "tree", "vehicle")
CORNERS = {"A": (0, 0), "B": (80, 0), "C": (160, 0), "D": (160, 60), "E": (80, 60), "F": (0, 60)}
SLOW = SimulationConfig(drive=DriveConfig(rate_hz=5.0))
"""With the default noise, at 5 scans a second."""
TWO_BLOCKS_ROUND_M, ONE_BLOCK_ROUND_M = 440.0, 280.0
"""Lengths of the first round."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """An output log and what can be said of it."""

    path: Path
    evaluation: Evaluation

    @property
    def records(self) -> list[LoopClosureRecord]:
        return [record for record in records_of(self.path, "/slam/closures") if isinstance(record, LoopClosureRecord)]

    @property
    def accepted_count(self) -> int:
        """How many closures were accepted when they were found, whatever the back end said of them in the end."""
        return len({(r.query_keyframe_id, r.reference_keyframe_id) for r in self.records if r.accepted})

    @property
    def graph(self) -> FactorGraphRecord:
        graph = records_of(self.path, "/slam/graph")[-1]
        assert isinstance(graph, FactorGraphRecord)
        return graph

    @property
    def closures(self) -> dict[str, Any]:
        """Figures by the keys of the JSON."""
        figures: dict[str, Any] = self.evaluation.to_json_dict()["closures"]
        return figures

    @property
    def ate_m(self) -> float:
        return self.evaluation.estimate.ate_m


def replay_drive(
    folder: Path, world: World, *, seed: int = 1, kidnap: KidnapConfig | None = None, **loop_closure: Any
) -> Outcome:
    """Drive through ``world`` with the default noise, at 5 scans a second, and replay it."""
    simulation = SLOW.model_copy(update={"kidnap": kidnap})
    path = folder / "out.mcap"
    config = Config.model_validate({"loop_closure": loop_closure})
    return Outcome(path, run(drive(simulation, seed=seed, world=world), path, config))


def two_blocks() -> World:
    """Around two blocks of 80 m x 60 m, one street of it again, the street between them, and back the other way."""
    return furnished([CORNERS[name] for name in "ABCDEFABEDC"], seed=3)


def one_block() -> World:
    """Around a block of 80 m x 60 m, and one street of it again."""
    return furnished([CORNERS[name] for name in "ABEFAB"], seed=3)


def winding_street() -> World:
    """Streets 100 m apart, to and fro, none driven twice."""
    return furnished([(0, 0), (120, 0), (120, 100), (0, 100), (0, 200), (120, 200)], seed=5)


def rows_of_lamps(spacing_m: float) -> World:
    """Two parallel streets of equal lamps, driven one after the other, the second one in the opposite direction."""
    x = np.arange(10.0, 195.0, spacing_m)
    rows = [np.column_stack([x, np.full_like(x, y), np.zeros_like(x)]) for y in (-6.0, 6.0, 94.0, 106.0)]
    positions = np.concatenate(rows)
    tour = np.array([[0.0, 0.0], [240.0, 0.0], [240.0, 100.0], [0.0, 100.0]])
    return World("lamps", _ids(len(positions)), positions, ("lamp",) * len(positions), tour)


def emptier(world: World) -> World:
    """The same tour past all but every fifth of the objects."""
    rows = [row for row in range(len(world.labels)) if row % 5]
    ids = tuple(world.object_ids[row] for row in rows)
    return World("few", ids, world.positions[rows], tuple(world.labels[row] for row in rows), world.tour)


def furnished(corners: list[tuple[int, int]], *, seed: int) -> World:
    """An object of some class about every 5 m of each street, 4 m to 9 m off it."""
    rng = np.random.default_rng(seed)
    tour = np.array(corners, float)
    streets = sorted({(min(a, b), max(a, b)) for a, b in pairwise(corners)})
    xy = np.concatenate([_along_street(np.array(a, float), np.array(b, float), rng) for a, b in streets])
    positions = np.column_stack([xy, rng.uniform(-0.5, 1.5, len(xy))])
    return World("town", _ids(len(xy)), positions, tuple(rng.choice(CLASSES, len(xy)).tolist()), tour)


def _along_street(start: FloatArray, end: FloatArray, rng: np.random.Generator) -> FloatArray:
    length_m = float(np.linalg.norm(end - start))
    along = (end - start) / length_m
    count = int(length_m / 5.0)
    at_m = rng.uniform(3.0, length_m - 3.0, (count, 1))
    beside_m = rng.uniform(4.0, 9.0, (count, 1)) * rng.choice([-1.0, 1.0], (count, 1))
    return np.asarray(start + at_m * along + beside_m * np.array([-along[1], along[0]]))


def _ids(count: int) -> tuple[str, ...]:
    return tuple(f"object-{i}" for i in range(count))
