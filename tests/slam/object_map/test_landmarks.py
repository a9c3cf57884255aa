"""The object map: beliefs, life cycle, merges, and growth."""

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.calibration import ObjectCalibration
from slam.object_map.landmarks import LandmarkState, ObjectMap, RetirementReason
from tests.helpers.landmarks import spheres

SECOND_NS = 1_000_000_000
CONFIG = ObjectCalibration(label_accuracy=0.8)


def new_map(vocabulary: str = "abc", count: int = 1) -> ObjectMap:
    """A map of ``count`` landmarks of class "a", each seen once at time 0, scan 1."""
    object_map = ObjectMap(CONFIG)
    object_map.labels.indices(tuple(vocabulary))
    see_new(object_map, np.zeros((count, 3)))
    return object_map


def belief(object_map: ObjectMap) -> FloatArray:
    """Probabilities of the classes of the first landmark."""
    return object_map.labels.beliefs(np.array([0]))[0]


def see_new(object_map: ObjectMap, positions, label: int = 0):
    count = len(positions)
    return object_map.add(positions, spheres(1.0, count), np.full(count, label), stamp_ns=0, scan=1, travel_m=0.0)


def see(
    object_map: ObjectMap,
    row: int,
    label: int = 0,
    *,
    position=(0.0, 0.0, 0.0),
    covariance=None,
    seconds: float = 0.0,
    scan: int = 2,
):
    object_map.record_observations(
        np.array([row]),
        np.array([position]),
        np.array([np.eye(3) if covariance is None else covariance]),
        np.array([label]),
        0.0,
        stamp_ns=round(seconds * SECOND_NS),
        scan=scan,
        travel_m=float(scan),
    )


@pytest.mark.parametrize("sightings", ["a", "aab", "abc", "bbbac", "c" * 12])
def test_the_belief_is_bayes_rule_applied_label_by_label(sightings):
    object_map = ObjectMap(CONFIG)
    object_map.labels.indices(("a", "b", "c"))
    see_new(object_map, np.zeros((1, 3)), label="abc".index(sightings[0]))
    for seen in sightings[1:]:
        see(object_map, 0, "abc".index(seen))
    posterior = np.full(3, 1 / 3)
    for seen in sightings:
        posterior = posterior * [0.8 if name == seen else 0.1 for name in "abc"]
        posterior /= posterior.sum()
    np.testing.assert_allclose(belief(object_map), posterior, atol=1e-12)


def test_of_one_class_no_label_lies_beyond_the_limit():
    object_map = ObjectMap(ObjectCalibration(max_classes=1))
    assert object_map.labels.indices(("a", "b")).tolist() == [0, 0]
    assert object_map.labels.unlisted == 0


def test_classes_beyond_the_limit_are_one_class():
    object_map = ObjectMap(ObjectCalibration(max_classes=3))
    assert object_map.labels.indices(("a", "b", "c", "d", "a")).tolist() == [0, 1, 2, 2, 0]
    assert object_map.labels.vocabulary == ("a", "b", "other")
    assert object_map.labels.unlisted == 2
    see_new(object_map, np.zeros((1, 3)), label=2)
    np.testing.assert_array_equal(object_map.labels.classes(np.array([0])), [2])


def test_the_life_of_a_landmark():
    object_map = new_map(count=4)
    object_map.confirm(np.array([1, 2]))
    object_map.retire(np.array([2]), RetirementReason.MOVING)
    object_map.retire(np.array([3]), RetirementReason.NOT_CONFIRMED)
    assert object_map.in_state(LandmarkState.TENTATIVE).tolist() == [0]
    assert object_map.in_state(LandmarkState.CONFIRMED).tolist() == [1]
    assert object_map.in_state(LandmarkState.RETIRED).tolist() == [2, 3]
    record = object_map.to_record(5)
    assert record.ids == ("0", "1", "2")
    assert record.states == ("tentative", "confirmed", "retired")
    assert record.reasons == ("", "", "moving")


def test_sightings_are_counted_and_the_first_and_last_are_remembered():
    object_map = new_map(count=2)
    see(object_map, 1, seconds=2.0, scan=5)
    see(object_map, 1, seconds=3.0, scan=9)
    landmark = object_map.rows[1]
    assert landmark["observations"] == 3
    assert (landmark["first_scan"], landmark["last_scan"]) == (1, 9)
    assert (landmark["first_seen_ns"], landmark["last_seen_ns"]) == (0, 3 * SECOND_NS)
    assert landmark["last_seen_travel_m"] == 9.0
    assert object_map.rows["observations"][0] == 1


