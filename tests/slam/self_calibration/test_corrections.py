"""Systematic errors of the input from tracks that have them, and from those that have none."""

from dataclasses import replace

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.geometry import travelled_m
from slam.self_calibration import corrections
from slam.self_calibration.corrections import (
    BLOCKS,
    TERMS,
    BodyMotion,
    J,
    _effects,
    _views,
    estimate_corrections,
    find_change,
    is_beyond_chance,
)
from slam.self_calibration.object_tracks import ObjectTracks
from tests.helpers.surveyed_drives import tracks_of

SCANS, PERIOD_S, SPEED_MPS = 600, 0.1, 4.0
SEEN = 40
"""Scans that an object is seen in."""


@pytest.fixture(scope="module")
def motion() -> BodyMotion:
    """To the left and to the right, now faster, now slower."""
    time_s = PERIOD_S * np.arange(SCANS)
    headings = 1.5 * np.sin(0.5 * time_s)
    velocities = (
        SPEED_MPS * (1.0 + 0.5 * np.sin(1.3 * time_s))[:, None] * np.stack([np.cos(headings), np.sin(headings)], axis=1)
    )
    positions = np.column_stack([np.cumsum(velocities * PERIOD_S, axis=0), np.zeros(SCANS)])
    travels = travelled_m(positions)
    return BodyMotion(positions, headings, velocities, np.gradient(headings, PERIOD_S), time_s, travels)


