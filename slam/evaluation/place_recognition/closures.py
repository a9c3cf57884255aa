"""How good loop closures are: how many are right, and how many of the revisits they recall."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from logs.closures import find_final_decisions, rank_stage
from logs.messages import LoopClosureRecord
from slam.common.arrays import FloatArray, IntArray
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.place_recognition.closure_labels import JudgedClosures, label_closures
from slam.evaluation.place_recognition.discoveries import Discoveries, count_discoveries
from slam.evaluation.place_recognition.precision_recall import ScoreSweep, sweep_scores
from slam.evaluation.place_recognition.reliability import Reliability, measure_reliability
from slam.evaluation.place_recognition.revisits import DIRECTIONS, Revisits, find_revisits

NO_TRUE_CANDIDATE = "no true candidate"
ASSOCIATION = "association"


@dataclass(frozen=True, slots=True)
class ClosureErrors:
    """Errors of the accepted true closures, of which there is one at least.

    Planar ones are those in the plane of the body, as some truths drift in height, that of KITTI among them.
    ``intra_revisit_std_m`` is the median over the runs of at least two closures, None where there is no such run.
    """

    median_translation_error_m: float
    p95_translation_error_m: float
    median_planar_error_m: float
    median_heading_error_deg: float
    median_rotation_error_deg: float
    p95_rotation_error_deg: float
    intra_revisit_std_m: float | None


@dataclass(frozen=True, slots=True, eq=False)
class RevisitQuality:
    """Revisits of R query keyframes, and where those without an accepted true closure were lost.

    revisit_counts and recalled_counts by direction; missed_by_stage: the farthest stage that a true candidate of a
    missed revisit reached, or :data:`NO_TRUE_CANDIDATE`. Of these latter ``missed_at_place_count`` had a candidate at
    the right place all the same and ``missed_without_candidate_count`` none at all. missed_stamps_ns (M,): their
    keyframes. ``sweep`` is None without a revisit. ``revisits``: all query keyframes, revisits or not.
    """

    revisit_counts: Mapping[str, int]
    recalled_counts: Mapping[str, int]
    missed_by_stage: Mapping[str, int]
    missed_at_place_count: int
    missed_without_candidate_count: int
    missed_stamps_ns: IntArray
    sweep: ScoreSweep | None
    revisits: Revisits

    @property
    def revisit_count(self) -> int:
        """Revisits in all directions."""
        return sum(self.revisit_counts.values())

    @property
    def recalled_count(self) -> int:
        """Those of them with an accepted true closure."""
        return sum(self.recalled_counts.values())

    @property
    def recall(self) -> float | None:
        """Recalled among all revisits; None where there is none."""
        return self.recalled_count / self.revisit_count if self.revisit_count else None

    @property
    def associated_count(self) -> int:
        """Revisits without a closure whose landmarks were never let go, at the right pose: they need none."""
        return self.missed_by_stage.get(ASSOCIATION, 0)

    @property
    def recognised(self) -> float | None:
        """Revisits that are recalled or associated among all; None where there is none."""
        return (self.recalled_count + self.associated_count) / self.revisit_count if self.revisit_count else None

    def recall_of(self, direction: str) -> float | None:
        """Recalled among the revisits of one direction; None where there is none.

        Args:
            direction: one of :data:`slam.evaluation.place_recognition.revisits.DIRECTIONS`.
        """
        count = self.revisit_counts[direction]
        return self.recalled_counts[direction] / count if count else None


@dataclass(frozen=True, slots=True, eq=False)
class ClosureQuality:
    """Loop-closure candidates by their final decisions, and what the truth says of them.

    ``judged`` is there without a truth too, all undecided; ``has_truth`` says so. ``revisits`` is None without truth or
    keyframes, ``errors`` without an accepted true closure. ``discoveries``: where the accepted ones come from.
    ``reliability``: of the posterior probabilities, None without truth.
    """

    judged: JudgedClosures
    has_truth: bool
    errors: ClosureErrors | None
    revisits: RevisitQuality | None
    discoveries: Discoveries
    reliability: Reliability | None = None

    @property
    def candidate_count(self) -> int:
        """Candidates, each two keyframes once."""
        return len(self.judged.candidates)

    @property
    def accepted_count(self) -> int:
        """Accepted candidates: true, false and undecided ones."""
        return int(np.count_nonzero(self.judged.accepted))

    @property
    def inserted_count(self) -> int:
        """Candidates that are factors of the graph."""
        return sum(candidate.inserted for candidate in self.judged.candidates)

    @property
    def stage_counts(self) -> dict[str, int]:
        """Candidates by the stage of their decision, in the order of the stages."""
        counts = Counter(candidate.stage for candidate in self.judged.candidates)
        return {stage: counts[stage] for stage in sorted(counts, key=lambda stage: (rank_stage(stage), stage))}

    @property
    def true_count(self) -> int | None:
        """Accepted candidates that are right; None without truth."""
        return int(np.count_nonzero(self.judged.accepted & self.judged.true)) if self.has_truth else None

    @property
    def false_count(self) -> int | None:
        """Accepted candidates that are wrong; None without truth."""
        wrong = self.judged.accepted & self.judged.decided & ~self.judged.true
        return int(np.count_nonzero(wrong)) if self.has_truth else None

    @property
    def undecided_count(self) -> int | None:
        """Accepted candidates of which the truth says nothing; None without any truth."""
        return int(np.count_nonzero(self.judged.accepted & ~self.judged.decided)) if self.has_truth else None

    @property
    def precision(self) -> float | None:
        """True among the accepted that could be decided; None where there is none."""
        if self.true_count is None or self.false_count is None or self.true_count + self.false_count == 0:
            return None
        return self.true_count / (self.true_count + self.false_count)


def evaluate_closures(
    records: Iterable[LoopClosureRecord],
    keyframe_ids: IntArray,
    keyframe_stamps_ns: IntArray,
    truth: PoseSeries,
    protocol: Protocol,
) -> ClosureQuality:
    """Judge the final decision of every candidate, and find the revisits that were recalled or missed.

    Args:
        records: in the order of the log; a later one about the same two keyframes replaces an earlier one.
        keyframe_ids: (K,) all keyframes of the drive; K = 0 leaves revisits unknown.
        keyframe_stamps_ns: (K,) in any order.
        truth: may hold no pose, which leaves only counts.
        protocol: the thresholds.
    """
    stamp_of_keyframe = dict(zip(keyframe_ids.tolist(), keyframe_stamps_ns.tolist(), strict=True))
    judged = label_closures(find_final_decisions(records), stamp_of_keyframe, truth, protocol)
    has_truth = len(truth.stamps_ns) > 0
    revisits = None
    if has_truth and len(keyframe_ids):
        revisits = _assess_revisits(find_revisits(keyframe_ids, keyframe_stamps_ns, truth, protocol), judged)
    discoveries = count_discoveries(judged, protocol, has_truth=has_truth)
    reliability = measure_reliability(judged) if has_truth else None
    return ClosureQuality(judged, has_truth, _summarize_errors(judged, protocol), revisits, discoveries, reliability)


def _assess_revisits(revisits: Revisits, judged: JudgedClosures) -> RevisitQuality:
    recalled_ids = judged.query_ids[judged.accepted & judged.true]
    is_recalled = np.isin(revisits.keyframe_ids, recalled_ids)
    missed = revisits.is_revisit & ~is_recalled
    missed_ids = revisits.keyframe_ids[missed]
    farthest = _find_farthest_stages(judged)
    lost_early = np.array([name for name in missed_ids.tolist() if name not in farthest], dtype=np.int64)
    counts = Counter(farthest.get(name, NO_TRUE_CANDIDATE) for name in missed_ids.tolist())
    return RevisitQuality(
        revisit_counts=_count_directions(revisits.directions),
        recalled_counts=_count_directions(revisits.directions[is_recalled]),
        missed_by_stage={stage: counts[stage] for stage in sorted(counts, key=lambda s: (rank_stage(s), s))},
        missed_at_place_count=int(np.isin(lost_early, judged.query_ids[judged.same_place]).sum()),
        missed_without_candidate_count=int((~np.isin(lost_early, judged.query_ids)).sum()),
        missed_stamps_ns=revisits.stamps_ns[missed],
        sweep=sweep_scores(
            judged.query_ids[judged.decided],
            judged.scores[judged.decided],
            judged.true[judged.decided],
            revisit_ids=revisits.keyframe_ids[revisits.is_revisit],
        ),
        revisits=revisits,
    )


def _find_farthest_stages(judged: JudgedClosures) -> dict[int, str]:
    """Query keyframe -> the farthest stage that one of its true candidates reached."""
    farthest: dict[int, str] = {}
    for row in np.flatnonzero(judged.true):
        candidate = judged.candidates[row]
        before = farthest.get(candidate.query_keyframe_id)
        if before is None or rank_stage(candidate.stage) > rank_stage(before):
            farthest[candidate.query_keyframe_id] = candidate.stage
    return farthest


def _count_directions(directions: IntArray) -> dict[str, int]:
    return {name: int(np.count_nonzero(directions == index)) for index, name in enumerate(DIRECTIONS)}


def _summarize_errors(judged: JudgedClosures, protocol: Protocol) -> ClosureErrors | None:
    rows = np.flatnonzero(judged.accepted & judged.true)
    if len(rows) == 0:
        return None
    translations_m = np.linalg.norm(judged.errors_xyz[rows], axis=1)
    rotations_deg = np.rad2deg(judged.rotation_errors_rad[rows])
    return ClosureErrors(
        median_translation_error_m=float(np.median(translations_m)),
        p95_translation_error_m=float(np.percentile(translations_m, 95.0)),
        median_rotation_error_deg=float(np.median(rotations_deg)),
        p95_rotation_error_deg=float(np.percentile(rotations_deg, 95.0)),
        median_planar_error_m=float(np.median(np.hypot(*judged.planar_errors[rows, :2].T))),
        median_heading_error_deg=float(np.rad2deg(np.median(np.abs(judged.planar_errors[rows, 2])))),
        intra_revisit_std_m=_measure_spread(
            judged.errors_xyz[rows], judged.travelled_m[rows], protocol.closure_run_gap_m
        ),
    )


def _measure_spread(errors_xyz: FloatArray, travelled_m: FloatArray, run_gap_m: float) -> float | None:
    """Median over runs of the RMS distance, metres, of errors (N, 3) from the mean of their run.

    A run ends where ``travelled_m`` (N,), which never falls, grows by ``run_gap_m`` or more. A single error has no
    spread, so runs of one are left out.
    """
    runs = np.split(errors_xyz, np.flatnonzero(np.diff(travelled_m) >= run_gap_m) + 1)
    spreads = [np.sqrt(np.sum(np.var(run, axis=0))) for run in runs if len(run) > 1]
    return float(np.median(spreads)) if spreads else None
