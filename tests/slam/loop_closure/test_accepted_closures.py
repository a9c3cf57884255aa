"""Accepted closures and the factors that represent them: both go together."""

import numpy as np
import pytest

from slam.backend.factors import Edge
from slam.common.calibration import ObjectCalibration
from slam.common.config import Config
from slam.loop_closure.accepted_closures import AcceptedClosures
from slam.loop_closure.candidate import Candidate
from slam.object_map.landmarks import ObjectMap
from tests.helpers.candidates import make_candidate
from tests.helpers.graphs import chained, odometry_edges
from tests.helpers.poses import pose_at
from tests.slam.loop_closure.doubles import make_keyframe

STEP_M = 2.0
ROUND = 90
"""Keyframes of the first round, of which the second one is the same."""


class Drive:
    """A street driven twice, without objects; the second round may be another segment of the odometry."""

    def __init__(self, *, second_segment: int = 0) -> None:
        self.keyframes = [
            make_keyframe(number, STEP_M * number, segment=second_segment if number >= ROUND else 0)
            for number in range(ROUND + 30)
        ]
        T = np.array([each.T_local_body for each in self.keyframes])
        self.graph = chained(T[0], odometry_edges(T, np.diag(np.repeat([1e-6, 1e-2], 3))))
        self.closures = AcceptedClosures(Config(), ObjectMap(ObjectCalibration()), self.graph, self.keyframes)
        self.graph.update()

    def accept(self, query: int, *, reference: int | None = None) -> None:
        self.closures.add(self.candidate(query, reference=reference))

    def candidate(self, query: int, *, reference: int | None = None) -> Candidate:
        return make_candidate(
            query=self.keyframes[query],
            reference=self.keyframes[query - ROUND if reference is None else reference],
            T_reference_query=pose_at(STEP_M * ROUND),
            T_local_query=pose_at(STEP_M * query),
        )

    def declare_lost(self, since: int) -> list[int]:
        records, _ = self.closures.revoke_since(self.keyframes[-1], since)
        assert not any(record.accepted or record.inserted for record in records)
        return sorted(record.query_keyframe_id for record in records)

    def condense_95(self) -> None:
        """Let the factor of the closure of that query be condensed."""
        self.graph.remove_factors([self.factors[95]])
        self.closures.forget_condensed()

    @property
    def closed(self) -> list[int]:
        return list(self.closures.closed)

    @property
    def factors(self) -> dict[int, int]:
        """The factor of each closure that has one, by its query."""
        factors = self.graph.factors.items()
        return {f.to_keyframe: n for n, f in factors if isinstance(f, Edge) and f.kind == "closure"}


@pytest.fixture
def street() -> Drive:
    return Drive()


def test_a_closure_leaves_the_map_with_the_factor_that_represents_it(street):
    street.accept(100)
    street.accept(99)
    assert list(street.factors) == [100]
    assert street.declare_lost(since=100) == [99, 100]
    assert street.factors == {}
    assert street.closed == []


def test_a_closure_that_is_inconsistent_goes_although_its_factor_stays(street):
    street.accept(99)
    street.accept(100)
    assert list(street.factors) == [99]
    assert street.declare_lost(since=100) == [100]
    assert list(street.factors) == [99]
    assert street.closed == [99]


def test_who_was_relocalized_lately_was_never_there():
    street = Drive(second_segment=1)
    street.accept(91)
    street.accept(118)
    records, is_kidnapped = street.closures.revoke_since(street.keyframes[-1], 118)
    assert not is_kidnapped
    assert sorted(record.query_keyframe_id for record in records) == [91, 118]
    assert street.closed == []


def test_who_was_relocalized_long_ago_was_carried_off():
    street = Drive(second_segment=1)
    street.accept(ROUND)
    late = make_keyframe(street.keyframes[-1].id, STEP_M * ROUND + 61.0, segment=1)
    assert street.closures.revoke_since(late, 118) == ([], True)
    assert street.closed == [ROUND]


def test_keyframes_are_localized_where_a_closure_connects_their_segment_with_the_map():
    alone = Drive(second_segment=1)
    first = [each.odometry.segment for each in alone.keyframes].index(1)
    assert list(map(alone.closures.is_localized, alone.keyframes)).index(False) == first
    alone.accept(118, reference=1)
    assert all(map(alone.closures.is_localized, alone.keyframes))


def test_a_condensed_closure_is_part_of_the_map_for_good(street):
    street.accept(95)
    street.accept(94)
    street.accept(110)
    street.condense_95()
    assert street.closed == [95, 94, 110]
    assert street.declare_lost(since=0) == [110]
    assert street.closed == [95, 94]


def test_segments_stay_connected_by_a_condensed_closure():
    street = Drive(second_segment=1)
    street.accept(95)
    assert street.closures.is_localized(street.keyframes[95])
    street.condense_95()
    street.accept(110)
    street.closures.revoke_since(make_keyframe(street.keyframes[-1].id, STEP_M * 95 + 61.0, segment=1), 110)
    assert street.closures.is_localized(street.keyframes[95])


def test_closures_are_settled_once_a_relocalization_would_no_longer_be_revoked():
    trusted_m = 60.0
    street = Drive()
    street.accept(110)
    assert street.closures.settled_before_m(1000.0) == 1000.0 - trusted_m
    street = Drive(second_segment=1)
    street.accept(110)
    relocalized_m = STEP_M * 110
    assert street.closures.settled_before_m(relocalized_m + trusted_m - 1.0) == -np.inf
    assert street.closures.settled_before_m(relocalized_m + trusted_m + 1.0) == relocalized_m + 1.0
