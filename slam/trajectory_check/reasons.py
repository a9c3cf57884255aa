"""Likely reasons why the final trajectory of a drive is worse than another one."""

from __future__ import annotations

from collections.abc import Mapping

from slam.common.calibration import Calibration
from slam.trajectory_check.judgement import FINAL, ONLINE, TrajectoryCheck


def explain(
    check: TrajectoryCheck, moving_share: float, counters: Mapping[str, int], calibration: Calibration
) -> tuple[str, ...]:
    """A warning with the likely reason if another trajectory is better than the final one; else nothing.

    Args:
        check: of the trajectories.
        moving_share: share of the objects that seem to have moved.
        counters: those of the drive, with ``odometry_corrected`` and ``closures_inserted``.
        calibration: by which the map was built.
    """
    if check.better is None:
        return ()
    name = "online estimate" if check.better == ONLINE else "odometry alone"
    gained = check.gains[check.better] - check.gains[FINAL]
    reason = "; ".join(_signs_of_confusion(moving_share, counters, calibration))
    if reason:
        reason = f"detections were probably assigned to wrong landmarks: {reason}"
    elif counters.get("closures_inserted"):
        reason = f"some of the {counters['closures_inserted']} closures in the graph are probably false"
    else:
        reason = "no closure corrects it; check the stamps, the frames and the calibration of the detections"
    return (
        f"the {name} is better than the final trajectory: it predicts detections on other visits better by "
        f"{gained:.1f} nats; {reason}",
    )


def _signs_of_confusion(moving_share: float, counters: Mapping[str, int], calibration: Calibration) -> list[str]:
    signs = []
    detection, spacing_m = calibration.detection, calibration.objects.spacing_m
    across_m = detection.base_sigma_m + detection.sigma_per_m * detection.sensor_range_m
    sigma_m = across_m * max(detection.range_sigma_ratio, 1.0)
    # Objects that are closer together than four standard deviations of a detection are confused.
    if spacing_m < 4.0 * sigma_m:
        signs.append(
            f"objects of a class are {spacing_m:.1f} m apart, and detections at the sensor range err by {sigma_m:.1f} m"
        )
    if moving_share > 0.1:  # more than what is moved between two drives
        signs.append(f"{100.0 * moving_share:.0f} % of the objects seem to move")
    if corrected := counters.get("odometry_corrected"):
        signs.append(f"they corrected the odometry {corrected} times")
    return signs
