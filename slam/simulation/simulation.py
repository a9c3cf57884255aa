"""A drive through a world as the records of a log."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from logs.importers.imported_log import DriveSummary, write_drive
from logs.messages import (
    DetectionTruth,
    GroundTruthPose,
    ObjectDetections,
    ObjectMapRecord,
    Odometry,
)
from logs.selection import DETECTION_TRUTH_TOPIC, GROUND_TRUTH_TOPIC, OBJECT_TRUTH_TOPIC
from slam.common.config_tree import CHANGED_SETTINGS, changed_settings
from slam.common.errors import SimulationError
from slam.common.geometry import invert
from slam.simulation.config import SimulationConfig
from slam.simulation.drive import START_NS, Drive, DrivePlan, plan_drive
from slam.simulation.odometry import drifting_odometry
from slam.simulation.sensor import Scan, scan_objects
from slam.simulation.world import World

SimulatedRecord = Odometry | ObjectDetections | GroundTruthPose | DetectionTruth | ObjectMapRecord

ODOMETRY_TOPIC = "/odom"
DETECTIONS_TOPIC = "/detections"

MIN_TOUR_M = 2.0
DAY_NS = 86_400 * 10**9
CAUSES = ("odometry", "position", "dropout", "label", "score", "false_positive")
"""Each has random numbers of its own; the order is part of what a seed means, so new causes go to the end."""


def simulate(world: World, config: SimulationConfig, *, seed: int) -> Iterator[tuple[str, int, SimulatedRecord]]:
    """Drive the tour of ``world``: (topic, stamp_ns, record) in the order of time.

    First the true objects (those that stand still) on /ground_truth/objects, frame "world"; then, for each scan,
    odometry (which starts at the identity), detections in the body frame "base_link", the true pose, and the true id of
    each detection. After a kidnapping the odometry starts at the identity again, unless it was silent. The same world,
    configuration and seed give the same records; each cause of error has its own random numbers.

    Raises:
        SimulationError: a negative seed, a kidnapping outside the tour, or a tour too short; raised at the call.
    """
    if seed < 0:
        raise SimulationError(f"seed {seed} is negative; give 0 or more")
    children = np.random.SeedSequence(seed).spawn(len(CAUSES))
    rngs = {cause: np.random.default_rng(child) for cause, child in zip(CAUSES, children, strict=True)}
    return _records(world, config, _drives(plan_drive(world.tour, config.drive), config), rngs)


def write_simulation(path: Path, world: World, config: SimulationConfig, *, seed: int) -> DriveSummary:
    """Write ``simulate(...)`` to the log ``path``, with the metadata "simulation".

    Raises:
        SimulationError: as ``simulate``; nothing is written then.
        UnwritableLogError: the log cannot be written.
    """
    records = simulate(world, config, seed=seed)
    made = {
        "world": world.name,
        "world_sha256": world.sha256(),
        "seed": str(seed),
        "configuration": json.dumps(config.model_dump(mode="json"), sort_keys=True),
        CHANGED_SETTINGS: changed_settings(config),
    }
    return write_drive(path, ((topic, record) for topic, _, record in records), "simulation", made)


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


def _records(
    world: World, config: SimulationConfig, drives: list[Drive], rngs: Mapping[str, np.random.Generator]
) -> Iterator[tuple[str, int, SimulatedRecord]]:
    start_ns = _start_ns(config)
    names, class_indices = np.unique(world.labels, return_inverse=True)
    vocabulary = tuple(names.tolist())
    objects = ObjectMapRecord.of_objects(
        world.object_ids, world.positions, class_indices, vocabulary, stamp_ns=start_ns, frame_id="world"
    )
    yield OBJECT_TRUTH_TOPIC, start_ns, objects
    T_odom_first = np.eye(4)
    for drive in drives:
        T_odom_body = T_odom_first @ drifting_odometry(drive.T_world_body, config.odometry, rng=rngs["odometry"])
        if config.kidnap is not None and config.kidnap.silent:
            T_odom_first = T_odom_body[-1] @ invert(T_odom_body[-2]) @ T_odom_body[-1]
        for i, stamp_ns in enumerate(drive.stamps_ns.tolist()):
            T_world_body = drive.T_world_body[i]
            # Positions about the body, in the axes of the world; those beyond the square of the range are not seen.
            offsets = world.positions - T_world_body[:3, 3]
            rows = np.flatnonzero(np.abs(offsets[:, :2]).max(axis=1) <= config.sensor.max_range_m)
            scan = scan_objects(
                offsets[rows] @ T_world_body[:3, :3],
                class_indices[rows],
                len(vocabulary),
                config.sensor,
                rngs,
            )
            true_ids = tuple("" if source < 0 else world.object_ids[rows[source]] for source in scan.sources.tolist())
            yield ODOMETRY_TOPIC, stamp_ns, Odometry(stamp_ns, T_odom_body[i])
            yield DETECTIONS_TOPIC, stamp_ns, _detections(stamp_ns, scan, vocabulary, config)
            yield GROUND_TRUTH_TOPIC, stamp_ns, GroundTruthPose(stamp_ns, T_world_body)
            yield DETECTION_TRUTH_TOPIC, stamp_ns, DetectionTruth(stamp_ns, true_ids)


def _detections(stamp_ns: int, scan: Scan, vocabulary: Sequence[str], config: SimulationConfig) -> ObjectDetections:
    labels = tuple(vocabulary[k] for k in scan.class_indices.tolist())
    covariances = scan.sigmas_m[:, None, None] ** 2 * np.eye(3) if config.sensor.covariances else None
    return ObjectDetections(stamp_ns, "base_link", scan.positions, labels, scan.scores, covariances)
