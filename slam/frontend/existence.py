"""Whether a landmark exists, or false detections lie near each other by chance.

The log-odds that a landmark exists are

    log(prior odds) + log B(k + 1, n - k + 1) + sum over its k matches of log(p(z | landmark) / p(z | something else))

after n scans since its first detection: each match is scored against the density of detections of no landmark, as
in data association, and in how many of the scans it was found by the evidence of a detection probability that may be
anything, with B the beta function. The prior is the share of the landmarks so far that were confirmed. (Integrated
tracking: Musicki, Evans and Stankovic, IEEE Trans. Automatic Control, 1994; score of a track: Blackman and Popoli,
Design and Analysis of Modern Tracking Systems, 1999, ch. 6.)
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln

from slam.common.arrays import BoolArray, IntArray
from slam.frontend.data_association import DECIDED
from slam.object_map.landmarks import LandmarkState


def which_exist(landmarks: NDArray[np.void], seen: IntArray, scan: int) -> BoolArray:
    """Which of the rows ``seen`` (N,) of the landmarks (L,) exist, by what was seen of them up to a scan; a single
    detection is no evidence against it.
    """
    confirmed = int(np.count_nonzero(landmarks["state"] == LandmarkState.CONFIRMED.value))
    prior = np.log((confirmed + 1.0) / (len(landmarks) - confirmed + 1.0))
    matches = landmarks["observations"][seen] - 1
    missed = np.maximum(scan - landmarks["first_scan"][seen] - matches, 0)
    odds = prior + betaln(matches + 1.0, missed + 1.0) + landmarks["log_likelihood_ratio"][seen]
    return (matches == 0) | (odds >= np.log(DECIDED / (1.0 - DECIDED)))
