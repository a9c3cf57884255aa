"""Accuracy of the labels of detections, from objects that are tracked by their positions alone.

Say that a label is right with probability a, else drawn from all labels of the log. Then two sightings of one object
agree with the probability a^2 + (1 - a^2) c, where c is the probability that two labels drawn at random agree: a^2 is
Cohen's kappa of successive sightings (Educational and Psychological Measurement, 1960).

A log may also begin to call all classes by other names: then the labels of all that is in view change between two
scans.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.records import frozen
from slam.common.arrays import FloatArray, IntArray
from slam.self_calibration.object_tracks import SurveyScan, follow_objects, objects_among
from slam.self_calibration.variance_components import LEAST_PAIRS

SLIGHT = 0.2
"""Kappa up to which agreement is slight (Landis and Koch, Biometrics 1977): labels say next to nothing."""
RENAMING = 1e-6
"""Prior probability that classes are renamed within a log."""
FOLLOWED = 0.5
"""Share of the objects in view that must be followed between two scans for their labels to be compared: where the
odometry jumps, positions tell little.
"""


@frozen
class LabelNoise:
    """``accuracy``: the probability that a label is right, NaN where too few objects could be followed or there is one
    class only; ``renamed_ns``: the stamp of the scan from which on classes have other names, None where they keep them.
    """

    accuracy: float = float("nan")
    renamed_ns: int | None = None

    @property
    def is_useless(self) -> bool:
        """Whether objects are better distinguished without their labels."""
        return self.renamed_ns is not None or self.accuracy**2 < SLIGHT


def estimate_label_noise(scans: Sequence[SurveyScan]) -> LabelNoise:
    """The noise of the labels in ``scans`` (K)."""
    tracks = objects_among(follow_objects(scans, by_class=False))
    same = tracks.track[1:] == tracks.track[:-1]
    if int(same.sum()) < LEAST_PAIRS:
        return LabelNoise()
    shares = np.unique(tracks.labels, return_counts=True)[1] / len(tracks.labels)
    by_chance = np.sum(shares**2)
    if by_chance == 1.0:
        return LabelNoise()
    changed = (tracks.labels[1:] != tracks.labels[:-1])[same]
    kappa = 1.0 - np.mean(changed) / (1.0 - by_chance)
    scan = tracks.scan[1:][same]
    followed = np.bincount(scan, minlength=len(scans))
    changes = np.bincount(scan[changed], minlength=len(scans))
    in_view = np.array([len(each.labels) for each in scans])
    is_renamed = _log_likelihood_ratio(followed, changes) > np.log(len(scans) / RENAMING)
    renamed = np.flatnonzero(is_renamed & (followed > FOLLOWED * in_view))
    # Where none of n pairs differs, one of n + 2 is expected to (Laplace): no label is right for certain.
    accuracy = min(np.sqrt(max(kappa, 0.0)), 1.0 - 1.0 / (len(changed) + 2.0))
    return LabelNoise(accuracy, scans[renamed[0]].stamp_ns if len(renamed) else None)


def _log_likelihood_ratio(followed: IntArray, changes: IntArray) -> FloatArray:
    """(K,) of new names for all classes against noise, from how many of the followed objects change their labels."""
    # The scan itself is left out of the share of changes that it is compared with.
    share = (changes.sum() - changes + 1.0) / (followed.sum() - followed + 2.0)
    return np.asarray((2.0 * changes - followed) * np.log((1.0 - share) / share))
