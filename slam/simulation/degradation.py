"""Detections made worse: what is lost, what is wrong, and what is invented; and the settings for a whole log.

What happens to detections happens in this order: field of view, range and labels; dropout; confusion of labels; noise;
false positives. ``slam.simulation.degraded_log`` applies it to a whole log.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from logs.messages import DetectionTruth, ObjectDetections
from slam.common.arrays import FloatArray, IntArray
from slam.common.config_tree import settings_of
from slam.common.errors import ConfigurationError, SimulationError

FALSE_POSITIVE_RANGE_PERCENTILE = 95.0
"""False positives lie within the range that holds so many per cent of the log's detections."""


class DegradationConfig(BaseModel):
    """How a log is made worse. By default nothing is."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    reversed: bool = Field(default=False, description="the drive is played backwards, in reverse gear")
    time_offset_s: float = Field(default=0.0, ge=-3600, le=3600, description="added to the detections' stamps [s]")
    field_of_view_deg: float = Field(
        default=360.0, gt=0, le=360, description="horizontal, centred on straight ahead of the body [deg]"
    )
    max_range_m: float = Field(
        default=math.inf, gt=0, description="horizontal distance from the sensor beyond which nothing is seen [m]"
    )
    keep_labels: tuple[str, ...] = Field(default=(), description="the only labels that are kept; none: all of them")
    drop_labels: tuple[str, ...] = Field(default=(), description="labels that are taken out")
    dropout: float = Field(default=0.0, ge=0, le=1, description="probability that a detection is lost")
    label_confusion: float = Field(default=0.0, ge=0, le=1, description="probability that a label becomes another one")
    position_noise_m: float = Field(default=0.0, ge=0, le=100, description="position noise per axis, 1 sigma [m]")
    false_positives: float = Field(default=0.0, ge=0, le=1000, description="mean number of invented objects a scan")
    odometry_translation_noise: float = Field(
        default=0.0, ge=0, le=10, description="translation noise per axis after 1 m of travel [m / sqrt(m)]"
    )
    odometry_yaw_noise: float = Field(
        default=0.0, ge=0, le=1, description="heading noise after 1 m of travel [rad / sqrt(m)]"
    )

    @property
    def changes_detections(self) -> bool:
        """Whether detections differ in more than their order."""
        odometry_only = ("reversed", "odometry_translation_noise", "odometry_yaw_noise")
        return any(key not in odometry_only for key in self.in_effect())

    @property
    def changes_odometry(self) -> bool:
        """Whether poses of the odometry differ."""
        return self.odometry_translation_noise > 0.0 or self.odometry_yaw_noise > 0.0

    @property
    def needs_bearings(self) -> bool:
        """Whether it matters where, seen from the body, detections are."""
        return not {"field_of_view_deg", "max_range_m", "false_positives"}.isdisjoint(self.in_effect())

    @property
    def is_random(self) -> bool:
        """Whether the seed matters."""
        chances = (self.dropout, self.label_confusion)
        return any(0.0 < chance < 1.0 for chance in chances) or bool(
            self.label_confusion or self.position_noise_m or self.false_positives or self.changes_odometry
        )

    def in_effect(self) -> dict[str, object]:
        """The values that are not the default."""
        return {s.key: s.value for s in settings_of(self) if s.value != s.default}


def make_degradation(values: Mapping[str, object]) -> DegradationConfig:
    """The configuration with ``values`` by name, checked.

    Raises:
        ConfigurationError: a value that is not allowed; the message says what is.
    """
    try:
        return DegradationConfig.model_validate(dict(values))
    except ValidationError as error:
        first = error.errors()[0]
        setting = {s.key: s for s in settings_of(DegradationConfig())}.get(str(first["loc"][0]))
        allowed = f"it is {setting.allowed}: {setting.meaning}" if setting else first["msg"]
        raise ConfigurationError(f"{first['loc'][0]}={first['input']!r} is not allowed; {allowed}") from error


@dataclass(frozen=True, slots=True)
class DegradationStreams:
    """One generator for each cause, so that switching one on leaves the others' numbers as they are."""

    dropout: np.random.Generator
    label: np.random.Generator
    position: np.random.Generator
    false_positive: np.random.Generator
    odometry: np.random.Generator

    @staticmethod
    def of_seed(seed: int) -> DegradationStreams:
        """The generators that ``seed`` stands for.

        Raises:
            SimulationError: a negative seed.
        """
        if seed < 0:
            raise SimulationError(f"seed {seed} is negative; give 0 or more")
        # The order is part of what a seed means: new causes go to the end.
        return DegradationStreams(*(np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(5)))


