"""What changed where a fleet drove: objects that appeared, went or moved, with probability and dates."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from logs.messages import ObjectMapRecord
from logs.records import frozen
from slam.fleet.part import Part
from slam.fleet.presence import REPORTED, Presence


@frozen
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


def find_changes(part: Part, presence: Presence, stamps_ns: Sequence[int]) -> tuple[Change, ...]:
    """What changed in a part of the map, by the presence of its landmarks in the sessions with these stamps."""
    dates = [datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC).isoformat() for stamp_ns in stamps_ns]
    objects, labels, changed = part.objects, part.objects.labels, presence.changed
    appeared, gone = dict[int, Change](), dict[int, Change]()
    kinds = ("appeared", presence.appeared, appeared), ("gone", presence.gone, gone)
    for column, (kind, probabilities, found) in enumerate(kinds):
        for row in np.flatnonzero(probabilities >= REPORTED).tolist():
            likely = changed[row, :, column]
            # All sessions among which the change may lie: those that did not pass leave it open.
            span = np.flatnonzero(likely > 0.05 * likely.max())
            after, before = dates[span[0]], dates[span[-1] + 1]
            x, y, z = objects.positions[row].tolist()
            probability = round(float(probabilities[row]), 4)
            found[row] = Change(kind, objects.ids[row], labels[row], probability, after, before, (x, y, z))
    for new, old, probability in _moves(objects, presence, list(appeared), list(gone)):
        earlier = gone.pop(old)
        appeared[new] = replace(
            appeared[new],
            kind="moved",
            probability=round(probability, 4),
            after=earlier.after,
            from_landmark=earlier.landmark,
            from_position=earlier.position,
        )
    changes = [*appeared.values(), *gone.values()]
    return tuple(sorted(changes, key=lambda change: (change.before, change.kind, int(change.landmark))))


def _moves(
    objects: ObjectMapRecord, presence: Presence, appeared: list[int], gone: list[int]
) -> list[tuple[int, int, float]]:
    """Rows of what appeared and of what went that are one object, with the probability.

    Another object of the class appears by chance within the distance d with probability 1 - exp(-density pi d^2); the
    two have to be the nearest of each other.
    """
    if not appeared or not gone:
        return []
    new, old, labels = np.array(appeared), np.array(gone), np.array(objects.labels)
    apart_m = cdist(objects.positions[new, :2], objects.positions[old, :2])
    apart_m[labels[new][:, None] != labels[old]] = np.inf
    nearest = apart_m.argmin(axis=1)
    is_mutual = apart_m.argmin(axis=0)[nearest] == np.arange(len(new))
    # Points at random are half a mean spacing from the nearest other.
    plane = objects.positions[:, :2]
    spacing_m = 2.0 * float(np.median(cKDTree(plane).query(plane, k=[2])[0])) + 1e-3
    density = (labels[new][:, None] == labels[new]).sum(axis=1) / (len(plane) * spacing_m**2)
    alone = np.exp(-density * np.pi * apart_m.min(axis=1) ** 2)
    probability = presence.appeared[new] * presence.gone[old[nearest]] * alone
    is_move = is_mutual & (probability >= REPORTED)
    return list(zip(new[is_move].tolist(), old[nearest[is_move]].tolist(), probability[is_move].tolist(), strict=True))
