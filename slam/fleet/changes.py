"""What changed where a fleet drove: objects that appeared, went or moved, with probability and dates."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from logs.storage.placement import write_text
from slam.common.arrays import IntArray
from slam.common.georeference import Georeference
from slam.fleet.passes import find_passes
from slam.fleet.presence import Presence, estimate_presence, seen_probabilities
from slam.map_joining.part import Part

REPORTED = 0.5
"""Changes of at least that probability are reported."""


@dataclass(frozen=True, slots=True)
class Change:
    """A landmark that changed. ``kind``: "appeared", "gone" or "moved"; ``probability`` of that; it happened between
    ``after`` and ``before`` (UTC), the sessions that tell. ``position`` (3,) m in the map, for a moved object where it
    is now, ``from_position`` where it was, and ``from_landmark`` what it was there; else None and empty.
    """

    kind: str
    landmark: str
    label: str
    probability: float
    after: str
    before: str
    position: tuple[float, float, float]
    from_landmark: str = ""
    from_position: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LivingMap:
    """``presence`` of the landmarks of a part, and the ``changes`` that this shows."""

    presence: Presence
    changes: tuple[Change, ...]


def detect_changes(part: Part, stamps_ns: Sequence[int]) -> LivingMap:
    """What changed in a part of the map.

    Args:
        part: with sessions numbered in the order of their dates.
        stamps_ns: when each of its sessions drove.
    """
    passes = find_passes(part)
    when = np.array(stamps_ns, dtype=np.int64)
    presence = estimate_presence(passes.seen, seen_probabilities(passes.seen, passes.in_view_m), when)
    return LivingMap(presence, _changes(part, presence, when, area_m2=_area_m2(part)))


def write_changes(path: Path, changes: Sequence[Change], georeference: Georeference | None) -> None:
    """Write a point a change as GeoJSON: degrees on WGS 84, or metres in the map where its place on earth is unknown.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": _coordinates(change.position, georeference)},
            "properties": {
                **{key: value for key, value in asdict(change).items() if key not in ("position", "from_position")},
                "from": None if change.from_position is None else _coordinates(change.from_position, georeference),
            },
        }
        for change in changes
    ]
    collection: dict[str, object] = {"type": "FeatureCollection", "features": features}
    if georeference is None:
        collection["coordinates"] = "metres in the frame of the map"
    write_text(path, json.dumps(collection, indent=1) + "\n")


def _coordinates(position: tuple[float, float, float], georeference: Georeference | None) -> list[float]:
    if georeference is None:
        return [round(value, 3) for value in position]
    latitude, longitude, altitude_m = georeference.to_geodetic(np.array([position]))[0].tolist()
    return [round(longitude, 9), round(latitude, 9), round(altitude_m, 3)]


def _area_m2(part: Part) -> float:
    """Area of the map, as its landmarks cover it: points at random are half a mean spacing from the nearest other."""
    positions = part.objects.positions[:, :2]
    if len(positions) < 2:
        return 1.0
    nearest_m = np.asarray(cKDTree(positions).query(positions, k=2)[0])[:, 1]
    return len(positions) * (2.0 * float(np.median(nearest_m)) + 1e-3) ** 2


def _changes(part: Part, presence: Presence, when: IntArray, *, area_m2: float) -> tuple[Change, ...]:
    if len(when) < 2:
        return ()
    appeared = np.flatnonzero(presence.appeared >= REPORTED).tolist()
    gone = np.flatnonzero(presence.gone >= REPORTED).tolist()
    moves = _moves(part, presence, appeared, gone, area_m2)
    came, went = {new for new, _, _ in moves}, {old for _, old, _ in moves}
    changes = [
        *(_moved(part, presence, when, *move) for move in moves),
        *(_change(part, presence, when, row, "appeared") for row in appeared if row not in came),
        *(_change(part, presence, when, row, "gone") for row in gone if row not in went),
    ]
    return tuple(sorted(changes, key=lambda change: (change.before, change.kind, int(change.landmark))))


def _moves(
    part: Part, presence: Presence, appeared: list[int], gone: list[int], area_m2: float
) -> list[tuple[int, int, float]]:
    """Rows of what appeared and of what went that are one object, with the probability.

    Another object of the class appears by chance within the distance d with probability 1 - exp(-density pi d^2); the
    two have to be the nearest of each other.
    """
    labels = np.array(part.objects.labels)
    positions = part.objects.positions[:, :2]
    moves = []
    for label in sorted({*labels[appeared].tolist()} & {*labels[gone].tolist()}):
        new, old = [row for row in appeared if labels[row] == label], [row for row in gone if labels[row] == label]
        apart_m = np.hypot(*(positions[new][:, None] - positions[old][None]).transpose(2, 0, 1))
        for i, row in enumerate(new):
            j = int(apart_m[i].argmin())
            if int(apart_m[:, j].argmin()) != i:
                continue
            alone = np.exp(-len(new) / area_m2 * np.pi * apart_m[i, j] ** 2)
            probability = float(presence.appeared[row] * presence.gone[old[j]] * alone)
            if probability >= REPORTED:
                moves.append((row, old[j], probability))
    return moves


def _moved(part: Part, presence: Presence, when: IntArray, new: int, old: int, probability: float) -> Change:
    return replace(
        _change(part, presence, when, new, "appeared"),
        kind="moved",
        probability=round(probability, 4),
        after=_change(part, presence, when, old, "gone").after,
        from_landmark=part.objects.ids[old],
        from_position=_position(part, old),
    )


def _change(part: Part, presence: Presence, when: IntArray, row: int, kind: str) -> Change:
    """A change of one landmark, between the sessions around the likeliest time."""
    column = ("appeared", "gone").index(kind)
    probability = float((presence.appeared, presence.gone)[column][row])
    likely = presence.changed[row, :, column]
    # All sessions among which the change may lie: those that did not pass leave it open.
    span = np.flatnonzero(likely > 0.05 * likely.max())
    return Change(
        kind,
        part.objects.ids[row],
        part.objects.labels[row],
        round(probability, 4),
        _date(int(when[span[0]])),
        _date(int(when[span[-1] + 1])),
        _position(part, row),
    )


def _position(part: Part, row: int) -> tuple[float, float, float]:
    x, y, z = part.objects.positions[row].tolist()
    return x, y, z


def _date(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC).isoformat()