@dataclass(frozen=True, slots=True, eq=False)
class Donors:
    """What false positives are made of: detections of the log, with positions from the sensor in the axes of the body.

    ``range_m``: how far false positives reach.
    """

    detections: ObjectDetections
    range_m: float

    @staticmethod
    def of(detections: ObjectDetections) -> Donors:
        """Donors from at least one detection."""
        ranges_m = np.hypot(detections.positions[:, 0], detections.positions[:, 1])
        return Donors(detections, float(np.percentile(ranges_m, FALSE_POSITIVE_RANGE_PERCENTILE)))


@dataclass(frozen=True, slots=True, eq=False)
class DegradedScan:
    """One message of detections after its degradation: those ``kept`` (N,) of its N, then the false positives.

    ``out_of_view``, ``unwanted`` (by their label), ``dropped`` and ``confused`` count detections.
    """

    detections: ObjectDetections
    kept: NDArray[np.bool_]
    false_positive_count: int
    out_of_view: int
    unwanted: int
    dropped: int
    confused: int

    def true_ids(self, truth: DetectionTruth) -> DetectionTruth | None:
        """The truth of what is left, "" for the false positives; None where ``truth`` is of another message."""
        if len(truth.object_ids) != len(self.kept):
            return None
        ids = tuple(id for id, is_kept in zip(truth.object_ids, self.kept, strict=True) if is_kept)
        return replace(truth, object_ids=ids + ("",) * self.false_positive_count)


def choose_labels(there: Sequence[str], config: DegradationConfig) -> tuple[str, ...]:
    """The labels of a log that stay, sorted, of those that are ``there``.

    Raises:
        SimulationError: a label that is not there, none that stays, or only one where labels are to be confused.
    """
    listing = f"the labels of the log are {', '.join(sorted(there))}"
    for label in (*config.keep_labels, *config.drop_labels):
        if label not in there:
            raise SimulationError(f"no detection is labelled {label!r}; {listing}")
    staying = sorted((set(config.keep_labels) or set(there)) - set(config.drop_labels))
    if not staying:
        raise SimulationError(f"no label is left; {listing}")
    if config.label_confusion > 0.0 and len(staying) == 1:
        raise SimulationError(f"{staying[0]!r} is the only label and cannot be confused with another; {listing}")
    return tuple(staying)


def in_view(positions: FloatArray, config: DegradationConfig) -> NDArray[np.bool_]:
    """Which of the positions (N, 3), metres, from the sensor in the axes of the body, are in view: (N,)."""
    bearing = np.arctan2(positions[:, 1], positions[:, 0])
    near = np.hypot(positions[:, 0], positions[:, 1]) <= config.max_range_m
    return np.asarray(near & (np.abs(bearing) <= 0.5 * np.deg2rad(config.field_of_view_deg)))


def select_detections(detections: ObjectDetections, rows: NDArray[np.bool_] | IntArray) -> ObjectDetections:
    """The detections ``rows``, a mask (N,) or row numbers (M,)."""
    numbers = np.arange(len(detections.labels))[rows]
    ids = detections.track_ids
    return replace(
        detections,
        positions=detections.positions[numbers],
        labels=tuple(detections.labels[i] for i in numbers),
        scores=detections.scores[numbers],
        covariances=None if detections.covariances is None else detections.covariances[numbers],
        sizes=None if detections.sizes is None else detections.sizes[numbers],
        track_ids=None if ids is None else tuple(ids[i] for i in numbers),
    )


