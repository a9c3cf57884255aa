"""Faults of what a sensor measures, misses and invents: positions, covariances, labels, wrong extrinsics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from logs.messages import ObjectDetections
from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.common.geometry import apply, invert, make_transform
from slam.simulation.faults.fault import Degrees, Duration, Factor, Metres, Share, Sigma, fault
from slam.simulation.faults.recording import Recording, join_detections, move_detections, take_detections

FALSE_POSITIVE_RANGE_PERCENTILE = 95.0
"""False positives lie within the range that holds so many per cent of the log's detections."""

_Angle = Annotated[float, Field(gt=0.0, le=360.0, description="deg")]
_Reach = Annotated[float, Field(gt=0.0, allow_inf_nan=False, description="m")]
_PerScan = Annotated[float, Field(ge=0.0, le=1000.0, description="number")]
_Claimed = Annotated[float, Field(ge=1e-9, le=1e3, description="m")]


@fault()
def position_noise(log: Recording, sigma_m: Sigma = 1.0, *, rng: np.random.Generator) -> Recording:
    """Positions have M more noise on each axis, and known covariances contain it."""

    def alter(seen: ObjectDetections) -> ObjectDetections:
        if seen.covariances is None:
            return seen
        is_known = np.any(seen.covariances != 0.0, axis=(1, 2))
        return replace(seen, covariances=seen.covariances + (is_known * sigma_m**2)[:, None, None] * np.eye(3))

    noisy: Recording = unreported_noise.function(log, sigma_m, rng=rng)
    return noisy.with_detections(alter)


@fault()
def unreported_noise(log: Recording, sigma_m: Sigma = 1.0, *, rng: np.random.Generator) -> Recording:
    """Positions have M of noise on each axis that no covariance contains."""
    return _moved(log, lambda seen: seen.positions + sigma_m * rng.standard_normal(seen.positions.shape))


@fault()
def dropout(log: Recording, probability: Share = 0.3, *, rng: np.random.Generator) -> Recording:
    """Each detection is lost with a probability."""
    return log.select_detections(lambda seen: rng.random(len(seen.labels)) >= probability)


@fault()
def field_of_view(log: Recording, angle_deg: _Angle = 180.0) -> Recording:
    """The sensor has a field of view of DEG, centred ahead."""
    from_sensor = _from_sensor(log)
    limit_rad = 0.5 * np.deg2rad(angle_deg)
    return log.select_detections(lambda seen: np.abs(np.arctan2(*from_sensor(seen).T[1::-1])) <= limit_rad)


@fault()
def max_range(log: Recording, range_m: _Reach = 20.0) -> Recording:
    """The sensor has a horizontal range of M."""
    from_sensor = _from_sensor(log)
    return log.select_detections(lambda seen: np.linalg.norm(from_sensor(seen)[:, :2], axis=1) <= range_m)


@fault()
def keep_label(log: Recording, *labels: str) -> Recording:
    """Only objects of these classes are detected."""
    _refuse_unknown(log, labels)
    return log.select_detections(lambda seen: np.isin(seen.labels, labels))


@fault()
def drop_label(log: Recording, *labels: str) -> Recording:
    """Objects of these classes are not detected."""
    _refuse_unknown(log, labels)
    if set(log.labels) == set(labels):
        raise SimulationError(f"no label is left; the labels of the log are {', '.join(log.labels)}")
    return log.select_detections(lambda seen: ~np.isin(seen.labels, labels))


