"""The result of an evaluation: one tree, and its JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.metrics.association import AssociationQuality
from slam.evaluation.metrics.calibration import CalibrationQuality, Consistency
from slam.evaluation.metrics.landmarks import LandmarkQuality
from slam.evaluation.metrics.relocalization import RelocalizationQuality
from slam.evaluation.metrics.trajectory import ErrorStatistics, RelativeErrors, TrajectoryErrors
from slam.evaluation.place_recognition.closure_labels import JudgedClosures
from slam.evaluation.place_recognition.closures import ClosureQuality
from slam.evaluation.place_recognition.discoveries import Discoveries
from slam.evaluation.place_recognition.place_pairs import OnlineQuality, PairQuality
from slam.evaluation.place_recognition.precision_recall import ScoreSweep
from slam.evaluation.place_recognition.reliability import reliability_dict
from slam.evaluation.place_recognition.retrieval import RECALL_AT, RetrievalQuality
from slam.evaluation.place_recognition.revisits import DIRECTIONS


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
            "associations": _association_dict(self.associations),
            "landmarks": _landmark_dict(self.landmarks),
            "closures": _closure_dict(self.closures),
            "retrieval": _retrieval_dict(self.retrieval),
            "literature_protocols": {"pairs": _pair_dict(self.pairs), "online": _online_dict(self.online_queries)},
            "relocalization": _relocalization_dict(self.relocalization),
            "calibration": _calibration_dict(self.calibration),
            "counters": dict(self.counters),
            "unavailable": dict(self.unavailable),
            "protocol": {**_plain(asdict(self.protocol)), "rules": self.protocol.describe()},
        }

    def _trajectory_dict(self) -> dict[str, Any]:
        head: dict[str, Any] = {}
        trajectories = {
            "": self.estimate,
            "odometry_": self.odometry,
            "online_": self.online,
            "closure_reference_": self.by_closure_reference,
        }
        for prefix, errors in trajectories.items():
            relative = errors.relative if errors else None
            head[f"{prefix}ate_m"] = _finite(errors.absolute.rmse_m) if errors else None
            yaw = errors.absolute_yaw if errors else None
            head[f"{prefix}ate_yaw_m"] = _finite(yaw.rmse_m) if yaw else None
            head[f"{prefix}rpe_translation_percent"] = _finite(relative.translation_percent) if relative else None
            head[f"{prefix}rpe_rotation_deg_per_100m"] = _finite(relative.rotation_deg_per_100m) if relative else None
        return {
            **head,
            "estimate": _trajectory_errors_dict(self.estimate),
            "odometry": _trajectory_errors_dict(self.odometry),
            "online": _trajectory_errors_dict(self.online),
            "closure_reference": _trajectory_errors_dict(self.by_closure_reference),
        }


def _trajectory_errors_dict(errors: TrajectoryErrors | None) -> dict[str, Any] | None:
    if errors is None:
        return None
    plain = {f.name: getattr(errors, f.name) for f in fields(errors)}
    for name in ("absolute", "absolute_yaw", "relative", "short_relative", "alignment"):
        del plain[name]
    return {
        "absolute": _plain(asdict(errors.absolute)),
        "absolute_yaw": _plain(asdict(errors.absolute_yaw)) if errors.absolute_yaw else None,
        "relative": _relative_dict(errors.relative),
        "short_relative": _relative_dict(errors.short_relative),
        "alignment": {
            "kind": errors.alignment.kind,
            "note": errors.alignment.note,
            "T_world_map": errors.alignment.T_world_map.tolist(),
        },
        **_plain(plain),
    }


def _relative_dict(errors: RelativeErrors) -> dict[str, Any]:
    return {**_plain(asdict(errors)), "rows": [_plain(asdict(row)) for row in errors.rows]}


def _association_dict(quality: AssociationQuality | None) -> dict[str, Any]:
    names = ["precision", "precision_without_false_positives", "recall"]
    names += [f.name for f in fields(AssociationQuality)]
    return {
        name: _finite(getattr(quality, name)) if quality else None
        for name in names
        if name not in ("landmark_object_ids", "object_detection_counts")
    }


def _landmark_dict(quality: LandmarkQuality | None) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for prefix, name in (("", "windowed"), ("horizontal_", "windowed_horizontal"), ("global_", "global_frame")):
        statistics: ErrorStatistics | None = getattr(quality, name) if quality else None
        result[f"{prefix}median_error_m"] = _finite(statistics.median_m) if statistics else None
        result[f"{prefix}p95_error_m"] = _finite(statistics.p95_m) if statistics else None
    names = ["class_accuracy", "precision", "recall"]
    names += [f.name for f in fields(LandmarkQuality) if not f.name.startswith(("windowed", "global"))]
    names.append("windowed_landmark_count")
    return {**result, **{name: _finite(getattr(quality, name)) if quality else None for name in names}}


def _closure_dict(quality: ClosureQuality | None) -> dict[str, Any]:
    revisits = quality.revisits if quality else None
    errors = quality.errors if quality else None
    sweep = revisits.sweep if revisits else None
    names = ("candidate", "accepted", "inserted", "true", "false", "undecided")
    return {
        **{f"{name}_count": getattr(quality, f"{name}_count") if quality else None for name in names},
        **_discovery_dict(quality.discoveries if quality else None),
        "reliability": reliability_dict(quality.reliability if quality else None),
        "precision": quality.precision if quality else None,
        "recall": revisits.recall if revisits else None,
        "recognised": revisits.recognised if revisits else None,
        **{f"recall_{name}": revisits.recall_of(name) if revisits else None for name in DIRECTIONS},
        "revisit_count": revisits.revisit_count if revisits else None,
        **{f"revisit_count_{name}": revisits.revisit_counts[name] if revisits else None for name in DIRECTIONS},
        "median_translation_error_m": errors.median_translation_m if errors else None,
        "p95_translation_error_m": errors.p95_translation_m if errors else None,
        "median_planar_error_m": errors.median_planar_m if errors else None,
        "median_heading_error_deg": errors.median_heading_deg if errors else None,
        "median_rotation_error_deg": errors.median_rotation_deg if errors else None,
        "p95_rotation_error_deg": errors.p95_rotation_deg if errors else None,
        "intra_revisit_std_m": errors.intra_revisit_std_m if errors else None,
        **_sweep_dict(sweep),
        "missed_by_stage": dict(revisits.missed_by_stage) if revisits else {},
        "missed_at_place_count": revisits.missed_at_place_count if revisits else None,
        "missed_without_candidate_count": revisits.missed_without_candidate_count if revisits else None,
        "stage_counts": quality.stage_counts if quality else {},
        "verified_candidates": _verified_candidates(quality.judged) if quality else [],
    }


def _discovery_dict(discoveries: Discoveries | None) -> dict[str, Any]:
    names = {
        "found_count": "found",
        "followed_count": "followed",
        "led_back_count": "led_back",
        "independent_count": "independent",
        "independent_false_count": "independent_false",
        "largest_false_share": "largest_false_share",
    }
    return {key: getattr(discoveries, name) if discoveries else None for key, name in names.items()}


def _verified_candidates(judged: JudgedClosures) -> list[dict[str, Any]]:
    """What each candidate with a log-likelihood ratio was decided from, and whether it is right: None if undecided."""
    ids = ("query_keyframe_id", "reference_keyframe_id", "seed_query_keyframe_id", "represented_by_keyframe_id")
    numbers = (
        *("score", "log_likelihood_ratio", "odometry_penalty"),
        *("posterior_log_odds", "best_rival_log_likelihood_ratio"),
    )
    return [
        {
            **{name: getattr(candidate, name) for name in ids},
            "accepted": candidate.accepted,
            "inserted": candidate.inserted,
            "stage": candidate.stage,
            "true": bool(judged.true[row]) if judged.decided[row] else None,
            **{name: _finite(getattr(candidate, name)) for name in numbers},
        }
        for row, candidate in enumerate(judged.candidates)
        if candidate.log_likelihood_ratio is not None
    ]


def _sweep_dict(sweep: ScoreSweep | None) -> dict[str, Any]:
    names = ("average_precision", "f1_max", "recall_at_full_precision", "extended_precision")
    curve = sweep.thinned() if sweep else None
    return {
        **_attributes(sweep, names),
        "precision_recall_curve": {
            name: [_finite(float(value)) for value in getattr(curve, name)] if curve else []
            for name in ("thresholds", "precision", "recall")
        },
    }


def _retrieval_dict(quality: RetrievalQuality | None) -> dict[str, Any]:
    return {
        **{f"recall_at_{k}": quality.recall_at(k) if quality else None for k in RECALL_AT},
        **_attributes(quality, ("query_count", "place_count", "note")),
    }


def _pair_dict(quality: PairQuality | None) -> dict[str, Any]:
    counts = _attributes(quality, [f.name for f in fields(PairQuality) if f.name != "sweep"])
    return {**counts, **_sweep_dict(quality.sweep if quality else None)}


def _online_dict(quality: OnlineQuality | None) -> dict[str, Any]:
    counts = _attributes(quality, ("query_count", "revisit_count", "found_count", "recall_at_1"))
    return {**counts, **_sweep_dict(quality.sweep if quality else None)}


def _relocalization_dict(quality: RelocalizationQuality | None) -> dict[str, Any]:
    counts = [f"{name}_count" for name in ("loss", "fix", "right", "wrong", "undecided")]
    measures = [f"{kind}_{name}" for name in ("seconds", "distance_m") for kind in ("median", "max")]
    errors = [f"{kind}_error_{unit}" for unit in ("m", "deg") for kind in ("median", "p95")]
    return {
        **_attributes(
            quality,
            ("success_rate", "false_relocalization_rate", *counts, *measures, *errors, "lost_time_ratio", "method"),
        ),
        "losses": [_plain(asdict(loss)) for loss in quality.losses] if quality else [],
    }


def _calibration_dict(quality: CalibrationQuality | None) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for name in ("pose", "landmark", "closure"):
        for prefix in ("", "planar_"):
            part: Consistency | None = getattr(quality, prefix + name) if quality else None
            result[f"{prefix}{name}_coverage"] = part.coverage(quality.probability) if quality and part else None
            result[f"{prefix}{name}_nees"] = _finite(part.nees) if part else None
            result[f"{prefix}{name}_count"] = part.count if part else 0
    return result


def _attributes(quality: object | None, names: Iterable[str]) -> dict[str, Any]:
    return {name: _finite(getattr(quality, name)) if quality is not None else None for name in names}


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: list(v) if isinstance(v, tuple) else _finite(v) for name, v in values.items()}


def _finite(value: Any) -> Any:
    """``value``, or None where it is a float that JSON cannot hold."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
