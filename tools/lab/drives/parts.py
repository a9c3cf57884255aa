"""Parts of the method that a sweep switches off, one at a time."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import field, replace
from typing import Any
from unittest.mock import patch

import numpy as np

from logs.records import frozen
from slam.backend.factor_graph import EditableGraph
from slam.sweeps.mapped_drive import DriveTask, MappedDrive, map_drive

_PREFIX = __name__.removesuffix("tools.lab.drives.parts")
"""Of the names of our packages: "dslam." in a wheel."""


@frozen
class Part:
    """What switches a part off: ``settings`` ("key=value"), and ``replaced``, functions and constants by their full
    names with their replacements, where there is no setting.
    """

    settings: tuple[str, ...] = ()
    replaced: Mapping[str, Any] = field(default_factory=dict)


def _uniform_clutter(distances: Any, is_other: Any, alike: Any, *rest: Any) -> Any:
    """The clutter density of the whole reference, the same for all objects of a class."""
    return (0.5 + np.sum(alike, axis=0)) / (np.pi * (0.5 * np.max(distances)) ** 2)


_ADD_OBSERVATIONS = EditableGraph.add_observations


def _add_weightless(self: Any, observations: Any) -> None:
    """``EditableGraph.add_observations`` of observations without weight."""
    # No weight against the odometry.
    _ADD_OBSERVATIONS(self, [replace(each, covariance_inflation=1e6) for each in observations])


PARTS: dict[str, Part] = {
    "descriptor: random vectors": Part(("loop_closure.descriptor=random",)),
    "propagation of closures": Part(("loop_closure.propagation_distance_m=0",)),
    "posterior: first candidate": Part(("localization.error_probability=0.999999",)),
    "loop closures": Part(("loop_closure.enabled=false",)),
    "weight of landmarks": Part(replaced={"slam.backend.factor_graph.EditableGraph.add_observations": _add_weightless}),
    "labels": Part(("calibration.objects.max_classes=1",)),
    "calibration": Part(("calibrate=false",)),
    "mode search in tracking": Part(
        replaced={
            "slam.frontend.tracker.Tracker._decided": lambda self, tracked, modes, sure: tracked,
            "slam.frontend.tracker.Tracker._sure_mode": lambda self, tracked, modes: None,
        }
    ),
    "existence of landmarks": Part(
        replaced={"slam.frontend.mapper.which_exist": lambda landmarks, seen, scan: np.ones(len(seen), dtype=np.bool_)}
    ),
    "association after a loop": Part(
        replaced={
            "slam.loop_closure.accepted_closures.AcceptedClosures._may_merge": lambda *each: False,
            "slam.graph_condenser.fuse_landmarks": lambda *each: 0,
        }
    ),
    "clutter around each object": Part(
        replaced={
            "slam.loop_closure.likelihood_ratio._disc_densities": _uniform_clutter,
            "slam.loop_closure.likelihood_ratio._row_densities": lambda offsets, *rest: np.zeros(offsets.shape[1]),
        }
    ),
    "robust back end": Part(replaced={"slam.backend.factors.KERNEL_WIDTHS": {}}),
    "kidnappings noticed by landmarks": Part(
        replaced={
            "slam.localization.continuity_monitor.ContinuityMonitor.update": lambda self, keyframe, object_map: None
        }
    ),
}
"""By name, in the order of the table."""


def map_without(task: DriveTask) -> MappedDrive:
    """Map a drive, with the part off that its variant names, if any."""
    with ExitStack() as stack:
        for name, value in PARTS.get(task.variant, Part()).replaced.items():
            stack.enter_context(patch(f"{_PREFIX}{name}", value))
        return map_drive(task)
