"""Observations on their way from the scans into the factor graph."""

from __future__ import annotations

from collections import defaultdict

from slam.backend.factors import Observation
from slam.backend.solver_options import GROUP_KEYFRAMES
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.frontend.input.scan import Scan
from slam.frontend.keyframe_observations import KeyframeObservations
from slam.frontend.observation_group import ObservationGroup
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.keyframe import Keyframe


class PendingObservations:
    """Observations since the last keyframe, from the keyframes since the last group, and of tentative landmarks."""

    def __init__(self, config: Config, object_map: ObjectMap) -> None:
        self._detection = config.calibration.detection
        self._map = object_map
        self._since_keyframe = KeyframeObservations()
        self._group = ObservationGroup(config.calibration.odometry)
        self._held_back: defaultdict[int, list[Observation]] = defaultdict(list)

    def add(self, rows: IntArray, scan: Scan) -> None:
        """Add what a scan, given in the frame of the last keyframe, saw of the landmarks ``rows`` (N,), none twice."""
        self._since_keyframe.add(rows, scan)

    def drop(self, row: int) -> None:
        """Forget what is held back of a landmark."""
        self._held_back.pop(row, None)

    def close(self, keyframe: Keyframe, T_local_body: FloatArray, *, ends_group: bool) -> list[Observation]:
        """The observations for the graph once a keyframe has all of them; those of tentative landmarks wait.

        ``T_local_body`` (4, 4): where the landmarks have the keyframe by then.
        """
        for observation in self._grouped(keyframe, T_local_body, ends_group=ends_group):
            self._held_back[observation.landmark].append(observation)
        ready = list[Observation]()
        rows = sorted(self._held_back)
        for row, state in zip(rows, self._map.rows["state"][rows].tolist(), strict=True):
            if state == LandmarkState.CONFIRMED:
                ready += self._held_back.pop(row)
            elif state == LandmarkState.RETIRED:
                del self._held_back[row]
        return ready

    def _grouped(self, keyframe: Keyframe, T_local_body: FloatArray, *, ends_group: bool) -> list[Observation]:
        """The observations of the groups of keyframes that end with a keyframe or before it."""
        observations = self._since_keyframe.observations(keyframe.id, self._detection)
        self._since_keyframe = KeyframeObservations()
        ended = self._group.take() if self._group.ends_before(keyframe) else []
        self._group.add(keyframe, T_local_body, observations)
        if ends_group or keyframe.id % GROUP_KEYFRAMES == 0:
            ended += self._group.take()
        return ended
