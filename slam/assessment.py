"""Reasons to doubt a finished map, for people: a way without landmarks, an odometry that tells little of the motion,
parts of the drive that nothing joins, closures that it contradicts, moving objects, and labels that may be identities
but have several landmarks.
"""

from collections.abc import Mapping

import numpy as np

from logs.messages import FactorGraphRecord, ObjectMapRecord
from slam.backend.edge_kind import EdgeKind
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import Calibration
from slam.common.geometry import pose_errors, relative, rotation_angle_rad, squared_mahalanobis
from slam.object_map.map_io import are_of_kind
from slam.object_map.map_validation import parts
from slam.trajectory_check.judgement import FINAL, ONLINE, TrajectoryCheck


def assess(
    graph: FactorGraphRecord,
    object_map: ObjectMapRecord,
    calibration: Calibration,
    counters: Mapping[str, int],
    check: TrajectoryCheck,
) -> tuple[str, ...]:
    """Reasons to doubt the map; none for a usual one.

    Args:
        graph: at the end of the drive.
        object_map: at the end of the drive.
        calibration: over a longer way than its sensor range without landmarks, none seen before is still in view.
        counters: those of the drive, with ``odometry_corrected`` and ``closures_inserted``.
        check: whether the final trajectory is the best.
    """
    moved = object_map.reasons.count("moving")
    share = moved / max(moved + object_map.states.count("confirmed"), 1)
    moving = f"{100.0 * share:.0f} % of the objects seem to move: landmarks may be wrong; check classes and stamps"
    doubts = (
        _unobserved(graph, calibration.detection.sensor_range_m),
        *_unexplained(graph, calibration.detection.sensor_range_m),
        _parted(graph),
        _contradicted(graph),
        moving if share >= 0.25 else "",
        _doubled(object_map, calibration),
        explain(check, share, counters, calibration),
    )
    return tuple(filter(None, doubts))


def diagnose_uncorrected(graph: FactorGraphRecord, counters: Mapping[str, int]) -> str:
    """Reasons why neither landmarks nor closures correct the odometry; empty if they do.

    Args:
        graph: at the end of the drive.
        counters: those of the drive, with ``objects_used``.
    """
    if len(graph.observation_keyframe_ids) or EdgeKind.LOOP_CLOSURE in graph.edge_kinds:
        return ""
    if counters.get("objects_used"):
        return "no landmark was confirmed; check the frames of the detections and the stamps"
    if outside := counters.get("detections_without_odometry"):
        return f"no scan is within the time of the odometry ({outside} are not); check that both have the same clock"
    return "no scan has an object"


def _unobserved(graph: FactorGraphRecord, sensor_range_m: float) -> str:
    """A long way without landmarks; empty where there is none."""
    if not len(graph.observation_keyframe_ids):
        return ""  # see diagnose_uncorrected
    ends, _ = _driven(graph)
    positions = graph.T_map_body[:, :3, 3]
    # Discontinuities and the keyframes of a fixed prior map add nothing.
    steps_m = np.zeros(len(positions))
    steps_m[ends.max(axis=1)] = np.linalg.norm(np.diff(positions[ends], axis=1), axis=2)[:, 0]
    travel_m = np.cumsum(steps_m)
    keyframes = np.searchsorted(graph.keyframe_ids, graph.observation_keyframe_ids)
    # Two landmarks fix the position and the heading of a keyframe in the plane.
    observed = np.bincount(keyframes, minlength=len(travel_m)) >= 2
    ways_m = np.diff(np.concatenate([[0.0], travel_m[observed], travel_m[-1:]]))
    share = ways_m[ways_m > sensor_range_m].sum() / max(travel_m[-1], 1e-9)
    if share < 0.1:
        return ""
    return (
        f"fewer than two landmarks in view over {100.0 * share:.0f} % of the way: only the odometry constrains it there"
    )


def _unexplained(graph: FactorGraphRecord, sensor_range_m: float) -> list[str]:
    """Translations or rotations that the odometry lacks, as one that holds orientations or positions only: the sum of
    its errors between keyframes is compared with the sum of the motion, by the final trajectory.
    """
    ends, measured = _driven(graph)
    if not len(ends):
        return []
    poses = graph.T_map_body
    moved = relative(*poses[ends.T])
    lengths_m, angles = np.linalg.norm(moved[:, :3, 3], axis=1), rotation_angle_rad(moved)
    errors_m = np.abs(lengths_m - np.linalg.norm(measured[:, :3, 3], axis=1))
    turned = rotation_angle_rad(relative(poses[ends[0, 0]], poses)).max()
    # Where there is little motion, noise is most of it.
    compared = {
        "translations": (errors_m, lengths_m, lengths_m.sum() > sensor_range_m, "positions"),
        "rotations": (rotation_angle_rad(relative(measured, moved)), angles, turned > 0.25, "orientations"),
    }
    # An odometry that errs by more than half of the motion tells little of it; that of wheels errs by a tenth.
    return [
        f"the {what} of the odometry are off by {100.0 * errors.sum() / motion.sum():.0f} % of those that landmarks "
        f"show; does it hold {held}?"
        for what, (errors, motion, is_much, held) in compared.items()
        if is_much and errors.sum() > 0.5 * motion.sum()
    ]


