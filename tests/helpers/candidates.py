"""Loop-closure candidates for the tests of what judges and inserts them."""

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
    T_odom_query: FloatArray = HERE,
    sigma: float = 0.1,
    nats: dict[int, float] | None = None,
    pairs: Sequence[tuple[int, int]] = (),
    doubt_nats: float = 0.0,
) -> Candidate:
    """``nats``: what each landmark of the query says; ``sigma`` is that of angles [rad] and of places [m]."""
    weighed = nats or {0: 25.0}
    return Candidate(
        query=query,
        reference=reference,
        query_stamp_ns=10**9 * query,
        reference_stamp_ns=10**9 * reference,
        travel_m=travel_m,
        T_reference_query=T_reference_query,
        T_odom_query=T_odom_query,
        covariance=sigma**2 * np.eye(6),
        rows=np.array(list(weighed), dtype=np.int64),
        nats=np.array(list(weighed.values())),
        pairs=np.array(pairs, dtype=np.int64).reshape(-1, 2),
        matched_fraction=1.0,
        doubt_nats=doubt_nats,
        retrieval_distance=0.5,
    )
