import numpy as np
import pytest

from slam.fleet.changes import Change, find_changes
from slam.fleet.presence import estimate_presence, find_passes, seen_probabilities
from tests.slam.fleet.parts import street_part

MONTH_NS = 30 * 86_400 * 10**9
MONTHS = 6
STAYS, GOES, COMES, MOVES, MOVED = range(30), 30, 31, 32, 33


def positions() -> np.ndarray:
    """Lamps along both kerbs; a tree goes, another one comes far from there, and a bench moves by 4 m."""
    lamps = [[3.0 * row, (5.0 + row % 5) * (-1.0) ** row, 0.0] for row in STAYS]
    return np.array([*lamps, [10.0, 7.0, 0.0], [80.0, 7.0, 0.0], [40.0, 8.0, 0.0], [44.0, 8.0, 0.0]])


@pytest.fixture(scope="module")
def changes() -> tuple[Change, ...]:
    seen = np.ones((34, MONTHS), bool)
    seen[[GOES, MOVES], 3:] = False
    seen[[COMES, MOVED], :3] = False
    part = street_part(positions(), [*["lamp"] * 30, "tree", "tree", "bench", "bench"], seen)
    stamps_ns = [month * MONTH_NS for month in range(MONTHS)]
    presence = estimate_presence(seen, seen_probabilities(*find_passes(part)), stamps_ns)
    return find_changes(part, presence, stamps_ns)


def test_what_went_came_and_moved_is_told_with_place_and_dates(changes: tuple[Change, ...]) -> None:
    found = {change.kind: change for change in changes}
    assert len(changes) == len(found) == 3
    for kind, label, row in (("gone", "tree", GOES), ("appeared", "tree", COMES), ("moved", "bench", MOVED)):
        change = found[kind]
        assert (change.landmark, change.label, change.position) == (str(row), label, tuple(positions()[row]))
        assert change.probability > 0.9
        assert change.after == "1970-03-02T00:00:00+00:00"
        assert change.before == "1970-04-01T00:00:00+00:00"
    assert found["moved"].from_landmark == str(MOVES)
    assert found["moved"].from_position == tuple(positions()[MOVES])
