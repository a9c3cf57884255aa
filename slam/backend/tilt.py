"""Whether gravity holds the tilt of the odometry, by the whole graph.

Over single steps the detections determine the tilt of the odometry no better than heights; over a whole drive they do.
Gravity holds the tilt of an odometry with an IMU, and that of a camera alone drifts. The noise of the tilts is the one
with the larger evidence (Laplace's approximation: MacKay, Information Theory, Inference, and Learning Algorithms, 2003,
ch. 28): with c the cost at the solution, H the information of all variables there, and f a factor on the standard
deviations of roll and pitch of E steps,

    log p(measurements | f) = -c - 1/2 log det H - 2 E log f + constant.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping

import numpy as np

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind
from slam.common.arrays import FloatArray
from slam.common.errors import FactorGraphError

logger = logging.getLogger(__name__)

HELD = 0.1
"""Factor on the standard deviations of roll and pitch if gravity holds them."""


def hold_tilt(graph: FactorGraph) -> None:
    """Optimise the whole graph, with the tilt of the odometry held if there is more evidence for it."""
    free = graph.optimize()
    steps = {
        number: each
        for number, each in graph.factors.items()
        if isinstance(each, Edge) and each.kind == EdgeKind.ODOMETRY
    }
    if not steps:
        return
    configured = {number: each.covariance for number, each in steps.items()}
    try:
        evidence = -free.error - 0.5 * graph.log_determinant()
        graph.replace_covariances(_scaled(graph, steps, HELD))
        held = graph.optimize()
        if -held.error - 0.5 * graph.log_determinant() - 2.0 * len(steps) * np.log(HELD) > evidence:
            return
    except FactorGraphError as error:
        logger.info("the noise of the tilt stays as it is configured: %s", error)
    graph.replace_covariances(configured)
    graph.optimize()


def _scaled(graph: FactorGraph, steps: Mapping[int, Edge], factor: float) -> dict[int, FloatArray]:
    """Covariances (6, 6) of steps, axes of the body, with the standard deviations of roll and pitch scaled."""
    R = graph.poses(np.array([each.to_keyframe for each in steps.values()], dtype=np.int64))[:, :3, :3]
    S = np.tile(np.eye(6), (len(R), 1, 1))
    S[:, :3, :3] = np.swapaxes(R, 1, 2) @ np.diag([factor, factor, 1.0]) @ R
    covariances = S @ np.array([each.covariance for each in steps.values()]) @ np.swapaxes(S, 1, 2)
    return dict(zip(steps, covariances, strict=True))
