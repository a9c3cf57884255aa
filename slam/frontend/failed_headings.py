"""Less weight for the odometry in the graph where its heading fails."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind
from slam.common.config import Config
from slam.odometry.failures import find_heading_failures
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import step_covariance


def loosen_failed_headings(
    graph: FactorGraph, keyframes: Sequence[Keyframe], config: Config, counters: Counter[str]
) -> None:
    """Let the variances of headings follow what landmarks say of the steps.

    ``keyframes``: all of the graph, in the order of their ids; ``counters`` is where it counts the steps that fail. The
    graph is solved in batch from then on.
    """
    factors = find_heading_failures(
        keyframes, config.calibration.odometry, failures_per_km=config.localization.failures_per_km
    )
    covariances = {
        number: step_covariance(
            keyframes[edge.from_keyframe].odometry,
            keyframes[edge.to_keyframe].odometry,
            config.calibration.odometry,
            heading_factor=factors[edge.to_keyframe],
        )
        for number, edge in graph.factors.items()
        if isinstance(edge, Edge) and edge.kind == EdgeKind.ODOMETRY and edge.to_keyframe in factors
    }
    graph.replace_covariances(covariances)
    counters["odometry_headings_doubted"] += len(covariances)
