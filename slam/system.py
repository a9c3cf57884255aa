"""The SLAM system: input records in, estimates out.

``Slam.process`` is where to begin reading.
"""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from logs.messages import (
    DetectionAssociations,
    GeodeticFix,
    LocalizationRecord,
    LoopClosureRecord,
    ObjectDetections,
    Odometry,
    Record,
    SlamPose,
    StatusRecord,
    TrajectoryRecord,
    Transform,
)
from slam.assessment import assess, diagnose_uncorrected
from slam.backend.factor_graph import FactorGraph
from slam.backend.solver import Optimization
from slam.backend.tilt import hold_tilt
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.common.geometry import invert
from slam.display.map_topics import MAP_FRAME, Message
from slam.display.snapshot import SnapshotSchedule, take_snapshot
from slam.final_map import FinalMap, final_trajectory, find_passed, judge_outcome, known_covariances, place_landmarks
from slam.frontend.frontend import Frontend
from slam.frontend.input.sensor_frames import SensorFrames
from slam.frontend.mapper import Mapper
from slam.graph_condenser import GraphCondenser
from slam.localization.gnss import GnssPrior, tie_to_fixes
from slam.localization.prior_map import PriorMap, restore_prior_map, with_heights_of
from slam.localization.state import DISCONTINUITY, KIDNAPPED, LocalizationState, State
from slam.loop_closure.loop_closer import LoopCloser, Outcome
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.calibrated_odometry import CalibratedOdometry
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose
from slam.odometry.track import OdometryPath, OdometryTrack
from slam.place_recognition.imported_places import SEGMENT
from slam.place_recognition.initial_pose import InitialPose
from slam.trajectory_check.judgement import DriveCheck


