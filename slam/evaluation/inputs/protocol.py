"""The rules and thresholds of the evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Self

import numpy as np
from pydantic import ConfigDict, PositiveFloat, PositiveInt, ValidationError
from pydantic.dataclasses import dataclass

from slam.common.arrays import BoolArray, FloatArray
from slam.common.errors import EvaluationError
from slam.evaluation.metrics.alignment import STRAIGHT_LINE_RATIO
from slam.evaluation.metrics.statistics import CONFIDENCE
from slam.evaluation.metrics.trajectory import KITTI_LENGTHS_M, KITTI_START_STEP

SPACING_TOLERANCE = 0.05
"""Part of the query spacing by which keyframes may be closer: those placed every 2 m must not be thinned by half."""
SAME_HEADING_DEG, OPPOSITE_HEADING_DEG = 45.0, 135.0
"""Angles between the headings of two visits up to which they are the same, and beyond which they are opposite."""
WINDOW_LANDMARKS = 3
"""Fewest landmarks of a window: two leave no residual after their alignment."""
RANGE_M = 30.0
"""Sensor range for which the lengths of the protocol are given: those of papers, about cars in streets."""


@dataclass(frozen=True, slots=True, config=ConfigDict(extra="forbid"))
class Protocol:
    """Thresholds; units are in the names. All are positive, and lengths (``..._m``) are those usual for cars."""

    max_truth_gap_s: PositiveFloat = 1.5
    revisit_m: PositiveFloat = 100.0
    window_m: PositiveFloat = 50.0
    match_distance_m: PositiveFloat = 2.0
    least_detections: PositiveInt = 5
    closure_translation_m: PositiveFloat = 4.0
    closure_rotation_deg: PositiveFloat = 10.0
    query_spacing_m: PositiveFloat = 2.0
    revisit_distance_m: PositiveFloat = 5.0

    def is_true(self, error_m: FloatArray, rotation_rad: FloatArray) -> BoolArray:
        """Whether errors (N,) of poses are those of true closures and right fixes."""
        return (error_m <= self.closure_translation_m) & (np.rad2deg(rotation_rad) <= self.closure_rotation_deg)

    def for_range(self, sensor_range_m: float) -> Self:
        """The same with all lengths in proportion to a sensor range [m]."""
        lengths = [each.name for each in fields(self) if each.name.endswith("_m")]
        return self.with_thresholds({name: sensor_range_m / RANGE_M * getattr(self, name) for name in lengths})

    def with_thresholds(self, thresholds: Mapping[str, float]) -> Self:
        """The same with other thresholds, by name.

        Raises:
            EvaluationError: there is no such threshold, or it cannot have this value.
        """
        try:
            return replace(self, **thresholds)  # type: ignore[arg-type]
        except ValidationError as error:
            first, names = error.errors()[0], [each.name for each in fields(self)]
            why = first["msg"] if first["loc"][0] in names else f"no such threshold; there are {', '.join(names)}"
            raise EvaluationError(f"{first['loc'][0]} = {first['input']} of the evaluation protocol: {why}") from error

    def describe(self) -> dict[str, str]:
        """Each rule in one sentence, with the thresholds in it."""
        lengths = ", ".join(f"{length:g}" for length in KITTI_LENGTHS_M)
        least_m = (1.0 - SPACING_TOLERANCE) * self.query_spacing_m
        return {
            "time": "The truth is interpolated at the stamps of the estimate, inside its span and not across gaps of "
            f"more than {self.max_truth_gap_s:g} s.",
            "alignment": "Umeyama SE(3) without scale over all compared positions; on a straight line (lateral spread "
            f"below {STRAIGHT_LINE_RATIO:g} of the longitudinal one) yaw and translation only.",
            "ate": "Distances between aligned estimated and true positions of the body; ate_m is their RMSE.",
            "rpe": f"KITTI: stretches of {lengths} m of true path, starting at every {KITTI_START_STEP}th compared "
            "pose and divided by the nominal length; the averages are over all stretches.",
            "landmark_identity": "A landmark shows the true object of most of its detections; false positives count as "
            "one candidate, and a tie goes to the first. Detections of a merged landmark count for the one it was "
            "merged into.",
            "lengths": f"Lengths of places, closures, revisits and windows are those usual for a sensor range of "
            f"{RANGE_M:g} m, scaled by the sensor range of the run: here a revisit comes after "
            f"{self.revisit_m:g} m.",
            "association_precision": "Assignments to an existing landmark whose detection shows that landmark's "
            "object; a false positive is wrong.",
            "association_recall": f"Detections of an object that was also detected within the last "
            f"{self.revisit_m:g} m of travel: the share assigned to an existing landmark of this object.",
            "landmark_error": f"Confirmed landmarks, grouped by first observation into windows of {self.window_m:g} m "
            "of true path that overlap by half; yaw and translation aligned in each window with at least "
            f"{WINDOW_LANDMARKS} landmarks; statistics over the errors in all windows.",
            "landmark_global_error": "Confirmed landmarks after the alignment of the trajectory.",
            "landmark_matching": "By landmark_identity; without a truth of the detections, the nearest true object of "
            f"the same class within {self.match_distance_m:g} m after the alignment of the trajectory.",
            "landmark_precision": "Confirmed landmarks that show an object.",
            "landmark_recall": f"True objects that were detected at least {self.least_detections} times: the share "
            "shown by a confirmed landmark.",
            "class_accuracy": "Confirmed landmarks whose most probable class is that of their object.",
            "closure_decision": "Of several records about the same two keyframes the last one counts.",
            "closure_true": f"The transform is within {self.closure_translation_m:g} m and "
            f"{self.closure_rotation_deg:g} deg (whole angle of rotation) of the true relative pose; undecided where "
            "it or the truth at one of the two stamps is missing.",
            "closure_precision": "The share of true closures among the accepted ones that are decided, at all "
            "keyframes.",
            "query_keyframes": f"Keyframes with truth, the first and then each at least {least_m:g} m of true travel "
            f"after the one before ({self.query_spacing_m:g} m less {100.0 * SPACING_TOLERANCE:g} %).",
            "revisit": f"A query keyframe within {self.revisit_distance_m:g} m (between true positions, 3-D) of any "
            f"keyframe at least {self.revisit_m:g} m of true travel before. The angle between the forward axes of it "
            f"and the nearest such keyframe makes it same (up to {SAME_HEADING_DEG:g} deg), opposite (beyond "
            f"{OPPOSITE_HEADING_DEG:g} deg) or crossing.",
            "closure_recall": "Revisits with at least one accepted true closure at the same keyframe; closures at "
            "neighbouring keyframes do not count.",
            "closure_recognised": "Revisits that are recalled, or at which landmarks of the earlier traversal are "
            "still associated and their pose is true, so that no closure is needed.",
            "reliability": "The likeliest candidate of each query that was not predicted by another closure, binned by "
            "its posterior probability against a new place, without rivals: the number of right ones in each bin.",
            "closure_missed": "The last stage that a true candidate of a missed revisit reached.",
            "closure_error": "Errors of the accepted true closures: position and rotation angle of the query keyframe.",
            "closure_score": "A threshold is moved over the score of the best decided candidate of each query "
            "keyframe; equal scores are accepted together, and ties within a keyframe are scored pessimistically. "
            "Average precision is the sum of (R_n - R_(n-1)) P_n as in scikit-learn, with recall over all revisits.",
            "relocalization_loss": "A loss lasts from the first status in state LOST, also at the start of a drive in "
            "a given map, to the next status RELOCALIZED (a fix). Time and travel (along the truth, else the odometry) "
            "include wrong fixes; lost_time_ratio is a share of the duration of the drive.",
            "relocalization_error": "Method closure, without a given map: the error of the last closure accepted up "
            "to the fix whose reference is from before the loss. With a given map: the error of the first pose on "
            "/slam/pose after the fix, aligned by the drive that made the map (method map) or by the evaluated "
            "trajectory itself (method trajectory), which hides a common offset.",
            "relocalization_right": f"Within {self.closure_translation_m:g} m and "
            f"{self.closure_rotation_deg:g} deg (whole angle of rotation). The success rate is the share of "
            "losses with a right fix, the wrong rate that of losses with a wrong one; fixes without truth are ignored.",
            "calibration": "The NEES e^T P^-1 e of an error e with the covariance P, per degree of freedom (1 is "
            f"right, more is overconfident), and the share of errors in the {100.0 * CONFIDENCE:g} % "
            "region of the chi-squared distribution. Covariances are in the map frame, which the first keyframe fixes, "
            "so the truth is aligned with the estimate there and nowhere else. Errors of one run are correlated: judge "
            "the coverage over several runs.",
            "calibration_of_poses": "All other keyframes with truth: six degrees of freedom about the axes of the "
            "body.",
            "calibration_of_landmarks": "Confirmed landmarks that show an object by the truth of their detections: "
            "three coordinates.",
            "calibration_of_closures": "Accepted true closures, inserted or not, by their own covariance and axes.",
        }
