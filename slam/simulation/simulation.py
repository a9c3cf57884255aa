"""A drive through a world as the records of a log."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.errors import LogError
from logs.messages import (
    DetectionTruth,
    GroundTruthPose,
    ObjectDetections,
    ObjectMapRecord,
    Odometry,
)
from logs.selection import DETECTION_TRUTH_TOPIC, GROUND_TRUTH_TOPIC, OBJECT_TRUTH_TOPIC
from logs.writer import LogWriter
from slam.common.arrays import FloatArray, IntArray
from slam.common.config_tree import CHANGED_SETTINGS, changed_settings
from slam.common.errors import SimulationError, SlamError
from slam.common.geometry import invert
from slam.simulation import traffic
from slam.simulation.config import SimulationConfig
from slam.simulation.drive import START_NS, Drive, DrivePlan, plan_drive
from slam.simulation.odometry import drifting_odometry
from slam.simulation.sensor import Scan, SensorStreams, scan_objects
from slam.simulation.world import World

SimulatedRecord = Odometry | ObjectDetections | GroundTruthPose | DetectionTruth | ObjectMapRecord

ODOMETRY_TOPIC = "/odom"
DETECTIONS_TOPIC = "/detections"

MIN_TOUR_M = 2.0
DAY_NS = 86_400 * 10**9


@dataclass(frozen=True, slots=True)
class SimulationSummary:
    """Summary of the log: messages by topic, number of detections, metres along the tour, first to last stamp."""

    message_counts: dict[str, int]
    detection_count: int
    driven_m: float
    duration_s: float


@dataclass(frozen=True, slots=True, eq=False)
class _Course:
    """The tour of a drive, and the random numbers of its errors."""

    plan: DrivePlan
    drives: list[Drive]
    odometry: np.random.Generator
    traffic: np.random.Generator
    sensor: SensorStreams


def simulate(world: World, config: SimulationConfig, *, seed: int) -> Iterator[tuple[str, int, SimulatedRecord]]:
    """Drive the tour of ``world``: (topic, stamp_ns, record) in the order of time.

    First the true objects (those that stand still) on /ground_truth/objects, frame "world"; then, for each scan,
    odometry (which starts at the identity), detections in the body frame "base_link", the true pose, and the true id of
    each detection. After a kidnapping the odometry starts at the identity again, unless it was silent. The same world,
    configuration and seed give the same records; each cause of error has its own random numbers.

    Raises:
        SimulationError: a negative seed, a kidnapping outside the tour, or a tour too short; raised at the call.
    """
    return _records(world, config, _course(world, config, seed))


def write_simulation(path: Path, world: World, config: SimulationConfig, *, seed: int) -> SimulationSummary:
    """Write ``simulate(...)`` to the log ``path``, with the metadata "simulation".

    Raises:
        SimulationError: as ``simulate``; nothing is written then.
        UnwritableLogError: the log cannot be written.
    """
    course = _course(world, config, seed)
    counts: Counter[str] = Counter()
    detection_count = 0
    with LogWriter(path, refusals=(LogError, SlamError)) as writer:
        writer.add_metadata(
            "simulation",
            {
                "world": world.name,
                "world_sha256": world.sha256(),
                "seed": str(seed),
                "configuration": json.dumps(config.model_dump(mode="json"), sort_keys=True),
                CHANGED_SETTINGS: changed_settings(config),
            },
        )
        for topic, stamp_ns, record in _records(world, config, course):
            writer.write(topic, record, stamp_ns)
            counts[topic] += 1
            if isinstance(record, ObjectDetections):
                detection_count += len(record.labels)
    drives = course.drives
    driven_m = sum(float(drive.tour_m[-1] - drive.tour_m[0]) for drive in drives)
    duration_s = float(drives[-1].stamps_ns[-1] - drives[0].stamps_ns[0]) * 1e-9
    return SimulationSummary(dict(counts), detection_count, driven_m, duration_s)


def _course(world: World, config: SimulationConfig, seed: int) -> _Course:
    if seed < 0:
        raise SimulationError(f"seed {seed} is negative; give 0 or more")
    # The order is part of what a seed means: new causes go to the end.
    odometry, position, dropout, label, score, false_positive, vehicles = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(7)
    )
    plan = plan_drive(world.tour, config.drive)
    sensor = SensorStreams(position, dropout, label, score, false_positive)
    return _Course(plan, _drives(plan, config), odometry, vehicles, sensor)


def _drives(plan: DrivePlan, config: SimulationConfig) -> list[Drive]:
    if config.kidnap is None:
        drives = [plan.sample(0.0, plan.length_m, start_ns=_start_ns(config))]
    else:
        kidnap = config.kidnap
        first_m = 0.0 if kidnap.before_m is None else max(kidnap.from_m - kidnap.before_m, 0.0)
        last_m = plan.length_m if kidnap.after_m is None else min(kidnap.to_m + kidnap.after_m, plan.length_m)
        before = plan.sample(first_m, kidnap.from_m, start_ns=_start_ns(config))
        gap_s = 1.0 / config.drive.rate_hz if kidnap.silent else kidnap.gap_s
        resume_ns = int(before.stamps_ns[-1]) + round(gap_s * 1e9)
        drives = [before, plan.sample(kidnap.to_m, last_m, start_ns=resume_ns)]
    fewest = min(len(drive.stamps_ns) for drive in drives)
    if plan.length_m < MIN_TOUR_M or fewest < 2:
        raise SimulationError(
            f"a tour of {plan.length_m:g} m whose shortest stretch has {fewest} scans is too short; give it at least "
            f"{MIN_TOUR_M:g} m, and two scans before and after a kidnapping (drive.rate_hz scans per second)"
        )
    return drives


def _start_ns(config: SimulationConfig) -> int:
    return START_NS + config.drive.start_day * DAY_NS


def _records(world: World, config: SimulationConfig, course: _Course) -> Iterator[tuple[str, int, SimulatedRecord]]:
    moving_count = config.traffic.vehicles
    object_ids = (*world.object_ids, *(f"moving-{k}" for k in range(moving_count)))
    labels = world.labels + (traffic.LABEL,) * moving_count
    vocabulary, class_indices = np.unique(labels, return_inverse=True)
    radii_m = np.full(len(labels), config.sensor.occluder_radius_m)
    radii_m[len(world.labels) :] = config.traffic.radius_m

    start_ns = _start_ns(config)
    known = [world.vocabulary.index(label) for label in world.labels]
    yield (
        OBJECT_TRUTH_TOPIC,
        start_ns,
        ObjectMapRecord.of_objects(
            world.object_ids, world.positions, known, world.vocabulary, stamp_ns=start_ns, frame_id="world"
        ),
    )
    stamps_ns = np.concatenate([drive.stamps_ns for drive in course.drives])
    vehicles = traffic.drive_traffic(course.plan, (stamps_ns - start_ns) * 1e-9, config.traffic, rng=course.traffic)
    row = 0
    T_odom_first = np.eye(4)
    for drive in course.drives:
        T_odom_body = T_odom_first @ drifting_odometry(drive.T_world_body, config.odometry, rng=course.odometry)
        if config.kidnap is not None and config.kidnap.silent:
            T_odom_first = T_odom_body[-1] @ invert(T_odom_body[-2]) @ T_odom_body[-1]
        T_body_world = invert(drive.T_world_body)
        for i, stamp_ns in enumerate(drive.stamps_ns.tolist()):
            rows, positions_body = _nearby(
                world.positions,
                vehicles[row],
                drive.T_world_body[i],
                T_body_world[i],
                config.sensor.max_range_m,
            )
            scan = scan_objects(
                positions_body, class_indices[rows], radii_m[rows], len(vocabulary), config.sensor, course.sensor
            )
            true_ids = tuple("" if source < 0 else object_ids[rows[source]] for source in scan.sources.tolist())
            yield ODOMETRY_TOPIC, stamp_ns, Odometry(stamp_ns, T_odom_body[i])
            yield (
                DETECTIONS_TOPIC,
                stamp_ns,
                _detections(stamp_ns, scan, vocabulary.tolist(), config.sensor.covariances),
            )
            yield GROUND_TRUTH_TOPIC, stamp_ns, GroundTruthPose(stamp_ns, drive.T_world_body[i])
            yield DETECTION_TRUTH_TOPIC, stamp_ns, DetectionTruth(stamp_ns, true_ids)
            row += 1


def _nearby(
    objects: FloatArray, vehicles: FloatArray, T_world_body: FloatArray, T_body_world: FloatArray, range_m: float
) -> tuple[IntArray, FloatArray]:
    """Rows of what is in the square about the body (objects, then vehicles), and positions (N, 3) in the body frame."""
    everything = np.concatenate([objects, vehicles])
    offset = everything - T_world_body[:3, 3]
    rows = np.flatnonzero(np.maximum(np.abs(offset[:, 0]), np.abs(offset[:, 1])) <= range_m)
    return rows, offset[rows] @ T_body_world[:3, :3].T


def _detections(stamp_ns: int, scan: Scan, vocabulary: list[str], with_covariances: bool) -> ObjectDetections:
    labels = tuple(vocabulary[k] for k in scan.class_indices.tolist())
    covariances = scan.sigmas_m[:, None, None] ** 2 * np.eye(3) if with_covariances else None
    return ObjectDetections(stamp_ns, "base_link", scan.positions, labels, scan.scores, covariances)
