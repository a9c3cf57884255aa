"""The SLAM system: input records in, estimates out.

``Slam.process`` is where to begin reading.
"""

from __future__ import annotations

import heapq
import logging
import time
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from logs.messages import (
    FactorGraphRecord,
    GeodeticFix,
    LoopClosureRecord,
    ObjectDetections,
    ObjectMapRecord,
    Odometry,
    Record,
    RelocalizationRecord,
    SceneMarkers,
    SlamPose,
    StatusRecord,
    TrajectoryRecord,
    Transform,
)
from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.errors import FactorGraphError, InputDataError
from slam.common.geometry import invert
from slam.display.snapshot import MapSnapshot, take_snapshot
from slam.frontend.continuity import decide
from slam.frontend.input.sensor_frames import SensorFrames, corrected
from slam.frontend.mapper import Mapper
from slam.frontend.scan import make_scan
from slam.localization.gnss import GnssPrior
from slam.localization.prior_map import PriorMap, restore, restore_map_frame, with_heights_of
from slam.localization.state import Fix, State
from slam.loop_closure.landmark_fusion import fuse_duplicate_landmarks
from slam.loop_closure.loop_closer import LoopCloser
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.interpolation import interpolate_between_keyframes
from slam.odometry.keyframe import Keyframe
from slam.odometry.path import OdometryPath
from slam.odometry.pose import OdometryPose
from slam.odometry.track import OdometryTrack
from slam.odometry.unexpected_step import Continuation, Correction, UnexpectedStep
from slam.place_recognition.imported_map import ImportedMap
from slam.place_recognition.imported_places import SEGMENT, ImportedPlaces
from slam.place_recognition.place_prior import PlacePrior

logger = logging.getLogger(__name__)

MAP_FRAME = "map"
CONTRADICTED = "localization lost: observations are inconsistent with the map"


@dataclass(frozen=True, slots=True, eq=False)
class FinalMap:
    """Results of a drive. ``closures``: those removed at the end as outliers."""

    trajectory: TrajectoryRecord
    object_map: ObjectMapRecord
    graph: FactorGraphRecord
    closures: tuple[LoopClosureRecord, ...]
    markers: SceneMarkers
    snapshot: MapSnapshot
    status: StatusRecord


