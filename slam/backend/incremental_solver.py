"""The solver while the drive goes on: iSAM2."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from slam.backend.batch_solver import BatchSolver, GtsamCalls, first_line, graph_of
from slam.backend.estimates import Estimates, read_estimates
from slam.backend.solver_options import FactorGraphConfig
from slam.common.arrays import FloatArray
from slam.common.errors import FactorGraphError

logger = logging.getLogger(__name__)

RELINEARIZE_UNIT_RANGES = 1.0 / 30.0
"""Unit of length in which a position changes by as much as a rotation in radians, in sensor ranges."""


class IncrementalSolver:
    """iSAM2 (Kaess et al. 2012), and what it takes in with its next update.

    Each factor has a number of the caller's, which never changes. Observations that are not summed up over several
    keyframes wait for the batch solution but for those from one keyframe in ``observed_keyframes``: neighbouring
    keyframes see the same landmarks, to which the local map has fitted them already, and the memory of iSAM2 grows with
    the keyframes that are tied to many landmarks.
    """

    def __init__(self, config: FactorGraphConfig, calls: GtsamCalls, *, sensor_range_m: float) -> None:
        self._config = config
        self._calls = calls
        self._relinearize_unit_m = RELINEARIZE_UNIT_RANGES * sensor_range_m
        self._isam = self._new_isam("CHOLESKY")
        self._values: gtsam.Values | None = None
        self._poses: dict[int, FloatArray] = {}  # what ``pose`` answered since the last update
        self._pending: dict[int, gtsam.NonlinearFactor] = {}
        self._pending_values = gtsam.Values()
        self._slots: dict[int, int] = {}
        self._removed_slots: list[int] = []
        self._leaving: set[int] = set()
        self._waiting: dict[int, gtsam.NonlinearFactor] = {}
        self._landmark_of: dict[int, int] = {}  # by the number of the factor
        self._uses: Counter[int] = Counter()  # factors of each landmark

    def holds_keyframe(self, keyframe: int) -> bool:
        """Whether a keyframe is among the variables."""
        return self._pending_values.exists(X(keyframe)) or self._isam.valueExists(X(keyframe))

    def holds_landmark(self, landmark: int) -> bool:
        """Whether a landmark is among the variables."""
        is_held = self._isam.valueExists(L(landmark)) and landmark not in self._leaving
        return is_held or self._pending_values.exists(L(landmark))

    def insert_keyframe(self, keyframe: int, T_map_body: gtsam.Pose3) -> None:
        """Add a keyframe, with its initial pose."""
        self._pending_values.insert(X(keyframe), T_map_body)

    def insert_landmark(self, landmark: int, position_map: FloatArray) -> None:
        """Add a landmark, with its initial position (3,) m; one that was about to leave stays where it was."""
        if landmark in self._leaving:
            self._leaving.remove(landmark)
        else:
            self._pending_values.insert(L(landmark), position_map)

    def add(self, number: int, factor: gtsam.NonlinearFactor) -> None:
        """Add a factor between variables that are held."""
        self._pending[number] = factor
        self._count(number, factor)

    def _count(self, number: int, factor: gtsam.NonlinearFactor) -> None:
        for key in list(factor.keys()):
            if gtsam.symbolChr(key) == ord("l"):
                self._landmark_of[number] = gtsam.symbolIndex(key)
                self._uses[self._landmark_of[number]] += 1

    def add_observation(
        self, number: int, factor: gtsam.NonlinearFactor, keyframe: int, landmark: int, position_map: FloatArray
    ) -> None:
        """Add an observation of a landmark, which has the position (3,) m if it is new; most only wait."""
        if self._waits(keyframe):
            self._waiting[number] = factor
            return
        if not self.holds_landmark(landmark):
            self.insert_landmark(landmark, position_map)
        self.add(number, factor)

    def _waits(self, keyframe: int) -> bool:
        return keyframe % self._config.observed_keyframes != 0

    def remove(self, number: int) -> None:
        """Take a factor out again; a landmark leaves with its last one."""
        if number in self._waiting:
            del self._waiting[number]
        elif number in self._pending:
            del self._pending[number]
        else:
            self._removed_slots.append(self._slots.pop(number))
        landmark = self._landmark_of.pop(number, None)
        if landmark is not None:
            self._uses[landmark] -= 1
            if not self._uses[landmark]:
                self._release(landmark)

    def _release(self, landmark: int) -> None:
        if self._pending_values.exists(L(landmark)):
            self._pending_values.erase(L(landmark))
        else:
            self._leaving.add(landmark)

    def update(self) -> None:
        """Bring the incremental estimate up to date with all that was added and removed."""
        if not self._pending and not self._removed_slots:
            return
        with self._calls.doing("the incremental update"):
            try:
                new = graph_of(self._pending.values())
                result = self._isam.update(new, self._pending_values, self._removed_slots)
                numbers = list(self._pending)
            except RuntimeError as error:
                logger.info("the incremental update failed (%s); solving afresh by QR", first_line(error))
                numbers = sorted([*self._slots, *self._pending])
                # The failed update has taken the new variables in already.
                result = self._start_over(self._factors(), self._isam.getLinearizationPoint(), "QR")
        self._took_in(numbers, result)

    def restart(self, values: gtsam.Values, changed: Mapping[int, gtsam.NonlinearFactor]) -> None:
        """Solve all afresh from ``values``, with factors added, or others in the place of some."""
        self.update()
        factors = self._factors() | dict(changed)
        try:
            result = self._start_over(factors, values, "CHOLESKY")
        except RuntimeError as error:
            logger.info("joining by Cholesky failed (%s); solving afresh by QR", first_line(error))
            result = self._start_over(factors, values, "QR")
        self._slots = {}
        self._took_in(list(factors), result)

    def resume(
        self, values: gtsam.Values, factors: Mapping[int, gtsam.NonlinearFactor], seen_from: Mapping[int, int]
    ) -> None:
        """Go on, empty so far, from a batch solution; ``seen_from``: the keyframes of the factors that observe."""
        self._waiting = {each: factors[each] for each, keyframe in seen_from.items() if self._waits(keyframe)}
        held = {number: factor for number, factor in factors.items() if number not in self._waiting}
        for number, factor in held.items():
            self._count(number, factor)
        self.restart(values, held)

    def settle(self, landmarks: Mapping[int, FloatArray]) -> BatchSolver:
        """The batch solver that goes on from here with all factors; positions (3,) m of ``landmarks`` not held yet."""
        self.update()
        values = gtsam.Values(self.estimate())
        for landmark, position_map in landmarks.items():
            values.insert(L(landmark), position_map)
        factors = self._factors() | self._waiting
        return BatchSolver({number: factors[number] for number in sorted(factors)}, values, self._calls)

    def pose(self, keyframe: int) -> FloatArray:
        """``T_map_body`` (4, 4) of a keyframe."""
        key = X(keyframe)
        if self._pending_values.exists(key):
            return np.asarray(self._pending_values.atPose3(key).matrix())
        if keyframe not in self._poses:
            if not self._isam.valueExists(key):
                raise FactorGraphError(f"keyframe {keyframe} is not in the graph")
            with self._calls.doing(f"the estimate of keyframe {keyframe}"):
                known = self._values
                pose = self._isam.calculateEstimatePose3(key) if known is None else known.atPose3(key)
            self._poses[keyframe] = pose.matrix()
        return self._poses[keyframe].copy()

    def estimate(self) -> gtsam.Values:
        """All variables as of the last update; iSAM2 computes those not queried before only here."""
        if self._values is None:
            with self._calls.doing("the estimate"):
                self._values = self._isam.calculateEstimate()
        return self._values

    def estimates(self) -> Estimates:
        """Where everything is as far as it is known now; nothing is solved for it."""
        return read_estimates(self.estimate(), self._pending_values)

    def _factors(self) -> dict[int, gtsam.NonlinearFactor]:
        """The factors that iSAM2 holds or takes in next, by their numbers, which ascend."""
        held = self._isam.getFactorsUnsafe()
        factors = {number: held.at(slot) for number, slot in self._slots.items()} | self._pending
        return {number: factors[number] for number in sorted(factors)}

    def _start_over(
        self, factors: Mapping[int, gtsam.NonlinearFactor], values: gtsam.Values, factorization: str
    ) -> gtsam.ISAM2Result:
        """Put all factors into a fresh iSAM2.

        One that eliminates by QR is slower than Cholesky, but it bears the poor conditioning of, say, a very sure
        odometry beside landmarks that the robust kernel has all but switched off.
        """
        graph, kept = graph_of(factors.values()), gtsam.Values()
        for key in graph.keyVector():
            if gtsam.symbolChr(key) == ord("x"):
                kept.insert(key, values.atPose3(key))
            else:
                kept.insert(key, values.atPoint3(key))
        self._isam = self._new_isam(factorization)
        return self._isam.update(graph, kept)

    def _took_in(self, numbers: list[int], result: gtsam.ISAM2Result) -> None:
        self._values = None
        self._poses = {}
        self._slots.update(zip(numbers, result.getNewFactorsIndices(), strict=True))
        self._pending = {}
        self._pending_values = gtsam.Values()
        self._removed_slots = []
        self._leaving.clear()

    def _new_isam(self, factorization: str) -> gtsam.ISAM2:
        """An empty one, with thresholds in radians and in units of length that are a fraction of the sensor range."""
        rotation = self._config.relinearize_threshold
        translation = rotation * self._relinearize_unit_m
        thresholds = gtsam.ISAM2ThresholdMap()
        thresholds.insert(("x", np.repeat([rotation, translation], 3)))
        thresholds.insert(("l", np.repeat(translation, 3)))
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(thresholds)
        parameters.relinearizeSkip = self._config.relinearize_skip
        parameters.setFactorization(factorization)
        return gtsam.ISAM2(parameters)
