"""The parts of the map of a fleet: places and landmarks of one session, or of many that were joined.

Once many sessions are joined, they are folded: one place in each cell of their area stands for all places in it, with
the sum of their observations. A folded part is joined with later sessions as a single map, so that the cost of a night
grows with the area of the city and not with the number of nights.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from pydantic_core import from_json

from logs.messages import ObjectMapRecord
from logs.records import frozen
from logs.storage.placement import write_text
from slam.backend.factors import EdgeKind
from slam.common.arrays import FloatArray, IntArray
from slam.object_map.map_io import SavedMap, are_of_kind, load_map, write_map
from slam.provenance import recorded_config

LEDGER_NAME = "visits.json"


@frozen
class Visit:
    """What a session did in a map: the ``steps`` (S, 2, 3) m between its places, and the ``landmarks`` (N,) that it
    observed, by their rows.
    """

    steps: FloatArray
    landmarks: IntArray


@frozen
class Part:
    """A condensed map of some sessions.

    ``visits`` by the numbers of the sessions, in the order of their dates.
    """

    saved: SavedMap
    visits: Mapping[int, Visit]

    @property
    def sessions(self) -> tuple[int, ...]:
        """Numbers of its sessions, ascending."""
        return tuple(sorted(self.visits))

    @property
    def objects(self) -> ObjectMapRecord:
        """Its landmarks."""
        return self.saved.objects


def session_part(number: int, saved: SavedMap) -> Part:
    """The condensed map of the session ``number`` as a part of its own."""
    graph = saved.graph
    steps = graph.edge_keyframe_ids[are_of_kind(graph, EdgeKind.ODOMETRY)]
    if not len(steps):
        steps = np.zeros((1, 2), dtype=np.int64)
    return Part(saved, {number: Visit(graph.T_map_body[steps, :3, 3], np.arange(len(saved.objects.ids)))})


def common_metadata(maps: Iterable[SavedMap]) -> Mapping[str, str]:
    """Of these maps, one at least, the metadata by whose configuration their landmarks are compared.

    It is that of the map whose landmarks are less exact than in nine of ten maps: landmarks of one object are as far
    apart as the errors of the worse of two maps, but one robot that is lost in noise is not to decide for all.

    Raises:
        SavedMapError: as :func:`slam.provenance.recorded_config`.
    """
    ordered = sorted(
        (saved.metadata for saved in maps), key=lambda each: recorded_config(each).calibration.objects.landmark_sigma_m
    )
    return ordered[math.ceil(0.9 * (len(ordered) - 1))]


def save_parts(folder: Path, parts: Sequence[Part]) -> None:
    """Write parts into a folder.

    Raises:
        LogError, SavedMapError: one cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    ledger = []
    for rank, part in enumerate(parts, start=1):
        write_map(_file(folder, rank), part.saved)
        ledger.append({number: (each.steps.tolist(), each.landmarks.tolist()) for number, each in part.visits.items()})
    # Written last: with it the folder is complete.
    write_text(folder / LEDGER_NAME, json.dumps(ledger) + "\n")


def are_saved(folder: Path) -> bool:
    """Whether all parts are in a folder."""
    return (folder / LEDGER_NAME).exists()


def load_parts(folder: Path) -> list[Part]:
    """The parts in a folder.

    Raises:
        LogError, SavedMapError: one cannot be read.
    """
    ledger = from_json((folder / LEDGER_NAME).read_text(encoding="utf-8"))
    return [
        Part(
            load_map(_file(folder, rank)),
            {int(number): Visit(*map(np.array, visit)) for number, visit in visits.items()},
        )
        for rank, visits in enumerate(ledger, start=1)
    ]


def _file(folder: Path, rank: int) -> Path:
    return folder / f"part_{rank}.mcap"
