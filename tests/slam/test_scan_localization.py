"""Localization of single scans: found in a street by what is seen alone; where that is not enough, it is said."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from logs.messages import ObjectDetections, ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.common.geometry import invert, yaw_rad
from slam.scan_localization import ScanLocalization, ScanLocalizer
from tests.helpers.landmarks import detections_of
from tests.helpers.long_street import start_of_street
from tools.lab.retrieval.labelled_map import LabelledMap
from tools.lab.retrieval.paper import localizer_config
from tools.lab.retrieval.paper_queries import SCENARIOS, LocalQuery, draw_queries

SELF, FEWER, NOISY = SCENARIOS
EXACT = localizer_config("descriptellation_lr")


@pytest.fixture(scope="module")
def street() -> tuple[LabelledMap, FloatArray]:
    """The first part of the street."""
    return start_of_street(300)


@pytest.fixture(scope="module")
def localizer(street) -> ScanLocalizer:
    return ScanLocalizer(street[0].to_record(), EXACT)


@pytest.fixture(scope="module")
def queries(street) -> list[LocalQuery]:
    return draw_queries(*street, SELF, count=6, rng=np.random.default_rng(1))


def scan_of(street: tuple[LabelledMap, FloatArray], query: LocalQuery) -> ObjectDetections:
    labels = street[0].names(query.labels)
    return detections_of(query.positions, labels)


@pytest.fixture(scope="module")
def localize(street, localizer) -> Callable[[LocalQuery], ScanLocalization]:
    return lambda query: localizer.localize(scan_of(street, query))


def part(query: LocalQuery, kept: np.ndarray) -> LocalQuery:
    return LocalQuery(query.positions[kept], query.labels[kept], query.objects[kept], query.T_map_query_gt)


def error_m(found: ScanLocalization, query: LocalQuery) -> float:
    """Of the place, infinite without an answer."""
    T_map_scan = found.T_reference_query
    return np.inf if T_map_scan is None else float(np.linalg.norm((T_map_scan - query.T_map_query_gt)[:3, 3]))


def test_an_exact_scan_is_found_to_a_centimetre_with_every_object(localize, queries):
    for query in queries:
        found = localize(query)
        assert error_m(found, query) < 0.01
        assert abs(yaw_rad(invert(query.T_map_query_gt) @ found.T_reference_query)) < 1e-3
        assert found.pairs.tolist() == [[place, which] for place, which in enumerate(query.objects)]
        assert found.covariance.shape == (6, 6)
        assert found.reason == ""


def test_objects_that_are_missing_added_or_of_another_class_are_tolerated(street, localize, queries):
    classes = len(street[0].vocabulary)
    rng = np.random.default_rng(2)
    for query in queries:
        some = part(query, rng.random(len(query.labels)) < 0.7)
        labels = some.labels.copy()
        wrong = rng.permutation(len(some.labels))[: len(some.labels) // 5]
        labels[wrong] = (labels[wrong] + rng.integers(1, classes, len(wrong))) % classes
        found = localize(replace(some, labels=labels))
        assert error_m(found, query) < 0.05
        assert set(np.setdiff1d(np.arange(len(some.labels)), wrong)) <= set(found.pairs[:, 0])


def test_objects_of_classes_that_the_map_lacks_are_left_out_and_pairs_count_all(street, localizer, queries):
    scan = scan_of(street, queries[0])
    more = replace(
        scan,
        positions=np.vstack([[[3.0, 4.0, 0.0]], scan.positions]),
        labels=("balloon", *scan.labels),
        scores=np.ones(len(scan.labels) + 1),
    )
    found = localizer.localize(more)
    assert error_m(found, queries[0]) < 0.01
    assert found.pairs.tolist() == [[place + 1, which] for place, which in enumerate(queries[0].objects)]


@pytest.mark.parametrize("count", [0, 1])
def test_a_scan_of_too_few_objects_has_a_reason_and_no_pose(localize, queries, count):
    found = localize(part(queries[0], np.arange(count)))
    assert not found.found
    assert found.reason == f"{count} objects of classes of the map, a pose needs 2"
    assert found.pairs.shape == (0, 2)


def test_what_several_places_may_be_is_not_accepted(localize, queries):
    """Three objects fit in many places; the pose is one of them, and is wrong too often."""
    query = queries[0]
    nearest = np.argsort(np.linalg.norm(query.positions, axis=1))[:3]
    found = localize(part(query, nearest))
    assert not found.found
    assert "wrong with probability" in found.reason


def test_a_larger_map_needs_more_evidence(street, queries):
    """Anywhere in the map is as likely as anywhere else."""
    objects = street[0]
    far = replace(
        objects,
        positions=np.vstack([objects.positions, objects.positions + np.array([9000.0, 0.0, 0.0])]),
        labels=np.append(objects.labels, np.full(len(objects), objects.labels[0])),
    )
    small, large = (ScanLocalizer(each.to_record(), EXACT) for each in (objects, far))
    scores = []
    for each in (small, large):
        query = each.query(scan_of(street, queries[0]))
        scores.append(each.decide(query, each.propose(query)).accepted.odometry_penalty)
    assert scores[1] - scores[0] == pytest.approx(np.log(2.0), abs=0.05)


def test_surroundings_that_the_map_lacks_are_not_accepted(street):
    objects, tour = street
    ahead = objects.positions[:, 0] < np.median(objects.positions[:, 0])
    first_half = LabelledMap(objects.positions[ahead], objects.labels[ahead], objects.vocabulary)
    localizer = ScanLocalizer(first_half.to_record(), EXACT)
    beyond = tour[tour[:, 0] > first_half.positions[:, 0].max() + 40.0]
    for query in draw_queries(objects, beyond, SELF, count=6, rng=np.random.default_rng(5)):
        found = localizer.localize(scan_of(street, query))
        assert not found.found
        assert found.reason


def test_a_map_without_landmarks_is_refused(street):
    nothing = LabelledMap(np.zeros((0, 3)), np.zeros(0, np.int64), ("tree",))
    with pytest.raises(InputDataError, match="no confirmed landmark"):
        ScanLocalizer(nothing.to_record())


def test_a_map_of_one_object_gives_a_reason():
    lonely: ObjectMapRecord = LabelledMap(np.zeros((1, 3)), np.zeros(1, np.int64), ("tree",)).to_record()
    seen = [[5.0, 0.0, 0.0], [0.0, 7.0, 0.0], [3.0, 3.0, 0.0]]
    found = ScanLocalizer(lonely, Config()).localize(detections_of(seen))
    assert not found.found
    assert found.reason