def _parted(graph: FactorGraphRecord) -> str:
    """Parts of a drive between which the odometry broke off, and that neither closures nor landmarks join, or empty."""
    is_break = are_of_kind(graph, EdgeKind.DISCONTINUITY)
    # A landmark joins all keyframes that saw it with the first of these.
    _, first, landmark = np.unique(graph.observation_landmark_ids, return_index=True, return_inverse=True)
    observers = graph.observation_keyframe_ids
    by_landmarks = np.column_stack([observers, observers[first[landmark]]])
    part = parts(graph.keyframe_ids, np.concatenate([graph.edge_keyframe_ids[~is_break], by_landmarks]))
    ends = np.searchsorted(graph.keyframe_ids, graph.edge_keyframe_ids[is_break])
    count = len(np.unique(part[ends]))
    if count < 2:
        return ""
    return f"the drive is in {count} parts: the odometry broke off, and neither closures nor landmarks join them"


def _contradicted(graph: FactorGraphRecord) -> str:
    """Closures that the final trajectory all but leaves out, beyond ten standard deviations, or empty."""
    is_closure = are_of_kind(graph, EdgeKind.LOOP_CLOSURE)
    ends = np.searchsorted(graph.keyframe_ids, graph.edge_keyframe_ids[is_closure])
    errors = pose_errors(graph.edge_transforms[is_closure], relative(*graph.T_map_body[ends.T]))
    count = np.count_nonzero(squared_mahalanobis(errors, graph.edge_covariances[is_closure]) > 100.0)
    if count < 0.1 * max(len(ends), 1):
        return ""
    return (
        f"the final trajectory contradicts {count} of {len(ends)} closures in the graph: the odometry slipped between "
        "two visits, or they are false"
    )


def _doubled(object_map: ObjectMapRecord, calibration: Calibration) -> str:
    """Labels that have several landmarks although no scan has two objects of one label, or empty."""
    if calibration.objects.spacing_m <= 2.0 * calibration.detection.farthest_m:  # so far apart are objects of a scan
        return ""
    _, counts = np.unique(object_map.classes[object_map.is_confirmed], return_counts=True)
    doubled = np.count_nonzero(counts > 1)
    if doubled < 0.25 * max(len(counts), 1):
        return ""
    return (
        f"{doubled} of {len(counts)} labels have several landmarks, but no scan has two objects of one: if labels are "
        "identities, the robot was lost"
    )


def _driven(graph: FactorGraphRecord) -> tuple[IntArray, FloatArray]:
    """The rows (E, 2) of the keyframes between which the odometry measured T_from_to (E, 4, 4)."""
    is_driven = are_of_kind(graph, EdgeKind.ODOMETRY)
    return np.searchsorted(graph.keyframe_ids, graph.edge_keyframe_ids[is_driven]), graph.edge_transforms[is_driven]


def explain(check: TrajectoryCheck, moving_share: float, counters: Mapping[str, int], calibration: Calibration) -> str:
    """A warning with the likely reason if another trajectory is better than the final one; else empty.

    Args:
        check: of the trajectories.
        moving_share: share of the objects that seem to have moved.
        counters: those of the drive, with ``odometry_corrected`` and ``closures_inserted``.
        calibration: by which the map was built.
    """
    if check.better is None:
        return ""
    name = "online estimate" if check.better == ONLINE else "odometry alone"
    gained = check.gains[check.better] - check.gains[FINAL]
    detection, spacing_m = calibration.detection, calibration.objects.spacing_m
    across_m = detection.base_sigma_m + detection.sigma_per_m * detection.sensor_range_m
    sigma_m = across_m * max(detection.range_sigma_ratio, 1.0)
    corrected = counters.get("odometry_corrected", 0)
    signs = {
        # Objects that are closer together than four standard deviations of a detection are confused.
        f"objects of a class are {spacing_m:.1f} m apart, and detections at the sensor range err by {sigma_m:.1f} m": (
            spacing_m < 4.0 * sigma_m
        ),
        # More than what is moved between two drives.
        f"{100.0 * moving_share:.0f} % of the objects seem to move": moving_share > 0.1,
        f"they corrected the odometry {corrected} times": corrected > 0,
    }
    if reason := "; ".join(sign for sign, is_seen in signs.items() if is_seen):
        reason = f"detections were probably assigned to wrong landmarks: {reason}"
    elif counters.get("closures_inserted"):
        reason = f"some of the {counters['closures_inserted']} closures in the graph are probably false"
    else:
        reason = "no closure corrects it; check the stamps, the frames and the calibration of the detections"
    return (
        f"the {name} is better than the final trajectory: it predicts detections on other visits better by "
        f"{gained:.1f} nats; {reason}"
    )
