"""How the odometry goes on at a step that was not to be expected, by the scans that follow it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from logs.messages import ObjectDetections
from slam.frontend.continuity import decide
from slam.frontend.input.scan import Scan
from slam.frontend.input.scan_placer import ScanPlacer
from slam.frontend.mapper import Mapper
from slam.odometry.unexpected_step import Continuation, Correction, UnexpectedStep


@dataclass(frozen=True, slots=True)
class Resolution:
    """How the odometry goes on, and what the detections say of the pose that was expected."""

    continuation: Continuation
    correction: Correction | None = None


class StepResolver:
    """Decides at unexpected steps by the first scan that tells the ways to go on apart."""

    def __init__(self, mapper: Mapper, placer: ScanPlacer) -> None:
        self._mapper = mapper
        self._placer = placer
        self._judged_ns = -1

    def resolve(self, step: UnexpectedStep, scans: Iterable[tuple[int, ObjectDetections]]) -> Resolution | None:
        """How the odometry goes on at ``step``; None while scans that tell are to come.

        ``scans``: those that wait, with their times [ns], ascending; none is judged twice.
        """
        first_ns, last_ns = step.span_ns
        for stamp_ns, detections in scans:
            if not max(first_ns, self._judged_ns + 1) <= stamp_ns <= last_ns or not self._mapper.keyframes:
                continue
            scan = None
            if len(detections.positions):
                scan = self._placer.place(detections, step.at(stamp_ns)[Continuation.REPORTED])
            if scan is None:
                continue
            found = self._judge(step, scan, stamp_ns)
            if found is not None:
                self._judged_ns = -1
                return found
            self._judged_ns = stamp_ns
        if not step.is_overdue:
            return None
        self._judged_ns = -1
        return Resolution(step.default)

    def _judge(self, step: UnexpectedStep, scan: Scan, stamp_ns: int) -> Resolution | None:
        """What one scan says of the ways to go on; None if it does not tell them apart."""
        poses = step.at(stamp_ns)
        ratios = {Continuation.REPORTED: self._mapper.log_likelihood_ratio(scan, poses[Continuation.REPORTED])}
        correction = None
        if Continuation.EXPECTED in poses and self._mapper.can_align(step.tolerances):
            expected = replace(poses[Continuation.REPORTED], T_odom_body=poses[Continuation.EXPECTED].T_odom_body)
            aligned = self._mapper.align(scan, expected, step.tolerances)
            ratios[Continuation.EXPECTED] = aligned.log_likelihood_ratio
            correction = Correction(aligned.T_correction, aligned.variances)
        way = decide(step, ratios)
        if way is None:
            return None
        return Resolution(way, correction if way is Continuation.EXPECTED else None)
