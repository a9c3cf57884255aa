"""Objects followed from scan to scan, as far as that is unambiguous."""

import tracemalloc

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.geometry import apply, invert
from slam.self_calibration import object_tracks
from slam.self_calibration.object_tracks import (
    MISSED_SCANS,
    SMOOTHED,
    ObjectTracks,
    SurveyScan,
    _smoothed,
    detectability_of,
    follow_objects,
    nearest_of_class_m,
)
from tests.helpers.poses import pose_at
from tests.helpers.surveyed_drives import SurveyedDrive

OBJECTS = np.array([[10.0, 5.0, 0.0], [15.0, -5.0, 0.5], [25.0, 6.0, 0.0]])


def scan_of(
    objects: FloatArray, *, number: int = 0, x: float = 0.0, yaw: float = 0.0, labels: list[int] | None = None
) -> SurveyScan:
    """``objects`` (N, 3) m of the odometry frame, seen from (x, 0)."""
    T, places = pose_at(x, yaw=yaw), np.array(objects, float).reshape(-1, 3)
    of_each = np.array([0] * len(places) if labels is None else labels, int)
    return SurveyScan(number * 10**8, T, apply(invert(T), places), of_each, np.full(len(places), 0.04))


def lengths(tracks: ObjectTracks) -> list[int]:
    """Detections of each track, the longest first."""
    return sorted(np.unique(tracks.track, return_counts=True)[1].tolist(), reverse=True)


def test_objects_are_followed_while_the_robot_drives_and_turns():
    tracks = follow_objects([scan_of(OBJECTS, number=i, x=0.5 * i, yaw=0.1 * i) for i in range(10)])
    assert lengths(tracks) == [10, 10, 10]
    np.testing.assert_array_equal(tracks.scan, np.tile(np.arange(10), 3))
    np.testing.assert_allclose(tracks.points, np.repeat(OBJECTS[:, :2], 10, axis=0), atol=1e-9)
    robot = 0.5 * tracks.scan[:, None] * [1.0, 0.0]
    np.testing.assert_allclose(tracks.offsets, tracks.points - robot, atol=1e-9)
    np.testing.assert_array_equal(tracks.claimed, np.full(30, 0.04))


def test_smoothed_is_the_mean_of_the_points_around_on_the_track():
    points, track, row = np.random.default_rng(0).random((30, 2)), np.repeat([0, 1, 2], [20, 3, 7]), np.arange(30)
    near = (track[:, None] == track) & (np.abs(row[:, None] - row) <= SMOOTHED)
    np.testing.assert_allclose(_smoothed(points, track), near @ points / near.sum(axis=1)[:, None])


@pytest.mark.parametrize(("missed", "expected"), [(MISSED_SCANS, [6]), (MISSED_SCANS + 1, [3, 3])])
def test_a_track_goes_on_after_a_few_scans_without_the_object(missed, expected):
    there, gone = OBJECTS[:1], OBJECTS[:0]
    seen = [there] * 3 + [gone] * missed + [there] * 3
    assert lengths(follow_objects([scan_of(each, number=i) for i, each in enumerate(seen)])) == expected


def test_labels_are_never_mixed():
    tracks = follow_objects([scan_of(OBJECTS[:1], number=i, labels=[i % 2]) for i in range(4)])
    assert {(int(t), int(c)) for t, c in zip(tracks.track, tracks.labels, strict=True)} == {(0, 0), (1, 1)}


@pytest.mark.parametrize(("step_m", "followed"), [(0.8, True), (1.2, False)])
def test_what_seems_to_move_by_more_than_half_the_spacing_is_ambiguous(step_m, followed):
    """Two objects 2 m apart, of which the odometry says that both moved."""
    pair = np.array([[10.0, 0.0, 0.0], [10.0, 2.0, 0.0]])
    tracks = follow_objects([scan_of(pair), scan_of(pair + np.array([step_m, 0.0, 0.0]), number=1)])
    assert (lengths(tracks) == [2, 2]) is followed


def test_a_newcomer_next_to_an_object_makes_it_ambiguous():
    place = OBJECTS[:1]
    later = np.concatenate([place + np.array([0.2, 0.0, 0.0]), place + np.array([0.2, 0.3, 0.0])])
    tracks = follow_objects([scan_of(place), scan_of(later, number=1)])
    assert max(lengths(tracks)) == 1


@pytest.mark.parametrize(("distance_m", "followed"), [(20.0, True), (4.0, False)])
def test_an_object_that_is_alone_moves_by_no_more_than_a_quarter_of_its_range(distance_m, followed):
    tracks = follow_objects([scan_of([[distance_m, 0, 0]]), scan_of([[distance_m, 2.0, 0]], number=1)])
    assert (lengths(tracks) == [2]) is followed


def test_without_scans_or_detections_there_are_no_tracks():
    assert len(follow_objects([]).track) == 0
    assert len(follow_objects([scan_of(OBJECTS[:0]), scan_of(OBJECTS[:0], number=1)]).track) == 0


def rarely_seen(share: float) -> list[SurveyScan]:
    """Objects of one class, 4 m apart, beside a robot that drives 0.2 m a scan; each is detected that often."""
    rng = np.random.default_rng(0)
    row = np.column_stack([np.arange(0.0, 120.0, 4.0), np.full(30, 8.0), np.zeros(30)])
    scans = []
    for number in range(400):
        near = row[np.abs(row[:, 0] - 0.2 * number) < 15.0]
        scans.append(scan_of(near[rng.random(len(near)) < share], number=number, x=0.2 * number))
    return scans


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_neighbours_are_not_taken_for_objects_that_are_often_missed(share):
    tracks = follow_objects(rarely_seen(share))
    steps_m = np.linalg.norm(np.diff(tracks.points, axis=0), axis=1)[np.diff(tracks.track) == 0]
    assert np.mean(steps_m > 1.0) < 0.01
    assert detectability_of(tracks).share == pytest.approx(share, abs=0.1)


def test_without_tracks_no_share_is_known():
    assert np.isnan(detectability_of(follow_objects([scan_of(OBJECTS)])).share)


def test_sensors_that_take_turns_detect_what_each_of_them_sees():
    """One looks ahead and one back; each object is in every second scan, and never missed."""
    seen = [OBJECTS[:2] if number % 2 else OBJECTS[2:] for number in range(40)]
    found = detectability_of(follow_objects([scan_of(each, number=number) for number, each in enumerate(seen)]))
    assert (found.period, found.probability, found.share) == (2, 1.0, 0.5)


@pytest.mark.parametrize("most", [1, 50, 1000])
def test_distances_may_be_held_in_parts(monkeypatch, most):
    drive = SurveyedDrive(0, {}, scans=40, objects=80)
    whole = follow_objects(drive.scans)
    monkeypatch.setattr(object_tracks, "MAX_DISTANCES", most)
    parts = follow_objects(drive.scans)
    np.testing.assert_array_equal(parts.track, whole.track)
    np.testing.assert_array_equal(parts.rooms, whole.rooms)


def test_scans_of_many_objects_take_no_memory_of_all_their_pairs():
    objects = np.random.default_rng(0).uniform(-300.0, 300.0, (3000, 3))
    tracemalloc.start()
    try:
        follow_objects([scan_of(objects), scan_of(objects, number=1)])
        nearest_of_class_m([scan_of(objects)])
        assert tracemalloc.get_traced_memory()[1] < 60e6
    finally:
        tracemalloc.stop()
