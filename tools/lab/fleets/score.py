"""How right the map of a simulated fleet is, beside the maps of its drives: landmarks, duplicates, joins, changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from logs.messages import ObjectMapRecord
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply
from slam.evaluation.metrics.alignment import align_yaw_translation
from slam.evaluation.metrics.landmarks import match_by_position
from slam.fleet.changes import Change
from slam.fleet.fleet import Fleet
from slam.fleet.part import Part
from slam.object_map.map_io import SavedMap
from tools.lab.fleets.simulated_fleet import XYZ, SimulatedFleet, TrueDrive

MATCH_M = 1.0
"""A landmark and an object of its class within that distance are one."""
PASSED_M = 15.0
PASSES = 2
"""A change counts where so many drives passed before it, and after it, within ``PASSED_M``: others cannot show."""
FALSE_JOIN_M = 3.0
ALIGNMENTS = 5


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Errors (N,) m of the landmarks that have an object, how many objects have several, and the alignment (4, 4)."""

    errors_m: FloatArray
    duplicates: int
    T_world_map: FloatArray


def score_fleet(truth: SimulatedFleet, fleet: Fleet, maps: Sequence[SavedMap]) -> dict[str, float]:
    """Compare the joint maps with the worlds.

    Args:
        truth: what was simulated.
        fleet: what became of it.
        maps: of the sessions, by their numbers.

    Returns:
        Errors of landmarks in the plane [m]: RMSE and median, in the joint maps and in the maps of the drives;
        ``duplicates``: share of landmarks whose object has another one; joins: members that are elsewhere by
        ``FALSE_JOIN_M`` or of another city; ``unjoined``: usable drives outside the part of their city; changes as
        events.
    """
    drives = [truth.drives[digest] for digest in fleet.order]
    joint = [each for each in fleet.maps if len(each.part.visits) > 1]
    best, false_joins, fits, changes = dict[int, int](), 0, [], [np.zeros(4, dtype=np.int64)]
    for each in joint:
        members = [drives[number] for number in each.part.sessions]
        city = members[0].city
        fits.append(_fit(each.part.objects, members[0], truth))
        false_joins += _false_joins(each.part, members, fits[-1].T_world_map)
        if city >= 0:
            best[city] = max(best.get(city, 0), len(members))
            changes.append(_score_changes(each.changes, truth.objects[city], members, fits[-1].T_world_map))
    single = [_fit(saved.objects, drive, truth) for saved, drive in zip(maps, drives, strict=True) if drive.city >= 0]
    usable = sum(drive.city >= 0 for drive in truth.drives.values())
    landmarks = sum(len(each.part.objects.ids) for each in joint)
    reported, right, shown, found = np.sum(changes, axis=0).tolist()
    return {
        "logs": len(truth.logs),
        "unusable": len(truth.logs) - usable,
        "parts": len(joint),
        "joined": sum(best.values()),
        "unjoined": usable - sum(best.values()),
        "false_joins": false_joins,
        "landmarks": landmarks,
        **_errors("", fits),
        **_errors("single_", single),
        "duplicates": sum(fit.duplicates for fit in fits) / max(landmarks, 1),
        "changes_true": shown,
        "changes_reported": reported,
        "change_precision": right / max(reported, 1),
        "change_recall": found / max(shown, 1),
    }


def _errors(of: str, fits: Sequence[_Fit]) -> dict[str, float]:
    """RMSE and median [m]."""
    errors_m = np.concatenate([fit.errors_m for fit in fits]) if fits else np.array([np.nan])
    return {f"{of}rmse_m": float(np.sqrt(np.mean(errors_m**2))), f"{of}median_m": float(np.median(errors_m))}


def _fit(objects: ObjectMapRecord, first: TrueDrive, truth: SimulatedFleet) -> _Fit:
    """Align a map with all that ever stood in its city, beginning at the true pose of its frame."""
    T = first.T_world_first
    nothing = _Fit(np.zeros(0), 0, T)
    if first.city < 0:
        return nothing
    table = truth.objects[first.city]
    vocabulary, classes = np.unique(table["label"].tolist(), return_inverse=True)
    world = ObjectMapRecord.of_objects(table.index.tolist(), table[XYZ].to_numpy(), classes, tuple(vocabulary.tolist()))
    rows = matched = np.zeros(0, dtype=np.int64)
    for _ in range(ALIGNMENTS):
        matches = match_by_position(objects, world, T, max_distance_m=MATCH_M)
        is_matched = matches.object_rows >= 0
        rows, matched = matches.landmark_rows[is_matched], matches.object_rows[is_matched]
        if len(rows) < 3:
            return nothing
        T = align_yaw_translation(objects.positions[rows], world.positions[matched]).T_world_map
    offsets = apply(T, objects.positions[rows]) - world.positions[matched]
    return _Fit(np.hypot(offsets[:, 0], offsets[:, 1]), len(matched) - len(np.unique(matched)), T)


def _false_joins(part: Part, members: Sequence[TrueDrive], T_world_map: FloatArray) -> int:
    """Members of another city than the first, or whose places are not on their path."""
    wrong = 0
    for number, drive in zip(part.sessions, members, strict=True):
        places = apply(T_world_map, part.visits[number].steps.reshape(-1, 3))
        away_m = cKDTree(drive.path).query(places[:, :2])[0]
        wrong += drive.city != members[0].city or bool(np.median(away_m) > FALSE_JOIN_M)
    return wrong


def _score_changes(
    changes: Sequence[Change], objects: pd.DataFrame, members: Sequence[TrueDrive], T_world_map: FloatArray
) -> IntArray:
    """Changes that are reported, those of them that are right, those that the drives could show, and of these found."""
    reported = [
        (kind, change.label, *apply(T_world_map, np.array([position]))[0, :2])
        for change in changes
        for kind, position in (
            ("gone" if change.kind == "gone" else "appeared", change.position),
            ("gone", change.from_position),
        )
        if position is not None
    ]
    told = pd.DataFrame(reported, columns=["kind", "label", "x", "y"])
    came, went = objects[objects["came"] > 0], objects[objects["went"].notna()]
    true = pd.concat([came.assign(kind="appeared", month=came["came"]), went.assign(kind="gone", month=went["went"])])
    apart_m = cdist(told[["x", "y"]].to_numpy(dtype=float), true[["x", "y"]])
    is_alike = np.equal(told[["kind", "label"]].to_numpy()[:, None], true[["kind", "label"]].to_numpy())
    is_same = (apart_m < MATCH_M) & np.all(is_alike, axis=-1)
    passed = np.array([cdist(true[["x", "y"]], drive.path).min(axis=1) < PASSED_M for drive in members])
    is_after = np.array([drive.month for drive in members])[:, None] >= true["month"].to_numpy()
    shown = np.minimum((passed & is_after).sum(axis=0), (passed & ~is_after).sum(axis=0)) >= PASSES
    return np.array([len(told), is_same.any(axis=1).sum(), shown.sum(), is_same.any(axis=0)[shown].sum()])