def join_detections(first: ObjectDetections, *more: ObjectDetections) -> ObjectDetections:
    """All detections in one message like ``first``; what only some have (covariances, sizes, ids) is unknown, zero or
    "", for the others.
    """
    parts = [part for part in (first, *more) if part.labels] or [first]

    def stack(arrays: list[FloatArray | None], shape: tuple[int, ...]) -> FloatArray | None:
        if all(array is None for array in arrays):
            return None
        zeros = [np.zeros((len(part.labels), *shape)) for part in parts]
        return np.concatenate([zero if array is None else array for array, zero in zip(arrays, zeros, strict=True)])

    has_ids = any(part.track_ids is not None for part in parts)
    return replace(
        first,
        positions=np.concatenate([part.positions for part in parts]),
        labels=tuple(label for part in parts for label in part.labels),
        scores=np.concatenate([part.scores for part in parts]),
        covariances=stack([part.covariances for part in parts], (3, 3)),
        sizes=stack([part.sizes for part in parts], (3,)),
        track_ids=tuple(i for part in parts for i in part.track_ids or ("",) * len(part.labels)) if has_ids else None,
    )


def degrade_detections(
    detections: ObjectDetections,
    R_body_sensor: FloatArray,
    config: DegradationConfig,
    labels: tuple[str, ...],
    donors: Donors | None,
    streams: DegradationStreams,
) -> DegradedScan:
    """Degrade one message; see the head of this file for the order.

    Args:
        detections: positions in the sensor's frame, metres.
        R_body_sensor: (3, 3), how the sensor is turned on the body.
        config: what to do.
        labels: those that stay (``choose_labels``), also what a label may be confused with.
        donors: where false positives get heights, labels, scores, sizes and covariances from; None: there are none.
        streams: random numbers; as many are used whatever ``config`` is, but for the false positives.
    """
    count = len(detections.labels)
    lost = streams.dropout.random(count) < config.dropout
    label_draw, other_draw = streams.label.random((2, count))
    normals = streams.position.standard_normal((count, 3))

    seen = in_view(detections.positions @ R_body_sensor.T, config)
    wanted = np.array([label in labels for label in detections.labels], dtype=np.bool_)
    kept = seen & wanted & ~lost
    confused = kept & (label_draw < config.label_confusion)
    relabelled = list(detections.labels)
    for i in np.flatnonzero(confused).tolist():
        others = [label for label in labels if label != relabelled[i]]
        relabelled[i] = others[min(int(other_draw[i] * len(others)), len(others) - 1)]
    positions = detections.positions + config.position_noise_m * normals
    left = select_detections(replace(detections, positions=positions, labels=tuple(relabelled)), kept)
    false_count = 0
    if donors is not None:
        false = _false_positives(donors, R_body_sensor, config, streams.false_positive)
        false_count = len(false.labels)
        left = join_detections(left, false)
    return DegradedScan(
        detections=replace(left, covariances=_widened(left.covariances, config.position_noise_m)),
        kept=kept,
        false_positive_count=false_count,
        out_of_view=int((~seen).sum()),
        unwanted=int((seen & ~wanted).sum()),
        dropped=int((seen & wanted & lost).sum()),
        confused=int(confused.sum()),
    )


def _false_positives(
    donors: Donors, R_body_sensor: FloatArray, config: DegradationConfig, rng: np.random.Generator
) -> ObjectDetections:
    """Evenly over the area in view, as far as the donors reach; all but the place is that of a donor."""
    count = int(rng.poisson(config.false_positives))
    range_m = donors.range_m * np.sqrt(rng.random(count))
    bearing = (rng.random(count) - 0.5) * np.deg2rad(config.field_of_view_deg)
    false = select_detections(donors.detections, rng.integers(len(donors.detections.labels), size=count))
    xyz = np.stack([range_m * np.cos(bearing), range_m * np.sin(bearing), false.positions[:, 2]], axis=1)
    return replace(false, positions=xyz @ R_body_sensor, track_ids=None)


def _widened(covariances: FloatArray | None, sigma_m: float) -> FloatArray | None:
    """Covariances (N, 3, 3) with the noise added; zeros, which mean unknown, stay zeros."""
    if covariances is None:
        return None
    is_known = np.any(covariances != 0.0, axis=(1, 2))
    return np.asarray(covariances + (is_known * sigma_m**2)[:, None, None] * np.eye(3))
