"""Objects followed from scan to scan by the odometry alone, as far as that is unambiguous.

A detection continues the track of its class that ended nearest to it, in the odometry frame, if each is the other's
nearest and they are much nearer to one another than other objects of the class are. Nothing here knows a length or a
noise: the spacing of the objects is the yardstick. Cameras err along the ray far more than across it, radars the other
way round: distances in the direction of the larger noise are divided by the ratio of the two, which the log tells.
"""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from scipy.spatial import cKDTree

from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.geometry import unit_vectors, yaw_rad

AMBIGUITY = 0.5
"""A track continues with a detection nearer than this share of the distance to the next object of its class."""
RANGE_SHARE = 0.25
"""... and of the range, for an object that is alone of its class."""
SMOOTHED = 4
"""Detections of a track before and after one that, together with it, say where its object is."""
MISSED_SCANS = 2
"""Consecutive scans in which an object may be missed before its track ends, ..."""
LOST_PROBABILITY, MOST_MISSED, SAMPLED_SCANS = 0.1, 20, 600
"""... more, where the detector misses so many that a track would end too soon with that probability; at most so many.
Then a neighbour would be taken for the object. Their number is estimated from the first scans.
"""
RATIO_ROUNDS, LEAST_STEPS, MAX_RATIO = 2, 100, 1e3
"""Rounds in which the ratio of the noise along the ray and across it is found, the least steps of tracks that tell it,
and how large it may be.
"""
ROUNDING = 1e-12
"""Squares that are a smaller share of what they are compared with are rounding."""
ROUNDS, CONVERGED = 200, 1e-6
LEAST = 1e-6
"""Probabilities stay that far from 0 and 1."""
MAX_DISTANCES = 2**20
"""Held at a time, 8 MB, however many objects a scan has."""


@frozen
class SurveyScan:
    """One scan: ``stamp_ns``; where the body was, ``T_odom_body`` (4, 4); detections in the upright frame of the body:
    ``positions`` (N, 3) m, ``labels`` (N,), ``variances`` (N,) m^2 that the message claims, NaN where it has none.
    """

    stamp_ns: int
    T_odom_body: FloatArray
    positions: FloatArray
    labels: IntArray
    variances: FloatArray


def poses_of(scans: Sequence[SurveyScan]) -> FloatArray:
    """``T_odom_body`` (K, 4, 4) of scans."""
    return np.array([scan.T_odom_body for scan in scans]).reshape(-1, 4, 4)


def seconds_of(scans: Sequence[SurveyScan]) -> FloatArray:
    """Times (K,) s of scans since the first one."""
    return np.array([scan.stamp_ns - scans[0].stamp_ns for scan in scans]) * 1e-9


def headings_of(scans: Sequence[SurveyScan]) -> FloatArray:
    """Unwrapped headings (K,) rad of the body at scans."""
    return np.unwrap(yaw_rad(poses_of(scans)))


def ranges_m(scans: Sequence[SurveyScan]) -> FloatArray:
    """Horizontal distances (N,) m of all objects of scans, one at least."""
    return np.concatenate([np.hypot(scan.positions[:, 0], scan.positions[:, 1]) for scan in scans])


@frozen
class ObjectTracks:
    """Detections (S,) that belong to tracks, ordered by track and time.

    ``track`` and ``scan`` (S,): ids; ``offsets`` (S, 2) m of the object from the body, smoothed along the track so that
    they have little of the noise of the detections, and ``points`` (S, 2) m where they were detected, both in the axes
    of the odometry frame; ``labels`` (S,); ``claimed`` (S,) m^2; ``heights`` (S,) m in the odometry frame; ``rooms``
    (S,) m: the distance from where the track ended within which a detection continued it, and ``steps`` (S,) m: its
    distance from there, both by the ratio of the noise; 0 where a track begins.
    """

    track: IntArray
    scan: IntArray
    offsets: FloatArray
    points: FloatArray
    labels: IntArray
    claimed: FloatArray
    heights: FloatArray
    rooms: FloatArray
    steps: FloatArray

    @property
    def rays(self) -> FloatArray:
        """Unit vectors (N, 2) from the body to the detections."""
        return unit_vectors(self.offsets)

    @property
    def places(self) -> FloatArray:
        """Where the objects were detected (S, 3) m, in the odometry frame."""
        return np.column_stack([self.points, self.heights])

    def of(self, chosen: BoolArray | IntArray) -> "ObjectTracks":
        """Some of the detections, by mask or rows."""
        return ObjectTracks(*(getattr(self, each.name)[chosen] for each in fields(self)))

    def pairs(self, *lags: int) -> tuple[IntArray, IntArray]:
        """Rows (P,) of two detections of one track that are so many detections apart."""
        firsts = [np.flatnonzero(self.track[:-lag] == self.track[lag:]) for lag in lags]
        seconds = [first + lag for first, lag in zip(firsts, lags, strict=True)]
        return np.concatenate(firsts), np.concatenate(seconds)


