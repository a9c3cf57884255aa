"""The result of an evaluation: one tree, and its JSON."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np

from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.metrics.association import AssociationQuality
from slam.evaluation.metrics.calibration import CALIBRATED, CalibrationQuality
from slam.evaluation.metrics.landmarks import LandmarkQuality
from slam.evaluation.metrics.relocalization import PERCENTILES, RelocalizationQuality
from slam.evaluation.metrics.trajectory import TrajectoryErrors
from slam.evaluation.place_recognition.closure_labels import JudgedClosures
from slam.evaluation.place_recognition.closures import ClosureErrors, ClosureQuality, RevisitQuality
from slam.evaluation.place_recognition.discoveries import Discoveries
from slam.evaluation.place_recognition.place_pairs import OnlineQuality, PairQuality
from slam.evaluation.place_recognition.precision_recall import ScoreSweep
from slam.evaluation.place_recognition.reliability import reliability_dict
from slam.evaluation.place_recognition.retrieval import RECALL_AT, RetrievalQuality
from slam.evaluation.place_recognition.revisits import DIRECTIONS

_DECIDED_FROM = (
    *("query_keyframe_id", "reference_keyframe_id", "seed_query_keyframe_id", "represented_by_keyframe_id"),
    *("accepted", "inserted", "stage", "score", "log_likelihood_ratio", "odometry_penalty"),
    *("posterior_log_odds", "best_rival_log_likelihood_ratio"),
)
_CLOSURE_PARTS = ("judged", "has_truth", "errors", "revisits", "discoveries", "reliability")
_REVISIT_PARTS = (
    *("revisit_counts", "recalled_counts", "recalled_count", "associated_count", "missed_stamps_ns", "sweep"),
    "revisits",
)
"""Members that are no figures of the JSON, or other ones."""
_LANDMARK_ERRORS = {"": "windowed", "horizontal_": "windowed_horizontal", "global_": "global_frame"}


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """What could be measured of one output log; a part that could not is None, and ``unavailable`` has its reason.

    ``estimate`` is the final trajectory, ``odometry`` the input alone, ``online`` the poses as they were at their time.
    ``by_closure_reference`` is the final one by the second truth, where closures have one of their own.
    ``pairs`` and ``online_queries`` are the two protocols of papers on place recognition.
    """

    protocol: Protocol
    estimate: TrajectoryErrors | None = None
    odometry: TrajectoryErrors | None = None
    online: TrajectoryErrors | None = None
    by_closure_reference: TrajectoryErrors | None = None
    associations: AssociationQuality | None = None
    landmarks: LandmarkQuality | None = None
    closures: ClosureQuality | None = None
    retrieval: RetrievalQuality | None = None
    pairs: PairQuality | None = None
    online_queries: OnlineQuality | None = None
    relocalization: RelocalizationQuality | None = None
    calibration: CalibrationQuality | None = None
    counters: Mapping[str, int] = field(default_factory=dict)
    unavailable: Mapping[str, str] = field(default_factory=dict)

    def to_json_dict(self) -> dict[str, Any]:
        """Plain dicts, lists, strings and finite numbers. Every key is always there; what is undefined is None."""
        return {
            "trajectory": self._trajectory_dict(),
            "associations": _members(
                AssociationQuality, self.associations, without=("landmark_object_ids", "object_detection_counts")
            ),
            "landmarks": _landmark_dict(self.landmarks),
            "closures": _closure_dict(self.closures),
            "retrieval": _retrieval_dict(self.retrieval),
            "literature_protocols": {
                "pairs": _swept_dict(PairQuality, self.pairs),
                "online": _swept_dict(OnlineQuality, self.online_queries),
            },
            "relocalization": _members(RelocalizationQuality, self.relocalization)
            | (self.relocalization.percentiles() if self.relocalization else dict.fromkeys(PERCENTILES))
            | ({} if self.relocalization else {"losses": []}),
            "calibration": _calibration_dict(self.calibration),
            "counters": dict(self.counters),
            "unavailable": dict(self.unavailable),
            "protocol": {**plain(asdict(self.protocol)), "rules": self.protocol.describe()},
        }

    def _trajectory_dict(self) -> dict[str, Any]:
        trajectories = {
            "": self.estimate,
            "odometry_": self.odometry,
            "online_": self.online,
            "closure_reference_": self.by_closure_reference,
        }
        head: dict[str, Any] = {}
        for prefix, errors in trajectories.items():
            yaw = errors.absolute_yaw if errors else None
            head |= {
                f"{prefix}ate_m": errors.absolute.rmse_m if errors else None,
                f"{prefix}ate_yaw_m": yaw.rmse_m if yaw else None,
                f"{prefix}rpe_translation_percent": errors.relative.translation_percent if errors else None,
                f"{prefix}rpe_rotation_deg_per_100m": errors.relative.rotation_deg_per_100m if errors else None,
            }
        whole = {prefix.rstrip("_") or "estimate": plain(errors) for prefix, errors in trajectories.items()}
        return {name: plain(value) for name, value in head.items()} | whole


def plain(value: Any) -> Any:
    """Dataclasses, arrays and mappings as JSON has them; a number that is not finite is None."""
    if is_dataclass(value):
        return {each.name: plain(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, Mapping):
        return {name: plain(each) for name, each in value.items()}
    if isinstance(value, np.ndarray | tuple | list):
        return [plain(each) for each in (value.tolist() if isinstance(value, np.ndarray) else value)]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _members(kind: type, quality: object | None, *, without: Collection[str] = ()) -> dict[str, Any]:
    """Fields and public properties of a dataclass, but for ``without``; None each where there is no ``quality``."""
    names = [each.name for each in fields(kind)]
    names += [name for name, each in vars(kind).items() if isinstance(each, property) and not name.startswith("_")]
    kept = [name for name in names if name not in without]
    return {name: plain(getattr(quality, name)) if quality is not None else None for name in kept}


def _landmark_dict(quality: LandmarkQuality | None) -> dict[str, Any]:
    members = _members(LandmarkQuality, quality)
    result: dict[str, Any] = {}
    for prefix, name in _LANDMARK_ERRORS.items():
        statistics = members.pop(name) or {}
        result |= {f"{prefix}{each}_error_m": statistics.get(f"{each}_m") for each in ("median", "p95", "max")}
    return result | members


def _closure_dict(quality: ClosureQuality | None) -> dict[str, Any]:
    revisits = quality.revisits if quality else None
    return {
        **_members(ClosureQuality, quality, without=_CLOSURE_PARTS),
        "stage_counts": quality.stage_counts if quality else {},
        **_members(Discoveries, quality.discoveries if quality else None),
        "reliability": reliability_dict(quality.reliability if quality else None),
        **_members(RevisitQuality, revisits, without=_REVISIT_PARTS),
        **{f"recall_{name}": revisits.recall_of(name) if revisits else None for name in DIRECTIONS},
        **{f"revisit_count_{name}": revisits.revisit_counts[name] if revisits else None for name in DIRECTIONS},
        **_members(ClosureErrors, quality.errors if quality else None),
        **_sweep_dict(revisits.sweep if revisits else None),
        "missed_by_stage": dict(revisits.missed_by_stage) if revisits else {},
        "verified_candidates": _verified_candidates(quality.judged) if quality else [],
    }


def _verified_candidates(judged: JudgedClosures) -> list[dict[str, Any]]:
    """What each candidate with a log-likelihood ratio was decided from, and whether it is right: None if undecided."""
    return [
        {name: plain(getattr(candidate, name)) for name in _DECIDED_FROM}
        | {"true": bool(judged.true[row]) if judged.decided[row] else None}
        for row, candidate in enumerate(judged.candidates)
        if candidate.log_likelihood_ratio is not None
    ]


def _sweep_dict(sweep: ScoreSweep | None) -> dict[str, Any]:
    curve = ("thresholds", "precision", "recall")
    points = plain(sweep.thinned()) if sweep else {name: [] for name in curve}
    return _members(ScoreSweep, sweep, without=curve) | {"precision_recall_curve": points}


def _swept_dict(kind: type, quality: PairQuality | OnlineQuality | None) -> dict[str, Any]:
    return _members(kind, quality, without=("sweep",)) | _sweep_dict(quality.sweep if quality else None)


def _retrieval_dict(quality: RetrievalQuality | None) -> dict[str, Any]:
    recalls = {f"recall_at_{k}": quality.recall_at(k) if quality else None for k in RECALL_AT}
    return recalls | _members(RetrievalQuality, quality, without=("hit_counts",))


def _calibration_dict(quality: CalibrationQuality | None) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for name in CALIBRATED:
        part = quality.parts.get(name) if quality else None
        result[f"{name}_coverage"] = part.coverage(quality.probability) if quality and part else None
        result[f"{name}_nees"] = plain(part.nees) if part else None
        result[f"{name}_count"] = part.count if part else 0
    return result