@fault()
def false_positives(log: Recording, mean: _PerScan = 10.0, *, rng: np.random.Generator) -> Recording:
    """NUMBER false objects a scan are added on average.

    They are evenly spread over the range and the bearings of the log's detections, and have heights, labels, scores,
    sizes and covariances of detections drawn from the log.
    """
    from_sensor, frames = _from_sensor(log), log.bearing_frames()
    seen = [replace(scan.detections, positions=from_sensor(scan.detections)) for scan in log.scans]
    if not any(each.labels for each in seen):
        raise SimulationError("no detection is in view, so false positives cannot be modelled; widen the field of view")
    donors = join_detections(*seen)
    x, y, _ = donors.positions.T
    reach_m = np.percentile(np.hypot(x, y), FALSE_POSITIVE_RANGE_PERCENTILE)
    bearings = np.arctan2(y, x)
    changed = []
    for scan in log.scans:
        number = int(rng.poisson(mean))
        range_m, bearing = reach_m * np.sqrt(rng.random(number)), rng.uniform(bearings.min(), bearings.max(), number)
        false = take_detections(donors, rng.integers(len(donors.labels), size=number))
        xyz = np.stack([range_m * np.cos(bearing), range_m * np.sin(bearing), false.positions[:, 2]], axis=1)
        R_body_sensor = frames(scan.detections.frame_id)[:3, :3]
        changed.append(scan.join(replace(false, positions=xyz @ R_body_sensor, track_ids=None)))
    return log.with_scans(changed)


@fault()
def claimed_sigma(log: Recording, sigma_m: _Claimed = 1e-3) -> Recording:
    """All covariances claim M on each axis."""
    P = sigma_m**2 * np.eye(3)
    return log.with_detections(lambda seen: replace(seen, covariances=np.tile(P, (len(seen.labels), 1, 1))))


@fault()
def one_point(log: Recording, distance_m: Metres = 5.0) -> Recording:
    """All objects are seen M ahead of the sensor."""
    return _moved(log, lambda seen: np.tile([distance_m, 0.0, 0.0], (len(seen.labels), 1)))


@fault()
def sensor_upside_down(log: Recording) -> Recording:
    """The sensor hangs upside down, turned about its x axis, without a transform."""
    return _turned(log, np.diag([1.0, -1.0, -1.0]))


@fault("10", "90")
def sensor_yaw(log: Recording, angle_deg: Degrees = 10.0) -> Recording:
    """The sensor is turned by DEG about its z axis, without a transform."""
    return _turned(log, Rotation.from_euler("z", -angle_deg, degrees=True).as_matrix())


@fault()
def sensor_optical(log: Recording) -> Recording:
    """Positions are in optical axes (x right, y down, z forward), but messages name other axes."""
    return _turned(log, np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]))


@fault()
def sensor_mirrored(log: Recording, seconds: Duration = 20.0) -> Recording:
    """Left and right of the sensor are exchanged for S from the middle of the drive on."""
    begin_ns, end_ns = log.from_half(seconds)
    return _moved(log, lambda seen: seen.positions * [1.0, -1.0 if begin_ns <= seen.stamp_ns < end_ns else 1.0, 1.0])


@fault()
def ranges_scaled(log: Recording, factor: Factor = 1.1) -> Recording:
    """All ranges are multiplied by a factor."""
    return _moved(log, lambda seen: factor * seen.positions)


@fault()
def height_offset(log: Recording, height_m: Metres = 2.0) -> Recording:
    """All objects are seen M too high, in the axes of the body."""
    frame, up = log.body_frames(), np.array([0.0, 0.0, height_m])
    return _moved(log, lambda seen: seen.positions + up @ frame(seen.frame_id)[:3, :3])


@fault()
def odometry_frame(log: Recording) -> Recording:
    """Positions are in the frame of the odometry; messages name that of the sensor."""
    frame, T_odom_body = log.body_frames(), iter(log.poses_at([scan.stamp_ns for scan in log.scans]))
    return log.with_detections(lambda seen: move_detections(seen, next(T_odom_body) @ frame(seen.frame_id)))


@fault("0.5", "3")
def detection_noise(log: Recording, factor: Factor = 3.0) -> Recording:
    """Errors of positions against the truth are multiplied; covariances stay as they are."""
    objects = {
        name: position
        for message in log.true_objects
        for name, position in zip(message.record.ids, message.record.positions, strict=True)
    }
    if not objects:
        raise SimulationError("the log holds no true objects (/ground_truth/objects), which this fault needs")
    frame, scans = log.body_frames(), log.scans_with_ids
    changed = {}
    for scan, T_world_body in zip(scans, log.true_poses_at([scan.stamp_ns for scan in scans]), strict=True):
        seen = scan.detections.positions
        known = np.array([name in objects for name in scan.ids], dtype=np.bool_)
        world = np.array([objects.get(name, np.zeros(3)) for name in scan.ids]).reshape(-1, 3)
        true = apply(invert(T_world_body @ frame(scan.detections.frame_id)), world)
        changed[scan] = scan.with_fields(positions=np.where(known[:, None], true + factor * (seen - true), seen))
    return log.with_scans(changed.get(scan, scan) for scan in log.scans)


