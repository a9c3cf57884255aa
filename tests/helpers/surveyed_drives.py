"""Drives past objects with noise of known size, as a survey sees them."""

from collections.abc import Iterable
from functools import cached_property

import numpy as np

from logs.messages import ObjectDetections, Odometry, Record
from slam.common.arrays import ComplexArray, FloatArray, IntArray
from slam.common.calibration import OdometryCalibration
from slam.common.geometry import transform_from_xyz_yaw
from slam.odometry.calibrated_odometry import CalibratedOdometry
from slam.self_calibration.object_tracks import ObjectTracks, SurveyScan, follow_objects, objects_among
from slam.self_calibration.survey import Survey, summarize
from slam.self_calibration.variance_components import Motion, NoiseComponents

INTERVAL_S = 0.2
VIEWS = 720
"""Steps of the random walks by which the error of a view changes."""
NOISE = {"radial": 0.05, "tangential": 0.05, "translation_by_travel": 0.02}
"""Standard deviations of a good detector and a good odometry."""


def summary_of(scans: list[SurveyScan]) -> Survey:
    """The survey of scans."""
    return summarize(scans, objects_among(follow_objects(scans)))


class SurveyedDrive:
    """A robot that winds its way past objects, stands still at times, and turns on the spot at times.

    ``sigmas``: standard deviations by component (see ``NoiseComponents``), for lengths in metres; ``scale``: factor on
    all lengths, noise included.
    """

    def __init__(
        self,
        seed: int,
        sigmas: dict[str, float],
        *,
        scans: int = 1200,
        objects: int = 350,
        scale: float = 1.0,
        turns: bool = True,
    ) -> None:
        self._rng = np.random.default_rng(seed)
        self.scale, self.range_m = scale, 15.0
        self.noise = NoiseComponents(**{name: sigma**2 for name, sigma in sigmas.items()})
        self._drive(scans, turns)
        self._odometry()
        self._see(objects)
        self._stamp()

    def _drive(self, count: int, turns: bool) -> None:
        """True poses: of each minute 30 s at 1.5 m/s, winding, 15 s standing still, 15 s turning on the spot."""
        phase = (np.arange(count) * INTERVAL_S) % 60.0
        speed = np.where(phase < 30.0, 1.5, 0.0)
        turn = np.where(phase < 30.0, 0.15 * np.sin(phase / 3.0), np.where(phase < 45.0, 0.0, 0.7))
        self.true_headings = np.cumsum(turn * INTERVAL_S) * turns
        self._true_places = np.cumsum(speed * INTERVAL_S * np.exp(1j * self.true_headings))
        self.times_s = INTERVAL_S * np.arange(count)

    def _odometry(self) -> None:
        """Poses with noise: random walks by travel, turn and time, and jitter."""
        steps = np.diff(self._true_places, prepend=self._true_places[:1])
        turns = np.diff(self.true_headings, prepend=self.true_headings[:1])
        length, turn, noise, count = np.abs(steps), np.abs(turns), self.noise, len(steps)
        heading_variances = (
            noise.heading_by_travel * length + noise.heading_by_turn * turn + noise.heading_by_time * INTERVAL_S
        )
        shift_variances = noise.translation_by_travel * length + noise.translation_by_time * INTERVAL_S
        drift = np.cumsum(self._rng.normal(size=count) * np.sqrt(heading_variances))
        shifts = _plane(self._rng.normal(size=(count, 2))) * np.sqrt(shift_variances)
        jitter = _plane(self._rng.normal(size=(count, 2))) * np.sqrt(noise.jitter)
        self._places = np.cumsum(np.exp(1j * drift) * steps + shifts) + jitter
        self.headings = self.true_headings + drift + self._rng.normal(size=count) * np.sqrt(noise.heading_jitter)

    def _see(self, count: int) -> None:
        """Detections in the body frame, by scan and object."""
        way = _xy(self._true_places)
        places = _plane(self._rng.uniform(way.min(axis=0) - 12.0, way.max(axis=0) + 12.0, (count, 2)))
        offsets = places - self._true_places[:, None]
        self.scan, self.object = np.nonzero((np.abs(offsets) < self.range_m) & (np.abs(offsets) > 1.0))
        offset, noise, normal = offsets[self.scan, self.object], self.noise, self._rng.normal
        r = np.abs(offset)
        radial = normal(size=len(r)) * np.sqrt(noise.radial + noise.radial_by_range * r**2)
        tangential = normal(size=len(r)) * np.sqrt(noise.tangential + noise.tangential_by_range * r**2)
        seen = offset + offset / r * (radial + 1j * tangential) + self._view_noise(offset)
        self._in_body = seen * np.exp(-1j * self.true_headings[self.scan])

    def _stamp(self) -> None:
        """Poses of the odometry at the stamps of the scans, which have noise."""
        late_s = self._rng.normal(size=len(self.times_s)) * np.sqrt(self.noise.stamps)
        self._places += late_s * np.gradient(self._true_places, self.times_s)
        self.headings += late_s * np.gradient(self.true_headings, self.times_s)

    def _view_noise(self, offset: ComplexArray) -> ComplexArray:
        """(S,): of each object the sum of two random walks, along the direction that it is seen from, where it is
        closed, and along the logarithm of the range.
        """
        bearing, log_range = np.angle(offset), np.log(np.abs(offset))
        steps = self._rng.normal(size=(2, VIEWS, self.object.max() + 1, 2)) * np.sqrt(self.noise.view / VIEWS)
        closed = steps[0] - steps[0].mean(axis=0)
        by_bearing, by_range = np.cumsum([np.sqrt(2.0 * np.pi) * closed, np.sqrt(np.ptp(log_range)) * steps[1]], axis=1)
        shares = bearing / (2.0 * np.pi) % 1.0, (log_range - log_range.min()) / np.ptp(log_range)
        rows = [np.minimum((share * VIEWS).astype(np.int64), VIEWS - 1) for share in shares]
        return _plane(by_bearing[rows[0], self.object] + by_range[rows[1], self.object])

    @property
    def motion(self) -> Motion:
        """As a survey has it, from the odometry."""
        travel_m = np.cumsum(np.abs(np.diff(self._true_places, prepend=self._true_places[:1])))
        return Motion(self.scale * travel_m, self.true_headings, self.times_s, np.zeros_like(travel_m))

    @property
    def tracks(self) -> ObjectTracks:
        """Detections by object, a new track wherever it was out of sight."""
        order = np.lexsort((self.scan, self.object))
        scan, number = self.scan[order], self.object[order]
        begins = (np.diff(number, prepend=-1) != 0) | (np.diff(scan, prepend=-9) != 1)
        offsets = self.scale * self._in_body[order] * np.exp(1j * self.headings[scan])
        points = offsets + self.scale * self._places[scan]
        return tracks_of(np.cumsum(begins) - 1, scan, _xy(offsets), _xy(points))

    @cached_property
    def scans(self) -> list[SurveyScan]:
        """The scans, without labels or association, at height zero."""
        found = []
        T_odom_body = transform_from_xyz_yaw(_xyz(self.scale * self._places), self.headings)
        for k in np.unique(self.scan).tolist():
            xyz = _xyz(self.scale * self._in_body[self.scan == k])
            labels, variances = np.zeros(len(xyz), int), np.full(len(xyz), np.nan)
            found.append(SurveyScan(round(self.times_s[k] * 1e9), T_odom_body[k], xyz, labels, variances))
        return found


