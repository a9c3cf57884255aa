"""Loop-closure candidates for the tests of acceptance and insertion."""

from collections.abc import Sequence

import numpy as np

from slam.common.arrays import FloatArray
from slam.loop_closure.candidate import Candidate
from slam.odometry.keyframe import Keyframe
from slam.place_recognition.place_search import Place
from tests.helpers.poses import keyframe_at

HERE = np.eye(4)


def make_candidate(
    *,
    query: int | Keyframe = 50,
    reference: int | Keyframe = 3,
    T_reference_query: FloatArray = HERE,
    T_local_query: FloatArray = HERE,
    sigma: float = 0.1,
    llrs: dict[int, float] | None = None,
    pairs: Sequence[tuple[int, int]] = (),
    odometry_penalty: float = 0.0,
) -> Candidate:
    """``llrs``: LLR of each landmark of the query; ``sigma`` is that of angles [rad] and of positions [m]."""
    llr_of = llrs or {0: 25.0}
    return Candidate(
        query=query if isinstance(query, Keyframe) else keyframe_at(HERE, query, travel_m=300.0),
        reference=reference if isinstance(reference, Keyframe) else keyframe_at(HERE, reference),
        place=Place(T_local_query, 0.0, 0, ""),
        T_reference_query=T_reference_query,
        T_local_query=T_local_query,
        covariance=sigma**2 * np.eye(6),
        log_likelihood_ratios=np.array(list(llr_of.values())),
        pairs=np.array(pairs, int).reshape(-1, 2),
        odometry_penalty=odometry_penalty,
        unpredicted_penalty=0.0,
    )
