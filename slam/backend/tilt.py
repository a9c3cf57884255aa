"""Whether gravity holds the tilt of the odometry, by the whole graph.

Over single steps the detections determine the tilt of the odometry no better than heights; over a whole drive they do.
Gravity holds the tilt of an odometry with an IMU, and that of a camera alone drifts. If gravity holds it, the tilts of
its E steps are not free parameters, and the decrease of the squared residuals when they are freed is chi-squared with
their effective number of degrees of freedom (Hastie and Tibshirani, Generalized Additive Models, 1990, section 3.5):

    nu = 2 E + 1/2 d log det H / d log f,

with H the information of all variables and f a factor on the standard deviations of the tilts. Of several factors the
least one that is not contradicted is used, so that a drive near the level of significance is near both solutions.
"""

import logging
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind
from slam.common.errors import FactorGraphError

logger = logging.getLogger(__name__)

DIFFERENCE = 0.8
"""Factor on the standard deviations of roll and pitch by which the derivative is taken."""
FACTORS = 10.0 ** np.array([-1.0, -0.75, -0.5])
"""Those by which the tilt may be held; a weaker hold changes little."""


def hold_tilt(graph: FactorGraph) -> None:
    """Optimise the whole graph, with the tilt of the odometry held unless the graph contradicts that."""
    graph.assume_gaussian_odometry()
    free, estimate = graph.optimize(roughly=True), graph.estimate()
    steps = graph.edges(EdgeKind.ODOMETRY)
    if not steps:
        return
    try:
        before = graph.log_determinant()
        graph.replace_edges(_scaled(graph, steps, DIFFERENCE))
        slope = (graph.log_determinant() - before) / np.log(DIFFERENCE)
    except FactorGraphError as error:
        logger.info("the noise of the tilt stays as it is configured: %s", error)
        graph.replace_edges(steps, estimate)
        return
    # Degrees of freedom of the tilts of the steps that the rest of the graph determines.
    freedom = max(2 * len(steps) + 0.5 * slope, 0.0)
    for factor in FACTORS:
        graph.replace_edges(_scaled(graph, steps, factor))
        held = graph.optimize(roughly=True)
        # A tilt that gravity holds is freed in one drive of a hundred.
        if chdtrc(freedom, 2.0 * max(held.error - free.error, 0.0)) > 0.01:
            return
    graph.replace_edges(steps, estimate)


def _scaled(graph: FactorGraph, steps: Mapping[int, Edge], factor: float) -> dict[int, Edge]:
    """The steps with the standard deviations of roll and pitch scaled."""
    R = graph.poses(each.to_keyframe for each in steps.values())[:, :3, :3]
    S = np.tile(np.eye(6), (len(R), 1, 1))
    S[:, :3, :3] = np.swapaxes(R, 1, 2) @ np.diag([factor, factor, 1.0]) @ R
    covariances = S @ np.array([each.covariance for each in steps.values()]) @ np.swapaxes(S, 1, 2)
    return {number: replace(each, covariance=C) for (number, each), C in zip(steps.items(), covariances, strict=True)}