def _plane(xy: FloatArray) -> ComplexArray:
    """x + iy (N,) of places (N, 2)."""
    return np.asarray(xy[:, 0] + 1j * xy[:, 1])


def _xy(places: ComplexArray) -> FloatArray:
    return np.column_stack([places.real, places.imag])


def _xyz(places: ComplexArray) -> FloatArray:
    """At height zero."""
    return np.column_stack([_xy(places), np.zeros(len(places))])


def tracks_of(
    track: IntArray, scan: IntArray, offsets: FloatArray, points: FloatArray, labels: IntArray | None = None
) -> ObjectTracks:
    """Tracks at height zero, of one class unless ``labels`` are given, whose messages claim no noise."""
    none = np.zeros(len(track))
    classes = np.zeros(len(track), int) if labels is None else labels
    return ObjectTracks(track, scan, offsets, points, classes, none * np.nan, none, none + np.inf, none)


def records_of(scans: Iterable[SurveyScan], frame_id: str = "base_link") -> list[Record]:
    """Odometry and detections of one class, as a log has them."""
    found: list[Record] = []
    for scan in scans:
        count = len(scan.labels)
        found.append(Odometry(scan.stamp_ns, scan.T_odom_body, "odom", "base_link"))
        found.append(ObjectDetections(scan.stamp_ns, frame_id, scan.positions, ("stem",) * count, np.ones(count)))
    return found


def with_odometry(records: Iterable[Record], **calibration: float) -> list[Record]:
    """Records whose odometry is as a calibration (see ``OdometryCalibration``) makes it."""
    changed = CalibratedOdometry(OdometryCalibration(**calibration))
    return [changed.correct(each) if isinstance(each, Odometry) else each for each in records]
