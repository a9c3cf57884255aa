"""Prior of the pose of a query before registration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import invert
from slam.localization.map_area import MapArea
from slam.localization.pose_prior import PosePrior, failure_probability
from slam.loop_closure.candidate import NOWHERE, Query
from slam.loop_closure.consistency import CLOSURE_SIGMA_RAD
from slam.object_map.submap import gravity_frame
from slam.odometry.drift import KeyframeTrack
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import SLIP_INFLATION
from slam.place_recognition.place import Place


class QueryPriors:
    """Priors of the poses of queries.

    ``mapped`` (N, 2) m are the objects of a map without keyframes, ``cell_m`` is the resolution of the area that is
    mapped.
    """

    def __init__(
        self,
        config: Config,
        track: KeyframeTrack,
        graph: FactorGraph,
        keyframes: Sequence[Keyframe],
        mapped: FloatArray,
        *,
        cell_m: float,
    ) -> None:
        self._config = config
        self._track = track
        self._graph = graph
        self._keyframes = keyframes
        self._area = MapArea(cell_m=cell_m)
        self._area.cover_positions(mapped)

    def prior(self, query: Query, place: Place, reference: Keyframe, seed_closure: int) -> PosePrior:
        """The prior of the query's pose: by the odometry since the seed closure, or else since the reference."""
        self._area.cover(self._keyframes)
        T_local_query = place.T_local_query
        since = seed_closure
        if seed_closure == NOWHERE:
            since = reference.id
            T_predicted = invert(self._graph.pose(reference.id)) @ self._graph.pose(query.keyframe.id)
            T_gravity_body = invert(query.T_local_gravity) @ query.keyframe.T_local_body
            T_local_query = gravity_frame(reference.T_local_body @ T_predicted @ invert(T_gravity_body))
        sigma_m, sigma_rad = self._track.drift_sigmas(*sorted((since, query.keyframe.id)))
        travel_m = abs(query.travel_m - self._keyframes[since].odometry.travel_m)
        return PosePrior(
            T_local_query,
            float(np.hypot(SLIP_INFLATION * sigma_m, self._config.calibration.objects.landmark_sigma_m)),
            float(np.hypot(SLIP_INFLATION * sigma_rad, CLOSURE_SIGMA_RAD)),
            failure_probability(self._config.localization.failures_per_km, travel_m),
            self._area.area_m2,
        )
