"""Which landmarks a place is found among, and which are its reference."""

from types import SimpleNamespace

import numpy as np
import pytest

from descriptors.constellation import Constellations
from descriptors.index import VectorIndex
from slam.common.config import Config
from slam.common.geometry import apply, invert
from slam.object_map.landmarks import ObjectMap, RetirementReason
from slam.object_map.submap import Submap
from slam.odometry.pose import OdometryPose
from slam.place_recognition.imported_places import SEGMENT
from slam.place_recognition.landmark_pairs import Batch, VectorPairs
from slam.place_recognition.place_search import Place
from slam.place_recognition.retrieval import INACTIVE_RANGES, INDEXED_TRAVERSALS, PLACE_RADIUS_RANGES, PlaceRetriever
from tests.helpers.landmarks import add_landmarks
from tests.helpers.poses import pose_at

CONFIG = Config()
COUNT = 25
NOW_M = 1000.0
BEFORE_M = NOW_M - CONFIG.closure_travel_m
RADIUS_M = PLACE_RADIUS_RANGES * CONFIG.sensor_range_m


class Places:
    """Landmarks around places, each seen at one travel, and a retriever that knows those left behind."""

    def __init__(self, config: Config = CONFIG) -> None:
        self.map = ObjectMap(config.calibration.objects)
        self.retriever = PlaceRetriever(config, self.map)
        self.map.labels.indices(("tree", "lamp", "bench", "bin"))

    def add(self, x_m: float, travel_m: float, *, segment: int = 0, seed: int = 1) -> np.ndarray:
        """The objects of ``seed`` around a place."""
        rng = np.random.default_rng(seed)
        positions = rng.uniform([-20.0, -15.0, 0.0], [20.0, 15.0, 0.5], (COUNT, 3)) + np.array([x_m, 0.0, 0.0])
        labels = rng.choice(("tree", "lamp", "bench", "bin"), COUNT).tolist()
        return add_landmarks(self.map, positions, labels, travel_m=travel_m, segment=segment)

    def index(self, travel_m: float = NOW_M) -> None:
        """Index what is left behind after some travel."""
        self.retriever.index_inactive_landmarks(OdometryPose(0, np.eye(4), travel_m, 0, 0.0))

    def query(self, x_m: float, seed: int = 1) -> Submap:
        """The same objects as seen from the place, under rows that the map does not have."""
        here = Places()
        rows = here.add(x_m, 0.0, seed=seed)
        positions = apply(invert(pose_at(x_m, yaw=0.4)), here.map.rows["position_local"][rows])
        return Submap(positions, np.full(COUNT, 0.4), here.map.labels.classes(rows), 10_000 + rows)

    def add_again(self, rows: np.ndarray, x_m: float, travel_m: float) -> None:
        """The objects of ``rows`` as seen on another traversal."""
        for kept, dropped in zip(rows, self.add(x_m, travel_m), strict=True):
            self.map.merge(int(kept), int(dropped))

    def propose(self, x_m: float, seed: int = 1, before_m: float = BEFORE_M) -> list[Place]:
        return self.retriever.propose(self.query(x_m, seed), before_m=before_m)

    def found_m(self, x_m: float, seed: int = 1) -> list[float]:
        """Where the first place is said to be, if there is one."""
        self.index()
        return [round(float(place.T_local_query[0, 3]), 1) for place in self.propose(x_m, seed)[:1]]

    def reference(self, travel_m: float, before_m: float = BEFORE_M) -> list[int]:
        """Rows of the reference of the place at 50 m that was seen then."""
        place = Place(pose_at(50.0), travel_m, 0, "descriptor")
        return list(self.retriever.reference_submap(place, before_m=before_m).rows)


@pytest.fixture
def places() -> Places:
    return Places()


def test_not_among_landmarks_of_this_traversal(places):
    places.add(50.0, BEFORE_M + 1.0)
    places.add(400.0, 450.0, seed=2)
    assert places.found_m(50.0) != [50.0]


def test_not_among_retired_landmarks(places):
    rows = places.add(50.0, 100.0)
    places.add(400.0, 450.0, seed=2)
    places.index()
    places.map.retire(rows, RetirementReason.GONE)
    assert places.found_m(50.0) != [50.0]


def test_not_among_landmarks_that_this_traversal_has_seen_again(places):
    rows = places.add(50.0, 100.0)
    assert len(places.reference(100.0)) == COUNT
    places.map.assign(rows, last_seen_travel_m=BEFORE_M + 1.0)
    assert places.reference(100.0) == []
    places.index(2.0 * NOW_M)
    assert places.propose(50.0) == []


def test_landmarks_are_left_behind_after_some_travel(places):
    recent_m = NOW_M - INACTIVE_RANGES * CONFIG.sensor_range_m
    places.add(50.0, recent_m + 1.0)
    places.index()
    assert places.propose(50.0, before_m=NOW_M) == []
    places.index(NOW_M + 20.0)
    assert places.propose(50.0, before_m=NOW_M) != []


def test_the_reference_of_a_place_is_of_its_traversal_its_segment_and_around_it(places):
    extent_m = 1.1 * CONFIG.closure_travel_m
    here = places.add(50.0, 500.0)
    places.add(50.0, 500.0 - extent_m - 1.0)
    places.add(50.0, 500.0 + extent_m + 1.0)
    places.add(50.0, 500.0, segment=1)
    places.add(50.0 + RADIUS_M + 25.0, 500.0)
    assert places.reference(500.0) == here.tolist()
    assert places.reference(500.0, before_m=499.0) == []


