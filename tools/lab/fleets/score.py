"""How right the map of a simulated fleet is, beside the maps of its drives: landmarks, duplicates, joins, changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from logs.messages import ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.geometry import apply
from slam.evaluation.metrics.alignment import align_yaw_translation
from slam.fleet.changes import Change
from slam.fleet.fleet import Fleet
from slam.map_joining.part import Part
from slam.object_map.map_io import SavedMap
from tools.lab.fleets.simulated_fleet import Event, SimulatedFleet, TrueDrive

MATCH_M = 1.0
"""A landmark and an object of its class within that distance are one."""
PASSED_M = 15.0
PASSES = 2
"""A change counts where so many drives passed before it, and after it, within ``PASSED_M``: others cannot show."""
FALSE_JOIN_M = 3.0
ALIGNMENTS = 5


@dataclass(frozen=True, slots=True)
class FleetScore:
    """Figures of a fleet. Errors of landmarks in the plane [m]: RMSE and median, in the joint maps and in the maps of
    the drives; ``duplicates``: share of landmarks whose object has another one; joins: members that are elsewhere by
    ``FALSE_JOIN_M`` or of another city; ``unjoined``: usable drives outside the part of their city; changes as events.
    """

    logs: int
    unusable: int
    parts: int
    joined: int
    unjoined: int
    false_joins: int
    landmarks: int
    rmse_m: float
    median_m: float
    single_rmse_m: float
    single_median_m: float
    duplicates: float
    changes_true: int
    changes_reported: int
    change_precision: float
    change_recall: float


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    errors_m: FloatArray
    duplicates: int
    T_world_map: FloatArray


def score_fleet(truth: SimulatedFleet, fleet: Fleet, maps: Sequence[SavedMap]) -> FleetScore:
    """Compare the joint maps with the worlds.

    Args:
        truth: what was simulated.
        fleet: what became of it.
        maps: of the sessions, by their numbers.
    """
    name_of = {digest: name for name, digest in reversed(list(fleet.logs.items()))}
    drives = [truth.drives[name_of[digest]] for digest in fleet.order]
    joint = [(part, living) for part, living in zip(fleet.parts, fleet.living, strict=True) if len(part.sessions) > 1]
    errors, duplicates, landmarks, false_joins = list[FloatArray](), 0, 0, 0
    reported = right = counted = found = 0
    best: dict[int, int] = {}
    for part, living in joint:
        city = drives[part.sessions[0]].city
        if city >= 0:
            best[city] = max(best.get(city, 0), len(part.sessions))
        fit = _fit(part.objects, drives[part.sessions[0]], _everything(truth, city))
        errors.append(fit.errors_m)
        duplicates += fit.duplicates
        landmarks += len(part.objects.ids)
        false_joins += _false_joins(part, drives, fit.T_world_map)
        members = [drives[number] for number in part.sessions]
        a, b, c, d = _score_changes(living.changes, truth.events[city], members, fit.T_world_map)
        reported, right, counted, found = reported + a, right + b, counted + c, found + d
    single = [
        _fit(saved.objects, drive, _everything(truth, drive.city)).errors_m
        for saved, drive in zip(maps, drives, strict=True)
        if drive.city >= 0
    ]
    usable = sum(drive.city >= 0 for drive in truth.drives.values())
    return FleetScore(
        logs=len(truth.logs),
        unusable=len(truth.logs) - usable,
        parts=len(joint),
        joined=sum(best.values()),
        unjoined=usable - sum(best.values()),
        false_joins=false_joins,
        landmarks=landmarks,
        rmse_m=_rmse(errors),
        median_m=float(np.median(np.concatenate(errors))) if errors else float("nan"),
        single_rmse_m=_rmse(single),
        single_median_m=float(np.median(np.concatenate(single))),
        duplicates=duplicates / max(landmarks, 1),
        changes_true=counted,
        changes_reported=reported,
        change_precision=right / max(reported, 1),
        change_recall=found / max(counted, 1),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Objects:
    ids: tuple[str, ...]
    labels: tuple[str, ...]
    positions: FloatArray


def _everything(truth: SimulatedFleet, city: int) -> _Objects:
    """All objects that ever stood in a city; none for no city."""
    known: dict[str, tuple[str, FloatArray]] = {}
    for world in truth.worlds[city] if city >= 0 else ():
        known |= {
            name: (label, position)
            for name, label, position in zip(world.object_ids, world.labels, world.positions, strict=True)
        }
    positions = np.array([position for _, position in known.values()]).reshape(-1, 3)
    return _Objects(tuple(known), tuple(label for label, _ in known.values()), positions)


def _fit(objects: ObjectMapRecord, first: TrueDrive, world: _Objects) -> _Fit:
    """Align a map with the world by the landmarks that have an object, which begins at the true pose of its frame."""
    T = first.T_world_first
    if not len(world.positions):
        return _Fit(np.zeros(0), 0, T)
    landmarks, matched = np.zeros(0, np.int64), np.zeros(0, np.int64)
    for _ in range(ALIGNMENTS):
        landmarks, matched = _matches(apply(T, objects.positions), objects.labels, world)
        if len(landmarks) < 3:
            return _Fit(np.zeros(0), 0, T)
        T = align_yaw_translation(objects.positions[landmarks], world.positions[matched]).T_world_map
    offsets = apply(T, objects.positions[landmarks]) - world.positions[matched]
    return _Fit(np.hypot(offsets[:, 0], offsets[:, 1]), len(matched) - len(np.unique(matched)), T)


def _matches(positions: FloatArray, labels: Sequence[str], world: _Objects) -> tuple[np.ndarray, np.ndarray]:
    """Rows of landmarks and of the nearest object of their class, where that is near."""
    landmarks, matched = [], []
    names, classes = np.array(labels), np.array(world.labels)
    for label in sorted(set(labels) & set(world.labels)):
        mine, theirs = np.flatnonzero(names == label), np.flatnonzero(classes == label)
        distances_m, nearest = cKDTree(world.positions[theirs, :2]).query(positions[mine, :2])
        near = np.asarray(distances_m) < MATCH_M
        landmarks.append(mine[near])
        matched.append(theirs[np.asarray(nearest)[near]])
    empty = [np.zeros(0, np.int64)]
    return np.concatenate(landmarks or empty), np.concatenate(matched or empty)


def _false_joins(part: Part, drives: Sequence[TrueDrive], T_world_map: FloatArray) -> int:
    """Members of another city than the first, or whose places are not on their path."""
    wrong = 0
    for number, steps in part.paths.items():
        places = steps.reshape(-1, 3)
        drive = drives[number]
        away_m = np.asarray(cKDTree(drive.path).query(apply(T_world_map, places)[:, :2])[0])
        wrong += drive.city != drives[part.sessions[0]].city or bool(np.median(away_m) > FALSE_JOIN_M)
    return wrong


def _score_changes(
    changes: Sequence[Change], events: Sequence[Event], members: Sequence[TrueDrive], T_world_map: FloatArray
) -> tuple[int, int, int, int]:
    """Changes that are reported, those of them that are right, those that the drives could show, and of these found."""
    reported = [
        (kind, change.label, apply(T_world_map, np.array([position]))[0])
        for change in changes
        for kind, position in _events_of(change)
    ]
    right = sum(any(_is_same(each, event) for event in events) for each in reported)
    shown = [event for event in events if _can_show(event, members)]
    found = sum(any(_is_same(each, event) for each in reported) for event in shown)
    return len(reported), right, len(shown), found


def _events_of(change: Change) -> list[tuple[str, tuple[float, float, float]]]:
    if change.kind == "moved" and change.from_position is not None:
        return [("appeared", change.position), ("gone", change.from_position)]
    return [(change.kind, change.position)]


def _is_same(change: tuple[str, str, FloatArray], event: Event) -> bool:
    kind, label, position = change
    return kind == event.kind and label == event.label and float(np.hypot(*(position - event.position)[:2])) < MATCH_M


def _can_show(event: Event, members: Sequence[TrueDrive]) -> bool:
    passed = [
        drive.month >= event.month
        for drive in members
        if np.hypot(*(drive.path - event.position[:2]).T).min() < PASSED_M
    ]
    return passed.count(False) >= PASSES and passed.count(True) >= PASSES


def _rmse(errors: Sequence[FloatArray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else float("nan")
