"""Faults of what a sensor measures, misses and invents: positions, covariances, labels, wrong extrinsics.

Each public function is a fault; its docstring tells what it does, its parameters are those of the command line.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from logs.dslam_codec import take_rows
from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.common.geometry import make_transform
from slam.simulation.faults.parameters import Degrees, Factor, Metres, Share, Sigma
from slam.simulation.faults.recording import Recording, Scan, joined
from slam.simulation.sensor import bearings_rad

_Angle = Annotated[float, Field(gt=0.0, le=360.0, description="deg")]
_Reach = Annotated[float, Field(gt=0.0, allow_inf_nan=False, description="m")]
_PerScan = Annotated[float, Field(ge=0.0, le=1000.0, description="number")]
_Claimed = Annotated[float, Field(ge=1e-9, le=1e3, description="m")]


def position_noise(log: Recording, sigma_m: Sigma = 1.0, *, rng: np.random.Generator) -> None:
    """Positions have M more noise on each axis, and known covariances contain it."""
    unreported_noise(log, sigma_m, rng=rng)
    for scan in log.scans:
        covariances = scan.seen.covariances
        if covariances is not None:
            is_known = np.any(covariances != 0.0, axis=(1, 2))
            scan.change(covariances=covariances + (is_known * sigma_m**2)[:, None, None] * np.eye(3))


def unreported_noise(log: Recording, sigma_m: Sigma = 1.0, *, rng: np.random.Generator) -> None:
    """Positions have M of noise on each axis that no covariance contains."""
    for scan in log.scans:
        positions = scan.seen.positions
        scan.change(positions=positions + sigma_m * rng.standard_normal(positions.shape))


def detected_twice(log: Recording, share: Share = 0.02, *, rng: np.random.Generator) -> None:
    """Each detection is followed by another one of the same object, off by a share of its range on each axis."""
    for scan in log.scans:
        seen, ids = scan.seen, scan.ids
        ranges = np.linalg.norm(seen.positions, axis=1, keepdims=True)
        errors = share * ranges * rng.standard_normal(seen.positions.shape)
        scan.put(joined([seen, replace(seen, positions=seen.positions + errors)]), (*ids, *ids))


def dropout(log: Recording, probability: Share = 0.3, *, rng: np.random.Generator) -> None:
    """Each detection is lost with a probability."""
    for scan in log.scans:
        scan.keep(rng.random(len(scan.seen.labels)) >= probability)


def field_of_view(log: Recording, angle_deg: _Angle = 180.0) -> None:
    """The sensor has a field of view of DEG, centred ahead."""
    limit_rad = 0.5 * np.deg2rad(angle_deg)
    for scan, from_sensor in _from_sensor(log):
        scan.keep(np.abs(bearings_rad(from_sensor)) <= limit_rad)


def max_range(log: Recording, range_m: _Reach = 20.0) -> None:
    """The sensor has a horizontal range of M."""
    for scan, from_sensor in _from_sensor(log):
        scan.keep(np.linalg.norm(from_sensor[:, :2], axis=1) <= range_m)


def keep_label(log: Recording, *labels: str) -> None:
    """Only objects of these classes are detected."""
    for label in labels:
        if label not in log.labels:
            raise SimulationError(
                f"no detection is labelled {label!r}; the labels of the log are {', '.join(log.labels)}"
            )
    for scan in log.scans:
        scan.keep(np.isin(scan.seen.labels, labels))


def false_positives(log: Recording, mean: _PerScan = 10.0, *, rng: np.random.Generator) -> None:
    """NUMBER false objects a scan are added on average.

    They are evenly spread over the range and the bearings of the log's detections, and have heights, labels, scores,
    and covariances of detections drawn from the log.
    """
    places = np.concatenate([np.zeros((0, 3)), *(from_sensor for _, from_sensor in _from_sensor(log))])
    if not len(places):
        raise SimulationError("no detection is in view, so false positives cannot be modelled; widen the field of view")
    donors = joined([scan.seen for scan in log.scans])
    x, y, z = places.T
    # A few detections are farther away than all others.
    reach_m, bearings = np.percentile(np.hypot(x, y), 95.0), np.arctan2(y, x)
    frames = log.body_frames()
    for scan in log.scans:
        number = rng.poisson(mean)
        range_m, bearing = reach_m * np.sqrt(rng.random(number)), rng.uniform(bearings.min(), bearings.max(), number)
        rows = rng.integers(len(places), size=number)
        xyz = np.stack([range_m * np.cos(bearing), range_m * np.sin(bearing), z[rows]], axis=1)
        in_sensor = xyz @ frames(scan.seen.frame_id)[:3, :3]
        scan.add(replace(take_rows(donors, N=rows), positions=in_sensor))


def claimed_sigma(log: Recording, sigma_m: _Claimed = 1e-3) -> None:
    """All covariances claim M on each axis."""
    for scan in log.scans:
        scan.change(covariances=np.tile(sigma_m**2 * np.eye(3), (len(scan.seen.labels), 1, 1)))


def sensor_rotated(log: Recording, roll_deg: Degrees = 180.0, pitch_deg: Degrees = 0.0, yaw_deg: Degrees = 0.0) -> None:
    """The sensor is mounted with ROLL:PITCH:YAW in DEG, without a transform."""
    R_wrong_sensor = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True).as_matrix().T
    for scan in log.scans:
        scan.move(make_transform(R_wrong_sensor, np.zeros(3)))


def ranges_scaled(log: Recording, factor: Factor = 1.1) -> None:
    """All ranges are multiplied by a factor."""
    for scan in log.scans:
        scan.change(positions=factor * scan.seen.positions)


def height_offset(log: Recording, height_m: Metres = 2.0) -> None:
    """All objects are seen M too high, in the axes of the body."""
    frames = log.body_frames()
    for scan in log.scans:
        up = np.array([0.0, 0.0, height_m]) @ frames(scan.seen.frame_id)[:3, :3]
        scan.change(positions=scan.seen.positions + up)


def odometry_frame(log: Recording) -> None:
    """Positions are in the frame of the odometry; messages name that of the sensor."""
    frames = log.body_frames()
    for scan, T_odom_body in zip(log.scans, log.scan_poses(), strict=True):
        scan.move(T_odom_body @ frames(scan.seen.frame_id))


def label_confusion(log: Recording, probability: Share = 0.5, *, rng: np.random.Generator) -> None:
    """Each label is replaced by another of the log with a probability."""
    labels = np.array(log.labels)
    if len(labels) == 1:
        raise SimulationError(f"{labels[0]!r} is the only label and cannot be confused with another")
    for scan in log.scans:
        rows = np.searchsorted(labels, np.array(scan.seen.labels, dtype=labels.dtype))
        is_confused = rng.random(len(rows)) < probability
        others = (rows + rng.integers(1, max(len(labels), 2), size=len(rows))) % len(labels)
        scan.change(labels=tuple(labels[np.where(is_confused, others, rows)].tolist()))


def labels_random(log: Recording, *, rng: np.random.Generator) -> None:
    """Each detection has a label of the log drawn at random."""
    labels = log.labels
    _rename(log, lambda label: labels[rng.integers(len(labels))])


def labels_unique(log: Recording) -> None:
    """Each detection has a label of its own."""
    number = count()
    _rename(log, lambda label: f"object_{next(number)}")


def labels_one_class(log: Recording) -> None:
    """All detections have one label."""
    _rename(log, lambda label: "object")


def _rename(log: Recording, rename: Callable[[str], str]) -> None:
    for scan in log.scans:
        scan.change(labels=tuple(map(rename, scan.seen.labels)))


def _from_sensor(log: Recording) -> list[tuple[Scan, FloatArray]]:
    """The scans with their positions (N, 3), metres, from the sensor in the axes of the body.

    Raises:
        SimulationError: detections are in the frame of the odometry.
    """
    odometry, frames = log.odometry[0].record, log.body_frames()
    if odometry.frame_id in {scan.seen.frame_id for scan in log.scans} - {"", odometry.child_frame_id}:
        raise SimulationError(
            f"detections are in {odometry.frame_id!r}, the frame of the odometry, which gives neither their range "
            "nor their bearing: record them in a sensor's frame"
        )
    return [(scan, scan.seen.positions @ frames(scan.seen.frame_id)[:3, :3].T) for scan in log.scans]