def tracks(motion: BodyMotion, *, delay_s: float = 0.0, noise_m: float = 0.02) -> ObjectTracks:
    """Objects that come and go on either side; what is seen is of a time later by ``delay_s`` than its stamp."""
    rng = np.random.default_rng(3)
    scans = np.concatenate([np.arange(first, first + SEEN) for first in range(0, SCANS - SEEN, 10)])
    track = np.repeat(np.arange(len(scans) // SEEN), SEEN)
    middles = motion.positions[np.unique(track) * 10 + SEEN // 2, :2] + rng.uniform(-12.0, 12.0, (track.max() + 1, 2))
    offsets = middles[track] - motion.positions[scans, :2] + rng.normal(0.0, noise_m, (len(scans), 2))
    moved = motion.velocities[scans] + motion.turn_rates[scans][:, None] * (offsets @ J.T)
    offsets = offsets - delay_s * moved
    return tracks_of(track, scans, offsets, motion.positions[scans, :2] + offsets)


def earned(tracks: ObjectTracks, motion: BodyMotion) -> dict[str, float]:
    return {each.term: each.value for each in estimate_corrections(tracks, motion) if each.is_earned}


def test_nothing_is_corrected_where_nothing_is_wrong(motion):
    assert earned(tracks(motion), motion) == {}


def test_a_correction_that_explains_almost_nothing_is_not_made(motion):
    # Significant, 7 standard errors and more, but of a displacement that is noise in the main.
    for delay_s, noise_m in ((0.004, 0.2), (0.01, 0.1), (0.02, 0.2)):
        assert earned(tracks(motion, delay_s=delay_s, noise_m=noise_m), motion) == {}


def test_few_views_of_objects_tell_nothing(motion):
    made = tracks(motion, delay_s=0.3)
    for count in (1, 3):
        assert estimate_corrections(made.of(made.track < count), motion) == ()
        assert find_change(made.of(made.track < count), motion) is None
    assert estimate_corrections(made.of(made.track < 30), motion)[0].is_earned


def test_views_are_tracks_and_their_changes_by_one_radian():
    angles = np.linspace(0.0, np.pi, 20)
    half_around = 5.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    offsets = np.concatenate([half_around, np.tile([3.0, 0.0], (20, 1))])
    track, scan = np.repeat([0, 1], 20), np.tile(np.arange(20), 2)
    assert _views(tracks_of(track, scan, offsets, offsets)) == pytest.approx(2.0 + np.pi)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_is_beyond_chance_if_few_changes_of_signs_gain_as_much(scale):
    """With three losses among equal gains, 2.9 % of all signs do; with two 0.6 %."""
    found = [is_beyond_chance(scale * np.where(np.arange(BLOCKS) < losses, -1.0, 1.0)) for losses in (2, 3)]
    assert found == [True, False]


@pytest.mark.parametrize("term", TERMS[1:8])
def test_each_error_is_told_from_the_others(motion, term):
    made = tracks(motion)
    heights = np.random.default_rng(5).uniform(-2.0, 2.0, made.track.max() + 1)[made.track]
    heights = heights + np.random.default_rng(6).normal(0.0, 0.02, len(heights))
    level = replace(made, heights=heights)
    effects = _effects(level, motion)[:, :, TERMS.index(term)]
    wrong = replace(level, points=made.points - 0.1 * effects[:, :2], heights=heights - 0.1 * effects[:, 2])
    first = estimate_corrections(wrong, motion)[0]  # what explains most is corrected before the others
    assert first.is_earned
    assert (first.term, first.value) == (term, pytest.approx(0.1, abs=0.015))


def changed(
    term: str, motion: BodyMotion, *, before: float, after: float, noise_m: float = 0.02, first: int = SCANS // 2
) -> ObjectTracks:
    """Tracks with an error of a term that has another size from a scan on."""
    made = tracks(motion, noise_m=noise_m)
    size = np.where(made.scan < first, before, after)[:, None]
    return replace(made, points=made.points - size * _effects(made, motion)[:, :2, TERMS.index(term)])


def test_turn_by_the_time_looks_like_one_by_the_way_at_a_constant_speed(motion):
    steady = replace(motion, travels=SPEED_MPS * motion.seconds)
    wrong = changed("drift_rad_per_s", steady, before=0.1, after=0.1)
    assert earned(wrong, steady) == {}
    first = estimate_corrections(wrong, steady, {"curvature_rad_per_m"})[0]
    assert (first.term, first.value, first.value_among_all) == ("drift_rad_per_s", *2 * [pytest.approx(0.1, abs=0.01)])


@pytest.mark.parametrize("term", ["yaw_rad", "turn_share", "length_share", "delay_s"])
@pytest.mark.parametrize("before", [0.0, 0.1])
def test_change_of_an_error_is_told_from_the_others(motion, term, before):
    change = find_change(changed(term, motion, before=before, after=before + 0.2), motion)
    assert (change.term, change.value) == (term, pytest.approx(0.2, abs=0.05))
    assert abs(change.scan - SCANS // 2) < SCANS // BLOCKS


def test_error_that_stays_or_explains_almost_nothing_is_no_change(motion):
    assert find_change(tracks(motion), motion) is None
    assert find_change(changed("yaw_rad", motion, before=0.2, after=0.2), motion) is None
    # Significant, but 1.5 % of a displacement that is noise in the main.
    assert find_change(changed("yaw_rad", motion, before=0.0, after=0.05, noise_m=0.3), motion) is None


@pytest.mark.parametrize("first", [100, SCANS - 150])
def test_change_near_an_end_of_the_log_is_found(motion, first):
    change = find_change(changed("yaw_rad", motion, before=0.0, after=0.2, first=first), motion)
    assert abs(change.scan - first) < SCANS // BLOCKS


def test_change_that_chance_may_explain_is_none(motion, monkeypatch):
    monkeypatch.setattr(corrections, "CHANCE", 0.0)
    assert find_change(changed("yaw_rad", motion, before=0.0, after=0.2), motion) is None


def test_turns_are_corrected_after_many_of_them(motion):
    """The heading is up to 60 rad then, which would multiply the noise of offsets."""
    rate = motion.turn_rates + 1.0
    motion = replace(motion, headings=np.cumsum(rate) * PERIOD_S, turn_rates=rate)
    exact = tracks(motion, noise_m=0.0)
    wrong = exact.points + 0.3 * _effects(exact, motion)[:, :2, TERMS.index("turn_share")]
    noise_m = np.random.default_rng(7).normal(0.0, 0.05, wrong.shape)
    first = estimate_corrections(replace(exact, points=wrong + noise_m, offsets=exact.offsets + noise_m), motion)[0]
    assert first.is_earned
    assert (first.term, first.value) == ("turn_share", pytest.approx(-0.3, abs=0.02))


def test_term_that_has_the_other_sign_alone_is_earned_after_what_hides_it_is_corrected(motion):
    motion, made = replace(motion, headings=motion.headings + 1.0), tracks(motion)
    yaw, turn = (_effects(made, motion)[:, :2, TERMS.index(term)] for term in ("yaw_rad", "turn_share"))
    turned = replace(made, points=made.points - 0.05 * yaw)
    assert set(earned(replace(turned, points=turned.points + 0.2 * turn), motion)) == {"turn_share"}
    assert earned(turned, motion) == {"yaw_rad": pytest.approx(0.05, abs=0.01)}


def test_turn_that_errs_more_near_objects_is_estimated_without_a_shift_of_the_sensor(motion):
    made = tracks(motion)
    forward = np.stack([np.cos(motion.headings), np.sin(motion.headings)], axis=1)
    ranges_m = np.linalg.norm(made.offsets, axis=1)
    seen = made.of(np.sum(forward[made.scan] * made.offsets, axis=1) > 0.85 * ranges_m)
    of_track_m = (np.bincount(made.track, ranges_m) / np.bincount(made.track))[seen.track]
    shares = 0.3 * np.median(of_track_m) / of_track_m
    turned = shares[:, None] * _effects(seen, motion)[:, :2, TERMS.index("turn_share")]
    first = estimate_corrections(replace(seen, points=seen.points + turned), motion)[0]
    assert (first.term, first.value) == ("turn_share", pytest.approx(-0.3, abs=0.04))


def test_an_error_of_one_part_of_the_log_does_not_predict_the_others(motion):
    """The stamps of one stretch alone are wrong."""
    made, late = tracks(motion), tracks(motion, delay_s=0.3)
    in_part = (made.scan > 200) & (made.scan < 240)
    assert earned(replace(made, points=np.where(in_part[:, None], late.points, made.points)), motion) == {}


def test_pairs_of_a_long_log_are_thinned_out_all_over_it(motion, monkeypatch):
    made = tracks(motion, delay_s=0.3)
    monkeypatch.setattr(corrections, "MAX_PAIRS", 1000)
    assert earned(made, motion)["delay_s"] == pytest.approx(0.3, abs=0.02)


def test_a_few_wild_points_do_not_matter(motion):
    made = tracks(motion, delay_s=0.3)
    wild: FloatArray = made.points.copy()
    wild[::50] += 30.0
    assert earned(replace(made, points=wild), motion)["delay_s"] == pytest.approx(0.3, abs=0.02)