@fault()
def label_confusion(log: Recording, probability: Share = 0.5, *, rng: np.random.Generator) -> Recording:
    """Each label is replaced by another of the log with a probability."""
    labels = np.array(log.labels)
    if len(labels) == 1:
        raise SimulationError(f"{labels[0]!r} is the only label and cannot be confused with another")

    def alter(seen: ObjectDetections) -> ObjectDetections:
        rows = np.searchsorted(labels, np.array(seen.labels, dtype=labels.dtype))
        is_confused = rng.random(len(rows)) < probability
        others = (rows + rng.integers(1, max(len(labels), 2), size=len(rows))) % max(len(labels), 1)
        return replace(seen, labels=tuple(labels[np.where(is_confused, others, rows)].tolist()))

    return log.with_detections(alter)


@fault()
def labels_random(log: Recording, *, rng: np.random.Generator) -> Recording:
    """Each detection has a label of the log drawn at random."""
    labels = log.labels
    return _relabelled(log, lambda seen: [labels[i] for i in rng.integers(max(len(labels), 1), size=len(seen.labels))])


@fault()
def labels_unique(log: Recording) -> Recording:
    """Each detection has a label of its own."""
    number = count()
    return _relabelled(log, lambda seen: [f"object_{next(number)}" for _ in seen.labels])


@fault()
def labels_one_class(log: Recording) -> Recording:
    """All detections have one label."""
    return _relabelled(log, lambda seen: ["object"] * len(seen.labels))


@fault()
def labels_case(log: Recording) -> Recording:
    """Labels are in capitals from the middle of the drive on."""
    return _renamed_from_half(log, str.upper)


@fault()
def labels_permuted(log: Recording, *, rng: np.random.Generator) -> Recording:
    """From the middle of the drive on, each label is that of another class."""
    labels = log.labels
    order = rng.permutation(len(labels)).tolist()
    # Along a cycle through all of them no label keeps its meaning.
    meaning = {labels[a]: labels[b] for a, b in zip(order, order[1:] + order[:1], strict=True)}
    return _renamed_from_half(log, meaning.__getitem__)


def _moved(log: Recording, move: Callable[[ObjectDetections], FloatArray]) -> Recording:
    """Other positions."""
    return log.with_detections(lambda seen: replace(seen, positions=move(seen)))


def _turned(log: Recording, R_wrong_sensor: FloatArray) -> Recording:
    T = make_transform(R_wrong_sensor, np.zeros(3))
    return log.with_detections(lambda seen: move_detections(seen, T))


def _relabelled(log: Recording, relabel: Callable[[ObjectDetections], list[str]]) -> Recording:
    """Other labels."""
    return log.with_detections(lambda seen: replace(seen, labels=tuple(relabel(seen))))


def _renamed_from_half(log: Recording, rename: Callable[[str], str]) -> Recording:
    half_ns = log.half_ns
    return _relabelled(log, lambda seen: [rename(each) if seen.stamp_ns >= half_ns else each for each in seen.labels])


def _from_sensor(log: Recording) -> Callable[[ObjectDetections], FloatArray]:
    """A function to positions (N, 3), metres, from the sensor in the axes of the body."""
    T_body_sensor = log.bearing_frames()
    return lambda seen: seen.positions @ T_body_sensor(seen.frame_id)[:3, :3].T


def _refuse_unknown(log: Recording, labels: tuple[str, ...]) -> None:
    for label in labels:
        if label not in log.labels:
            raise SimulationError(
                f"no detection is labelled {label!r}; the labels of the log are {', '.join(log.labels)}"
            )
