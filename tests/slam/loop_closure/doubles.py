"""What stands in for a verifier where the rules of acceptance are tested without a drive."""

from dataclasses import replace

import numpy as np

from slam.common.arrays import FloatArray
from slam.loop_closure.candidate import Candidate, Query
from slam.object_map.submap import Submap
from slam.odometry.keyframe import Keyframe
from tests.helpers.poses import keyframe_at, pose_at


def make_keyframe(number: int, travel_m: float, *, segment: int = 0, is_prior: bool = False) -> Keyframe:
    """A keyframe ``travel_m`` along the street."""
    return keyframe_at(pose_at(travel_m), number, travel_m=travel_m, segment=segment, is_prior=is_prior)


def make_submap(positions: FloatArray, *, first_row: int = 0) -> Submap:
    """Landmarks at ``positions`` (N, 3) m, of one class."""
    count = len(positions)
    rows = np.arange(first_row, first_row + count)
    return Submap(np.asarray(positions, float).reshape(-1, 3), np.full(count, 0.3), np.zeros(count, int), rows)


def make_query(keyframe: Keyframe, count: int = 0, *, first_row: int = 0) -> Query:
    """A query with so many objects."""
    submap = make_submap(np.zeros((count, 3)))
    before_m = keyframe.odometry.travel_m - 100.0
    return Query(keyframe, replace(submap, rows=submap.rows + first_row), keyframe.T_local_body, before_m)


class Patterns:
    """A verifier that knows of other poses at which the same objects fit."""

    def __init__(self) -> None:
        self.alike: list[Candidate] = []

    def rivals(self, query: Query, candidate: Candidate) -> list[Candidate]:
        return self.alike
