"""The factor graph: what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Observation
from slam.common.errors import FactorGraphError
from tests.helpers.graphs import PLAIN
from tests.slam.backend.graphs import (
    KEYFRAMES,
    SEEN_COVARIANCE,
    build,
    edge,
    noisy_edges,
    sightings,
)

NOWHERE = np.full((4, 4), np.nan)
HERE = np.eye(4)
AHEAD = np.array([5.0, 0.0, 0.0])
UNKNOWN_KEYFRAME, UNKNOWN_LANDMARK = KEYFRAMES + 28, 77
REFUSED: dict[str, tuple[Callable[[FactorGraph], object], str]] = {
    "no transform to the next keyframe": (lambda graph: graph.add_next_keyframe(edge(11, 12, NOWHERE)), "keyframe 12"),
    "no covariance of the next keyframe": (
        lambda graph: graph.add_next_keyframe(replace(edge(11, 12, HERE), covariance=-np.eye(6))),
        "11 -> 12",
    ),
    "no position": (
        lambda graph: graph.add_observations([Observation(2, UNKNOWN_LANDMARK, AHEAD * np.nan, SEEN_COVARIANCE)]),
        "landmark 77",
    ),
    "the pose of an unknown keyframe": (lambda graph: graph.pose(UNKNOWN_KEYFRAME), "keyframe 40"),
    "an observation from an unknown keyframe": (
        lambda graph: graph.add_observations([Observation(UNKNOWN_KEYFRAME, 4, AHEAD, SEEN_COVARIANCE)]),
        "keyframe 40",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_by_name(name):
    call, told = REFUSED[name]
    graph = build(noisy_edges(), sightings())
    with pytest.raises(FactorGraphError, match=told):
        call(graph)


@pytest.mark.parametrize(
    ("add", "told"),
    [
        (lambda graph: graph.add_keyframe(17, NOWHERE), "keyframe 17"),
        (lambda graph: graph.add_next_keyframe(edge(0, 1, HERE)), "keyframe 0"),
    ],
)
def test_a_graph_begins_with_a_keyframe_that_is_held(add, told):
    with pytest.raises(FactorGraphError, match=told):
        add(FactorGraph(kernel_width=PLAIN))
