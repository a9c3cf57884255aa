"""One record of every kind, with numbers that have no short decimal form."""

import dataclasses

import numpy as np

from logs import messages as m
from tests.helpers.poses import motion_by


def random_transform(rng):
    return motion_by(rng.normal(scale=2.0, size=3), rng.normal(scale=50.0, size=3))


def random_covariance(rng, size):
    A = rng.normal(size=(size, size))
    return A @ A.T + 0.1 * np.eye(size)


def transforms(rng, count):
    return np.stack([random_transform(rng) for _ in range(count)])


def covariances(rng, count, size):
    return np.stack([random_covariance(rng, size) for _ in range(count)])


def random_detections(rng, count, *, full=True, stamp_ns=1):
    return m.ObjectDetections(
        stamp_ns=stamp_ns,
        frame_id="lidar",
        positions=rng.normal(size=(count, 3)),
        labels=tuple(f"class {i % 3}" for i in range(count)),
        scores=rng.uniform(size=count),
        covariances=covariances(rng, count, 3) if full else None,
    )


def every_kind(rng):
    """(topic, kind, record) of every kind of record that can be read back."""
    k, e, o, n = 4, 5, 6, 7
    return [
        ("/odom", "odometry", m.Odometry(10, random_transform(rng), "odom", "base")),
        ("/odom", "odometry", m.Odometry(11, random_transform(rng))),
        ("/detections", "detections", random_detections(rng, n, stamp_ns=12)),
        ("/detections", "detections", random_detections(rng, n, full=False, stamp_ns=13)),
        ("/tf", "transforms", m.Transform(14, "map", "odom", random_transform(rng))),
        ("/ground_truth", "ground_truth", m.GroundTruthPose(15, random_transform(rng), "utm")),
        ("/ground_truth/detections", "detection_truth", m.DetectionTruth(16, ("a", "", "b"))),
        ("/slam/associations", "associations", m.DetectionAssociations(17, ("", "L1"), np.array([True, False]))),
        ("/slam/pose", "slam_pose", m.SlamPose(18, random_transform(rng))),
        (
            "/slam/map",
            "object_map",
            m.ObjectMapRecord(
                stamp_ns=19,
                frame_id="map",
                vocabulary=("tree", "pole"),
                ids=tuple(f"L{i}" for i in range(n)),
                positions=rng.normal(size=(n, 3)),
                covariances=covariances(rng, n, 3),
                class_probabilities=rng.dirichlet([1.0, 1.0], size=n),
                states=("confirmed",) * (n - 1) + ("retired",),
                reasons=("",) * (n - 1) + ("merged into L0",),
                observation_counts=rng.integers(0, 100, size=n),
                first_seen_ns=rng.integers(0, 2**62, size=n),
                last_seen_ns=rng.integers(0, 2**62, size=n),
                merged_into=("",) * (n - 1) + ("L0",),
            ),
        ),
        (
            "/slam/full_trajectory",
            "trajectory",
            m.TrajectoryRecord(20, "map", rng.integers(0, 2**62, size=n), transforms(rng, n)),
        ),
        (
            "/slam/graph",
            "factor_graph",
            m.FactorGraphRecord(
                stamp_ns=21,
                keyframe_ids=np.arange(k),
                keyframe_stamps_ns=rng.integers(0, 2**62, size=k),
                T_map_body=transforms(rng, k),
                edge_keyframe_ids=rng.integers(0, k, size=(e, 2)),
                edge_transforms=transforms(rng, e),
                edge_covariances=covariances(rng, e, 6),
                edge_kinds=("odometry",) * (e - 1) + ("closure",),
                observation_keyframe_ids=rng.integers(0, k, size=o),
                observation_landmark_ids=tuple(f"L{i}" for i in range(o)),
                observation_positions=rng.normal(size=(o, 3)),
                observation_covariances=covariances(rng, o, 3),
                pose_covariances=covariances(rng, k, 6),
            ),
        ),
        (
            "/slam/closures",
            "loop_closures",
            m.LoopClosureRecord(
                stamp_ns=22,
                query_keyframe_id=7,
                reference_keyframe_id=3,
                accepted=True,
                stage="accepted",
                reason="",
                inlier_count=9,
                score=1.5,
                T_reference_query=random_transform(rng),
                covariance=random_covariance(rng, 6),
                reference_stamp_ns=11,
                inserted=True,
                log_likelihood_ratio=21.5,
                odometry_penalty=0.0,
                posterior_log_odds=24.25,
                seed_query_keyframe_id=0,
            ),
        ),
        ("/slam/closures", "loop_closures", m.LoopClosureRecord(23, 7, 4, False, "retrieval", "too far")),
        ("/slam/status", "status", m.StatusRecord(26, "mapping", "info", "fine", {"keyframes": 3, "closures": 1})),
    ]


def assert_same_record(actual, expected, tolerance=1e-12):
    assert type(actual) is type(expected)
    for field in dataclasses.fields(expected):
        a, b = getattr(actual, field.name), getattr(expected, field.name)
        if isinstance(b, np.ndarray):
            assert a.dtype == b.dtype
            np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance, err_msg=field.name)
        else:
            assert a == b, field.name
