"""Maps a drive of a robot without calibration from the past records alone."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from logs.messages import ObjectDetections, Record, Transform
from logs.storage.regular_file import AnyPath
from slam.common.calibration import Calibration
from slam.common.config import Config
from slam.common.errors import SavedMapError
from slam.display.map_topics import Message
from slam.final_map import FinalMap
from slam.frontend.input.sensor_frames import SensorFrames
from slam.frontend.input.stamp_clocks import LoggingDelays
from slam.localization.prior_map import PriorMap
from slam.localization.state import CALIBRATIONS, OF_ONE_MAP, State
from slam.object_map.map_io import save_map
from slam.odometry.pose import OdometryPose
from slam.place_recognition.initial_pose import InitialPose
from slam.provenance import settings_of
from slam.self_calibration.calibration import CalibratedLog, calibrate
from slam.self_calibration.survey import survey
from slam.self_calibration.surveyed_log import MAX_DETECTIONS, SurveyedLog
from slam.system import Slam


class LiveSlam:
    """Maps a drive, record by record, as :class:`slam.system.Slam` does, and calibrates the robot meanwhile.

    Each time twice as many scans have come, what was not given of the calibration is estimated from all of them, while
    a quarter as many new ones come, and a second map is built by it, four records of the past with each new one. Once
    it has caught up, it takes the place of the first. So nothing depends on the clock, and the same records give the
    same results.
    """

    def __init__(
        self,
        config: Config,
        prior_map: PriorMap | None = None,
        *,
        calibration: Calibration | None = None,
        extend: bool = True,
        initial_pose: InitialPose | None = None,
        frames: SensorFrames | None = None,
        delays: Callable[[], LoggingDelays] = LoggingDelays,
    ) -> None:
        """As those of ``Slam``. What was given of ``calibration``, or else of that of ``config``, is kept; if
        ``config.calibrate`` is off, all of it. ``delays``: how long after their stamps messages were logged so far.
        """
        self._given = config if calibration is None else config.model_copy(update={"calibration": calibration})
        self._prior_map, self._extend, self._delays = prior_map, extend, delays
        self._frames = frames or SensorFrames()
        self._build = partial(Slam, prior_map=prior_map, extend=extend, initial_pose=initial_pose, frames=self._frames)
        self.calibration = CalibratedLog(self._given)
        """The current calibration, with its corrections."""
        self._slam = self._build(self._given)
        self._estimate: Future[CalibratedLog | None] | None = None
        self._successor: _Successor | None = None
        self._is_estimating = config.calibrate and not self._given.calibration.is_complete
        self._records: list[Record] = []
        self._scans = self._detections = self._surveyed = 0

    @property
    def counters(self) -> Counter[str]:
        """Counters since the start, of the current map."""
        return self._slam.counters

    @property
    def state(self) -> State:
        """The localization state of the robot."""
        return self._slam.state

    @property
    def fixes(self) -> Sequence[OdometryPose]:
        """The poses of the odometry at the relocalizations so far."""
        return self._slam.fixes

    def snapshot(self) -> list[Message] | None:
        """The map as it is known now, for viewers; None if too few keyframes brought it up to date since the last."""
        return self._slam.snapshot()

    def process(self, record: Record) -> list[Record]:
        """Process the next record in the order of the log; returns the updates."""
        if isinstance(record, Transform):
            self._frames.add(record)
            return []
        if not self._is_estimating:
            return self._slam.process(record)
        self._records.append(record)
        if self._successor is not None and self._successor.follow(self._records, 4):
            return self._succeed(self._successor)
        updates = self._slam.process(record)
        if isinstance(record, ObjectDetections):
            self._scans += 1
            self._detections += len(record.positions)
            if self._estimate is not None:
                if self._scans >= 1.25 * self._surveyed:
                    self._begin_map(self._estimate)
            elif self._scans >= 2 * self._surveyed and self._successor is None:
                # The calibration is estimated from all records so far, in a thread.
                self._surveyed = self._scans
                log, worker = SurveyedLog(self._records, deepcopy(self._frames)), ThreadPoolExecutor(1)
                self._estimate = worker.submit(_estimate, self._given, log, self._delays())
                worker.shutdown(wait=False)
        return updates

    def catch_up(self) -> list[Record]:
        """Complete the second map immediately, as at the end of a drive; returns the updates."""
        if self._estimate is not None:
            self._begin_map(self._estimate)
        if self._successor is None:
            return []
        self._successor.follow(self._records, len(self._records))
        return self._succeed(self._successor)

    def finish(self) -> FinalMap:
        """Close the last keyframe, optimise the whole graph and return the result.

        Raises:
            InputDataError: there was nothing to map.
        """
        self.catch_up()
        return self._slam.finish()

    def save(self, path: AnyPath, final: FinalMap, provenance: Mapping[str, str] | None = None) -> None:
        """Write the map of the drive, which ``finish`` returned, for later drives.

        ``provenance``: metadata of the map; by default the settings and the calibration.

        Raises:
            LogError: it cannot be written.
            SavedMapError: it could not be used, or the robot was never relocalized in its prior map.
        """
        prior_map = self._prior_map
        if prior_map is not None and not self.fixes:
            raise SavedMapError(
                f"the robot was never relocalized in the given map, so {path} would hold two unrelated places and was "
                "not written"
            )
        drives = None if prior_map is None else prior_map.drives
        about = provenance or settings_of(self._given, self.calibration, prior_map, extend=self._extend)
        save_map(Path(path), final.object_map, final.graph, about, earlier_drives=drives)

    def _begin_map(self, estimate: Future[CalibratedLog | None]) -> None:
        """Begin a map by the calibration that was estimated."""
        self._estimate, calibration = None, estimate.result()
        if calibration is not None:
            self._successor = _Successor(self._build(calibration.config), calibration)
            self._successor.slam.counters[CALIBRATIONS] = self._slam.counters[CALIBRATIONS] + 1

    def _succeed(self, successor: "_Successor") -> list[Record]:
        self._slam, self.calibration, self._successor = successor.slam, successor.calibration, None
        if self._detections >= MAX_DETECTIONS:
            self._is_estimating, self._records = False, []
        message = f"calibrated by {self._surveyed} scans: the map was rebuilt"
        return [self._slam.status(self.state, message, level="info"), *successor.updates]


def _estimate(given: Config, log: SurveyedLog, delays: LoggingDelays) -> CalibratedLog | None:
    found = survey([log], given.calibration)
    return None if found is None else calibrate(given, found, delays)


@dataclass(slots=True)
class _Successor:
    """A map that is built from the records so far by a newer calibration; ``updates``: what readers must know of it."""

    slam: Slam
    calibration: CalibratedLog
    updates: list[Record] = field(default_factory=list)
    _mapped: int = 0

    def follow(self, records: Sequence[Record], count: int) -> bool:
        """Map so many further ones of the records; returns whether it has caught up. Poses of the past are left out."""
        for record in records[self._mapped : self._mapped + count]:
            self._mapped += 1
            updates = self.slam.process(record)
            is_newest = self._mapped == len(records)
            self.updates += [update for update in updates if is_newest or isinstance(update, OF_ONE_MAP)]
        return self._mapped == len(records)
