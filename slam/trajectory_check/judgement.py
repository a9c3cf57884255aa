"""Comparison of the trajectories of a drive by their prediction of detections from those of other visits.

The final trajectory was fitted to all detections, so the judgement favours it: where another one predicts better, the
data association or the closures of the final one have failed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import stdtrit

from logs.messages import TrajectoryRecord
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import Calibration
from slam.common.geometry import interpolate, relative
from slam.frontend.tracker import Tracked
from slam.odometry.pose import OdometryPose
from slam.trajectory_check.prediction import SampledScan, VisitPredictor

ODOMETRY, ONLINE, FINAL = "odometry", "online", "final"
MAX_DETECTIONS = 2**15
"""Detections that are kept, so that the memory of a long drive is bounded: 2 MB."""


@dataclass(frozen=True, slots=True)
class TrajectoryCheck:
    """Comparison of the trajectories of a drive by detections on several visits to the same places.

    ``gains``: by trajectory, mean logarithm of the density that it predicts for a detection beside the density in the
    field of view, in nats; above 0 it predicts better than chance. Empty if none predicts better than chance, as where
    the drive comes nowhere twice. ``better``: the trajectory that predicts significantly better than the final one, the
    best if several do; None where none does. ``detections``: how many were predicted.
    """

    gains: Mapping[str, float] = field(default_factory=dict)
    better: str | None = None
    detections: int = 0

    def __str__(self) -> str:
        if not self.gains:
            return "cannot tell which trajectory is best: no place was recognised on a second visit"
        gains = ", ".join(f"{name} {gain:.2f}" for name, gain in self.gains.items())
        return (
            f"{f'the {self.better}' if self.better else 'none'} is significantly better than the final one; gain over "
            f"chance in predicting detections on other visits, in nats per detection: {gains}"
        )


def check_trajectories(
    scans: tuple[SampledScan, ...], trajectories: Mapping[str, FloatArray], *, sensor_range_m: float, sigma_m: float
) -> TrajectoryCheck:
    """Judge the trajectories (N, 4, 4), each of all N ``scans``; one of them is ``FINAL``.

    ``sigma_m``: by how much the position of an object differs between two visits.
    """
    # Evenly spread over the drive; more would tell hardly more.
    queries = np.unique(np.linspace(0, len(scans) - 1, min(256, len(scans))).astype(np.int64))
    predictor = VisitPredictor(scans, sensor_range_m=sensor_range_m, sigma_m=sigma_m)
    predictions = {name: predictor.predict(T, queries) for name, T in trajectories.items()}
    counts = np.max([counts for _, counts in predictions.values()], axis=0)
    blocks = np.unique([int(scans[query].travel_m / sensor_range_m) for query in queries], return_inverse=True)[1]
    if len(np.unique(blocks[counts > 0])) < 4:  # their scatter gives the significance
        return TrajectoryCheck()
    gains = {name: float(sums.sum() / counts.sum()) for name, (sums, _) in predictions.items()}
    if max(gains.values()) <= 0.0:
        return TrajectoryCheck()
    better = [
        name
        for name, (sums, _) in predictions.items()
        if gains[name] > 0.0 and _is_better(sums - predictions[FINAL][0], counts, blocks)
    ]
    return TrajectoryCheck(gains, max(better, key=gains.__getitem__, default=None), int(counts.sum()))


def _is_better(differences: FloatArray, counts: IntArray, blocks: IntArray) -> bool:
    """Whether the mean of the differences (Q,) by the counts (Q,) of detections is more than chance makes.

    Scans of one block (Q,), a part of the way as long as the sensor range, err together, so the test is a one-sided
    t-test over the blocks, at a level of 0.1 %. A density that is less than a tenth higher is not worth a report.
    """
    of_block = np.bincount(blocks, counts)
    informative = of_block > 0
    advantage = differences.sum() / counts.sum()
    residuals = (np.bincount(blocks, differences) - advantage * of_block)[informative]
    degrees = len(residuals) - 1
    sigma = np.sqrt((residuals**2).sum() * (degrees + 1) / degrees) / counts.sum()
    return bool(advantage > max(0.1, float(stdtrit(degrees, 0.999)) * sigma))


class DriveCheck:
    """Samples the scans of a drive evenly, and judges its trajectories by them at the end.

    All scans are kept; every second one once they hold ``MAX_DETECTIONS``, and so on.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._sensor_range_m = calibration.detection.sensor_range_m
        self._sigma_m = calibration.objects.landmark_sigma_m
        self._stride, self._offered = 1, 0
        self._scans: list[SampledScan] = []
        self._detections = 0  # in these scans

    def add(self, tracked: Tracked, pose: OdometryPose, T_map_body: FloatArray) -> None:
        """Take the next scan with detections if it is due, at a ``pose`` that it has not corrected, and where that was
        in the map at its time.
        """
        positions, T_odom_body = tracked.scan.positions, relative(pose.T_odom_reported, pose.T_odom_body)
        if not len(positions):
            return
        if self._offered % self._stride == 0:
            scan = SampledScan(pose.stamp_ns, positions, tracked.labels, pose.travel_m, T_odom_body, T_map_body)
            self._scans.append(scan)
            self._detections += len(positions)
            while self._detections > MAX_DETECTIONS and len(self._scans) > 1:
                del self._scans[1::2]
                self._stride *= 2
                self._detections = sum(len(kept.positions) for kept in self._scans)
        self._offered += 1

    def judge(self, final: TrajectoryRecord) -> TrajectoryCheck:
        """Judge the odometry, the online estimate and the final trajectory."""
        first_ns, last_ns = final.stamps_ns[[0, -1]].tolist()
        scans = tuple(scan for scan in self._scans if first_ns <= scan.stamp_ns <= last_ns)
        if not scans:
            return TrajectoryCheck()
        trajectories = {
            ODOMETRY: np.stack([scan.T_odom_body for scan in scans]),
            ONLINE: np.stack([scan.T_online_body for scan in scans]),
            FINAL: interpolate(final.stamps_ns, final.T_map_body, np.array([scan.stamp_ns for scan in scans])),
        }
        return check_trajectories(scans, trajectories, sensor_range_m=self._sensor_range_m, sigma_m=self._sigma_m)
