"""Localization of a single scan in a map: a query submap of one scan, without odometry.

The stages are those of a closure in a prior map: retrieval proposes places, :class:`Verifier` registers the scan there,
and :class:`Acceptance` accepts the likeliest of them once its posterior probability of being wrong is small enough. The
prior is uniform over the map, and the alternatives are the other candidates and "not in the map".
"""

from collections.abc import Sequence

import numpy as np

from logs.messages import ObjectDetections, ObjectMapRecord
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.localization.prior_map import map_frame
from slam.loop_closure.acceptance import Acceptance, Decision
from slam.loop_closure.candidate import Query, Verified
from slam.loop_closure.verification import Verifier
from slam.object_map.landmarks import ObjectMap
from slam.object_map.submap import Submap
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose
from slam.place_recognition.imported_places import TRAVEL_M
from slam.place_recognition.retrieval import PlaceRetriever
from slam.registration.registration import MIN_OBJECTS, Registration


class ScanLocalization(Registration):
    """``T_reference_query`` (4, 4) = ``T_map_scan`` with its covariance (6, 6), rotation first; None where the scan is
    not localized, and the ``reason`` why.

    ``pairs`` (K, 2): inliers, as indices of the scan's detections and of the map's landmarks.
    """

    @property
    def found(self) -> bool:
        """Whether there is a pose."""
        return self.T_reference_query is not None


class ScanLocalizer:
    """Finds single scans in a map, without odometry. Reuse one for many scans: it holds the index of the map."""

    def __init__(self, objects: ObjectMapRecord | Sequence[ObjectMapRecord], config: Config | None = None) -> None:
        """Index all landmarks of a map, or of several, each of which has a frame and a segment of its own.

        Raises:
            InputDataError: the map is empty.
            DescriptorError: there is no such descriptor.
        """
        maps = [objects] if isinstance(objects, ObjectMapRecord) else objects
        config = Config() if config is None else config
        self._objects = config.calibration.objects
        object_map = ObjectMap(config.calibration.objects)
        for number, each in enumerate(maps):
            object_map.restore(each, travel_m=TRAVEL_M, segment=number)
        self._size = len(object_map)
        if not self._size:
            raise InputDataError("the map holds no confirmed landmark, so no scan can be localized in it")
        self._number = {label: number for number, label in enumerate(object_map.labels.vocabulary)}
        # The scan is a keyframe, and those before it are the frames of the maps.
        self._scan = Keyframe(len(maps), OdometryPose(0, np.eye(4), 0.0, len(maps), np.inf), np.eye(4))
        keyframes = [*map(map_frame, range(len(maps))), self._scan]
        self._retriever = PlaceRetriever(config, object_map)
        self._retriever.index_inactive_landmarks(self._scan.odometry)
        mapped = [each.positions[:, :2] for each in maps]
        self._verifier = Verifier(config, self._retriever, keyframes, lambda number: np.eye(4), None, mapped)
        self._acceptance = Acceptance(config, self._verifier)

    def localize(self, scan: ObjectDetections) -> ScanLocalization:
        """The pose of the scan in the map, or the reason why there is none.

        Args:
            scan: detections in a frame whose z points up, such as the body of a robot on level ground. Objects of
                classes that the map does not have are left out.
        """
        query = self.query(scan)
        verified = self.propose(query)
        if len(query.submap) < MIN_OBJECTS:
            return ScanLocalization.not_found(
                f"{len(query.submap)} objects of classes of the map, a pose needs {MIN_OBJECTS}"
            )
        if not verified:
            return ScanLocalization.not_found("no matches that agree on a place")
        decision = self.decide(query, verified)
        best = decision.accepted
        if best is None:
            return ScanLocalization.not_found(decision.rejected[-1].reason)
        pairs = best.pairs - np.array([self._size, 0])
        return ScanLocalization(best.T_local_query, best.covariance, pairs, "")

    def query(self, scan: ObjectDetections) -> Query:
        """The query submap of one scan: its objects of classes of the map, numbered after the landmarks of the map."""
        known = np.flatnonzero([label in self._number for label in scan.labels])
        positions = scan.positions[known]
        distances_m = np.hypot(*positions[:, :2].T)
        sigmas = np.hypot(self._objects.landmark_sigma_m, self._objects.landmark_sigma_per_m * distances_m)
        labels = np.array([self._number[scan.labels[row]] for row in known.tolist()], dtype=np.int64)
        return Query(self._scan, Submap(positions, sigmas, labels, self._size + known), np.eye(4), before_m=0.0)

    def propose(self, query: Query) -> list[Verified]:
        """The candidates at the places that retrieval proposes, as for a drive, or the reasons why there is none."""
        places = self._retriever.propose(query.submap, before_m=query.before_m)
        return [self._verifier.verify(query, place) for place in places]

    def decide(self, query: Query, verified: Sequence[Verified]) -> Decision:
        """The accepted candidate, if there is one; the reason of the likeliest one comes last."""
        return self._acceptance.decide(query, verified)
