"""What is said of a drive that was not found in its map, or at a wrong place."""

import re
from dataclasses import replace

import numpy as np
import pytest

from logs.messages import GeodeticFix, ObjectMapRecord, TrajectoryRecord
from slam.common.arrays import FloatArray
from slam.common.geometry import apply, transform_from_xyz_yaw
from slam.common.georeference import Georeference
from slam.localization.prior_map import PriorMap
from slam.localization.unrecognised_map import MIN_LANDMARKS, MIRRORED, why_doubtful, why_not_recognised
from slam.object_map.map_io import SavedMap
from slam.place_recognition.imported_map import ImportedMap, make_imported_map
from tests.helpers.poses import pose_at
from tests.slam.evaluation.results import graph

SIGMA_M = 0.1
CLASSES = ("bench", "lamp", "tree")
SEEN = 30


def town(seed: int = 0, *, vocabulary: tuple[str, ...] = CLASSES, is_mirrored: bool = False) -> ImportedMap:
    """Objects all over 300 m by 300 m, far from the origin."""
    rng = np.random.default_rng(seed)
    positions = np.column_stack([rng.uniform(5000.0, 5300.0, (700, 2)), np.zeros(700)])
    positions = positions[:, [1, 0, 2]] if is_mirrored else positions
    labels = [vocabulary[row] for row in rng.integers(3, size=700).tolist()]
    known = make_imported_map(positions, labels, [str(row) for row in range(700)], sigma_m=SIGMA_M)
    return replace(known, georeference=Georeference(60.0, 25.0, 0.0, 0.0))


def driven(known: ImportedMap) -> tuple[ObjectMapRecord, TrajectoryRecord]:
    """The nearest objects to a robot in the middle of the town, in a frame of its own, with noise."""
    from_middle = np.linalg.norm(known.positions[:, :2] - known.positions[:, :2].mean(axis=0), axis=1)
    rows = np.argsort(from_middle)[:SEEN]
    T_local_map = transform_from_xyz_yaw(np.zeros(3), 2.0)
    T_local_map[:3, 3] = np.array([7.0, -3.0, 1.0]) - T_local_map[:3, :3] @ known.positions.mean(axis=0)
    seen: FloatArray = apply(T_local_map, known.positions[rows])
    seen[:, :2] += np.random.default_rng(1).normal(0.0, SIGMA_M, (SEEN, 2))
    ids = tuple(str(row) for row in range(SEEN))
    objects = ObjectMapRecord.of_objects(ids, seen, known.classes[rows], known.vocabulary, stamp_ns=5)
    return objects, TrajectoryRecord(5, "map", np.array([5]), pose_at(7.0, -3.0, z=1.0)[None])


@pytest.mark.parametrize(
    ("known", "reason"),
    [
        (town(), "30 of 30 landmarks meet an object .*; drive farther"),
        (town(is_mirrored=True), "x and y exchanged"),
        (town(seed=9), "of 30 landmarks meet an object of their class: the map is of another place"),
        (town(vocabulary=("Bank", "Baum", "Licht")), "no class in common: the map has Bank, Baum, Licht, the drive"),
    ],
    ids=["true", "mirrored", "other", "foreign"],
)
def test_likeliest_reason_is_told(known: ImportedMap, reason: str) -> None:
    assert re.search(reason, why_not_recognised(known, *driven(town()), SIGMA_M))


@pytest.mark.parametrize("is_driven", [False, True])
def test_fixes_far_from_the_map_come_first(is_driven: bool) -> None:
    fixes = [GeodeticFix(0, "gps", 10.0, 25.0, 0.0)]
    known: PriorMap = town()
    if is_driven:
        known = SavedMap(
            known.objects, graph(np.arange(1), np.eye(4)[None]), {"georeference": Georeference(60.0, 25.0).to_json()}
        )
    assert "are 4877 km from the nearest object" in why_not_recognised(known, *driven(town()), SIGMA_M, fixes)


def test_landmarks_of_the_drive_alone_count_and_a_few_are_too_few() -> None:
    objects, trajectory = driven(town())
    first_seen_ns = np.where(np.arange(SEEN) < MIN_LANDMARKS - 1, 5, 4)
    old = replace(objects, first_seen_ns=first_seen_ns)
    assert "3 landmarks" in why_not_recognised(town(), old, trajectory, SIGMA_M)


@pytest.mark.parametrize(("known", "doubt"), [(town(is_mirrored=True), MIRRORED), (town(), ""), (town(seed=9), "")])
def test_only_a_mirrored_map_is_doubtful(known: ImportedMap, doubt: str) -> None:
    assert why_doubtful(known, *driven(town()), SIGMA_M) == doubt
