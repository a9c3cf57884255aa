"""The frame of the detections, if it is not the one that their messages name: turned by quarter turns, as upside down
or in optical axes, or that of the body, or that of the odometry, in which the objects of a tracker stand still already.

In the right frame, the motion of the body between two scans brings their detections nearer to one another than the
inverse motion does; in a wrong one, neither motion is better than the other. The mean log ratio of the two distances
is the evidence for a frame. Scans that share no object are as far apart by both motions, and tell nothing.

The same tells the unit of the odometry's lengths: with lengths that are too long by far, both motions are as wrong, and
with lengths that are too short, scans that are a part of the spacing of the objects apart share no object. So the
evidence has one maximum, at the right octave, if scans that are so far apart share objects.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray
from slam.common.geometry import make_transform
from slam.self_calibration.object_tracks import SurveyScan
from slam.self_calibration.scan_pairs import ScanPairs, evidence, is_better, is_positive, median_range, spacing_of

FACTOR = 1.25
"""By which there is more evidence for another frame: with less, it is a matter of degrees. By so much, at least,
lengths of another unit bring scans nearer than the inverse motion does; in wrong axes, some lengths do so by a tenth.
"""
OCTAVES = 20
"""Factors of up to two to that power are tried, a million either way."""


def better_frame(as_they_are: Sequence[SurveyScan], others: Mapping[str, Sequence[SurveyScan]]) -> str | None:
    """The name of another frame of the same scans (K) for which there is more evidence, or None."""
    # Ranges in the frame of the odometry grow with the travel if the detections are not in that frame.
    found = {
        name: scans
        for name, scans in others.items()
        if len(scans) == len(as_they_are) > 1 and median_range(scans) < FACTOR * median_range(as_they_are)
    }
    if not found:
        return None
    pairs = ScanPairs.of(as_they_are, min(spacing_of(scans) for scans in (as_they_are, *found.values())))

    def distances(scans: Sequence[SurveyScan]) -> FloatArray:
        same = ScanPairs(scans, pairs.rows, pairs.spacing_m)
        return same.log_distances(same.motions)

    by_name = {name: distances(scans) for name, scans in found.items()}
    best = max(found, key=lambda name: np.sum(evidence(by_name[name])))
    # Objects that go along with the body are twice as far apart by the inverse motion in the frame of the odometry.
    beyond = evidence(by_name[best]) - np.log(2.0)
    # By four standard errors of all pairs: where the body stands there is no evidence, which is not chance.
    is_sure = len(beyond) > 0 and np.mean(beyond) > 4.0 * np.std(beyond) / np.sqrt(len(beyond))
    return best if is_sure and is_better(by_name[best], distances(as_they_are), FACTOR) else None


def find_level(rotations: FloatArray) -> FloatArray:
    """The rotation (3, 3) by which the frame of the odometry becomes level, from those of the body (K, 3, 3) in it.

    The vertical is the direction that is most constant in the axes of the body, which leans about it: the first
    singular vector of the mean rotation. As the mean of few leans it may err by as much as they spread, and by more
    where the body keeps its heading, so that other directions are as constant. A frame that is level within that error
    is left as it is. Up is where the z axis points, or, of a frame in optical axes, away from the y axis.
    """
    directions, constancy, _ = np.linalg.svd(rotations.sum(axis=0) / max(len(rotations), 1))
    x, y, z = directions[:, 0] if directions[2, 0] >= directions[1, 0] else -directions[:, 0]
    # Poses have seven digits.
    spread_rad = np.sqrt(max(2.0 * (1.0 - constancy[0]), np.finfo(np.float32).eps))
    if np.arccos(np.clip(z, -1.0, 1.0)) * (constancy[0] - constancy[1]) <= spread_rad:
        return np.eye(3)
    return Rotation.from_euler("xy", (np.arctan2(y, z), -np.arctan2(x, np.hypot(y, z)))).as_matrix()


def find_orientation(scans: Sequence[SurveyScan]) -> FloatArray:
    """The quarter turn (3, 3) of detections, in the axes of the body, for which there is more evidence than for the
    axes as they are; the identity where there is none. ``scans``: (K), two at least, in the order of their stamps.
    """
    pairs = ScanPairs.of(scans, spacing_of(scans))
    turns = sorted(np.rint(Rotation.create_group("O").as_matrix()), key=lambda turn: -np.trace(turn))
    distances = [pairs.log_distances(pairs.seen_by(make_transform(turn, np.zeros(3)), pairs.motions)) for turn in turns]
    best = np.argmax([np.sum(evidence(each)) for each in distances])
    return turns[best] if is_better(distances[best], distances[0], FACTOR) else np.eye(3)


def is_unit_right(scans: Sequence[SurveyScan]) -> bool:
    """Whether the travel of the odometry brings scans (K), in the order of their stamps, nearer to one another than its
    inverse does, and there is no more evidence for the next octaves.
    """
    spacing_m = spacing_of(scans)
    half, found, double = (_evidence(scans, spacing_m, factor) for factor in (0.5, 1.0, 2.0))
    return is_positive(found) and bool(np.sum(found) >= max(np.sum(half), np.sum(double)))


def find_unit(scans: Sequence[SurveyScan]) -> float:
    """The power of two by which lengths of the odometry must be multiplied; 1 where no other one is sure.

    ``scans``: (K), two at least, in the order of their stamps.
    """
    spacing_m, factors = spacing_of(scans), 2.0 ** np.arange(-OCTAVES, OCTAVES + 1)
    found = [_evidence(scans, spacing_m, factor) for factor in factors.tolist()]
    best = np.argmax([np.sum(each) for each in found])
    if not is_positive(found[best]) or np.mean(found[best]) <= np.log(FACTOR):
        return 1.0
    # A factor that is too large chooses scans of a short way, which share objects, and has evidence for it where scans
    # of a longer way share none: it must bring its own scans nearer to one another than lengths as they are.
    pairs = ScanPairs.by_travel(scans, spacing_m, factors[best])
    as_they_are = pairs.motions.copy()
    as_they_are[:, :3, 3] /= factors[best]
    nearer = pairs.log_distances(as_they_are)[:, 0] - pairs.log_distances(pairs.motions)[:, 0]
    return factors[best] if is_positive(nearer) else 1.0


def _evidence(scans: Sequence[SurveyScan], spacing_m: float, factor: float) -> FloatArray:
    """Evidence (P,) of pairs of scans, where the lengths of the odometry are multiplied by a factor."""
    pairs = ScanPairs.by_travel(scans, spacing_m, factor)
    return evidence(pairs.log_distances(pairs.motions))
