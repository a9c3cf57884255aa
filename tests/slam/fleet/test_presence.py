import numpy as np

from slam.fleet.presence import estimate_presence, find_passes, seen_probabilities
from tests.slam.fleet.parts import street_part

DAY_NS = 86_400 * 10**9
MONTHS_NS = np.arange(8) * 30 * DAY_NS
SEEN = 0.9


STEADY = [[1] * 8] * 20
"""Twenty landmarks that each session sees."""


def presence(seen: list[list[int]], passed: list[list[int]] | None = None):  # type: ignore[no-untyped-def]
    sightings = np.array(seen, bool)
    probabilities = np.where(np.ones_like(sightings) if passed is None else np.array(passed, bool), SEEN, 0.0)
    return estimate_presence(sightings, probabilities, MONTHS_NS)


def test_what_is_always_seen_neither_appeared_nor_went() -> None:
    result = presence([[1] * 8, [1, 1, 0, 1, 1, 1, 0, 1]])
    assert (result.appeared < 0.1).all()
    assert (result.gone < 0.1).all()


def test_what_is_missed_from_a_month_on_is_gone_and_that_month_is_told() -> None:
    result = presence([*STEADY, [1, 1, 1, 1, 0, 0, 0, 0], [0, 0, 0, 0, 1, 1, 1, 1]])
    assert result.gone[20] > 0.95
    assert result.changed[20, :, 1].argmax() == 3
    assert result.appeared[21] > 0.95
    assert result.changed[21, :, 0].argmax() == 3
    assert result.present[20] < 0.05


def test_a_session_that_did_not_pass_says_nothing() -> None:
    seen = [1, 1, 1, 1, 0, 0, 0, 0]
    result = presence([*STEADY, seen], [*STEADY, seen])
    assert result.gone[20] < 0.5


def test_the_hazard_follows_the_share_that_changes() -> None:
    rng = np.random.default_rng(0)
    rows = []
    for _ in range(400):
        begins, ends = rng.exponential(300.0), rng.exponential(300.0)
        days = np.arange(8) * 30.0
        there = (days < ends) & (days > (begins - 200.0 if rng.random() < 0.5 else -1.0))
        rows.append((there & (rng.random(8) < SEEN)).astype(int).tolist())
    kept = [row for row in rows if sum(row)]
    few, many = presence([[1] * 8] * len(kept)).hazard_per_day, presence(kept).hazard_per_day
    assert few < 1e-4
    assert 1.0 / 600.0 < many < 1.0 / 100.0


def test_what_few_of_many_sessions_have_neither_came_nor_went() -> None:
    rows = [*["11111111"] * 40, "00100000", "00010000", "01000010", "00001000", "00001111"]
    seen = np.array([[*map(int, row)] for row in rows], bool).repeat(4, axis=1)
    seen[40:44] &= np.arange(32) % 4 == 0
    result = estimate_presence(seen, np.full(seen.shape, SEEN), np.arange(32) * 7 * DAY_NS)
    assert (np.array([result.appeared, result.gone, result.useful])[:, 40:44] < 0.5).all()
    assert min(*result.useful[:40], result.useful[44], result.appeared[44]) > 0.9


def test_what_half_of_the_sessions_see_is_no_change_where_most_are_seen_by_all() -> None:
    rng = np.random.default_rng(2)
    seen = np.vstack([np.ones((60, 32), bool), rng.random((8, 32)) < 0.4])
    seen[60:, -3:] = False
    result = estimate_presence(seen, np.full(seen.shape, 0.97), np.arange(32) * 7 * DAY_NS)
    assert (result.gone[60:] < 0.5).all()
    assert (result.detectability[60:] < 0.6).all()


def test_probabilities_are_learned_by_the_distance_from_what_certainly_stood_there() -> None:
    rng = np.random.default_rng(1)
    distances_m = rng.uniform(1.0, 30.0, (300, 8))
    seen = rng.random((300, 8)) < np.where(distances_m < 15.0, 0.95, 0.5)
    seen[:, [0, -1]] = True
    distances_m[:, 1] = 60.0
    seen[:, 1] = False
    probabilities = seen_probabilities(seen, distances_m)
    middle = slice(2, 7)
    missed = ~seen[:, middle]
    away_m = distances_m[:, middle]
    assert abs(np.median(probabilities[:, middle][missed & (away_m < 12.0)]) - 0.95) < 0.05
    assert abs(np.median(probabilities[:, middle][missed & (away_m > 18.0)]) - 0.5) < 0.1
    assert (probabilities[:, 1] == 0.0).all()


def test_find_passes_measures_distances_from_the_path_and_beyond_its_ends() -> None:
    positions = np.array([[50.0, 5.0, 0.0], [37.0, -8.0, 1.0], [-3.0, 4.0, 0.0], [101.0, 8.0, 0.0]])
    seen = np.array([[True, False], [True, True], [False, False], [False, True]])
    found, distances_m = find_passes(street_part(positions, ["tree"] * 4, seen))
    np.testing.assert_array_equal(found, seen)
    np.testing.assert_allclose(distances_m, np.repeat([[5.0], [8.0], [5.0], [10.0]], 2, axis=1))
