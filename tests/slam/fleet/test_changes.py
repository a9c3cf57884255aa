from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from slam.common.georeference import Georeference
from slam.fleet.changes import Change, find_changes, write_changes
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
    seen = np.ones((34, MONTHS), dtype=bool)
    seen[[GOES, MOVES], 3:] = False
    seen[[COMES, MOVED], :3] = False
    part = street_part(positions(), [*["lamp"] * 30, "tree", "tree", "bench", "bench"], seen)
    stamps_ns = [month * MONTH_NS for month in range(MONTHS)]
    passes = find_passes(part)
    presence = estimate_presence(passes.seen, seen_probabilities(passes), stamps_ns)
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


def test_changes_are_points_on_earth_where_the_origin_is_known(changes: tuple[Change, ...], tmp_path: Path) -> None:
    write_changes(tmp_path / "changes.geojson", changes, Georeference(60.0, 25.0))
    features = json.loads((tmp_path / "changes.geojson").read_text())["features"]
    assert len(features) == len(changes)
    coordinates = [feature["geometry"]["coordinates"][:2] for feature in features]
    np.testing.assert_allclose(coordinates, [[25.0, 60.0]] * 3, atol=0.02)


def test_without_an_origin_they_are_metres_of_the_map_and_say_so(changes: tuple[Change, ...], tmp_path: Path) -> None:
    write_changes(tmp_path / "changes.geojson", changes, None)
    collection = json.loads((tmp_path / "changes.geojson").read_text())
    assert collection["coordinates"] == "metres in the frame of the map"
    np.testing.assert_allclose(collection["features"][0]["geometry"]["coordinates"], changes[0].position, atol=1e-3)
