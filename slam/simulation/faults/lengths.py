"""All lengths of a log, its truth included, in another unit."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from logs.messages import GroundTruthPose, ObjectDetections, ObjectMapRecord, Odometry, Transform
from slam.common.arrays import FloatArray
from slam.simulation.faults.fault import EVERYTHING, Range, fault
from slam.simulation.faults.stream import Entry, Stream

_Factor = Annotated[float, Range("factor", min=1e-6, max=1e6)]


@fault(EVERYTHING, cases=("0.05", "20"))
def lengths_scaled(stream: Stream, factor: _Factor = 0.05) -> list[Entry]:
    """All lengths of the log and of its truth are multiplied."""
    return [_scaled(entry, factor) for entry in stream]


def _scaled(entry: Entry, factor: float) -> Entry:
    match entry.content:
        case Odometry() as odometry:
            covariance = odometry.covariance
            units = np.repeat([1.0, factor], 3)
            return entry.having(
                replace(
                    odometry,
                    T_odom_body=_moved(odometry.T_odom_body, factor),
                    covariance=None if covariance is None else covariance * np.outer(units, units),
                )
            )
        case ObjectDetections() as seen:
            return entry.having(
                replace(
                    seen,
                    positions=factor * seen.positions,
                    covariances=None if seen.covariances is None else factor**2 * seen.covariances,
                    sizes=None if seen.sizes is None else factor * seen.sizes,
                )
            )
        case Transform() as transform:
            return entry.having(replace(transform, T_parent_child=_moved(transform.T_parent_child, factor)))
        case GroundTruthPose() as pose:
            return entry.having(replace(pose, T_world_body=_moved(pose.T_world_body, factor)))
        case ObjectMapRecord() as objects:
            positions, covariances = factor * objects.positions, factor**2 * objects.covariances
            return entry.having(replace(objects, positions=positions, covariances=covariances))
        case _:
            return entry


def _moved(T: FloatArray, factor: float) -> FloatArray:
    scaled = T.copy()
    scaled[:3, 3] *= factor
    return scaled
