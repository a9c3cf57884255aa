"""The factors in force, and the solver that holds them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import gtsam
import numpy as np

from slam.backend.batch_solver import BatchSolver, GtsamCalls
from slam.backend.condensing.attached_keyframes import AttachedKeyframes
from slam.backend.condensing.condensed_factors import condensed_factors, relative_covariances, summed_at_estimate
from slam.backend.factors import (
    Edge,
    Factor,
    LandmarkPrior,
    Observation,
    PosePrior,
    between_factor,
    checked_pose,
    landmark_prior_factor,
    map_frame_factor,
    observation_factors,
    prior_factor,
)
from slam.backend.incremental_solver import IncrementalSolver
from slam.backend.known_map import KnownMap
from slam.backend.observed_landmarks import ObservedLandmarks
from slam.backend.segment_joining import moved_estimate, relaxed_breaks, shift_of_segment
from slam.backend.solver_options import FactorGraphConfig
from slam.common.arrays import FloatArray
from slam.common.errors import FactorGraphError


class FactorStore:
    """Factors by numbers that never change, each as a record of ours in ``factors`` and as GTSAM's in ``solver``.

    ``landmarks``: which of them each landmark has; ``known``: what a prior map says of the variables.
    """

    def __init__(self, config: FactorGraphConfig, calls: GtsamCalls, *, sensor_range_m: float) -> None:
        self._config = config
        self._calls = calls
        self._sensor_range_m = sensor_range_m
        self._landmark_priors: dict[int, int] = {}  # priors of the landmarks of a prior map that are in the graph
        self._next_factor = 0
        self.factors: dict[int, Factor] = {}
        self.solver: IncrementalSolver | BatchSolver = self._incremental_solver()
        self.landmarks = ObservedLandmarks()
        self.attached = AttachedKeyframes()
        self.known = KnownMap()

    def pose(self, keyframe: int) -> FloatArray:
        """``T_map_body`` (4, 4) of a keyframe."""
        if keyframe in self.attached.anchors:
            return self.attached.pose(keyframe, self.pose(self.attached.anchors[keyframe]))
        fixed = self.known.poses.get(keyframe)
        return self.solver.pose(keyframe) if fixed is None else fixed

    def holds_keyframe(self, keyframe: int) -> bool:
        """Whether a keyframe is in the graph, as a variable or attached to one."""
        return keyframe in self.attached.anchors or self.solver.holds_keyframe(keyframe)

    def insert_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        """Add a keyframe at a pose (4, 4)."""
        pose = checked_pose(T_map_body, f"keyframe {keyframe}")
        if self.holds_keyframe(keyframe):
            raise FactorGraphError(f"keyframe {keyframe} is in the graph already")
        self.solver.insert_keyframe(keyframe, pose)

    def add(self, record: Factor, factor: gtsam.NonlinearFactor | None = None) -> int:
        """Add a factor between variables that are there; returns its number."""
        if isinstance(record, Edge) and self.attached.moves(record):
            record, factor = self.attached.edge(record), None
        number = self._number(record)
        self.solver.add(number, factor if factor is not None else self.solver_factor(record))
        return number

    def add_observations(self, observations: Sequence[Observation]) -> None:
        """Tie landmarks to the keyframes that saw them.

        A landmark enters the graph with its first observation, which gives it all three coordinates, so none is ever
        under-constrained.
        """
        observations = [self.attached.observation(each) for each in observations]
        factors = self._observation_factors(observations)
        for observation, factor, position in zip(observations, factors, self._positions_map(observations), strict=True):
            if observation.landmark not in self.landmarks:
                self._enter(observation.landmark)
            number = self._number(observation)
            variable = self.landmarks.variable_of(observation.landmark)
            self.solver.add_observation(number, factor, observation.keyframe, variable, position)
            self.landmarks.observe(observation.landmark, number)

    def _observation_factors(self, observations: Sequence[Observation]) -> list[gtsam.NonlinearFactor]:
        """The solver's factors of observations, each of the variable that its landmark has in the graph."""
        return observation_factors(
            [self._canonical(each) for each in observations], self._config, sensor_range_m=self._sensor_range_m
        )

    def _positions_map(self, observations: Sequence[Observation]) -> FloatArray:
        """Where observations (N,) put their landmarks, (N, 3) m in the map."""
        poses = {keyframe: self.pose(keyframe) for keyframe in dict.fromkeys(each.keyframe for each in observations)}
        T = np.array([poses[each.keyframe] for each in observations]).reshape(-1, 4, 4)
        positions = np.array([each.position for each in observations]).reshape(-1, 3, 1)
        return np.asarray((T[:, :3, :3] @ positions)[..., 0] + T[:, :3, 3])

    def remove(self, number: int) -> None:
        """Take a factor out again; a landmark without observations leaves the graph with its last one."""
        factor = self.factors.pop(number)
        self.solver.remove(number)
        if isinstance(factor, Observation):
            unseen = self.landmarks.forget(factor.landmark, number)
            if unseen in self._landmark_priors:
                self.remove(self._landmark_priors.pop(unseen))

    def remove_landmark(self, landmark: int) -> None:
        """Take a landmark, with all that was merged into it, and all observations of it out of the graph.

        Nothing happens if it is not in it.
        """
        for number in self.landmarks.factors_of(landmark):
            self.remove(number)

    def merge_landmarks(self, kept: int, dropped: int) -> None:
        """Merge two landmarks: observations of ``dropped``, now or later, are observations of ``kept``.

        What they were merged into before is merged; nothing happens if they are one already.
        """
        if not self.landmarks.are_one(kept, dropped):
            self._move(self.landmarks.variable_of(dropped), lambda: self.landmarks.merge(kept, dropped))

    def undo_merge(self) -> None:
        """Undo the last merge in force: what was dropped is its own landmark again, with all that it had absorbed.

        Raises:
            FactorGraphError: no merge is in force.
        """
        last = self.landmarks.last_merge
        if last is None:
            raise FactorGraphError("no landmarks are merged, so no merge can be undone")
        self._move(last.dropped, lambda: self.landmarks.undo(last))

    def observers(self) -> dict[int, set[int]]:
        """The keyframes that saw each landmark which has a variable of its own, those merged into it included."""
        return {
            variable: {factor.keyframe for number in numbers if isinstance(factor := self.factors[number], Observation)}
            for variable, numbers in self.landmarks.factors_of_variables()
        }

    def _seen_by_others(self, keyframes: set[int]) -> set[int]:
        """Landmarks that other keyframes than these observe."""
        return {
            self.landmarks.variable_of(factor.landmark)
            for factor in self.factors.values()
            if isinstance(factor, Observation) and factor.keyframe not in keyframes
        }

    def join(self, edge: Edge, moved: set[int], keyframes: Sequence[int]) -> int:
        """Move the keyframes ``moved``, and landmarks that only they saw, to where an edge puts them, and add it.

        ``keyframes``: those that are variables. Returns the number of the edge.
        """
        T_shift = shift_of_segment(edge, self.pose(edge.from_keyframe), self.pose(edge.to_keyframe), moved)
        landmarks = [each for each in self.landmarks.variables if self.solver.holds_landmark(each)]
        seen_by_others = self._seen_by_others(moved)
        along = {each for each in landmarks if each not in seen_by_others and not self.known.holds(each)}
        values = moved_estimate(self.solver.estimate(), keyframes, landmarks, moved, along, T_shift)
        return self._restart(values, edge, relaxed_breaks(self.factors, moved, values))

    def _restart(self, values: gtsam.Values, new: Edge, changed: Mapping[int, Edge]) -> int:
        """Solve all afresh from ``values``, with a new edge, and others in the place of some; returns its number."""
        self.factors |= changed
        number = self._number(self.attached.edge(new))
        replaced = {each: self.solver_factor(self.factors[each]) for each in (*changed, number)}
        self.solver.restart(values, replaced)
        return number

    def change(self, changed: Mapping[int, Edge]) -> None:
        """Put others in the place of some edges, once all is solved in batch."""
        self.factors |= changed
        factors = {number: self.solver_factor(edge) for number, edge in changed.items()}
        solver = self.settle()
        solver.restart(solver.estimate(), factors)

    def condense(self, anchors: Mapping[int, int]) -> None:
        """Attach keyframes to their anchors at the optimum, and go on incrementally."""
        solver = self.settle()
        factors = self.factors.values()
        covariances = relative_covariances(
            ((self.landmarks.variable_of(each.landmark), each) for each in factors if isinstance(each, Observation)),
            [each for each in factors if isinstance(each, Edge)],
            anchors,
            sensor_range_m=self._sensor_range_m,
        )
        self.attached.attach(anchors, covariances, self.pose)
        gone, edges, moved = condensed_factors(self.factors, anchors, self.attached)
        for edge in edges:
            self.add(edge)
        moved = [self._canonical(each) for each in moved]
        T_map_body = np.array([self.pose(each.keyframe) for each in moved]).reshape(-1, 4, 4)
        points = np.array([solver.point(each.landmark) for each in moved]).reshape(-1, 3)
        self.add_observations(summed_at_estimate(moved, T_map_body, points, self._config))
        for number in gone:
            self.remove(number)
        resumed = self._incremental_solver()
        seen_from = {number: each.keyframe for number, each in self.factors.items() if isinstance(each, Observation)}
        resumed.resume(solver.estimate(), solver.factors, seen_from)
        self.solver = resumed

    def settle(self) -> BatchSolver:
        """End the incremental estimate: from now on all observations are used, and updates are steps in batch."""
        self.solver.update()
        new = {
            variable: last
            for variable, numbers in self.landmarks.factors_of_variables()
            if not self.solver.holds_landmark(variable) and isinstance(last := self.factors[numbers[-1]], Observation)
        }
        positions = self._positions_map(list(new.values()))
        self.solver = settled = self.solver.settle(dict(zip(new, positions, strict=True)))
        return settled

    def solver_factor(self, record: Factor) -> gtsam.NonlinearFactor:
        """What the solver is given for a record."""
        match record:
            case Edge():
                return map_frame_factor(record) if record.from_keyframe == self.known.frame else between_factor(record)
            case Observation():
                return self._observation_factors([record])[0]
            case PosePrior():
                return prior_factor(record)
            case LandmarkPrior():
                return landmark_prior_factor(record)

    def _incremental_solver(self) -> IncrementalSolver:
        return IncrementalSolver(self._config, self._calls, sensor_range_m=self._sensor_range_m)

    def _number(self, record: Factor) -> int:
        self._next_factor += 1
        self.factors[self._next_factor - 1] = record
        return self._next_factor - 1

    def _move(self, landmark: int, rename: Callable[[], object]) -> None:
        """Take the observations of a landmark, and of those merged into it, along to its new variable."""
        observations = [self.factors[number] for number in self.landmarks.factors_of(landmark)]
        self.remove_landmark(landmark)
        rename()
        self.add_observations([o for o in observations if isinstance(o, Observation)])

    def _canonical(self, observation: Observation) -> Observation:
        """The observation of the variable that its landmark has in the graph."""
        variable = self.landmarks.variable_of(observation.landmark)
        return observation if variable == observation.landmark else replace(observation, landmark=variable)

    def _enter(self, landmark: int) -> None:
        """Take a landmark in that is not in the graph."""
        if not self.landmarks.enter(landmark):
            return
        variable = self.landmarks.variable_of(landmark)
        if self.known.holds(variable):
            prior = self.known.prior_of(variable)
            self.solver.insert_landmark(variable, prior.position)
            self._landmark_priors[variable] = self.add(prior)
