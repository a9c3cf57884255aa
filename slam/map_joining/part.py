"""The parts of the map of a fleet: places and landmarks of one session, or of many that were joined.

Once many sessions are joined, they are folded: one place in each cell of their area stands for all places in it, with
the sum of their observations. A folded part is joined with later sessions as a single map, so that the cost of a night
grows with the area of the city and not with the number of nights.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from logs.container.json_text import parse_json
from logs.messages import ObjectMapRecord
from logs.storage.placement import write_text
from slam.backend.factors import EdgeKind
from slam.common.arrays import FloatArray
from slam.map_joining.condensed_map import condense_area
from slam.map_joining.joins import Join
from slam.object_map.map_io import SavedMap, are_of_kind, load_map, write_map

_LEDGER_NAME = "parts.json"


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A condensed map of some sessions, which have numbers in the order of their dates.

    ``paths``: the steps (S, 2, 3) m between places of each session, in the map; ``seen``: the sessions that have a
    landmark, by its id; ``rejected``: joins that contradict the others.
    """

    saved: SavedMap
    paths: Mapping[int, FloatArray]
    seen: Mapping[str, tuple[int, ...]]
    rejected: tuple[Join, ...] = ()

    @property
    def sessions(self) -> tuple[int, ...]:
        """Numbers of its sessions, ascending."""
        return tuple(sorted(self.paths))

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
    path = graph.T_map_body[steps, :3, 3]
    return Part(saved, {number: path}, dict.fromkeys(saved.objects.ids, (number,)))


def fold_part(part: Part, *, stretch_m: float) -> Part:
    """The part with one place for each cell of ``stretch_m``."""
    return replace(part, saved=condense_area(part.saved, stretch_m=stretch_m), rejected=())


def save_parts(folder: Path, parts: Sequence[Part]) -> None:
    """Write parts into a folder; complete once :func:`are_saved`.

    Raises:
        LogError, SavedMapError: one cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for path, part in zip(_files(folder, len(parts)), parts, strict=True):
        write_map(path, part.saved)
    ledger = [
        {"paths": {number: path.tolist() for number, path in part.paths.items()}, "seen": dict(part.seen)}
        for part in parts
    ]
    write_text(folder / _LEDGER_NAME, json.dumps(ledger) + "\n")


def are_saved(folder: Path) -> bool:
    """Whether a folder holds parts, all of them."""
    return (folder / _LEDGER_NAME).exists()


def load_parts(folder: Path) -> list[Part]:
    """The parts in a folder.

    Raises:
        LogError, SavedMapError: one cannot be read.
    """
    ledger = parse_json((folder / _LEDGER_NAME).read_text(encoding="utf-8"))
    return [
        Part(
            load_map(path),
            {int(number): np.array(steps) for number, steps in values["paths"].items()},
            {name: tuple(numbers) for name, numbers in values["seen"].items()},
        )
        for path, values in zip(_files(folder, len(ledger)), ledger, strict=True)
    ]


def saved_parts(folder: Path) -> list[Path]:
    """The files of the parts in a folder, which are all saved."""
    ledger = parse_json((folder / _LEDGER_NAME).read_text(encoding="utf-8"))
    return _files(folder, len(ledger))


def _files(folder: Path, count: int) -> list[Path]:
    return [folder / f"part_{rank}.mcap" for rank in range(1, count + 1)]
