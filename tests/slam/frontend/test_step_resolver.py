"""Unexpected steps are decided by the first scan that tells the ways to go on apart."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from logs.messages import ObjectDetections
from slam.frontend.scan_alignment import Alignment
from slam.frontend.step_resolver import Resolution, StepResolver
from slam.odometry.unexpected_step import Continuation
from tests.slam.odometry.test_unexpected_step import driven, message

CLEAR, UNCLEAR = 50.0, 0.0


@dataclass
class Placer:
    """Places all detections but those of an unknown frame."""

    def place(self, detections, pose):
        return None if detections.frame_id == "unknown" else detections


@dataclass
class Mapper:
    """Says of each scan what its test wants."""

    ratios: dict[int, float]
    can_align_scans: bool = True
    keyframes: tuple[str, ...] = ("one",)
    asked: list[int] = field(default_factory=list)

    def log_likelihood_ratio(self, scan, pose):
        self.asked.append(scan.stamp_ns)
        return -CLEAR

    def can_align(self, tolerances):
        return self.can_align_scans

    def align(self, scan, pose, tolerances):
        return Alignment(np.eye(4), np.ones(2), self.ratios[scan.stamp_ns])


def scans(*steps: float, frame_id: str = "sensor", objects: int = 1) -> list[tuple[int, ObjectDetections]]:
    stamps = [int(10**9 + step * 10**8) for step in steps]
    return [
        (at, ObjectDetections(at, frame_id, np.zeros((objects, 3)), ("tree",) * objects, np.ones(objects), None))
        for at in stamps
    ]


def jump(until: int = 102):
    track, _ = driven()
    for step in range(100, until):
        track.add(message(step, aside_m=100.0))
    return track.unexpected


def frozen():
    track, _ = driven()
    for step in (100, 101):
        track.add(replace(message(step), T_odom_body=message(99).T_odom_body))
    return track.unexpected


def test_the_expected_pose_comes_with_its_correction():
    waiting = scans(100.5)
    found = StepResolver(Mapper({waiting[0][0]: CLEAR}), Placer()).resolve(jump(until=106), waiting)
    assert found.continuation is Continuation.EXPECTED
    np.testing.assert_array_equal(found.correction.variances, np.ones(2))


def test_where_scans_cannot_be_aligned_the_expected_pose_is_not_tried():
    waiting, step = scans(100.5), jump(until=106)
    found = StepResolver(Mapper({}, can_align_scans=False), Placer()).resolve(step, waiting)
    assert found == Resolution(step.default)


def test_a_scan_that_does_not_tell_is_not_judged_again():
    waiting, step = scans(100.2, 100.8), frozen()
    unclear = {at: UNCLEAR - CLEAR for at, _ in waiting}
    mapper = Mapper(unclear)
    resolver = StepResolver(mapper, Placer())
    assert resolver.resolve(step, waiting[:1]) is None
    assert resolver.resolve(step, waiting) is None
    assert mapper.asked == [at for at, _ in waiting]


def test_scans_outside_the_step_empty_or_out_of_place_are_passed_over():
    mapper = Mapper({})
    resolver, step = StepResolver(mapper, Placer()), jump()
    for waiting in (scans(90.0, 103.0), scans(100.5, objects=0), scans(100.5, frame_id="unknown")):
        assert resolver.resolve(step, waiting) is None
    assert mapper.asked == []


def test_a_step_for_which_no_scan_comes_is_decided_by_default():
    step = jump(until=400)
    assert step.is_overdue
    assert StepResolver(Mapper({}), Placer()).resolve(step, []) == Resolution(step.default)
