"""Loop-closure candidates for the tests of acceptance and insertion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.common.arrays import FloatArray
from slam.loop_closure.candidate import Candidate

HERE = np.eye(4)


def make_candidate(
    *,
    query: int = 50,
    reference: int = 3,
    travel_m: float = 300.0,
    T_reference_query: FloatArray = HERE,
    T_local_query: FloatArray = HERE,
    sigma: float = 0.1,
    llrs: dict[int, float] | None = None,
    pairs: Sequence[tuple[int, int]] = (),
    odometry_penalty: float = 0.0,
    unpredicted_penalty: float = 0.0,
) -> Candidate:
    """``llrs``: LLR of each landmark of the query; ``sigma`` is that of angles [rad] and of positions [m]."""
    llr_of = llrs or {0: 25.0}
    return Candidate(
        query=query,
        reference=reference,
        query_stamp_ns=10**9 * query,
        reference_stamp_ns=10**9 * reference,
        travel_m=travel_m,
        T_reference_query=T_reference_query,
        T_local_query=T_local_query,
        covariance=sigma**2 * np.eye(6),
        rows=np.array(list(llr_of), dtype=np.int64),
        log_likelihood_ratios=np.array(list(llr_of.values())),
        pairs=np.array(pairs, dtype=np.int64).reshape(-1, 2),
        matched_fraction=1.0,
        odometry_penalty=odometry_penalty,
        unpredicted_penalty=unpredicted_penalty,
        retrieval_distance=0.5,
    )