class Slam:
    """Maps a drive, record by record. The same records and configuration give the same results."""

    def __init__(
        self,
        config: Config,
        prior_map: PriorMap | None = None,
        *,
        extend: bool = True,
        initial_pose: InitialPose | None = None,
        frames: SensorFrames | None = None,
    ) -> None:
        """``prior_map``: a map to localize in; ``extend``: update it instead of keeping it fixed; ``initial_pose``:
        where in it the robot starts; ``frames``: where the sensors sit, as far as it is known before the drive;
        transforms add to it.
        """
        self._config = config = with_heights_of(config, prior_map)
        self.counters: Counter[str] = Counter()
        self._first_segment = 0 if prior_map is None else SEGMENT + 1
        self._frames = frames or SensorFrames()
        self._object_map = ObjectMap(config.calibration.objects)
        self._graph = FactorGraph(sensor_range_m=config.sensor_range_m)
        known, imported = restore_prior_map(prior_map, self._object_map, self._graph, fixed=not extend)
        self._first_keyframe = len(known)
        self._extends = extend
        self._mapper = Mapper(config, self._object_map, self._graph, known)
        self._track = OdometryTrack(config.calibration, self.counters, first_segment=self._first_segment)
        self._frontend = Frontend(config.calibration.detection, self._frames, self._track, self._mapper, self.counters)
        self._closer = LoopCloser(config, self._object_map, self._graph, self._mapper.keyframes, imported)
        self._closer.initial_pose = None if prior_map is None else initial_pose
        self._condenser = GraphCondenser(
            config, self._object_map, self._graph, self._mapper.keyframes, self._closer.closures, self.counters
        )
        georeference = None if prior_map is None or initial_pose is not None else prior_map.georeference
        self._gnss = None if georeference is None else GnssPrior(georeference)
        self._geodetic_fixes: dict[int, GeodeticFix] = {}  # the latest at each keyframe
        self._localization = LocalizationState(has_prior_map=prior_map is not None)
        self.fixes: Sequence[OdometryPose] = self._localization.fixes
        """The poses of the odometry at the relocalizations so far."""
        self._odometry = CalibratedOdometry(config.calibration.odometry)
        self._path, self._output = OdometryPath(), PoseOutput()
        self._check = DriveCheck(config.calibration)
        self._schedule = SnapshotSchedule(self._first_keyframe)
        self.closing_seconds: list[float] = []
        """Time that looking for loops took, keyframe by keyframe."""

    @property
    def first_stamp_ns(self) -> int:
        """When the drive began."""
        return self._path.first_stamp_ns

    @property
    def state(self) -> State:
        """The localization state of the robot."""
        return self._localization.state

    def process(self, record: Record) -> list[Record]:
        """Process the next record in the order of the log; returns what is new."""
        if isinstance(record, Transform):
            self._frames.add(record)
        elif isinstance(record, GeodeticFix):
            self._geodetic_fixes[len(self._mapper.keyframes)] = record
            if self._gnss is not None and self._path.latest is not None:
                self._closer.initial_pose = self._gnss.add(record, self._path.latest.travel_m)
        elif isinstance(record, ObjectDetections):
            self._frontend.add_detections(record)
        elif isinstance(record, Odometry):
            return self._follow(self._odometry.correct(record))
        return self._advance()

    def snapshot(self) -> list[Message] | None:
        """A snapshot of the map for viewers; None if it is not due."""
        return self._snapshot() if self._schedule.is_due(len(self._mapper.keyframes)) else None

    def _snapshot(self) -> list[Message]:
        return take_snapshot(
            self._mapper.keyframes,
            self._object_map,
            self._graph,
            np.array(list(self._closer.closures.closed.items()), dtype=np.int64).reshape(-1, 2),
            self._closer.closures.is_localized,
            self._config.calibration,
        )

    def finish(self) -> FinalMap:
        """Close the last keyframe, optimise the whole graph and return the result.

        Raises:
            InputDataError: there was nothing to map.
        """
        with _refused_noises():
            for placed in self._frontend.finish():
                self._take(placed)
        if len(self._mapper.keyframes) == self._first_keyframe:
            raise InputDataError(
                "no odometry message was usable, so there is nothing to map; see 'dslam info' of the log"
            )
        return self._final_map(self._optimize())

    def _optimize(self) -> Optimization:
        """Optimise the whole graph."""
        self._mapper.close_keyframe()
        if self._extends:
            self._condenser.fuse_landmarks()
            if self._first_keyframe:
                # Those of the prior map that this drive passed, where it closed loops, and did not see.
                closures, keyframes = self._closer.closures, self._mapper.keyframes
                closed = [each for each in sorted(closures.closed) if closures.is_localized(keyframes[each])]
                places, radius_m = self._graph.poses(closed)[:, :3, 3], 0.5 * self._config.sensor_range_m
                self._mapper.retire_gone(find_passed(self._object_map, SEGMENT, places, radius_m))
            if fixes := [*self._geodetic_fixes.values()]:
                own = self._mapper.keyframes[self._first_keyframe :]
                self.counters["gnss_fixes_used"] = tie_to_fixes(self._graph, own, self._trajectory, fixes)
        hold_tilt(self._graph)
        optimization = self._graph.match_noise()
        self.counters["batch_iterations"] = optimization.iterations
        return optimization

    def _final_map(self, optimization: Optimization) -> FinalMap:
        stamp_ns, own = self._frontend.latest_ns, self._mapper.keyframes[self._first_keyframe :]
        T_map_body = self._graph.poses()[self._first_keyframe :]
        pose_covariances, covariances = known_covariances(self._graph, self.counters)
        place_landmarks(self._object_map, self._graph, covariances, own, T_map_body, self._first_segment)
        self.counters["labels_beyond_max_classes"] += self._object_map.labels.unlisted
        stamps_ns = np.array([keyframe.odometry.stamp_ns for keyframe in self._mapper.keyframes], dtype=np.int64)
        graph = self._graph.to_record(stamp_ns, stamps_ns, pose_covariances)
        object_map = self._object_map.to_record(stamp_ns)
        trajectory = self._trajectory()
        check = self._check.judge(trajectory)
        doubts = assess(graph, object_map, self._config.calibration, self.counters, check)
        uncorrected = diagnose_uncorrected(graph, self.counters)
        level, message = judge_outcome(optimization, self.counters, doubts, uncorrected=uncorrected)
        return FinalMap(
            trajectory=trajectory,
            object_map=object_map,
            graph=graph,
            snapshot=self._snapshot(),
            status=self.status(self.state, message, level=level),
            trajectory_check=check,
        )

    def _trajectory(self) -> TrajectoryRecord:
        """All poses of the drive, by the graph as it is now."""
        own = slice(self._first_keyframe, None)
        stamp_ns = self._frontend.latest_ns
        return final_trajectory(self._path, self._mapper.keyframes[own], self._graph.poses()[own], stamp_ns)

    def _follow(self, odometry: Odometry) -> list[Record]:
        self._output.follow(odometry)
        added_ns = self._frontend.add_odometry(odometry)
        updates = self._advance()
        for stamp_ns in added_ns:
            if (pose := self._track.at(stamp_ns)) is not None:
                updates += self._output.at(pose, is_localized=self.state != State.LOST)
        return updates

    def _advance(self) -> list[Record]:
        """Map the scans that the odometry has caught up with, and make keyframes of the poses before them."""
        with _refused_noises():
            return [record for placed in self._frontend.advance() for record in self._take(placed)]

    def _take(self, placed: OdometryPose | DetectionAssociations) -> list[Record]:
        if isinstance(placed, OdometryPose):
            breaks = self._path.latest is not None and self._path.latest.segment != placed.segment
            self.counters["odometry_used"] += 1
            self._path.add(placed)
            keyframe = self._mapper.add_odometry(placed)
            return [] if keyframe is None else self._keyframe_updates(keyframe, began=DISCONTINUITY if breaks else "")
        if self._frontend.placed is not None:
            tracked, pose = self._frontend.placed
            self._check.add(tracked, pose, self._output.in_map(pose))
        active, state = self._mapper.tracker.active, self.state
        kidnapped = 1.0 if state == State.LOST else self._closer.continuity.kidnapping_probability
        names, ratios = tuple(active.innovation_ratios), np.array(list(active.innovation_ratios.values()))
        certainty = LocalizationRecord(placed.stamp_ns, state.value, kidnapped, names, ratios, active.pose_covariance)
        return [placed, certainty]

    def _keyframe_updates(self, keyframe: Keyframe, *, began: str) -> list[Record]:
        outcome = self._close_loops(keyframe)
        closures = outcome.records
        if outcome.lost_after_m is not None:
            revoked, is_kidnapped = self._declare_lost(keyframe, outcome.lost_after_m)
            closures += revoked
            began = KIDNAPPED if is_kidnapped else began
            keyframe = self._mapper.keyframes[-1]
        self._output.place(keyframe.odometry, self._graph.pose(keyframe.id))
        if began == DISCONTINUITY:
            self.counters["odometry_breaks"] += 1
        is_localized = self._closer.closures.is_localized(keyframe)
        changes = self._localization.update(keyframe, is_localized=is_localized, began=began)
        if any(state == State.RELOCALIZED for state, _, _ in changes):
            self.counters["relocalizations"] += 1
        updates: list[Record] = [*closures]
        updates += [self.status(state, message, level=level) for state, message, level in changes]
        if self.state != State.LOST:
            updates.append(self._output.map_to_odom(keyframe.odometry))
        if self._extends:
            self._condenser.update()
        accepted = [each for each in closures if each.accepted]
        self.counters.update(
            keyframes=1,
            # Those before the first one of this drive are of the prior map.
            keyframes_recognised=sum(each.reference_keyframe_id < self._first_keyframe for each in accepted),
            closures_accepted=len(accepted),
            closures_retrieved=sum(each.seed_query_keyframe_id is None for each in accepted),
            closures_inserted=sum(each.inserted for each in closures),
        )
        if keyframe.id == self._first_keyframe:
            updates.append(self.status(self.state, "first odometry", level="info"))
        return updates

    def _declare_lost(self, keyframe: Keyframe, after_m: float) -> tuple[list[LoopClosureRecord], bool]:
        """Revoke a false relocalization, or let a new segment begin after a kidnapping, at a travel ``after_m``.

        Returns the records of the revoked closures, and whether the robot was kidnapped.
        """
        first = next(
            each
            for each in self._mapper.keyframes
            if each.odometry.segment == keyframe.odometry.segment
            and (each.odometry.travel_m > after_m or each is keyframe)
        )
        revoked, is_kidnapped = self._closer.declare_lost(keyframe, first.id)
        if is_kidnapped:
            self.counters["kidnappings_detected"] += 1
            self._path.break_at(self._frontend.break_after(after_m, first))
            self._closer.begin_segment(first.id)
        else:
            self.counters["relocalizations_revoked"] += 1
        return revoked, is_kidnapped

    def _close_loops(self, keyframe: Keyframe) -> Outcome:
        if not self._config.loop_closure.enabled:
            return Outcome([])
        started = time.perf_counter()
        outcome = self._closer.close(keyframe)
        self.closing_seconds.append(time.perf_counter() - started)
        return outcome

    def status(self, state: State, message: str, *, level: str) -> StatusRecord:
        """A status with the counters and the numbers of landmarks as they are now."""
        counters = {key: int(value) for key, value in sorted(self.counters.items())}
        counters |= {
            f"landmarks_{state.name.lower()}": len(self._object_map.in_state(state)) for state in LandmarkState
        }
        return StatusRecord(self._frontend.latest_ns, state.value, level, message, counters)