def follow_objects(scans: Sequence[SurveyScan], *, by_class: bool = True) -> ObjectTracks:
    """Tracks of the objects in ``scans`` (K).

    ``by_class``: a track has one class; else objects are followed by their positions alone.
    """
    if not scans:
        none, nowhere = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
        return ObjectTracks(none, none, nowhere, nowhere, none, *np.zeros((4, 0)))
    ratio = 1.0
    for _ in range(RATIO_ROUNDS):
        tracks = objects_among(_follow(scans[:SAMPLED_SCANS], MOST_MISSED, ratio, by_class=by_class))
        ratio = _noise_ratio(tracks)
    found, missed_scans = detectability_of(tracks), MISSED_SCANS
    if np.isfinite(found.probability):
        detected = np.clip(found.probability, 1e-3, 1.0 - 1e-3)
        periods = np.log(LOST_PROBABILITY) / np.log1p(-detected)
        missed_scans = int(np.clip(found.period * periods, MISSED_SCANS, MOST_MISSED))
    return _follow(scans, missed_scans, ratio, by_class=by_class)


def _noise_ratio(tracks: ObjectTracks) -> float:
    """The noise along the ray by that across it, from the medians of the steps of tracks; 1 where there are few."""
    before, row = tracks.pairs(1)
    if len(row) < LEAST_STEPS:
        return 1.0
    steps, offsets = tracks.points[row] - tracks.points[before], tracks.offsets[row]
    along = np.median(np.abs(np.einsum("ni,ni->n", steps, offsets)))
    across = np.median(np.abs(steps[:, 1] * offsets[:, 0] - steps[:, 0] * offsets[:, 1]))
    is_exact = max(along, across) < ROUNDING * np.mean(offsets**2)
    return 1.0 if is_exact else np.clip(along / max(across, along / MAX_RATIO), 1.0 / MAX_RATIO, MAX_RATIO)


@frozen
class Detectability:
    """Rate of detection of an object in view: in every ``period``-th scan, as several sensors take turns, with a
    ``probability``; NaN where none was tracked.
    """

    period: int = 1
    probability: float = float("nan")

    @property
    def share(self) -> float:
        """Probability that an object is detected in a scan."""
        return self.probability / self.period


