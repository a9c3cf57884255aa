"""Kidnapped robots in simulated worlds: the verdicts are what the truth says, and a map of elsewhere finds nobody."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, ObjectMapRecord, Record, SlamPose
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import transform_from_xyz_yaw
from slam.localization.state import State
from slam.object_map.map_io import SavedMap
from slam.place_recognition.imported_map import ImportedMap, make_imported_map
from slam.simulation.config import DriveConfig, SimulationConfig
from slam.simulation.simulation import simulate
from slam.simulation.world import World
from slam.system import Slam
from tests.helpers.loop_drives import one_block, winding_street
from tools.lab.relocalization.kidnaps import draw_kidnaps, thin_world
from tools.lab.relocalization.known_map import KnownMap
from tools.lab.relocalization.oracle import Oracle
from tools.lab.relocalization.trial import RECOVERED_WITHIN_M, Verdict
from tools.lab.relocalization.worlds import (
    BESIDE_M,
    TOLERANCE,
    Search,
    benchmark_in_map,
    benchmark_relocalization,
    draw_street,
    map_tour,
    relocalize,
    search_all,
)

SLOW = SimulationConfig(drive=DriveConfig(rate_hz=5.0))
Outcome = dict[str, Any]


@pytest.fixture(scope="module")
def block() -> World:
    return one_block().shortened(200.0)


@pytest.fixture(scope="module")
def searches(block: World) -> list[Search]:
    known = map_tour(block, Config(), SLOW, seed=0)
    kidnaps = draw_kidnaps(block.tour, count=3, length_m=30.0, rng=np.random.default_rng(2))
    return [Search(known, block, Config(), SLOW, 1, kidnap) for kidnap in kidnaps]


@pytest.fixture(scope="module")
def outcomes(searches: list[Search]) -> list[Outcome]:
    return search_all(searches)


@pytest.mark.slow
def test_robot_is_found_on_a_furnished_block(outcomes: list[Outcome], searches: list[Search]):
    for outcome, search in zip(outcomes, searches, strict=True):
        assert (outcome["verdict"], outcome["number"]) == (Verdict.RECOVERED, search.kidnap.number)
        assert 0.0 < outcome["error_m"] <= TOLERANCE.metres
        assert outcome["error_deg"] <= TOLERANCE.degrees
        assert outcome["later_right"]
        assert outcome["local_error_m"] <= outcome["error_m"] + search.known.ate_m + 0.5
        assert 0.0 < outcome["distance_m"] <= RECOVERED_WITHIN_M
        assert outcome["seconds"] >= outcome["distance_m"] / 8.0 - 0.2  # no drive is faster than 8 m/s
        *_, (log_odds, is_right) = outcome["places"]
        assert log_odds > 9.0
        assert is_right


@pytest.mark.slow
def test_robot_is_not_found_in_the_map_of_another_town(searches: list[Search]):
    elsewhere = map_tour(winding_street().shortened(200.0), Config(), SLOW, seed=0)
    lost = relocalize(replace(searches[0], known=elsewhere))
    assert lost["verdict"] == Verdict.NOT_FOUND
    assert {lost[name] for name in ("distance_m", "seconds", "error_m", "error_deg", "later_right")} == {None}


@pytest.mark.slow
@pytest.mark.parametrize(
    "T_false", [transform_from_xyz_yaw(np.array([0.0, 2.5, 0.0]), 0.0), transform_from_xyz_yaw(np.zeros(3), 0.1)]
)
def test_fix_away_from_the_truth_is_wrong_but_not_misplaced_in_the_map(
    searches: list[Search], outcomes: list[Outcome], T_false: FloatArray
):
    known = searches[0].known
    outcome = relocalize(replace(searches[0], known=replace(known, T_world_map=T_false @ known.T_world_map)))
    assert (outcome["verdict"], outcome["later_right"], outcome["is_misplaced"]) == (Verdict.WRONG, False, False)
    for name in ("local_error_m", "local_error_deg", "places"):
        assert outcome[name] == outcomes[0][name]


@pytest.mark.slow
def test_fix_away_from_the_mapping_drive_is_misplaced(searches: list[Search]):
    known, aside = searches[0].known, transform_from_xyz_yaw(np.array([0.0, 4.0, 0.0]), 0.0)
    bent = replace(known, T_world_body_gt=aside @ known.T_world_body_gt)
    outcome = relocalize(replace(searches[0], known=bent))
    assert (outcome["verdict"], outcome["is_misplaced"]) == (Verdict.RECOVERED, True)
    assert outcome["local_error_m"] == pytest.approx(4.0, abs=1.0)


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


@pytest.mark.slow
def test_fix_that_is_taken_back_is_no_later_right_one(
    searches: list[Search], outcomes: list[Outcome], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("tools.lab.relocalization.trial.Slam", GivesUp)
    outcome = relocalize(searches[0])
    assert (outcome["later_right"], outcomes[0]["later_right"]) == (None, True)
    assert outcome["error_m"] == outcomes[0]["error_m"]


@pytest.mark.slow
def test_benchmark_is_json_and_the_same_in_several_processes():
    done: list[float] = []

    def run(**more: Any) -> Outcome:
        world = one_block().shortened(100.0)
        return benchmark_relocalization(
            world, Config(), kidnaps=2, seed=3, noise=1.5, changed=0.2, max_travel_m=20.0, **more
        )

    first, again = run(on_progress=done.append), run(jobs=2)
    assert done == [0.5, 1.0]
    json.dumps(first, allow_nan=False)
    assert (first["world"], first["tour_m"]) == ("town", pytest.approx(100.0))
    assert first["landmarks"] > 10
    assert 0.0 < first["map_ate_m"] < 2.0
    for result in (first, again):
        for timed in (result, *result["outcomes"]):
            del timed["load_s"], timed["query_ms"]
    assert again == first


# The ceiling.


def simulated(world: World) -> tuple[KnownMap, list[Record]]:
    """The world itself as a map, and a drive through it."""
    records: list[Record] = [record for _, _, record in simulate(world, SimulationConfig(), seed=1)]
    objects = next(each for each in records if isinstance(each, ObjectMapRecord))
    T = np.stack([each.T_world_body for each in records if isinstance(each, GroundTruthPose)])
    graph: Any = type("Graph", (), {"T_map_body": T})()
    return KnownMap(SavedMap(objects, graph), T, T, np.eye(4), 0.0), records


def test_oracle_finds_the_place_among_many_objects(block: World):
    known, records = simulated(block)
    assert Oracle(known, Config(), TOLERANCE).finds(records)
    shifted = replace(known, T_map_body=known.T_map_body @ transform_from_xyz_yaw(np.array([3.0, 0.0, 0.0]), 0.0))
    assert not Oracle(shifted, Config(), TOLERANCE).finds(records)
    blind = [each for each in records if not isinstance(each, ObjectDetections | DetectionTruth)]
    assert not Oracle(known, Config(), TOLERANCE).finds(blind)


def test_oracle_is_not_sure_of_the_place_among_a_few_objects(block: World):
    known, records = simulated(thin_world(block, 30.0, rng=np.random.default_rng(0)))
    assert not Oracle(known, Config(), TOLERANCE).finds(records)


# Maps that nobody drove.


def rows_of_trees() -> ImportedMap:
    """Ten rows of forty trees along x, irregularly 8 m apart."""
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(8.0 * np.arange(40), 60.0 * np.arange(10))
    plane = np.stack([x.ravel(), y.ravel()], axis=1) + rng.normal(0.0, 1.5, (x.size, 2)) * [1.0, 0.2]
    positions = np.column_stack([plane, np.zeros(len(plane))])
    return make_imported_map(positions, ["tree"] * len(plane), [str(i) for i in range(len(plane))], sigma_m=0.3)


def test_street_runs_along_the_row_beside_which_it_begins() -> None:
    for seed in range(5):
        start, end = draw_street(rows_of_trees(), 30.0, length_m=100.0, rng=np.random.default_rng(seed)).tour
        assert np.linalg.norm(end - start) == pytest.approx(100.0)
        assert abs((end - start)[0]) > 95.0
        assert abs(start[1] - np.round(start[1] / 60.0) * 60.0) == pytest.approx(BESIDE_M, abs=1.5)


@pytest.mark.slow
def test_kidnappings_in_an_imported_map_are_measured() -> None:
    config = Config.model_validate({"calibrate": False})
    result = benchmark_in_map(rows_of_trees(), config, kidnaps=2, max_travel_m=60.0)
    assert (result["kidnaps"], result["landmarks"]) == (2, 400)
    assert result["false_relocalization_rate"] == 0.0
