"""Global localization: a query is found in a street by its constellations alone; where it cannot be, that is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from descriptors.registry import make_index
from slam.benchmarks.localization_queries import SCENARIOS, LocalQuery, draw_queries, labelled_map
from slam.common.arrays import FloatArray
from slam.common.config import RegistrationConfig
from slam.common.geometry import invert, yaw_rad
from slam.place_recognition.global_localization import GlobalLocalizer, LabelledMap, Localization
from slam.simulation.street import generate_street

CONFIG = RegistrationConfig(min_inliers=2)
STRICT = RegistrationConfig(min_inliers=5)
SIGMA_M = 0.05
SELF, FEWER, NOISY = SCENARIOS


@pytest.fixture(scope="module")
def street() -> tuple[LabelledMap, FloatArray]:
    world = generate_street(rng=np.random.default_rng(0))
    return labelled_map(world), world.tour


@pytest.fixture(scope="module")
def localizer(street) -> GlobalLocalizer:
    return GlobalLocalizer(street[0], make_index("ring_likelihood"))


@pytest.fixture(scope="module")
def queries(street) -> list[LocalQuery]:
    return draw_queries(*street, SELF, count=25, rng=np.random.default_rng(1))


def localize(
    localizer: GlobalLocalizer, query: LocalQuery, config: RegistrationConfig = CONFIG, *, per_m: float = 0.0
) -> Localization:
    sigmas = SIGMA_M + per_m * np.linalg.norm(query.positions, axis=1)
    return localizer.localize(query.positions, query.labels, config, query_sigmas=sigmas, map_sigma_m=SIGMA_M)


def error_m(found: Localization, query: LocalQuery) -> float:
    """Of the place, infinite without an answer."""
    T_map_query = found.registration.T_reference_query
    return np.inf if T_map_query is None else float(np.linalg.norm((T_map_query - query.T_map_query_gt)[:3, 3]))


def part(query: LocalQuery, kept: np.ndarray) -> LocalQuery:
    return LocalQuery(query.positions[kept], query.labels[kept], query.objects[kept], query.T_map_query_gt)


def test_a_query_without_noise_is_found_to_a_centimetre_with_every_object(localizer, queries):
    for query in queries:
        found = localize(localizer, query)
        assert error_m(found, query) < 0.01
        T = found.registration.T_reference_query
        assert abs(yaw_rad(invert(query.T_map_query_gt) @ T)) < 1e-3
        assert found.registration.score == pytest.approx(len(query), abs=1e-3)


def test_the_pairs_of_an_answer_are_objects_of_the_query_and_of_the_whole_map(localizer, queries):
    for query in queries:
        pairs = localize(localizer, query).registration.pairs
        assert pairs.tolist() == [[place, which] for place, which in enumerate(query.objects)]


def test_objects_that_are_missing_added_or_of_another_class_are_tolerated(street, localizer, queries):
    classes = len(street[0].vocabulary)
    rng = np.random.default_rng(2)
    for query in queries:
        some = part(query, rng.random(len(query)) < 0.7)
        labels = some.labels.copy()
        wrong = rng.permutation(len(some))[: len(some) // 5]
        labels[wrong] = (labels[wrong] + rng.integers(1, classes, len(wrong))) % classes
        added = np.column_stack([rng.uniform(-25.0, 25.0, (3, 2)), rng.uniform(0.3, 4.0, 3)])
        disturbed = replace(
            some,
            positions=np.vstack([some.positions, added]),
            labels=np.append(labels, rng.integers(0, classes, 3)),
        )
        found = localize(localizer, disturbed)
        assert error_m(found, query) < 0.05
        right = np.setdiff1d(np.arange(len(some)), wrong)
        assert set(right) <= set(found.registration.pairs[:, 0])


def test_noise_that_grows_with_the_range_leaves_the_place_within_a_metre_most_often(street, localizer):
    config = RegistrationConfig(min_inliers=2, estimate_scale=True)
    noisy = draw_queries(*street, NOISY, count=25, rng=np.random.default_rng(3))
    errors_m = np.array([error_m(localize(localizer, query, config, per_m=0.08), query) for query in noisy])
    assert np.median(errors_m) < 1.0
    assert np.mean(errors_m < 5.0) > 0.9


def test_the_pose_is_that_of_the_query_wherever_it_is_and_however_it_is_turned(street):
    objects, tour = street
    away = np.array([3000.0, -2000.0, 40.0])
    moved = replace(objects, positions=objects.positions + away)
    localizer = GlobalLocalizer(moved, make_index("ring_likelihood"))
    for query in draw_queries(moved, tour + away[:2], SELF, count=5, rng=np.random.default_rng(4)):
        assert error_m(localize(localizer, query), query) < 0.01


@pytest.mark.parametrize("name", ["onion", "onion_histogram", "gosmatch_vertex"])
def test_other_descriptors_find_it_too(street, queries, name):
    localizer = GlobalLocalizer(street[0], make_index(name))
    for query in queries[:5]:
        assert error_m(localize(localizer, query), query) < 0.01


def test_without_descriptors_that_mean_something_most_queries_are_lost(street, queries):
    lost = GlobalLocalizer(street[0], make_index("random"), neighbours=1)
    found = GlobalLocalizer(street[0], make_index("ring_likelihood"), neighbours=1)
    assert np.mean([error_m(localize(lost, query), query) < 1.0 for query in queries]) < 0.5
    assert np.mean([error_m(localize(found, query), query) < 1.0 for query in queries]) == 1.0


def test_the_matches_are_those_of_the_index_and_no_more_than_asked_for(street, queries):
    objects, _ = street
    localizer = GlobalLocalizer(objects, make_index("ring_likelihood"), neighbours=3)
    for query in queries[:5]:
        matches = localize(localizer, query).matches
        assert np.bincount(matches.queries, minlength=len(query)).max() <= 3
        np.testing.assert_array_equal(objects.labels[matches.entries], query.labels[matches.queries])
        first = matches.entries[np.unique(matches.queries, return_index=True)[1]]
        assert np.mean(first == query.objects) > 0.6


def test_the_same_query_has_the_same_answer(street, localizer, queries):
    again = GlobalLocalizer(street[0], make_index("ring_likelihood"))
    for query in queries[:5]:
        first, second, third = (localize(each, query) for each in (localizer, localizer, again))
        for other in (second, third):
            np.testing.assert_array_equal(
                first.registration.T_reference_query, other.registration.T_reference_query, strict=True
            )
            np.testing.assert_array_equal(first.registration.pairs, other.registration.pairs)
            np.testing.assert_array_equal(first.matches.entries, other.matches.entries)
        assert min(first.match_s, first.verify_s) > 0.0


def test_what_is_drawn_where_there_are_too_many_pairs_depends_on_the_seed_alone(street):
    localizer = GlobalLocalizer(street[0], make_index("onion"))
    config = RegistrationConfig(min_inliers=2, estimate_scale=True, max_pairs=300)
    (query,) = draw_queries(*street, NOISY, count=1, rng=np.random.default_rng(3))
    first, again, other = (
        localizer.localize(
            query.positions,
            query.labels,
            config,
            query_sigmas=SIGMA_M + 0.08 * np.linalg.norm(query.positions, axis=1),
            map_sigma_m=SIGMA_M,
            seed=seed,
        ).registration.T_reference_query
        for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first, again, strict=True)
    assert not np.array_equal(first, other)


def test_a_query_of_one_object_has_a_reason_and_no_pose(localizer, queries):
    found = localize(localizer, part(queries[0], np.array([0])))
    assert not found.registration.found
    assert found.registration.reason
    assert len(found.registration.pairs) == 0


def test_a_query_of_no_object_has_a_reason_and_no_pose(localizer, queries):
    found = localize(localizer, part(queries[0], np.zeros(0, dtype=np.int64)))
    assert "no correspondences" in found.registration.reason
    assert not found.registration.found
    assert len(found.matches.queries) == 0


@pytest.mark.parametrize("name", ["ring_likelihood", "onion_histogram"])
def test_a_query_of_classes_that_the_map_lacks_has_a_reason_and_no_pose(street, queries, name):
    objects, _ = street
    without = objects.labels != 3
    known = LabelledMap(objects.positions[without], objects.labels[without], objects.vocabulary)
    localizer = GlobalLocalizer(known, make_index(name))
    query = replace(queries[0], labels=np.full(len(queries[0]), 3))
    found = localize(localizer, query)
    assert "no correspondences" in found.registration.reason
    assert not found.registration.found


def test_surroundings_that_the_map_lacks_have_a_reason_and_no_pose(street):
    objects, tour = street
    ahead = objects.positions[:, 0] < np.median(objects.positions[:, 0])
    first_half = LabelledMap(objects.positions[ahead], objects.labels[ahead], objects.vocabulary)
    localizer = GlobalLocalizer(first_half, make_index("ring_likelihood"))
    elsewhere = draw_queries(objects, tour[-300:], SELF, count=8, rng=np.random.default_rng(5))
    known = draw_queries(first_half, tour[100:300], SELF, count=8, rng=np.random.default_rng(6))
    strict = STRICT.model_copy(update={"min_inliers": 12})
    for query in elsewhere:
        found = localize(localizer, query, strict)
        assert not found.registration.found
        assert found.registration.reason
    for query in known:
        assert error_m(localize(localizer, query, strict), query) < 0.01


def test_two_objects_that_are_alike_everywhere_give_an_answer_without_an_exception(localizer, queries):
    for query in queries:
        found = localize(localizer, part(query, np.array([0, 1])))
        assert found.registration.found or found.registration.reason


def test_a_map_of_one_object_gives_a_reason():
    lonely = LabelledMap(np.zeros((1, 3)), np.zeros(1, np.int64), ("tree",))
    localizer = GlobalLocalizer(lonely, make_index("ring_likelihood"))
    query = LocalQuery(np.array([[5.0, 0.0, 0.0], [0.0, 7.0, 0.0]]), np.zeros(2, np.int64), np.zeros(2), np.eye(4))
    found = localize(localizer, query)
    assert not found.registration.found
    assert found.registration.reason