def objects_among(tracks: ObjectTracks) -> ObjectTracks:
    """The tracks of objects, without those of false detections that are near each other by chance."""
    _, first, row = np.unique(tracks.track, return_index=True, return_inverse=True)
    shares = np.maximum(tracks.steps**2, ROUNDING * tracks.rooms**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        closeness = np.nan_to_num(np.log(tracks.rooms**2 / shares))
    closeness[first] = 0.0  # a track begins there
    links = (np.bincount(row) - 1).astype(np.float64)
    existence = existence_probabilities(links, np.bincount(row, closeness).astype(np.float64))
    return tracks.of(existence[row] > 0.5)


def existence_probabilities(links: FloatArray, closeness: FloatArray) -> FloatArray:
    """Probability (T,) that a track is of an object, and not of false detections that are near each other by chance,
    from its ``links`` (T,) and the sum of their w (T,).

    Where detections lie at random, the nearest one within a room around the end of a track is at a squared distance
    that is even over the room: w = -log(distance^2 / room^2) has an exponential distribution of mean 1. What continues
    the track of an object is nearer: of mean 1 / a > 1. A track by chance continues with a probability q, that of an
    object with p. The likelihoods of a track with n links are

        chance: q^n (1 - q) exp(-sum w)          object: p^n (1 - p) a^n exp(-a sum w)

    and expectation maximisation finds p, q, a and the share of objects from all tracks of a log (Dempster, Laird and
    Rubin, J. Royal Statistical Society B, 1977): the existence probability of integrated tracking (Musicki, Evans and
    Stankovic, IEEE Trans. Automatic Control, 1994), with clutter that is estimated from the log. No length and no noise
    is known.
    """
    share, p, q, a = 0.5, 0.9, 0.3, 0.3
    objects, before = np.full(len(links), share), -np.inf
    if not len(links):
        return objects
    for _ in range(ROUNDS):
        of_object = np.log(share) + links * np.log(p * a) + np.log1p(-p) - a * closeness
        by_chance = np.log1p(-share) + links * np.log(q) + np.log1p(-q) - closeness
        likelihood = np.logaddexp(of_object, by_chance)
        objects = np.exp(of_object - likelihood)
        mean = likelihood.mean()
        if abs(mean - before) < CONVERGED:
            break
        before = mean
        share, p, q = _probability(objects.mean()), _goes_on(links, objects), _goes_on(links, 1.0 - objects)
        q = min(p, q)
        a = float(np.clip(objects @ links / max(float(objects @ closeness), LEAST), LEAST, 1.0))
    return objects


def _goes_on(links: FloatArray, weights: FloatArray) -> float:
    """Probability that a track continues, of tracks with weights (T,)."""
    return _probability(float(weights @ links) / max(float(weights @ (links + 1)), LEAST))


def _probability(value: float) -> float:
    return float(np.clip(value, LEAST, 1.0 - LEAST))


def layered(scans: Sequence[SurveyScan], apart_m: float) -> FloatArray:
    """Positions (N, 3) m of all detections of scans, and a layer of each scan and class, so far apart."""
    if not scans:
        return np.zeros((0, 4))
    layers = [number + len(scans) * scan.labels for number, scan in enumerate(scans)]
    return np.column_stack([np.concatenate([scan.positions for scan in scans]), apart_m * np.concatenate(layers)])


def nearest_of_class_m(scans: Sequence[SurveyScan], *, is_level: bool = False) -> FloatArray:
    """How far (N,) each of the detections of scans is, along the ground or in space, from the nearest of its class in
    its scan; inf if it is alone.
    """
    reach_m = 4.0 * max(np.abs(scan.positions).max(initial=0.0) for scan in scans)
    points = layered(scans, 2.0 * reach_m)[:, [0, 1, 3] if is_level else slice(None)]
    distances, _ = cKDTree(points).query(points, k=2, distance_upper_bound=reach_m)
    return np.asarray(distances)[:, 1]


def detectability_of(tracks: ObjectTracks) -> Detectability:
    """The most frequent gap between sightings of an object is the period; the share of these gaps, the probability."""
    gaps = np.diff(tracks.scan)[np.diff(tracks.track) == 0]
    if not len(gaps):
        return Detectability()
    counts = np.bincount(gaps)
    period = int(np.argmax(counts))
    return Detectability(period, counts[period] / len(gaps))


def _follow(scans: Sequence[SurveyScan], missed_scans: int, ratio: float, *, by_class: bool) -> ObjectTracks:
    c, s = (turn(headings_of(scans)) for turn in (np.cos, np.sin))
    turns = np.column_stack([c, s, -s, c]).reshape(-1, 2, 2)
    scan_of = np.repeat(np.arange(len(scans)), [len(scan.labels) for scan in scans])
    offsets = np.concatenate([scan.positions[:, :2] @ turn for scan, turn in zip(scans, turns, strict=True)])
    bodies = poses_of(scans)[scan_of, :3, 3]
    rays = unit_vectors(offsets)
    # Distances in the direction of the larger noise are divided by the ratio.
    axes = np.stack([rays / max(ratio, 1.0), rays[:, ::-1] * [-1.0, 1.0] / max(1.0 / ratio, 1.0)], axis=1)
    detected = ObjectTracks(
        track=np.arange(len(scan_of)),
        scan=scan_of,
        offsets=offsets,
        points=offsets + bodies[:, :2],
        labels=np.concatenate([scan.labels for scan in scans]),
        claimed=np.concatenate([scan.variances for scan in scans]),
        heights=np.concatenate([scan.positions[:, 2] for scan in scans]) + bodies[:, 2],
        rooms=RANGE_SHARE * np.hypot(offsets[:, 0], offsets[:, 1]),
        steps=np.zeros(len(scan_of)),
    )
    _continue_tracks(detected, detected.labels * by_class, axes, missed_scans)
    order = np.argsort(detected.track, kind="stable")
    tracks = detected.of(order)
    return replace(tracks, offsets=_smoothed(tracks.points, tracks.track) - bodies[order, :2])


def _continue_tracks(detected: ObjectTracks, classes: IntArray, axes: FloatArray, missed_scans: int) -> None:
    """Give detections (S,), scan by scan, each a track of its own, the tracks of their ``classes`` (S,) that they
    continue, and their steps, along their ``axes`` (S, 2, 2); ``rooms``, which are the most there may be, become
    smaller where other objects are near.
    """
    track, points, rooms = detected.track, detected.points, detected.rooms
    ends = np.zeros(0, dtype=np.int64)  # the last detection of each track that may go on
    counts = np.bincount(detected.scan)
    for number, rows in enumerate(np.split(np.arange(len(track)), np.cumsum(counts)[:-1])):
        ends = ends[number - detected.scan[ends] <= missed_scans + 1]
        nearest, distances, next_m, back = _nearest(
            points[rows], classes[rows], points[ends], classes[ends], axes[rows]
        )
        rooms[rows] = np.minimum(AMBIGUITY * next_m, rooms[rows])
        if len(ends):
            goes_on = (back[nearest] == np.arange(len(rows))) & (distances < rooms[rows])
            found, before = rows[goes_on], nearest[goes_on]
            track[found], detected.steps[found] = track[ends[before]], distances[goes_on]
            ends = np.delete(ends, before)
        ends = np.concatenate([ends, rows])


def _smoothed(points: FloatArray, track: IntArray) -> FloatArray:
    """The mean (S, 2) of each point and those around it on its track."""
    row = np.arange(len(track))
    first = np.maximum(row - SMOOTHED, np.searchsorted(track, track, side="left"))
    end = np.minimum(row + SMOOTHED + 1, np.searchsorted(track, track, side="right"))
    sums = np.concatenate([np.zeros((1, 2)), np.cumsum(points, axis=0)])
    return (sums[end] - sums[first]) / (end - first)[:, None]


def _nearest(
    points: FloatArray, labels: IntArray, tracks: FloatArray, track_labels: IntArray, axes: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray, IntArray]:
    """Between points (N, 2) and the ends (M, 2) m of tracks, of equal labels. ``axes`` (N, 2, 2): of each
    point, by rows, whose lengths scale the distances along them.

    Returns for each point the nearest track (N,), its distance (N,) and that of the next object (N,), be it another
    track or another of the points, inf where there is none of the class; and for each track the nearest point (M,).
    """
    count = len(points)
    index, back = np.zeros(count, dtype=np.int64), np.zeros(len(tracks), dtype=np.int64)
    nearest, following, least = np.full(count, np.inf), np.full(count, np.inf), np.full(len(tracks), np.inf)
    all_points, all_labels = np.concatenate([points, tracks]), np.concatenate([labels, track_labels])
    size = max(MAX_DISTANCES // max(len(all_points), 1), 1)  # as many rows of distances as are held
    for start in range(0, count, size):
        part = slice(start, start + size)
        x, y = (np.subtract.outer(points[part, axis], all_points[:, axis]) for axis in range(2))
        x, y = (axes[part, row, 0, None] * x + axes[part, row, 1, None] * y for row in range(2))
        apart = x * x + y * y
        apart[labels[part, None] != all_labels] = np.inf
        rows = np.arange(len(apart))
        apart[rows, start + rows] = np.inf
        if len(tracks):
            of_tracks = apart[:, count:]
            closest = of_tracks.argmin(axis=0)
            of_part = of_tracks[closest, np.arange(len(tracks))]
            nearer = of_part < least
            least[nearer], back[nearer] = of_part[nearer], start + closest[nearer]
            index[part] = chosen = of_tracks.argmin(axis=1)
            nearest[part] = of_tracks[rows, chosen]
            of_tracks[rows, chosen] = np.inf
        following[part] = apart.min(axis=1)
    return index, np.sqrt(nearest), np.sqrt(following), back