class Slam:
    """Maps a drive, record by record. The same records and configuration give the same results."""

    def __init__(
        self,
        config: Config,
        prior_map: PriorMap | None = None,
        *,
        extend: bool = True,
        place_prior: PlacePrior | None = None,
        frames: SensorFrames | None = None,
    ) -> None:
        """``prior_map``: a map to localize in; ``extend``: update it instead of keeping it fixed; ``place_prior``:
        where in it the robot starts.

        ``frames``: where the sensors sit, as far as it is known before the drive; transforms add to it.
        """
        self._config = config = with_heights_of(config, prior_map)
        self.counters: Counter[str] = Counter()
        self._first_segment = 0 if prior_map is None else SEGMENT + 1
        self._track = OdometryTrack(
            config.odometry,
            self.counters,
            first_segment=self._first_segment,
            sensor_range_m=config.detection.sensor_range_m,
        )
        self._frames = frames or SensorFrames()
        self._object_map = ObjectMap(config.association)
        self._graph = FactorGraph(config.factor_graph, sensor_range_m=config.detection.sensor_range_m)
        known, imported = list[Keyframe](), None
        if isinstance(prior_map, ImportedMap):
            known = [restore_map_frame(self._graph)]
            imported = ImportedPlaces(prior_map, self._object_map, self._graph, is_fixed=not extend)
        elif prior_map is not None:
            known = restore(prior_map, self._object_map, self._graph, fixed=not extend)
        self._first_keyframe = len(known)
        self._extends = extend
        self._mapper = Mapper(config, self._object_map, self._graph, known)
        self._closer = LoopCloser(config, self._object_map, self._graph, self._mapper.keyframes, imported)
        self._closer.place_prior = place_prior
        self._gnss: GnssPrior | None = None
        if isinstance(prior_map, ImportedMap) and prior_map.georeference is not None and place_prior is None:
            self._gnss = GnssPrior(prior_map.georeference)
        self._waiting: list[tuple[int, int, ObjectDetections]] = []
        self._arrivals = 0
        self._odometry_offset_ns = round(config.odometry.time_offset_s * 1e9)
        self._time_offset_ns = round(config.detection.time_offset_s * 1e9)
        self._last_scan_ns = self._judged_ns = -1
        self._last_scan_frames: set[str] = set()
        self._body_frame = ""
        self._odom_frame = ""
        self._frames_missing: set[str] = set()
        self._path = OdometryPath()
        self._T_map_odom = np.eye(4)
        self._is_kidnapped = False
        self._state = State.MAPPING if prior_map is None else State.LOST
        self._keyframes_shown = self._first_keyframe
        self.fixes: list[Fix] = []
        self.closing_seconds: list[float] = []
        """Time that looking for loops took, keyframe by keyframe."""

    @property
    def first_stamp_ns(self) -> int:
        """When the drive began."""
        return self._path.first_stamp_ns

    @property
    def state(self) -> State:
        """The localization state of the robot."""
        return self._state

    @property
    def solver_seconds(self) -> float:
        """Time spent inside GTSAM so far."""
        return self._graph.solver_seconds

    def process(self, record: Record) -> list[Record]:
        """Take in the next record in the order of the log; returns what it made known."""
        if isinstance(record, Transform):
            self._frames.add(record)
        elif isinstance(record, GeodeticFix):
            if self._gnss is not None and self._path.latest is not None:
                self._closer.place_prior = self._gnss.add(record, self._path.latest.travel_m)
        elif isinstance(record, ObjectDetections):
            # In the order of their stamps, so that a single stamp from the future holds up nothing.
            heapq.heappush(self._waiting, (record.stamp_ns + self._time_offset_ns, self._arrivals, record))
            self._arrivals += 1
        elif isinstance(record, Odometry):
            return self._follow(replace(record, stamp_ns=record.stamp_ns + self._odometry_offset_ns))
        return self._map_waiting_scans()

    def snapshot(self) -> MapSnapshot | None:
        """The map as it is known now, for viewers; None if no keyframe has brought it up to date since the last one."""
        keyframes = self._mapper.keyframes
        if len(keyframes) == self._keyframes_shown or keyframes[-1].id % self._config.factor_graph.update_keyframes:
            return None
        self._keyframes_shown = len(keyframes)
        return self._snapshot()

    def _snapshot(self) -> MapSnapshot:
        return take_snapshot(
            self._mapper.keyframes,
            self._object_map,
            self._graph,
            self._closer.closures.keyframes,
            self._closer.closures.is_localized,
            self._config.submap,
        )

    def finish(self) -> FinalMap:
        """Close the last keyframe, optimise everything at once and hand out the result.

        Raises:
            InputDataError: there was nothing to map.
        """
        for pose in self._track.finish():
            self._step(pose)
        self._map_waiting_scans()
        if len(self._mapper.keyframes) == self._first_keyframe:
            raise InputDataError(
                "no odometry message was usable, so there is nothing to map; see 'dslam info' of the log"
            )
        if self._frames_missing and not self.counters["detections_used"]:
            raise InputDataError(
                f"{self._describe_missing()}, the body frame of the odometry, so no detection could be placed; record "
                "/tf_static, or say --set detection.assume_body_frame=true if the detections are in the body frame"
            )
        self.counters["detections_without_odometry"] += len(self._waiting)
        self._mapper.close_keyframe()
        self._graph.settle()
        removed, warning = self._closer.closures.reject_outliers()
        if self._first_keyframe and self._extends:
            self._mapper.retire_gone(self._closer.missing_landmarks())
        if self._extends:
            self._fuse_duplicate_landmarks()
        optimization = self._graph.optimize()
        self.counters["batch_iterations"] = optimization.iterations
        message = "optimised" if optimization.converged else (
            f"the final optimisation did not converge in {optimization.iterations} iterations"
        )  # fmt: skip
        if warning:
            message += f"; closures: {warning}"
        unused = self.counters["odometry_out_of_order"] + self.counters["odometry_duplicated"]
        if unused > self.counters["odometry_used"]:
            message += "; most odometry messages were unusable: their stamps do not increase"
        object_map = self._map_record()
        self.counters["labels_beyond_max_classes"] += self._object_map.unlisted_labels
        self.counters["closures_removed"] = len(removed)
        self.counters["closures_rejected_by_odometry"] = self._closer.rejected_by_odometry_count
        is_well = optimization.converged and not warning and unused <= self.counters["odometry_used"]
        level = "info" if is_well and not self.counters["covariances_missing"] else "warning"
        confirmed = self._object_map.in_state(LandmarkState.CONFIRMED)
        return FinalMap(
            trajectory=self._trajectory(),
            object_map=object_map,
            graph=self._graph_record(),
            closures=tuple(removed),
            markers=self._markers(confirmed),
            snapshot=self._snapshot(),
            status=self._status(message, level=level),
        )

    def _fuse_duplicate_landmarks(self) -> None:
        """Merge landmarks that are duplicates in the optimised map."""
        self.counters["landmarks_fused"] = fuse_duplicate_landmarks(
            self._object_map,
            self._graph,
            self._closer.closures.keyframes_nearby(),
            radius_m=2.0 * self._config.submap.landmark_sigma_m,
        )

    def _follow(self, odometry: Odometry) -> list[Record]:
        self._body_frame, self._odom_frame = odometry.child_frame_id, odometry.frame_id
        updates = [update for pose in self._track.add(odometry) for update in self._step(pose)]
        while (step := self._track.unexpected) is not None and (way := self._way_on(step)) is not None:
            self._judged_ns = -1
            updates += [update for pose in self._track.resolve(*way) for update in self._step(pose)]
        return updates + self._map_waiting_scans()

    def _way_on(self, step: UnexpectedStep) -> tuple[Continuation, Correction | None] | None:
        """How the odometry goes on at an unexpected step, by the next scan; None while that is to come."""
        first_ns, last_ns = step.span_ns
        for stamp_ns, _, detections in sorted(self._waiting, key=lambda waiting: waiting[:2]):
            if not max(first_ns, self._judged_ns + 1) <= stamp_ns <= last_ns or not self._mapper.keyframes:
                continue
            if len(detections.positions) == 0:
                continue
            poses = step.at(stamp_ns)
            T_body_sensor = self._sensor_pose(detections, poses[Continuation.REPORTED])
            if T_body_sensor is None:
                continue
            up_body = poses[Continuation.REPORTED].T_odom_body[2, :3]
            scan = make_scan(detections, T_body_sensor, self._config.detection, up_body)
            ratios = {Continuation.REPORTED: self._mapper.log_likelihood_ratio(scan, poses[Continuation.REPORTED])}
            correction = None
            if Continuation.EXPECTED in poses and self._mapper.can_align(step.tolerances):
                expected = replace(poses[Continuation.REPORTED], T_odom_body=poses[Continuation.EXPECTED].T_odom_body)
                aligned = self._mapper.align(scan, expected, step.tolerances)
                ratios[Continuation.EXPECTED] = aligned.log_likelihood_ratio
                correction = Correction(aligned.T_correction, aligned.variances)
            way = decide(step, ratios)
            if way is not None:
                return way, correction if way is Continuation.EXPECTED else None
            self._judged_ns = stamp_ns
        return (step.default, None) if step.is_overdue else None

    def _step(self, pose: OdometryPose) -> list[Record]:
        # Scans from before this pose belong to the keyframe before it, also where the odometry breaks in between.
        updates = self._map_waiting_scans(before_ns=pose.stamp_ns)
        breaks = self._path.latest is not None and self._path.latest.segment != pose.segment
        self.counters["odometry_used"] += 1
        self._path.add(pose)
        if self._mapper.add_odometry(pose) is not None:
            updates += self._keyframe_updates(pose, breaks=breaks)
        # What leaves here refers to the odometry as its messages have it.
        T_odom_body = invert(pose.T_odom_reported) @ pose.T_odom_body
        updates.append(Transform(pose.stamp_ns, self._odom_frame, self._body_frame, T_odom_body))
        if self._state != State.LOST:
            T_map_reported = self._T_map_odom @ pose.T_odom_reported
            updates.append(SlamPose(pose.stamp_ns, self._T_map_odom @ pose.T_odom_body, T_map_reported))
        return updates

    def _keyframe_updates(self, pose: OdometryPose, *, breaks: bool) -> list[Record]:
        keyframe = self._mapper.keyframes[-1]
        closures = self._close_loops(keyframe)
        if self._closer.lost_since_keyframe is not None:
            closures += self._declare_lost(keyframe, self._closer.lost_since_keyframe)
        self._T_map_odom = self._graph.pose(keyframe.id) @ invert(pose.T_odom_body)
        changes = self._change_state(keyframe, self._why_lost(breaks=breaks))
        updates: list[Record] = [*closures, *changes, *self._relocalizations(closures)]
        if self._state != State.LOST:
            T_map_reported = self._T_map_odom @ pose.T_odom_reported
            updates.append(Transform(pose.stamp_ns, MAP_FRAME, self._odom_frame, T_map_reported))
        self.counters["keyframes"] += 1
        self.counters["closures_accepted"] += sum(closure.accepted for closure in closures)
        self.counters["closures_inserted"] += sum(closure.inserted for closure in closures)
        if len(self._mapper.keyframes) == self._first_keyframe + 1:
            updates.append(self._status("first odometry", level="info"))
        return updates

    def _relocalizations(self, closures: list[LoopClosureRecord]) -> list[RelocalizationRecord]:
        """Poses of keyframes in the prior map, from closures with its keyframes."""
        found = [
            RelocalizationRecord(
                stamp_ns=closure.stamp_ns,
                success=True,
                reason=closure.reason,
                T_map_body=self._graph.pose(closure.reference_keyframe_id) @ closure.T_reference_query,
                covariance=closure.covariance,
                inlier_count=closure.inlier_count,
                score=closure.score,
            )
            for closure in closures
            if closure.accepted
            and closure.reference_keyframe_id < self._first_keyframe
            and closure.T_reference_query is not None
        ]
        self.counters["keyframes_recognised"] += len(found)
        return found

    def _declare_lost(self, keyframe: Keyframe, since: int) -> list[LoopClosureRecord]:
        """Revoke a false relocalization, or begin a new segment after a kidnapping, from the keyframe ``since`` on."""
        first = self._mapper.keyframes[since]
        revoked, is_kidnapped = self._closer.declare_lost(keyframe, since)
        if is_kidnapped:
            self.counters["kidnappings_detected"] += 1
            self._mapper.retire_since(first)
            self._track.break_off()
            self._is_kidnapped = True
        else:
            self.counters["relocalizations_revoked"] += 1
        return revoked

    def _why_lost(self, *, breaks: bool) -> str:
        """Why the segment ended, empty if it did not."""
        if not breaks:
            return ""
        self.counters["odometry_breaks"] += 1
        cause = "kidnapped" if self._is_kidnapped else "odometry discontinuity (jump, gap or restart)"
        self._is_kidnapped = False
        return f"{cause}: active landmarks dropped"

    def _change_state(self, keyframe: Keyframe, why_lost: str) -> list[Record]:
        """Update the localization state: lost unless odometry and closures connect the newest keyframe to the map."""
        if not self._closer.closures.is_localized(keyframe):
            was_lost, self._state = self._state == State.LOST, State.LOST
            if was_lost and not why_lost:
                return []
            return [self._status(why_lost or CONTRADICTED, level="warning")]
        if self._state != State.LOST:
            return []
        self._state = State.RELOCALIZED
        self.fixes.append(Fix(keyframe.odometry.stamp_ns, keyframe.odometry.travel_m))
        self.counters["relocalizations"] += 1
        found = self._status("relocalized in the map", level="info")
        self._state = State.MAPPING if self._first_keyframe == 0 else State.TRACKING
        return [found, self._status("localization continues", level="info")]

    def _close_loops(self, keyframe: Keyframe) -> list[LoopClosureRecord]:
        if not self._config.loop_closure.enabled:
            return []
        started = time.perf_counter()
        closures = self._closer.close(keyframe)
        self.closing_seconds.append(time.perf_counter() - started)
        return closures

    def _map_waiting_scans(self, before_ns: int | None = None) -> list[Record]:
        """Map the scans that the odometry has caught up with; ``before_ns`` keeps those at or after it waiting."""
        updates: list[Record] = []
        latest = self._track.latest
        while self._waiting and latest is not None:
            stamp_ns = self._waiting[0][0]
            if stamp_ns > latest.stamp_ns or (before_ns is not None and stamp_ns >= before_ns):
                break
            updates += self._map_scan(heapq.heappop(self._waiting)[2])
        return updates

    def _map_scan(self, detections: ObjectDetections) -> list[Record]:
        if detections.stamp_ns < self._last_scan_ns:
            self.counters["detections_out_of_order"] += 1
            return []
        if detections.stamp_ns == self._last_scan_ns and detections.frame_id in self._last_scan_frames:
            self.counters["detections_duplicated"] += 1
            return []
        pose = self._track.at(detections.stamp_ns + self._time_offset_ns)
        # A scan from before a discontinuity does not constrain the keyframes after it.
        if pose is None or not self._mapper.keyframes or pose.segment != self._mapper.keyframes[-1].odometry.segment:
            self.counters["detections_without_odometry"] += 1
            return []
        T_body_sensor = self._sensor_pose(detections, pose)
        if T_body_sensor is None:
            self.counters["detections_without_transform"] += 1
            return []
        if detections.stamp_ns > self._last_scan_ns:
            self._last_scan_frames.clear()
        self._last_scan_frames.add(detections.frame_id)
        self._last_scan_ns = detections.stamp_ns
        scan = make_scan(detections, T_body_sensor, self._config.detection, pose.T_odom_body[2, :3])
        self.counters["detections_used"] += 1
        self.counters["detections_without_frame"] += not (
            detections.frame_id or self._config.detection.assume_body_frame
        )
        self.counters["objects_used"] += len(scan.positions)
        self.counters["objects_filtered"] += len(detections.positions) - len(scan.positions)
        return [self._mapper.add_scan(scan, pose)]

    def _sensor_pose(self, detections: ObjectDetections, pose: OdometryPose) -> FloatArray | None:
        """``T_body_sensor`` at the stamp of the detections; None where the log has no transform."""
        frame, body_frame = detections.frame_id.lstrip("/"), self._body_frame.lstrip("/")
        if frame in ("", body_frame) or self._config.detection.assume_body_frame:
            return corrected(np.eye(4), self._config.detection)
        if frame == self._odom_frame.lstrip("/"):
            return invert(pose.T_odom_body)
        T_body_sensor = self._frames.find(body_frame, frame, detections.stamp_ns)
        if T_body_sensor is None and frame not in self._frames_missing:
            self._frames_missing.add(frame)
            logger.warning("%s: detections in that frame are dropped", self._describe_missing())
        return None if T_body_sensor is None else corrected(T_body_sensor, self._config.detection)

    def _describe_missing(self) -> str:
        """Which frames nothing connects with the body, and what they and the body are connected with."""
        trees = {self._frames.tree_of(frame) for frame in (*self._frames_missing, self._body_frame)}
        listed = "; ".join(", ".join(tree) for tree in sorted(trees))
        return (
            f"no transform leads from {', '.join(sorted(self._frames_missing))} to {self._body_frame} (frames that "
            f"belong together: {listed})"
        )

    def _trajectory(self) -> TrajectoryRecord:
        stamps_ns = self._path.stamps_ns
        keyframe_stamps_ns = [keyframe.odometry.stamp_ns for keyframe in self._own_keyframes]
        T_map_body = interpolate_between_keyframes(
            stamps_ns,
            self._path.T_odom_body,
            np.searchsorted(stamps_ns, keyframe_stamps_ns),
            self._graph.poses()[self._first_keyframe :],
            self._path.segments,
        )
        return TrajectoryRecord(self._now_ns, MAP_FRAME, stamps_ns, T_map_body)

    def _map_record(self) -> ObjectMapRecord:
        landmarks = self._object_map.rows
        # What never got into the graph has no place in the map but where the odometry put it when it was last seen;
        # landmarks of a prior map stay where they were.
        own = landmarks["segment"] >= self._first_segment
        T_map_local = self._T_map_local_at(landmarks["last_seen_ns"][own])
        R = T_map_local[:, :3, :3]
        landmarks["position_map"][own] = (
            np.einsum("nij,nj->ni", R, landmarks["position_local"][own]) + T_map_local[:, :3, 3]
        )
        landmarks["covariance_map"][own] = R @ landmarks["covariance_local"][own] @ np.swapaxes(R, 1, 2)
        in_graph = self._graph.landmarks
        landmarks["position_map"][in_graph] = self._graph.landmark_positions(in_graph)
        try:
            landmarks["covariance_map"][in_graph] = self._graph.landmark_covariances(in_graph)
        except FactorGraphError as error:
            # The map is worth having without them; what stands there then is the covariance relative to the robot.
            logger.warning("the map has local covariances only: %s", error)
            self.counters["covariances_missing"] = len(in_graph)
        return self._object_map.to_record(self._now_ns)

    def _T_map_local_at(self, stamps_ns: IntArray) -> FloatArray:
        """``T_map_local`` (N, 4, 4) of the last keyframes before the stamps (N,)."""
        keyframes = self._own_keyframes
        T_local_body = np.stack([keyframe.T_local_body for keyframe in keyframes])
        keyframe_stamps_ns = [keyframe.odometry.stamp_ns for keyframe in keyframes]
        before = np.maximum(np.searchsorted(keyframe_stamps_ns, stamps_ns, side="right") - 1, 0)
        T_map_body = self._graph.poses()[self._first_keyframe :]
        return np.asarray((T_map_body @ invert(T_local_body))[before])

    @property
    def _own_keyframes(self) -> list[Keyframe]:
        """Those of this drive."""
        return self._mapper.keyframes[self._first_keyframe :]

    def _graph_record(self) -> FactorGraphRecord:
        keyframe_stamps_ns = np.array(
            [keyframe.odometry.stamp_ns for keyframe in self._mapper.keyframes], dtype=np.int64
        )
        return self._graph.to_record(self._now_ns, keyframe_stamps_ns)

    def _markers(self, rows: IntArray) -> SceneMarkers:
        """Landmarks for viewers, where they are in the final map."""
        classes = self._object_map.beliefs(rows).argmax(axis=1) if len(rows) else []
        return SceneMarkers(
            stamp_ns=self._now_ns,
            frame_id=MAP_FRAME,
            positions=self._object_map.rows["position_map"][rows],
            labels=tuple(self._object_map.vocabulary[index] for index in classes),
            ids=tuple(str(row) for row in rows),
        )

    def _status(self, message: str, *, level: str) -> StatusRecord:
        counters = {key: int(value) for key, value in sorted(self.counters.items())}
        counters |= {
            f"landmarks_{state.name.lower()}": len(self._object_map.in_state(state)) for state in LandmarkState
        }
        return StatusRecord(self._now_ns, self._state.value, level, message, counters)

    @property
    def _now_ns(self) -> int:
        latest = self._track.latest
        return latest.stamp_ns if latest is not None else 0
