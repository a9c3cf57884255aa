"""Settings that were renamed: old dotted key -> new dotted key. An old key is refused with the name of the new one."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

RENAMED_SETTINGS: Mapping[str, str] = MappingProxyType(
    {
        "loop_closure.odometry_inflation": "odometry.inflation",
        "detection.redundancy": "detection.covariance_inflation",
        "landmark.give_up_distance_m": "landmark.max_missed_distance_m",
        "landmark.give_up_scans": "landmark.max_missed_scans",
        "evidence": "likelihood_ratio",
        "evidence.persistence": "likelihood_ratio.detection_probability",
        "evidence.covered_m": "likelihood_ratio.coverage_radius_m",
        "evidence.around_m": "likelihood_ratio.clutter_radius_m",
        "evidence.row_length_m": "likelihood_ratio.clutter_along_track_m",
        "evidence.row_sigma_m": "likelihood_ratio.clutter_cross_track_sigma_m",
        "loop_closure.settle_travel_m": "loop_closure.inactive_travel_m",
        "loop_closure.neighbours": "loop_closure.top_k",
        "loop_closure.places": "loop_closure.max_candidates",
        "loop_closure.lost_places": "loop_closure.max_candidates_when_lost",
        "loop_closure.follow_travel_m": "loop_closure.propagation_distance_m",
    }
)
