"""Maps as drives along parts of a tour would leave them behind, without a replay."""

import numpy as np

from logs.messages import FactorGraphRecord, ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.geometry import apply, invert, transform_from_xyz_yaw, travelled_m
from slam.object_map.map_io import SavedMap
from slam.simulation.street_grid import generate_street_grid
from slam.simulation.world import World
from tests.helpers.landmarks import spheres

STEP_M, RANGE_M, NOISE_M = 2.0, 30.0, 0.05


def town(seed: int = 1) -> World:
    return generate_street_grid(rng=np.random.default_rng(seed))


def drive_poses(world: World, from_m: float, to_m: float) -> FloatArray:
    """True poses (K, 4, 4) on a part of the tour, driven backwards if it ends before it begins."""
    along = travelled_m(world.tour)
    at = np.arange(from_m, to_m, STEP_M if to_m > from_m else -STEP_M)
    xy = np.column_stack([np.interp(at, along, world.tour[:, axis]) for axis in (0, 1)])
    steps = np.gradient(xy, axis=0)
    return transform_from_xyz_yaw(np.column_stack([xy, np.zeros(len(xy))]), np.arctan2(steps[:, 1], steps[:, 0]))


def driven_map(world: World, from_m: float, to_m: float, *, seed: int = 0) -> SavedMap:
    """The map of a drive; its frame is that of the first pose. Landmarks have the ids of the objects."""
    rng = np.random.default_rng(seed)
    T_world_body = drive_poses(world, from_m, to_m)
    T_map_body = invert(T_world_body[0]) @ T_world_body
    noisy = apply(invert(T_world_body[0]), world.positions) + rng.normal(0.0, NOISE_M, world.positions.shape)
    offsets = world.positions[None, :, :2] - T_world_body[:, None, :2, 3]
    keyframes, objects = np.nonzero(np.hypot(offsets[..., 0], offsets[..., 1]) < RANGE_M)
    seen = np.unique(objects)
    T_body_map = invert(T_map_body[keyframes])
    positions = np.einsum("nij,nj->ni", T_body_map[:, :3, :3], noisy[objects]) + T_body_map[:, :3, 3]
    count = len(T_map_body)
    stamps_ns = np.arange(count) * 250_000_000
    vocabulary = world.vocabulary
    classes = [vocabulary.index(world.labels[row]) for row in seen.tolist()]
    ids = [world.object_ids[row] for row in seen.tolist()]
    end_ns = int(stamps_ns[-1])
    record = ObjectMapRecord.of_objects(
        ids, noisy[seen], classes, vocabulary, stamp_ns=end_ns, sigma_m=NOISE_M, observations=9
    )
    graph = FactorGraphRecord(
        stamp_ns=end_ns,
        keyframe_ids=np.arange(count),
        keyframe_stamps_ns=stamps_ns,
        T_map_body=T_map_body,
        edge_keyframe_ids=np.column_stack([np.arange(count - 1), np.arange(1, count)]),
        edge_transforms=invert(T_map_body[:-1]) @ T_map_body[1:],
        edge_covariances=np.tile(np.diag([1e-5, 1e-5, 1e-5, 1e-3, 1e-3, 1e-3]), (count - 1, 1, 1)),
        edge_kinds=("odometry",) * (count - 1),
        observation_keyframe_ids=keyframes,
        observation_landmark_ids=tuple(world.object_ids[row] for row in objects.tolist()),
        observation_positions=positions,
        observation_covariances=spheres(0.1, len(objects)),
    )
    return SavedMap(record, graph)
