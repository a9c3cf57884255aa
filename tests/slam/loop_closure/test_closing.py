"""What follows what when loops are looked for: rules of ``LoopCloser`` without a drive, with doubles of its parts."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from logs.closures import Stage
from logs.messages import LoopClosureRecord
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.loop_closure import loop_closer as module
from slam.loop_closure.candidate import Candidate, Query
from slam.loop_closure.loop_closer import LoopCloser
from slam.object_map.landmarks import LANDMARK
from slam.object_map.submap import Submap
from slam.odometry.keyframe import Keyframe
from slam.place_recognition.initial_pose import InitialPose
from slam.place_recognition.place_search import Place
from slam.registration.registration import MIN_INLIERS
from tests.helpers.candidates import make_candidate
from tests.helpers.poses import motion_by, pose_at
from tests.slam.loop_closure.doubles import Patterns, make_keyframe, make_query

STEP_M = 2.0
LOOP_M = 400.0
"""The street is driven again after so much travel."""
FIRST = int(LOOP_M / STEP_M)
SURE_LLR, TRACKED_LLR, WEAK_LLR = 30.0, 15.0, 1.0
UNPREDICTED_PENALTY = 10.0
"""Of a place that no closure predicts."""
PLACE = Place(pose_at(0.0), 0.0, 0, "descriptor")


class Parts(Patterns):
    """All that a ``LoopCloser`` asks, and what it asked."""

    def __init__(self) -> None:
        super().__init__()
        self.llrs: dict[int, float] = {}
        """What a query finds where the odometry leads; none where nothing is said."""
        self.off_m = 0.0
        """How far from there."""
        self.objects, self.unconfirmed = 10, 0
        self.new_rows, self.first_row = 0, 0
        """Landmarks that each query has and the one before it had not."""
        self.retrieved = 0
        self.queries = list[Query]()
        self.places = [PLACE]
        self.keyframes: Sequence[Keyframe] = []
        self.is_connected = True
        self.kidnapped_after_m: float | None = None
        self.closed: dict[int, int] = {}

    def recent_submap(self, *_: Any) -> Submap:
        self.first_row += self.new_rows
        return make_query(self.keyframes[0], self.objects, first_row=self.first_row).submap

    # Verifier.
    def predict(self, seed: Candidate, query: Query) -> Place | None:
        travel_m = query.keyframe.odometry.travel_m - LOOP_M
        return Place(pose_at(travel_m), travel_m, 0, "prediction", predicted_by=seed.query.id)

    def verify(self, query: Query, place: Place) -> Candidate | LoopClosureRecord:
        self.queries.append(query)
        llr = self.llrs.get(query.keyframe.id)
        if llr is None:
            return query.refusal(Stage.REGISTRATION, "nothing fits")
        found = make_candidate(
            query=query.keyframe,
            reference=self.keyframes[max(query.keyframe.id - FIRST, 0) if not self.keyframes[0].is_prior else 0],
            T_local_query=pose_at(query.keyframe.odometry.travel_m - LOOP_M + self.off_m),
            llrs=dict.fromkeys(range(self.objects), llr / self.objects),
            odometry_penalty=UNPREDICTED_PENALTY if place.predicted_by is None else 0.0,
        )
        return replace(found, place=place)

    def unmatched(self, query: Query, place: Place) -> FloatArray:
        return np.full(len(query.submap), -2.0)

    reach_m = 6.0
    track = SimpleNamespace(add=lambda keyframe: None)

    # Retriever.
    def index_inactive_landmarks(self, travel_m: float) -> None:
        pass

    def propose(self, query: Submap, *, before_m: float) -> list[Place]:
        self.retrieved += 1
        return self.places

    def reference_submap(self, place: Place, *, before_m: float) -> Submap:
        return make_query(self.keyframes[0], 1).submap

    # Accepted closures.
    def is_localized(self, keyframe: Keyframe) -> bool:
        return self.is_connected

    def add(self, candidate: Candidate) -> LoopClosureRecord:
        assert candidate.query.id not in self.closed
        self.closed[candidate.query.id] = candidate.reference.id
        return candidate.record(Stage.ACCEPTED, "")

    def revoke_since(self, keyframe: Keyframe, since: int) -> tuple[list[LoopClosureRecord], bool]:
        return [], True

    # Continuity monitor.

    def update(self, *arguments: Any) -> float | None:
        return self.kidnapped_after_m

    def restart(self) -> None:
        pass


class Map:
    """An object map of landmarks of the segment 1, seen from the beginning."""

    def __init__(self) -> None:
        self.rows = np.zeros(1000, dtype=LANDMARK)
        self.rows["segment"] = 1
        self.rows["first_seen_travel_m"] = 1e9


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> Parts:
    parts = Parts()
    for name in ("Verifier", "PlaceRetriever", "AcceptedClosures", "ContinuityMonitor"):
        monkeypatch.setattr(module, name, lambda *_, **__: parts)
    monkeypatch.setattr(module, "recent_submap", parts.recent_submap)
    monkeypatch.setattr(
        module,
        "recent_submap_with_unconfirmed",
        lambda *_: make_query(parts.keyframes[0], parts.objects + parts.unconfirmed).submap,
    )
    return parts


class Drive:
    """Along a street that was driven before, or that a prior map has."""

    def __init__(self, parts: Parts, *, prior: bool = False, **settings: Any) -> None:
        self.parts = parts
        self.keyframes: list[Keyframe] = [make_keyframe(0, 0.0, is_prior=prior)]
        if not prior:
            self.keyframes += [make_keyframe(number, STEP_M * number) for number in range(1, FIRST)]
        parts.keyframes = self.keyframes
        config = Config.model_validate({"loop_closure": settings})
        self.map = Map()
        self.closer = LoopCloser(config, self.map, SimpleNamespace(pose=None, observed_positions=None), self.keyframes)  # type: ignore[arg-type]
        self.prior = prior
        self.lost_after_m: float | None = None

    def close(self, number: int, *, segment: int | None = None) -> list[LoopClosureRecord]:
        own = 1 if self.prior else 0
        keyframe = make_keyframe(number, STEP_M * number, segment=own if segment is None else segment)
        while len(self.keyframes) < number:
            filler = len(self.keyframes)
            self.keyframes.append(make_keyframe(filler, STEP_M * filler, segment=own))
        self.keyframes.append(keyframe)
        outcome = self.closer.close(keyframe)
        self.lost_after_m = outcome.lost_after_m
        return outcome.records


def accepted(records: list[LoopClosureRecord]) -> dict[int, int | None]:
    """The accepted queries, and which closure predicted each."""
    return {record.query_keyframe_id: record.seed_query_keyframe_id for record in records if record.accepted}


def test_landmarks_of_an_earlier_traversal_are_no_part_of_a_query(parts):
    drive = Drive(parts)
    drive.map.rows["first_seen_travel_m"][[0, 3, 4]] = 10.0
    drive.close(FIRST)
    assert [query.submap.rows.tolist() for query in parts.queries] == [[1, 2, 5, 6, 7, 8, 9]]


def test_a_closure_predicts_no_keyframe_far_before_it(parts):
    drive = Drive(parts)
    numbers = FIRST, FIRST + 1, FIRST + 26
    parts.llrs = dict.fromkeys(numbers, TRACKED_LLR)
    drive.close(numbers[0])
    drive.close(numbers[1])
    parts.llrs[numbers[2]] = SURE_LLR
    assert accepted(drive.close(numbers[2])).keys() == {numbers[1], numbers[2]}


@pytest.mark.parametrize(("llr", "off_m"), [(WEAK_LLR, 0.0), (TRACKED_LLR, 5.0)])
def test_what_is_predicted_must_be_confirmed_and_agree(parts, llr, off_m):
    drive = Drive(parts)
    parts.llrs = {FIRST: SURE_LLR, FIRST + 1: llr}
    drive.close(FIRST)
    parts.off_m = off_m
    assert accepted(drive.close(FIRST + 1)) == {}


def test_a_closure_predicts_over_some_travel_only(parts):
    for off, expected in ((25, {FIRST + 25}), (26, set())):
        parts.closed.clear()
        parts.llrs = {FIRST: SURE_LLR, FIRST + off: TRACKED_LLR}
        drive = Drive(parts)
        drive.close(FIRST)
        assert accepted(drive.close(FIRST + off)).keys() == expected


def test_a_closure_predicts_those_before_it_that_are_not_closed(parts):
    parts.new_rows = 10
    drive = Drive(parts)
    for number in range(FIRST, FIRST + 4):
        parts.llrs[number] = TRACKED_LLR
        assert accepted(drive.close(number)) == {}
    parts.closed[FIRST + 1] = 1
    parts.llrs[FIRST + 4] = SURE_LLR
    found = accepted(drive.close(FIRST + 4))
    assert found.keys() == {FIRST, FIRST + 2, FIRST + 3, FIRST + 4}
    assert found[FIRST + 2] == FIRST + 3
    parts.llrs[FIRST + 5] = TRACKED_LLR
    assert accepted(drive.close(FIRST + 5)) == {FIRST + 5: FIRST + 4}


def test_query_of_a_tilted_body_is_upright(parts):
    drive = Drive(parts)
    T_local_body = pose_at(STEP_M * FIRST) @ motion_by([0.0, -0.17, 0.0]) @ motion_by([0.09, 0.0, 0.0])
    keyframe = make_keyframe(FIRST, STEP_M * FIRST, segment=0)
    drive.keyframes.append(keyframe)
    drive.closer.close(Keyframe(keyframe.id, keyframe.odometry, T_local_body))
    np.testing.assert_allclose([each.T_local_gravity for each in parts.queries], [pose_at(STEP_M * FIRST)], atol=1e-9)


def test_a_query_with_the_landmarks_of_the_last_one_is_not_looked_up_again(parts):
    drive = Drive(parts)
    parts.objects, parts.new_rows = 20, 1
    drive.close(FIRST)
    told = [(record.stage, record.reason) for record in drive.close(FIRST + 1)]
    assert (parts.retrieved, told) == (1, [("repeated", f"landmarks are those of keyframe {FIRST}")])
    drive.close(FIRST + 2)  # two others among twenty: 18 of 22
    assert parts.retrieved == 1
    drive.close(FIRST + 3)  # 17 of 23
    assert parts.retrieved == 2


def test_a_query_with_the_landmarks_of_the_last_one_is_looked_up_where_no_closure_will_predict_it(parts):
    drive = Drive(parts, propagation_distance_m=5.0)
    drive.close(FIRST)
    drive.close(FIRST + 2)
    assert parts.retrieved == 1
    drive.close(FIRST + 3)
    assert parts.retrieved == 2


def test_a_robot_that_got_lost_looks_up_what_it_had_looked_up_before(parts):
    drive = Drive(parts)
    drive.close(FIRST)
    drive.closer.declare_lost(drive.keyframes[-1], FIRST)
    drive.close(FIRST + 1)
    assert parts.retrieved == 2


def test_few_objects_close_no_loop(parts):
    drive = Drive(parts)
    parts.llrs = {FIRST: SURE_LLR}
    parts.objects = MIN_INLIERS - 1
    (record,) = drive.close(FIRST)
    assert record.reason == "2 landmarks in the submap, min_inliers is 3"
    parts.objects += 1
    parts.llrs[FIRST + 1] = SURE_LLR
    assert accepted(drive.close(FIRST + 1))


def test_unconfirmed_landmarks_are_used_only_where_the_confirmed_ones_do_not_suffice(parts):
    drive = Drive(parts)
    parts.places, parts.unconfirmed = [], 1
    drive.close(FIRST)
    assert parts.retrieved == 1
    parts.is_connected, parts.places, parts.llrs = False, [PLACE], {FIRST + 1: WEAK_LLR, FIRST + 2: SURE_LLR}
    drive.close(FIRST + 1, segment=3)
    assert parts.retrieved == 3
    drive.close(FIRST + 2, segment=3)
    assert parts.retrieved == 4


def test_at_the_beginning_there_is_no_loop_to_close(parts):
    parts.llrs = {40: SURE_LLR}
    drive = Drive(parts)
    del drive.keyframes[40:]
    assert drive.close(40) == []


# In a prior map


def start_in_map(parts: Parts) -> Drive:
    drive = Drive(parts, prior=True, min_travel_m=2.0 * RECENT_M)
    parts.llrs, parts.objects = {FIRST: SURE_LLR}, 12
    assert accepted(drive.close(FIRST)) == {FIRST: None}
    return drive


RECENT_M = 30.0
"""Travel on which landmarks must have come into view to speak against a place."""


def see(drive: Drive, count: int, first_seen_m: float, *, segment: int = 1) -> None:
    """All others for longer than the last sensor range of travel."""
    others_m = STEP_M * FIRST - 1.5 * RECENT_M
    drive.map.rows["first_seen_travel_m"] = np.where(np.arange(1000) < count, first_seen_m, others_m)
    drive.map.rows["segment"][:count] = segment


@pytest.mark.parametrize(("count", "is_lost"), [(10, False), (11, True)])
def test_who_sees_other_landmarks_than_the_map_has_is_lost(parts, count, is_lost):
    """Objects without a match in a place that may have changed, against one failure of the odometry in 1,000 km."""
    drive = start_in_map(parts)
    see(drive, count, STEP_M * FIRST)
    found = drive.close(FIRST + 1)
    assert ("expected landmarks not observed" in [record.reason for record in found]) is is_lost
    # The last sensor range of travel is in doubt.
    assert drive.lost_after_m == (STEP_M * (FIRST + 1) - RECENT_M if is_lost else None)


@pytest.mark.parametrize(("ago_m", "is_lost"), [(RECENT_M - 0.1, True), (RECENT_M, False)])
def test_landmarks_seen_for_long_do_not_speak_against_a_place(parts, ago_m, is_lost):
    drive = start_in_map(parts)
    see(drive, 20, STEP_M * (FIRST + 1) - ago_m)
    drive.close(FIRST + 1)
    assert (drive.lost_after_m is not None) is is_lost


def test_landmarks_that_were_merged_into_the_map_count_whenever_they_were_seen(parts):
    drive = start_in_map(parts)
    see(drive, 20, STEP_M * FIRST - 1.5 * RECENT_M, segment=0)
    drive.close(FIRST + 1)
    assert drive.lost_after_m is not None


def test_what_fits_at_the_predicted_place_does_not_lose_the_robot(parts):
    drive = start_in_map(parts)
    see(drive, 20, STEP_M * FIRST)
    parts.llrs[FIRST + 1] = WEAK_LLR
    drive.close(FIRST + 1)
    assert drive.lost_after_m is None
    parts.llrs[FIRST + 2] = -20.0
    drive.close(FIRST + 2)
    assert drive.lost_after_m is not None


def test_in_a_map_that_is_being_made_landmarks_may_be_missed(parts):
    drive = Drive(parts)
    parts.llrs, parts.objects = {FIRST: SURE_LLR}, 12
    drive.close(FIRST)
    see(drive, 20, STEP_M * FIRST, segment=0)
    drive.close(FIRST + 1)
    assert drive.lost_after_m is None


@pytest.mark.parametrize(("off_m", "is_lost"), [(5.9, False), (6.1, True)])
def test_a_closure_far_from_where_the_last_one_leads_is_a_kidnapping(parts, off_m, is_lost):
    parts.new_rows = 10
    drive = start_in_map(parts)
    parts.llrs[FIRST + 1], parts.off_m = SURE_LLR, off_m
    found = drive.close(FIRST + 1)
    assert bool(accepted(found)) is not is_lost
    assert (drive.lost_after_m is not None) is is_lost
    assert ("contradicts the odometry: kidnapped" in [record.reason for record in found]) is is_lost


def test_places_where_the_robot_is_said_not_to_be_are_left_out(parts):
    parts.new_rows = 10
    drive = Drive(parts, prior=True, min_travel_m=1.0)
    parts.llrs = {FIRST: SURE_LLR, FIRST + 1: SURE_LLR}
    drive.closer.initial_pose = InitialPose(np.array([5000.0, 0.0]), 10.0)
    (record,) = drive.close(FIRST)
    assert record.reason == "outside the prior of the pose"
    drive.closer.initial_pose = InitialPose(np.array([-300.0, 0.0]), 10.0)
    assert accepted(drive.close(FIRST + 1))


def test_a_place_of_another_segment_than_the_map_may_be_anywhere(parts):
    drive = Drive(parts, prior=True, min_travel_m=1.0)
    parts.llrs, parts.places = {FIRST: SURE_LLR}, [replace(PLACE, segment=2)]
    drive.closer.initial_pose = InitialPose(np.array([5000.0, 0.0]), 10.0)
    assert accepted(drive.close(FIRST))


def test_a_kidnapping_by_the_landmarks_in_view_loses_the_robot(parts):
    drive = Drive(parts)
    parts.llrs = {FIRST: SURE_LLR}
    parts.kidnapped_after_m = 12.0
    (record,) = drive.close(FIRST)
    assert record.reason.startswith("kidnapped")
    assert drive.lost_after_m == 12.0


def test_who_was_lost_follows_no_closure_from_before(parts):
    drive = start_in_map(parts)
    drive.closer.declare_lost(drive.keyframes[-1], FIRST)
    assert drive.lost_after_m is None
    parts.llrs[FIRST + 1] = TRACKED_LLR
    assert accepted(drive.close(FIRST + 1)) == {}
    parts.llrs[FIRST + 2] = SURE_LLR
    parts.closed.clear()
    assert FIRST not in accepted(drive.close(FIRST + 2))
