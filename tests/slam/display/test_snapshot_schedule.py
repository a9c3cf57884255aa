"""SnapshotSchedule: often at first, and in proportion to the map later."""

from itertools import pairwise

import pytest

from slam.display.snapshot import SnapshotSchedule


def taken(keyframes: int, *, first: int = 0) -> list[int]:
    schedule = SnapshotSchedule(first)
    return [count - first for count in range(first + 1, first + keyframes + 1) if schedule.is_due(count)]


@pytest.mark.parametrize("first", [0, 1000])
def test_short_drive_has_snapshot_at_every_update(first):
    assert taken(400, first=first) == list(range(1, 401, 5))


def test_later_snapshots_are_spaced_by_share_of_drive():
    counts = taken(20_000)
    for before, after in pairwise(counts):
        assert 0.01 * after < after - before <= 0.01 * after + 5
    assert len(counts) < 600


def test_no_keyframe_is_shown_twice():
    schedule = SnapshotSchedule(0)
    assert schedule.is_due(1)
    assert not schedule.is_due(1)
