"""A prior map as segment 0 of the odometry: relocalization in it is a closure across a discontinuity."""

import numpy as np

from logs.reader import LogReader
from logs.storage.regular_file import AnyPath
from slam.backend.factor_graph import FactorGraph
from slam.backend.graph_record import edges_of, observations_of
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.object_map.landmarks import ObjectMap
from slam.object_map.map_io import IMPORTED, METADATA, SavedMap, load_map
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose
from slam.place_recognition.imported_map import ImportedMap, load_imported_map
from slam.place_recognition.imported_places import HEIGHT_SIGMA_M, SEGMENT, TRAVEL_M, ImportedPlaces, is_flat

PriorMap = SavedMap | ImportedMap
"""A map that drives made, or a landmark-only map without a trajectory."""


def load_prior_map(path: AnyPath) -> PriorMap:
    """Read a map of either kind: saved by a replay, or imported or made by a fleet.

    Raises:
        LogError: no MCAP file.
        SavedMapError: a log that is no map, of another format version, damaged, empty, or inconsistent.
    """
    with LogReader(path) as reader:
        is_imported = reader.metadata().get(METADATA, {}).get("kind") == IMPORTED
    return load_imported_map(path) if is_imported else load_map(path)


def with_heights_of(config: Config, prior_map: PriorMap | None) -> Config:
    """The configuration by which a drive is registered with a map: one without heights tells nothing of these.

    Raises:
        InputDataError: it is no map.
    """
    if not isinstance(prior_map, PriorMap | None):
        raise InputDataError(f"not a map: {prior_map!r}; load_map reads one from a file")
    if not isinstance(prior_map, ImportedMap) or not is_flat(prior_map):
        return config
    return config.calibrated({"objects.height_sigma_m": HEIGHT_SIGMA_M})


def restore_prior_map(
    prior_map: PriorMap | None, object_map: ObjectMap, graph: FactorGraph, *, fixed: bool
) -> tuple[list[Keyframe], ImportedPlaces | None]:
    """Put a map of either kind into an empty object map and an empty graph.

    ``fixed``: keep the map as it is: its keyframes and landmarks are constants, and its factors are not restored.
    Returns its keyframes, renumbered from 0, and the places of one without a trajectory; without a map none.
    """
    if prior_map is None:
        return [], None
    if isinstance(prior_map, ImportedMap):
        graph.add_fixed_keyframe(0, np.eye(4))
        return [map_frame(0)], ImportedPlaces(prior_map, object_map, graph, is_fixed=fixed)
    objects, record = prior_map.objects, prior_map.graph
    rows = object_map.restore(objects, travel_m=TRAVEL_M)
    if fixed:
        for number, T_map_body in enumerate(record.T_map_body):
            graph.add_fixed_keyframe(number, T_map_body)
        positions = dict(zip(rows.tolist(), objects.positions, strict=True))
        graph.add_known_landmarks(positions, np.full(3, graph.prior_sigma_m), is_fixed=True)
    else:
        landmarks = dict(zip(objects.ids, rows.tolist(), strict=True))
        observed = set(record.observation_landmark_ids)
        for name, position, covariance in zip(objects.ids, objects.positions, objects.covariances, strict=True):
            if name not in observed:  # only keyframes that are not in the map saw it
                graph.add_known_landmarks({landmarks[name]: position}, np.sqrt(np.diag(covariance)), is_fixed=False)
        number_of = {keyframe: number for number, keyframe in enumerate(record.keyframe_ids.tolist())}
        edges, observations = edges_of(record, number_of), observations_of(record, number_of, landmarks)
        graph.restore(record.T_map_body, edges, observations)
    keyframes = [
        Keyframe(number, _prior_pose(T_map_body), T_map_body, is_prior=True)
        for number, T_map_body in enumerate(record.T_map_body)
    ]
    return keyframes, None


def map_frame(number: int) -> Keyframe:
    """The frame of a map without a trajectory as a keyframe and a segment of that number, at the origin of the map."""
    return Keyframe(number, _prior_pose(np.eye(4), number), np.eye(4), is_prior=True, is_map_frame=True)


def _prior_pose(T_map_body: FloatArray, segment: int = SEGMENT) -> OdometryPose:
    # The clocks of the drives are unrelated.
    return OdometryPose(-1, T_map_body, TRAVEL_M, segment, np.inf)
