"""A drive through a world as the records of a log."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from logs.importers.imported_log import DriveRecord, DriveSummary, write_drive
from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, ObjectMapRecord, Odometry
from slam.common.arrays import FloatArray
from slam.common.config_tree import CHANGED_SETTINGS, changed_settings
from slam.common.errors import SimulationError
from slam.common.geometry import invert, transform_from_xyz_yaw, yaw_rad
from slam.simulation.config import OdometryConfig, SimulationConfig
from slam.simulation.drive import START_NS, Drive, DrivePlan, plan_drive
from slam.simulation.sensor import scan_objects
from slam.simulation.world import World

CAUSES = ("odometry", "position", "dropout", "label", "score", "false_positive")
"""Each has random numbers of its own; the order is part of what a seed means, so new causes go to the end."""


def simulate(world: World, config: SimulationConfig, *, seed: int) -> Iterator[DriveRecord]:
    """Drive the tour of ``world``: records in the order of time.

    First the true objects (those that stand still), frame "world"; then, for each scan,
    odometry (which starts at the identity), detections in the body frame "base_link", the true pose, and the true id of
    each detection. After a kidnapping the odometry starts at the identity again, unless it was silent. The same world,
    configuration and seed give the same records; each cause of error has its own random numbers.

    Raises:
        SimulationError: a kidnapping outside the tour, or a tour too short; raised at the call.
    """
    rngs = dict(zip(CAUSES, np.random.default_rng(seed).spawn(len(CAUSES)), strict=True))
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
    return write_drive(path, records, made, "simulation")


def _drives(plan: DrivePlan, config: SimulationConfig) -> list[Drive]:
    start_ns, kidnap = START_NS + config.drive.start_day * 86_400 * 10**9, config.kidnap
    if kidnap is None:
        drives = [plan.sample(0.0, plan.length_m, start_ns=start_ns)]
    else:
        first_m = max(kidnap.from_m - (kidnap.before_m or np.inf), 0.0)
        last_m = min(kidnap.to_m + (kidnap.after_m or np.inf), plan.length_m)
        before = plan.sample(first_m, kidnap.from_m, start_ns=start_ns)
        gap_s = 1.0 / config.drive.rate_hz if kidnap.silent else kidnap.gap_s
        resume_ns = int(before.stamps_ns[-1]) + round(gap_s * 1e9)
        drives = [before, plan.sample(kidnap.to_m, last_m, start_ns=resume_ns)]
    fewest = min(len(drive.stamps_ns) for drive in drives)
    if fewest < 2:
        raise SimulationError(
            f"a tour of {plan.length_m:g} m whose shortest stretch has {fewest} scans is too short; give it at least "
            "two scans, also before and after a kidnapping (drive.rate_hz scans per second)"
        )
    return drives


def _records(
    world: World, config: SimulationConfig, drives: list[Drive], rngs: Mapping[str, np.random.Generator]
) -> Iterator[DriveRecord]:
    vocabulary, class_indices = world.vocabulary, np.searchsorted(world.vocabulary, world.labels)
    start_ns = int(drives[0].stamps_ns[0])
    yield ObjectMapRecord.of_objects(
        world.object_ids, world.positions, class_indices, vocabulary, stamp_ns=start_ns, frame_id="world"
    )
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
                offsets[rows] @ T_world_body[:3, :3], class_indices[rows], len(vocabulary), config.sensor, rngs
            )
            labels = tuple(vocabulary[k] for k in scan.class_indices.tolist())
            covariances = scan.sigmas_m[:, None, None] ** 2 * np.eye(3) if config.sensor.covariances else None
            true_ids = tuple("" if source < 0 else world.object_ids[rows[source]] for source in scan.sources.tolist())
            yield Odometry(stamp_ns, T_odom_body[i])
            yield ObjectDetections(stamp_ns, "base_link", scan.positions, labels, scan.scores, covariances)
            yield GroundTruthPose(stamp_ns, T_world_body)
            yield DetectionTruth(stamp_ns, true_ids)


def drifting_odometry(T_world_body: FloatArray, config: OdometryConfig, *, rng: np.random.Generator) -> FloatArray:
    """Odometry ``T_odom_body`` (K, 4, 4), metres, of the true planar poses ``T_world_body`` (K, 4, 4); K >= 1.

    It starts at the identity. Of each true step with path length d, turn a and translation t in the frame of the pose
    that it leaves, the odometry measures the turn ``a + n`` and the translation ``(1 + e) t``, and adds these up:

    * n ~ N(0, sigma_h^2 d / 100 m), independent: the heading error is a random walk, its rms after 100 m of path is
      sigma_h = ``heading_drift_deg_per_100m``, and it grows with the root of the path.
    * e is a stationary Gauss-Markov process over the path with the correlation exp(-s / c), c =
      ``scale_correlation_m``: the error of length, the integral of e, is a random walk over distances well above c, and
      smooth below. Its standard deviation is set so that the rms error of length over 100 m of path is p =
      ``scale_drift_percent`` of it: ``Var = sigma_e^2 2 c^2 (L/c - 1 + exp(-L/c)) = (p L)^2`` at L = 100 m.

    On a straight 100 m the heading's walk adds a lateral rms of 100 m times sigma_h / sqrt(3), 0.5 m by default.
    While the body stands, or turns on the spot, nothing drifts. z, roll and pitch have no error.
    """
    step = invert(T_world_body[:-1]) @ T_world_body[1:]  # (K - 1, 4, 4) T_previous_next
    path_m = np.linalg.norm(step[:, :3, 3], axis=1)
    # Both streams are always drawn, so that one drift does not change with the other's setting.
    heading_normals, scale_normals = rng.standard_normal((2, len(step)))
    sigma_heading = np.deg2rad(config.heading_drift_deg_per_100m)
    turn = yaw_rad(step) + heading_normals * sigma_heading * np.sqrt(path_m / 100.0)
    translation = step[:, :2, 3] + step[:, :2, 3] * _scale_errors(path_m, scale_normals, config)[:, None]
    heading = np.concatenate([[0.0], np.cumsum(turn)])  # (K,)
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    moved = np.stack(
        [c * translation[:, 0] - s * translation[:, 1], s * translation[:, 0] + c * translation[:, 1]], axis=1
    )
    xyz = np.zeros((len(T_world_body), 3))
    xyz[1:, :2] = np.cumsum(moved, axis=0)
    return transform_from_xyz_yaw(xyz, heading)


def _scale_errors(path_m: FloatArray, normals: FloatArray, config: OdometryConfig) -> FloatArray:
    # Errors that are correlated over c add up over 100 m to as many metres as percent.
    c = config.scale_correlation_m
    sigma = config.scale_drift_percent / np.sqrt(2.0 * c**2 * (100.0 / c + np.expm1(-100.0 / c)))
    kept = np.exp(-path_m / c)
    errors = np.sqrt(-np.expm1(-2.0 * path_m / c)) * normals
    errors[:1] = normals[:1]
    for i in range(1, len(errors)):
        errors[i] += kept[i] * errors[i - 1]
    return sigma * errors
