"""Kidnapped robots: the verdicts are what the truth says, and a map of somewhere else finds nobody."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from logs.messages import Record, SlamPose
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import SimulationError
from slam.common.geometry import transform_from_xyz_yaw
from slam.localization.state import State
from slam.simulation.config import DriveConfig, SensorConfig, SimulationConfig
from slam.simulation.world import World
from slam.system import Slam
from tests.helpers.loop_drives import one_block, winding_street
from tools.lab.relocalization.figures import (
    RECOVERED_WITHIN_M,
    Outcome,
    Verdict,
    deviation,
    figures,
    judge,
    sum_up,
)
from tools.lab.relocalization.kidnaps import Kidnap, change_world, draw_kidnaps, worsen
from tools.lab.relocalization.known_map import KnownMap
from tools.lab.relocalization.simulated import (
    TOLERANCE,
    Search,
    benchmark_relocalization,
    map_tour,
    relocalize,
    search_all,
)

pytestmark = pytest.mark.slow

SLOW = SimulationConfig(drive=DriveConfig(rate_hz=5.0))
TIMES = {"load_s", "query_ms"}


@pytest.fixture(scope="module")
def block() -> World:
    return one_block().shortened(200.0)


@pytest.fixture(scope="module")
def known(block: World) -> KnownMap:
    return map_tour(block, Config(), SLOW, seed=0)


@pytest.fixture(scope="module")
def search(block: World, known: KnownMap) -> Search:
    return Search(known, block, Config(), SLOW, first_seed=1)


@pytest.fixture(scope="module")
def kidnaps(block: World) -> list[Kidnap]:
    return draw_kidnaps(block.tour, count=3, length_m=30.0, rng=np.random.default_rng(2))


@pytest.fixture(scope="module")
def outcomes(search: Search, kidnaps: list[Kidnap]) -> list[Outcome]:
    return list(search_all(search, kidnaps, jobs=1))


# The search.


def test_on_a_furnished_block_everybody_is_found(outcomes: list[Outcome], kidnaps: list[Kidnap], known: KnownMap):
    assert known.ate_m < 1.0
    assert [each.verdict for each in outcomes] == [Verdict.RECOVERED] * 3
    for outcome, kidnap in zip(outcomes, kidnaps, strict=True):
        assert (outcome.number, outcome.start_m, outcome.is_along) == (kidnap.number, kidnap.start_m, kidnap.is_along)
        assert outcome.error_m is not None
        assert outcome.error_deg is not None
        assert 0.0 < outcome.error_m <= TOLERANCE.metres
        assert outcome.error_deg <= TOLERANCE.degrees
        assert outcome.later_right
        assert outcome.local_error_m is not None
        assert outcome.local_error_m <= outcome.error_m + known.ate_m + 0.5
        assert outcome.distance_m is not None
        assert 0.0 < outcome.distance_m <= RECOVERED_WITHIN_M
        # Cruising speed is 8 m/s, and no drive is faster.
        assert outcome.seconds is not None
        assert outcome.seconds >= outcome.distance_m / 8.0 - 0.2
        assert outcome.load_s > 0.0
        *_, (log_odds, is_right) = outcome.places
        assert log_odds > 9.0
        assert is_right


def test_in_the_map_of_another_town_nobody_is_found(search: Search, kidnaps: list[Kidnap], outcomes: list[Outcome]):
    elsewhere = replace(search, known=map_tour(winding_street().shortened(200.0), Config(), SLOW, seed=0))
    for kidnap, found in zip(kidnaps, outcomes, strict=True):
        lost = relocalize(elsewhere, kidnap)
        assert (lost.verdict, lost.distance_m, lost.later_right) == (Verdict.NOT_FOUND, None, None)
        assert (lost.seconds, lost.error_m, lost.error_deg) == (None, None, None)
        assert lost.objects == found.objects


@pytest.mark.parametrize(
    "T_false", [transform_from_xyz_yaw(np.array([0.0, 2.5, 0.0]), 0.0), transform_from_xyz_yaw(np.zeros(3), 0.1)]
)
def test_a_fix_away_from_the_truth_is_wrong_and_was_not_taken_back(
    search: Search, kidnaps: list[Kidnap], T_false: FloatArray
):
    shifted = replace(search.known, T_world_map=T_false @ search.known.T_world_map)
    outcome, plain = relocalize(replace(search, known=shifted), kidnaps[0]), relocalize(search, kidnaps[0])
    assert (outcome.verdict, outcome.later_right) == (Verdict.WRONG, False)
    # Next to where the map's own drive was, it is what it was.
    assert (outcome.local_error_m, outcome.local_error_deg) == (plain.local_error_m, plain.local_error_deg)
    assert outcome.places == plain.places
    assert figures([outcome])["misplaced_rate"] == 0.0


def test_reliability_is_that_of_all_places():
    outcomes = [made_up(Verdict.NOT_FOUND, None, None, places=((5.0, True), (9.0, False))), *MADE_UP]
    found = sum_up(outcomes, world="made up", tour_m=1.0, landmarks=1, map_ate_m=0.0)["reliability"]
    assert (found["sure_count"], found["sure_right"]) == (2, 1)


def test_a_fix_in_a_bent_map_is_at_its_place_and_one_elsewhere_is_not(search: Search, kidnaps: list[Kidnap]):
    aside = transform_from_xyz_yaw(np.array([0.0, 4.0, 0.0]), 0.0)
    bent = replace(search.known, T_world_body_gt=aside @ search.known.T_world_body_gt)
    outcome = relocalize(replace(search, known=bent), kidnaps[0])
    assert outcome.verdict == Verdict.RECOVERED
    assert outcome.local_error_m == pytest.approx(4.0, abs=1.0)
    assert figures([outcome])["misplaced_rate"] == 1.0


class GivesUp(Slam):
    """Takes back where it is once it has known it for a while."""

    known = 0

    @property
    def state(self) -> State:
        return State.LOST if self.known > 3 else super().state

    def process(self, record: Record) -> list[Record]:
        updates = super().process(record)
        self.known += any(isinstance(each, SlamPose) for each in updates)
        return [each for each in updates if self.known <= 3 or not isinstance(each, SlamPose)]


def test_fix_that_is_taken_back_is_no_later_right_one(
    search: Search, kidnaps: list[Kidnap], monkeypatch: pytest.MonkeyPatch
):
    plain = relocalize(search, kidnaps[0])
    monkeypatch.setattr("tools.lab.relocalization.trial.Slam", GivesUp)
    outcome = relocalize(search, kidnaps[0])
    assert (outcome.later_right, plain.later_right) == (None, True)
    assert (outcome.verdict, outcome.error_m) == (plain.verdict, plain.error_m)


# The whole.


@pytest.fixture(scope="module")
def measured(block: World) -> tuple[dict[str, Any], list[float]]:
    told: list[float] = []
    return run(block, on_progress=told.append), told


def run(world: World, **arguments: object) -> dict[str, Any]:
    given = {"kidnaps": 2, "seed": 3, "noise": 1.5, "changed": 0.2, "max_travel_m": 20.0, **arguments}
    return benchmark_relocalization(world.shortened(100.0), Config(), **given)  # type: ignore[arg-type]


def test_the_result_has_everything_and_goes_into_json(measured: tuple[dict[str, Any], list[float]]):
    result, told = measured
    assert told == [0.5, 1.0]
    assert sum(each["count"] for each in result["reliability"]["bins"]) > 0
    json.dumps(result, allow_nan=False)
    assert (result["world"], result["tour_m"]) == ("town", pytest.approx(100.0))
    assert result["landmarks"] > 10
    assert 0.0 < result["map_ate_m"] < 2.0
    assert result["load_s"] > 0.0
    assert list(result["groups"]) == [
        *("same direction", "opposite direction"),
        *("0-4 objects", "5-9 objects", "10-19 objects", "20+ objects"),
    ]
    assert result["kidnaps"] == len(result["outcomes"]) == 2


def test_again_and_in_several_processes_it_gives_the_same(block: World, measured: tuple[dict[str, Any], list[float]]):
    first, again = measured[0], run(block, jobs=2)
    for result in (first, again):
        for timed in (result, *result["outcomes"]):
            for name in TIMES:
                del timed[name]
    assert again == first


# Verdicts and figures.


def test_deviation_is_in_the_plane_and_the_shorter_way_round():
    a = transform_from_xyz_yaw(np.array([1.0, 2.0, 9.0]), np.deg2rad(179.0))
    b = transform_from_xyz_yaw(np.array([4.0, -2.0, 0.0]), np.deg2rad(-178.0))
    assert deviation(a, b) == deviation(b, a) == pytest.approx((5.0, 3.0))


def test_verdicts_at_their_limits():
    metres, degrees = TOLERANCE.metres, TOLERANCE.degrees
    assert judge(RECOVERED_WITHIN_M, (metres, degrees), TOLERANCE) == Verdict.RECOVERED
    assert judge(RECOVERED_WITHIN_M + 0.1, (metres, degrees), TOLERANCE) == Verdict.LATE
    assert judge(1.0, (metres + 0.1, 0.0), TOLERANCE) == Verdict.WRONG
    assert judge(1.0, (0.0, degrees + 0.1), TOLERANCE) == Verdict.WRONG


def made_up(verdict: Verdict, distance_m: float | None, later_right: bool | None, **more: object) -> Outcome:
    error_m = None if distance_m is None else 7.0 if verdict == Verdict.WRONG else 0.01 * distance_m
    seconds = None if distance_m is None else distance_m / 8.0
    known = {"objects": 7, "is_along": True, "start_m": 0.0, "load_s": 0.1, "query_ms": (2.0,), **more}
    return Outcome(
        number=0,
        verdict=verdict,
        distance_m=distance_m,
        seconds=seconds,
        error_m=error_m,
        error_deg=error_m,
        local_error_m=error_m if verdict == Verdict.WRONG and distance_m == 2.0 else distance_m and 0.1,
        local_error_deg=distance_m and 0.1,
        is_misplaced=None if distance_m is None else verdict == Verdict.WRONG and distance_m == 2.0,
        later_right=later_right,
        **known,  # type: ignore[arg-type]
    )


MADE_UP = [
    made_up(Verdict.RECOVERED, 8.0, True, objects=4),
    made_up(Verdict.RECOVERED, 10.0, True, objects=5, is_along=False),
    made_up(Verdict.RECOVERED, 30.0, False, objects=9),
    made_up(Verdict.LATE, 50.0, None, objects=10),
    made_up(Verdict.WRONG, 1.0, False, objects=19),
    made_up(Verdict.WRONG, 2.0, None, objects=20, query_ms=(8.0, 9.0)),
    made_up(Verdict.WRONG, 3.0, True, objects=400),
    made_up(Verdict.NOT_FOUND, None, None, objects=0, query_ms=()),
]


def test_figures_of_outcomes_by_hand():
    told = figures(MADE_UP)
    rates = (told["success_rate"], told["late_rate"], told["false_relocalization_rate"], told["not_found_rate"])
    assert rates == (3 / 8, 1 / 8, 3 / 8, 1 / 8)
    assert (told["kidnaps"], told["median_distance_m"], told["median_seconds"]) == (8, 20.0, 2.5)
    assert told["p95_distance_m"] == pytest.approx(47.0)
    assert (told["median_error_m"], told["median_error_deg"]) == (0.5, 0.5)
    assert told["p95_error_m"] == told["p95_error_deg"] == 7.0
    assert told["misplaced_rate"] == 1 / 8
    assert told["success_in_map_rate"] == 5 / 8, "three right ones, and two that only a bent map made wrong"
    assert told["kept_rate"] == 2 / 4
    assert told["revoked_rate"] == pytest.approx(2 / 3)


def test_figures_of_nothing_are_none():
    empty = figures([])
    assert empty.pop("kidnaps") == 0
    assert set(empty.values()) == {None}
    lost = figures([MADE_UP[-1]])
    assert (lost["success_rate"], lost["not_found_rate"]) == (0.0, 1.0)
    assert lost["median_distance_m"] is lost["median_error_m"] is lost["kept_rate"] is None


def test_groups_are_by_direction_and_by_objects_in_range():
    result = sum_up(MADE_UP, world="w", tour_m=1.0, landmarks=2, map_ate_m=0.3)
    assert [group["kidnaps"] for group in result["groups"].values()] == [7, 1, 2, 2, 2, 2]
    assert (result["load_s"], result["query_ms"]) == (0.1, 2.0)
    assert sum_up([MADE_UP[-1]], world="w", tour_m=1.0, landmarks=2, map_ate_m=0.3)["query_ms"] is None


# Where the robot is put down.


def test_places_that_cannot_be_are_refused(block: World):
    rng = np.random.default_rng(0)
    for count, length_m, tour in ((0, 50.0, block.tour), (3, 0.0, block.tour), (3, 50.0, np.zeros((4, 2)))):
        with pytest.raises(SimulationError, match="above 0"):
            draw_kidnaps(tour, count=count, length_m=length_m, rng=rng)


# What changed in the meantime.


def test_that_share_of_the_objects_is_replaced_and_the_others_stay():
    block = one_block()
    far = replace(
        block,
        object_ids=(*block.object_ids, "far"),
        positions=np.vstack([block.positions, [900.0, 900.0, 0.0]]),
        labels=(*block.labels, "tower"),
    )
    changed = change_world(far, 0.25, reach_m=30.0, rng=np.random.default_rng(1))
    new = set(changed.object_ids) - set(far.object_ids)
    assert len(new) == round(0.25 * len(block.object_ids)) == len(set(far.object_ids) - set(changed.object_ids))
    assert "far" in changed.object_ids
    where = dict(zip(far.object_ids, zip(far.labels, far.positions.tolist(), strict=True), strict=True))
    for name, label, position in zip(changed.object_ids, changed.labels, changed.positions.tolist(), strict=True):
        assert name in new or where[name] == (label, position)
    np.testing.assert_array_equal(changed.tour, far.tour)


def test_nothing_changes_without_a_share_and_shares_are_shares(block: World):
    rng = np.random.default_rng(0)
    assert change_world(block, 0.0, reach_m=30.0, rng=rng).sha256() == block.sha256()
    for share in (-0.1, 1.1, np.nan):
        with pytest.raises(SimulationError, match="0 to 1"):
            change_world(block, share, reach_m=30.0, rng=rng)


def test_a_worse_sensor_is_that_much_worse_and_probabilities_stay_below_one():
    sensor = SensorConfig()
    assert worsen(sensor, 1.0) == sensor
    twice, far_worse = worsen(sensor, 2.0), worsen(sensor, 50.0)
    errors = ("noise_base_m", "noise_per_m", "dropout", "false_positives_per_scan", "misclassification")
    assert [getattr(twice, name) for name in errors] == [2.0 * getattr(sensor, name) for name in errors]
    assert (far_worse.dropout, far_worse.misclassification) == (1.0, 1.0)
    assert twice.max_range_m == sensor.max_range_m