class PoseOutput:
    """Messages of the robot's pose. Their odometry is that of the messages, before corrections."""

    def __init__(self) -> None:
        self._T_map_odom = np.eye(4)
        self._odom_frame = self._body_frame = ""

    def follow(self, odometry: Odometry) -> None:
        """Take the names of the body and the odometry frame from a message."""
        self._body_frame, self._odom_frame = odometry.child_frame_id, odometry.frame_id

    def place(self, pose: OdometryPose, T_map_body: FloatArray) -> None:
        """From now on the odometry is placed so that the body is at ``T_map_body`` (4, 4) at ``pose``."""
        self._T_map_odom = T_map_body @ invert(pose.T_odom_body)

    def in_map(self, pose: OdometryPose) -> FloatArray:
        """``T_map_body`` (4, 4) at a pose of the track."""
        return self._T_map_odom @ pose.T_odom_body

    def at(self, pose: OdometryPose, *, is_localized: bool) -> list[Record]:
        """The pose in the odometry frame and, where the robot knows it, in the map."""
        T_odom_body = invert(pose.T_odom_reported) @ pose.T_odom_body
        records: list[Record] = [Transform(pose.stamp_ns, self._odom_frame, self._body_frame, T_odom_body)]
        if is_localized:
            records.append(SlamPose(pose.stamp_ns, self.in_map(pose)))
        return records

    def map_to_odom(self, pose: OdometryPose) -> Transform:
        """The odometry frame in the map, at the time of ``pose``."""
        return Transform(pose.stamp_ns, MAP_FRAME, self._odom_frame, self._T_map_odom @ pose.T_odom_reported)


@contextmanager
def _refused_noises() -> Iterator[None]:
    """An error for people where covariances cannot be inverted, since float64 has too few digits for them."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise InputDataError(
            "the noise of odometry and that of detections differ by too many orders of magnitude; check "
            "calibration.odometry and calibration.detection, and the covariances of detections"
        ) from error
