"""The likelihood of a place that is not in the map, where places look alike."""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from slam.common.arrays import FloatArray


def log_somewhere_new(
    log_likelihood_ratios: FloatArray, log_uniform: FloatArray, log_aligned: FloatArray | float = 0.0
) -> float:
    """Log-likelihood ratio of "somewhere new" to clutter, where a query fits K known places at other poses.

    A new place looks like clutter, or like one of the mapped places, with the robot anywhere in it. Each counts by the
    probability that its fit is not by chance: by chance a pose somewhere in the area reaches an LLR with a probability
    below exp(-LLR - ``log_uniform``), as exp(LLR) is 1 in the mean over clutter (Markov's inequality).

    Args:
        log_likelihood_ratios: (K,), LLR of the query there to clutter.
        log_uniform: (K,), log prior probability of the poses that it does not tell apart, in the whole area.
        log_aligned: (K,), the same within one place.
    """
    shares = -np.expm1(np.minimum(0.0, -log_uniform - log_likelihood_ratios))
    ratios = np.append(log_likelihood_ratios + log_aligned, 0.0)
    return float(logsumexp(ratios, b=np.append(shares, 1.0)) - np.log1p(shares.sum()))
