"""The solver during the drive: iSAM2."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from slam.backend.gtsam_calls import first_line, graph_of, gtsam_errors
from slam.backend.solver import Solver, Value

logger = logging.getLogger(__name__)

RELINEARIZE_RAD = 0.05
"""Rotation that relinearises a pose."""


class IncrementalSolver(Solver):
    """iSAM2 (Kaess et al. 2012), and what is added to it by its next update."""

    def __init__(self, *, sensor_range_m: float) -> None:
        super().__init__()
        self._relinearize_m = RELINEARIZE_RAD * (1.0 / 30.0 * sensor_range_m)
        self._isam = self._new_isam("CHOLESKY")
        self._values: gtsam.Values | None = None
        self._poses: dict[int, gtsam.Pose3] = {}  # those queried since the last update
        self._slots: dict[int, int] = {}  # places of the factors in iSAM2
        self._new_values = gtsam.Values()
        self._leaving: set[int] = set()

    def holds(self, key: int) -> bool:
        """Whether a variable is there."""
        is_held = self._isam.valueExists(key) and key not in self._leaving
        return bool(is_held or self._new_values.exists(key))

    def insert(self, key: int, value: Value) -> None:
        """Add a variable with its initial value; one that was about to leave stays where it was."""
        if key in self._leaving:
            self._leaving.remove(key)
        else:
            self._new_values.insert(key, value)

    def values(self) -> gtsam.Values:
        """The estimate of all variables; iSAM2 computes those that were not queried before only here."""
        if self._values is None:
            with gtsam_errors("the estimate"):
                self._values = self._isam.calculateEstimate()
        return self._values

    @property
    def new_values(self) -> gtsam.Values:
        """Initial values of the variables that the next update adds."""
        return self._new_values

    def _improve(self) -> None:
        with gtsam_errors("the incremental update"):
            try:
                removed_slots = [self._slots.pop(number) for number in self._removed]
                result = self._isam.update(graph_of(self._added.values()), self._new_values, removed_slots)
                self._take_result(list(self._added), result)
            except RuntimeError as error:
                logger.info("the incremental update failed (%s); solving again with QR", first_line(error))
                # The failed update has the new variables already.
                self._solve_afresh(self._isam.getLinearizationPoint(), "QR")

    def _start(self, values: gtsam.Values) -> None:
        try:
            self._solve_afresh(values, "CHOLESKY")
        except RuntimeError as error:
            logger.info("the solution by Cholesky failed (%s); solving again with QR", first_line(error))
            self._solve_afresh(values, "QR")

    def _solve_afresh(self, values: gtsam.Values, factorization: str) -> None:
        """Put all factors into a new iSAM2.

        Elimination by QR is slower than by Cholesky, but bears the poor conditioning of, say, a very exact odometry
        beside landmarks that the robust kernel has all but switched off.
        """
        numbers = sorted(self._factors)
        graph, kept = graph_of(self._factors[number] for number in numbers), gtsam.Values()
        for key in graph.keyVector():
            is_pose = gtsam.symbolChr(key) == ord("x")
            kept.insert(key, values.atPose3(key) if is_pose else values.atPoint3(key))
        self._isam, self._slots = self._new_isam(factorization), {}
        self._take_result(numbers, self._isam.update(graph, kept))

    def _take_result(self, numbers: Sequence[int], result: gtsam.ISAM2Result) -> None:
        self._slots.update(zip(numbers, result.getNewFactorsIndices(), strict=True))
        self._values, self._poses = None, {}
        self._new_values = gtsam.Values()
        self._leaving.clear()

    def _release(self, key: int) -> None:
        if self._new_values.exists(key):
            self._new_values.erase(key)
        else:
            self._leaving.add(key)

    def _pose(self, keyframe: int) -> gtsam.Pose3:
        key = X(keyframe)
        if self._new_values.exists(key):
            return self._new_values.atPose3(key)
        if keyframe not in self._poses:
            with gtsam_errors(f"the estimate of keyframe {keyframe}"):
                known = self._values
                self._poses[keyframe] = self._isam.calculateEstimatePose3(key) if known is None else known.atPose3(key)
        return self._poses[keyframe]

    def _new_isam(self, factorization: str) -> gtsam.ISAM2:
        """An empty one, with thresholds by the sensor range."""
        thresholds = gtsam.ISAM2ThresholdMap()
        thresholds.insert(("x", np.repeat([RELINEARIZE_RAD, self._relinearize_m], 3)))
        thresholds.insert(("l", np.repeat(self._relinearize_m, 3)))
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(thresholds)
        parameters.setFactorization(factorization)
        return gtsam.ISAM2(parameters)
