"""Parts of a fleet without files: made of maps of drives, joined, or with landmarks that a test places."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from logs.messages import ObjectMapRecord
from slam.common.arrays import BoolArray, FloatArray
from slam.common.config import Config
from slam.fleet.condensed_map import condense_map
from slam.fleet.joins import Join, find_joins
from slam.fleet.part import Part, Visit, session_part
from slam.object_map.map_io import SavedMap
from tests.helpers.driven_maps import driven_map, town

CONFIG = Config()


def session_parts(maps: Iterable[SavedMap]) -> list[Part]:
    return [session_part(*each) for each in enumerate(condense_map(saved, CONFIG) for saved in maps)]


def joins_of(parts: Sequence[Part]) -> list[Join]:
    maps = [part.saved for part in parts]
    return [join for number in range(1, len(maps)) for join in find_joins(maps[number], maps[:number], CONFIG)]


def street_part(positions: FloatArray, labels: Sequence[str], seen: BoolArray) -> Part:
    """Landmarks at (L, 3) m, as ``seen`` (L, M) by sessions that drove 95 m along x from 0, with places every 25 m."""
    saved = driven_map(town(), 0.0, 10.0)
    vocabulary, classes = np.unique(labels, return_inverse=True)
    ids = [str(row) for row in range(len(positions))]
    objects = ObjectMapRecord.of_objects(ids, positions, classes, tuple(vocabulary.tolist()))
    steps = np.zeros((4, 2, 3))
    steps[:, :, 0] = [[0.0, 25.0], [25.0, 50.0], [50.0, 75.0], [75.0, 95.0]]
    visits = {number: Visit(steps, np.flatnonzero(column)) for number, column in enumerate(seen.T)}
    return Part(replace(saved, objects=objects), visits)