@pytest.mark.parametrize("speed", [(1.5, -0.5, 0.0), (0.0, 1.0, 0.0)])
def test_velocity_is_the_least_squares_line_and_its_noise_that_along_it_at_each_sighting(speed):
    rng = np.random.default_rng(0)
    t, sigmas = np.append(0.0, np.sort(rng.uniform(0.1, 9.0, 9))), np.linspace(5.0, 1.0, 10)
    covariances = np.array([np.diag([sigma**2, 0.01, 0.01]) for sigma in sigmas])  # less as the object comes nearer
    p = t[:, None] * speed + rng.normal(scale=0.2, size=(10, 3))
    object_map = ObjectMap(CONFIG)
    labels = object_map.labels.indices(("a",))
    object_map.add(p[:1], covariances[:1], labels, stamp_ns=0, scan=1, travel_m=0.0)
    for second, position, covariance in zip(t[1:].tolist(), p[1:], covariances[1:], strict=True):
        see(object_map, 0, position=position, covariance=covariance, seconds=second)
    (found,), noise = object_map.velocities(np.array([0]))
    np.testing.assert_allclose(found, np.polyfit(t, p, 1)[0], atol=1e-6)
    gains, direction = (t - t.mean()) / np.sum((t - t.mean()) ** 2), found / np.linalg.norm(found)
    along = np.einsum("i,nij,j->n", direction, covariances, direction)
    np.testing.assert_allclose(noise, np.sqrt(np.sum(gains**2 * along)), rtol=1e-6)


def test_merged_landmarks_are_one_in_the_map_and_two_around_the_robot():
    object_map = new_map(count=3)
    see(object_map, 0, label=1, seconds=1.0)
    see(object_map, 1, label=0, seconds=7.0)
    object_map.merge(0, 1)
    assert object_map.rows["observations"].tolist() == [2, 2, 1]
    object_map.merge(2, 1)
    object_map.merge(0, 2)
    assert object_map.canonical.tolist() == [2, 2, 2]
    assert object_map.in_state(LandmarkState.TENTATIVE).tolist() == [2]
    record = object_map.to_record(0)
    assert record.states == ("retired", "retired", "tentative")
    assert record.reasons == ("merged into 2", "merged into 2", "")
    assert record.merged_into == ("2", "2", "")
    assert record.observation_counts.tolist() == [2, 2, 5]
    assert record.last_seen_ns[2] == 7 * SECOND_NS
    together = new_map(count=1)
    for label in (0, 1, 0, 0):
        see(together, 0, label)
    np.testing.assert_allclose(record.class_probabilities[2, :2], belief(together)[:2], rtol=1e-6)


def test_merges_are_of_the_landmarks_given():
    object_map = new_map(count=4)
    for kept, dropped, closure in ((0, 1, None), (1, 2, 7), (3, 2, None)):
        object_map.merge(kept, dropped, closure=closure)
    object_map.merge(1, 3)
    assert object_map.aliases == {0: 3, 1: 3, 2: 3}
    object_map.undo_merges({7})
    assert object_map.aliases == {1: 0, 2: 3}


def test_the_record_does_not_change_with_the_map():
    object_map = new_map()
    record = object_map.to_record(0)
    object_map.assign(slice(None), position_map=9.0, covariance_map=np.diag([0.1, 0.2, 0.3]))
    see(object_map, 0)
    changed = object_map.to_record(4)
    assert (changed.labels, changed.observation_counts.tolist()) == (("a",), [2])
    np.testing.assert_array_equal(changed.positions, [[9.0, 9.0, 9.0]])
    np.testing.assert_array_equal(changed.covariances, [np.diag([0.1, 0.2, 0.3])])
    assert record.positions.tolist() == [[0.0, 0.0, 0.0]]
    assert record.observation_counts.tolist() == [1]


def test_the_map_grows_and_forgets_nothing():
    object_map = new_map("ab", count=60)
    first = object_map.rows[:60].copy()
    for start in range(60, 500, 44):
        rows = see_new(object_map, np.full((44, 3), float(start)), label=1)
        assert rows.tolist() == list(range(start, start + 44))
    assert len(object_map) == 500
    np.testing.assert_array_equal(object_map.rows[:60], first)
    assert object_map.labels.beliefs(np.arange(500)).argmax(axis=1).tolist() == [0] * 60 + [1] * 440


def test_the_vocabulary_grows_and_old_labels_keep_their_index():
    object_map = new_map("a")
    names = tuple(f"class {i}" for i in range(40))
    assert object_map.labels.indices(("a", *names[:20])).tolist() == list(range(21))
    see(object_map, 0, label=20)
    assert object_map.labels.indices((names[3], *names)).tolist() == [4, *range(1, 41)]
    assert object_map.labels.vocabulary == ("a", *names)
    assert belief(object_map).shape == (41,)
    assert np.flatnonzero(belief(object_map) > 0.3).tolist() == [0, 20]
    assert object_map.labels.indices(()).shape == (0,)
