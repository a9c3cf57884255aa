"""One message of detections, made ready for mapping: in the body frame, with covariances, without the unwanted."""

from dataclasses import replace
from itertools import compress

import numpy as np
from scipy.spatial import cKDTree

from logs.dslam_codec import take_rows
from logs.messages import ObjectDetections
from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray
from slam.common.calibration import DetectionCalibration
from slam.common.geometry import apply, unit_vectors
from slam.frontend.input.label_map import DROPPED


@frozen
class Scan:
    """Detections in one frame, at first the body's: positions (N, 3) m, covariances (N, 3, 3) m^2, labels (N,).

    ``used`` (M,): which of the message's M detections these are; ``has_own_covariance`` (N,): the message gave it;
    ``stamp_shifts`` (N, 3) m: what a stamp that is late by one standard deviation shifts all of them by, which the
    covariances contain. ``sensor`` is the frame that the message named.
    """

    stamp_ns: int
    sensor: str
    positions: FloatArray
    covariances: FloatArray
    labels: tuple[str, ...]
    used: BoolArray
    has_own_covariance: BoolArray
    stamp_shifts: FloatArray

    @property
    def own_covariances(self) -> FloatArray:
        """(N, 3, 3) m^2, without the noise of the stamp."""
        return self.covariances - self.stamp_shifts[:, :, None] * self.stamp_shifts[:, None, :]

    def of(self, chosen: BoolArray) -> "Scan":
        """Some of the detections, chosen by (N,); ``used`` stays that of the whole message."""
        if chosen.all():
            return self
        return replace(
            self,
            positions=self.positions[chosen],
            covariances=self.covariances[chosen],
            labels=tuple(compress(self.labels, chosen.tolist())),
            has_own_covariance=self.has_own_covariance[chosen],
            stamp_shifts=self.stamp_shifts[chosen],
        )

    def joined(self, other: "Scan") -> "Scan":
        """These detections and those of another scan, in one frame; ``used`` stays that of this message."""
        return replace(
            self,
            positions=np.concatenate([self.positions, other.positions]),
            covariances=np.concatenate([self.covariances, other.covariances]),
            labels=self.labels + other.labels,
            has_own_covariance=np.concatenate([self.has_own_covariance, other.has_own_covariance]),
            stamp_shifts=np.concatenate([self.stamp_shifts, other.stamp_shifts]),
        )

    def seen_from(self, T_frame_body: FloatArray) -> "Scan":
        """The same scan with its positions and covariances in another frame."""
        R = T_frame_body[:3, :3]
        return replace(
            self,
            positions=apply(T_frame_body, self.positions),
            covariances=R @ self.covariances @ R.T,
            stamp_shifts=self.stamp_shifts @ R.T,
        )


def is_wanted(detections: ObjectDetections, config: DetectionCalibration) -> BoolArray:
    """(M,): which detections of a message neither the settings of labels nor that of scores leave out, and which are of
    objects that were not detected better.
    """
    is_kept = np.array([label != DROPPED for label in detections.labels], dtype=np.bool_)
    is_kept &= detections.scores >= config.min_score
    if config.resolution_m > 0.0:
        rows = np.flatnonzero(is_kept & np.isfinite(detections.positions).all(axis=1))
        is_kept[rows[_is_repeated(take_rows(detections, N=rows), config.resolution_m)]] = False
    return is_kept


def _is_repeated(detections: ObjectDetections, resolution_m: float) -> BoolArray:
    """(M,): which detections are nearer than the resolution to one of the same label with a higher score, or an earlier
    one with the same, that is not repeated itself: non-maximum suppression.
    """
    is_repeated = np.zeros(len(detections.labels), dtype=np.bool_)
    tree, labels = cKDTree(detections.positions), detections.labels
    for best in np.argsort(-detections.scores, kind="stable").tolist():
        if not is_repeated[best]:
            near = tree.query_ball_point(detections.positions[best], resolution_m)
            is_repeated[[row for row in near if row != best and labels[row] == labels[best]]] = True
    return is_repeated


def in_metres(detections: ObjectDetections, config: DetectionCalibration) -> ObjectDetections:
    """The detections with their ranges corrected by the scale of the calibration."""
    scale = config.range_scale
    if scale == 1.0:
        return detections
    covariances = None if detections.covariances is None else scale**2 * detections.covariances
    return replace(detections, positions=scale * detections.positions, covariances=covariances)


def make_scan(
    detections: ObjectDetections,
    T_body_sensor: FloatArray,
    config: DetectionCalibration,
    up_body: FloatArray,
    T_body_before: FloatArray,
) -> Scan:
    """The detections of one message that pass the limits on score and range, in the body frame.

    Covariances are the message's own, else (base_sigma_m + sigma_per_m * range)^2 across the line of sight, and
    range_sigma_ratio^2 times that along it; the range is taken from the body, since the frame of the message may be one
    that does not move with the sensor. Two noises are added to both: that of heights, along the vertical ``up_body``
    (3,) in the axes of the body, and that of the stamp: ``T_body_before`` (4, 4) is where the body was one standard
    deviation of the stamp earlier.
    """
    positions = apply(T_body_sensor, detections.positions)
    ranges = np.linalg.norm(positions, axis=1)
    used = is_wanted(detections, config) & (ranges <= config.reach_m)
    positions = positions[used]
    covariances = _covariances_by_range(positions, ranges[used], config)
    has_own_covariance = np.zeros(len(positions), dtype=np.bool_)
    if detections.covariances is not None:
        R, own = T_body_sensor[:3, :3], detections.covariances[used]
        has_own_covariance = own.any(axis=(1, 2))
        # No detector is right to the millimetre; what claims it would outweigh everything else.
        floor_m = 1.0 / 3000.0 * config.sensor_range_m
        own = config.claimed_sigma_factor**2 * (R @ own @ R.T) + floor_m**2 * np.eye(3)
        covariances = np.where(has_own_covariance[:, None, None], own, covariances)
    shifts = apply(T_body_before, positions) - positions
    covariances = covariances + config.height_sigma_m**2 * np.outer(up_body, up_body)
    covariances += shifts[:, :, None] * shifts[:, None, :]
    return Scan(
        stamp_ns=detections.stamp_ns,
        sensor=detections.frame_id,
        positions=positions,
        covariances=covariances,
        labels=tuple(compress(detections.labels, used.tolist())),
        used=used,
        has_own_covariance=has_own_covariance,
        stamp_shifts=shifts,
    )


def with_expected_noise(scan: Scan, ranges: FloatArray, config: DetectionCalibration) -> Scan:
    """The scan, in the frame of the body, with the noise by the ``ranges`` (N,) m at which its objects are expected.

    With the noise by its own range, a detection that is too near would seem more precise than one that is too far, and
    the map would shrink.
    """
    both = np.stack([ranges, np.linalg.norm(scan.positions, axis=1)])
    change = np.subtract(*_covariances_by_range(scan.positions, both, config))
    change[scan.has_own_covariance] = 0.0
    return replace(scan, covariances=scan.covariances + change)


def _covariances_by_range(positions: FloatArray, ranges: FloatArray, config: DetectionCalibration) -> FloatArray:
    """(..., N, 3, 3) m^2 of detections in the directions of (N, 3) m, at ``ranges`` (..., N) m, whose message gives
    none.
    """
    sigmas = config.base_sigma_m + config.sigma_per_m * ranges
    sights = unit_vectors(positions)
    along = (config.range_sigma_ratio**2 - 1.0) * sights[:, :, None] * sights[:, None, :]
    return sigmas[..., None, None] ** 2 * (np.eye(3) + along)