@pytest.mark.parametrize(("traversals", "is_found"), [(INDEXED_TRAVERSALS - 1, True), (INDEXED_TRAVERSALS, False)])
def test_the_index_holds_only_so_many_traversals_of_a_place(places, traversals, is_found):
    first = places.add(0.0, 0.0)
    for number in range(1, traversals):
        places.add_again(first, 0.0, float(number))
    places.index(500.0)
    places.add_again(first, 50.0, 550.0)
    places.add(400.0, 551.0, seed=2)
    places.index()
    assert any(abs(place.T_local_query[0, 3] - 50.0) < 0.1 for place in places.propose(50.0)) is is_found
    assert places.found_m(400.0, seed=2) == [400.0]


def test_landmarks_are_indexed_among_those_of_their_traversal(places, monkeypatch):
    added = list[Batch]()
    monkeypatch.setattr(places.retriever, "_pairs", SimpleNamespace(enter=added.append))
    for seed, travel_m in enumerate((0.0, 500.0, 510.0)):
        places.add(0.0, travel_m, seed=seed)
        places.index(travel_m + 200.0)
    assert [(len(batch.centres), len(batch.positions)) for batch in added] == [
        (COUNT, COUNT),
        (COUNT, COUNT),
        (COUNT, 2 * COUNT),
    ]


def test_landmarks_of_an_imported_map_are_not_indexed_again(places, monkeypatch):
    added = list[Batch]()
    retriever = PlaceRetriever(CONFIG, places.map, SimpleNamespace())
    monkeypatch.setattr(retriever, "_pairs", SimpleNamespace(enter=added.append))
    places.add(0.0, 0.0, segment=SEGMENT)
    places.add(50.0, 0.0, segment=SEGMENT + 1, seed=2)
    retriever.index_inactive_landmarks(OdometryPose(0, np.eye(4), 200.0, 0, 0.0))
    assert [batch.segment for batch in added] == [SEGMENT + 1]


class _Recorded:
    """A descriptor that keeps the constellations it is given."""

    name, radius_m = "recorded", 30.0

    def __init__(self) -> None:
        self.seen: list[Constellations] = []

    def describe(self, constellations: Constellations) -> np.ndarray:
        self.seen.append(constellations)
        return np.ones((len(constellations), 2), dtype=np.float32)


@pytest.mark.parametrize("sensor_range_m", [10.0, 100.0])
def test_vectors_see_lengths_in_sensor_ranges(places, sensor_range_m):
    query = places.query(0.0)
    entries = np.arange(COUNT)
    seen = []
    for range_m in (CONFIG.sensor_range_m, sensor_range_m):
        config = Config.model_validate({"calibration": {"detection": {"sensor_range_m": range_m}}})
        descriptor = _Recorded()
        landmarks = VectorPairs(config, VectorIndex(descriptor))
        scaled = query.positions * range_m / CONFIG.sensor_range_m
        landmarks.enter(Batch(scaled, query.labels, entries, entries, 0, places.map.labels.vocabulary))
        seen.append(descriptor.seen[0].positions)
    np.testing.assert_allclose(seen[0], seen[1])


def test_matches_by_vectors_are_pairs_of_one_length_in_one_segment(places):
    """Two objects 9 m apart: the same on each of two segments, and a third one at another distance."""
    ends = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    landmarks = VectorPairs(CONFIG, VectorIndex(_Recorded()))
    for segment, more in ((0, [[20.0, 0.0, 0.0]]), (1, [])):
        positions = np.concatenate([ends, np.reshape(more, (-1, 3))])
        rows = np.arange(len(positions))
        landmarks.enter(Batch(positions, np.zeros_like(rows), rows, rows, segment, ("tree",)))
    for allowed, pairs in ((None, {(0, 1), (3, 4)}), (np.arange(5) < 4, {(0, 1)})):
        found = landmarks.search(ends, np.zeros(2, int), sigmas_m=np.full(2, 0.1), allowed=allowed)
        assert {tuple(sorted(pair)) for pair in found.entries.tolist()} == pairs


@pytest.mark.parametrize("descriptor", ["descriptellation_lr", "gosmatch_vertex"])
def test_places_of_segments_are_told_apart(descriptor):
    """Frames of two segments of the odometry overlap."""
    places = Places(Config.model_validate({"loop_closure": {"descriptor": descriptor}}))
    places.add(50.0, 100.0)
    places.add(50.0, 100.0, seed=2, segment=1)
    places.index()
    for seed, segment in ((1, 0), (2, 1)):
        best = places.propose(50.0, seed)[0]
        assert (round(float(best.T_local_query[0, 3]), 1), best.segment) == (50.0, segment)


def test_landmarks_are_indexed_again_when_their_spacing_has_changed(places):
    places.add(50.0, 100.0)
    places.index(200.0)
    before_m = places.retriever._pairs.unit_m
    for row in range(4):
        places.add(400.0, 101.0 + row, seed=10 + row)
    places.index()
    assert places.retriever._pairs.unit_m < before_m / 1.25
    assert places.found_m(50.0) == [50.0]


def test_class_shares_are_those_of_all_indexed_objects_but_one(places):
    rows = places.add(50.0, 100.0)
    places.add_again(rows, 50.0, 200.0)
    places.index()
    counts = np.bincount(places.map.labels.classes(rows), minlength=4)
    np.testing.assert_allclose(places.retriever.class_shares(), (counts - 0.75) / COUNT)


def test_class_that_one_landmark_has_is_hardly_another_object_s(places):
    names = [f"tag {number}" for number in range(20)]
    add_landmarks(places.map, np.arange(60.0).reshape(20, 3), names, travel_m=0.0)
    places.index()
    tree, tag = places.retriever.class_shares()[[0, 4]]
    assert tag == pytest.approx(1.0 / 24.0 / 20.0)
    assert tree == pytest.approx(tag + 1.0 / 24.0)
