"""The rules and thresholds by which everything is measured; they are printed with the numbers."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from slam.errors import EvaluationError
from slam.evaluation.alignment import STRAIGHT_LINE_RATIO
from slam.evaluation.trajectory import KITTI_LENGTHS_M, KITTI_START_STEP


@dataclass(frozen=True, slots=True)
class Protocol:
    """Thresholds, with KITTI's values for the relative errors; units are in the names.

    Raises:
        EvaluationError: a threshold is not positive, or windows of fewer than three landmarks are asked for.
    """

    max_truth_gap_s: float = 1.5
    relative_lengths_m: tuple[float, ...] = KITTI_LENGTHS_M
    short_relative_lengths_m: tuple[float, ...] = (1.0, 10.0)
    relative_start_step: int = KITTI_START_STEP
    revisit_m: float = 100.0
    window_m: float = 50.0
    window_stride_m: float = 25.0
    window_least_landmarks: int = 3
    match_distance_m: float = 2.0
    least_detections: int = 5

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            values = value if isinstance(value, tuple) else (value,)
            if not all(number > 0 for number in values):
                raise EvaluationError(f"{name} = {value} of the evaluation protocol must be positive")
        if self.window_least_landmarks < 3:
            raise EvaluationError(
                f"window_least_landmarks = {self.window_least_landmarks}: fewer than 3 landmarks leave no residual"
            )

    def describe(self) -> dict[str, str]:
        """Each rule in one sentence, with the thresholds in it."""
        lengths = ", ".join(f"{length:g}" for length in self.relative_lengths_m)
        short = ", ".join(f"{length:g}" for length in self.short_relative_lengths_m)
        return {
            "time": "The truth is interpolated at the stamps of the estimate, inside its span and not across gaps of "
            f"more than {self.max_truth_gap_s:g} s.",
            "alignment": "Umeyama SE(3), no scale, over all compared positions; on a straight line (spread across it "
            f"below {STRAIGHT_LINE_RATIO:g} of that along it) yaw and translation only.",
            "ate": "Distances between aligned estimated and true positions of the body; ate_m is their RMSE.",
            "rpe": f"KITTI: stretches of {lengths} m of true path, starting at every {self.relative_start_step}th "
            "compared pose and divided by the nominal length; the averages are over all stretches.",
            "short_rpe": f"Stretches of {short} m likewise, divided by the path that each really measures.",
            "landmark_identity": "A landmark shows the object that most of its detections show, false positives "
            "counted as one candidate; a tie goes to the first. Detections of a merged landmark count for the one that "
            "it became.",
            "association_precision": "Assignments to an existing landmark whose detection shows that landmark's "
            "object; a false positive is wrong.",
            "association_recall": f"Detections of an object that an earlier frame showed within the last "
            f"{self.revisit_m:g} m of travel, assigned to an existing landmark that shows the object.",
            "landmark_error": f"Confirmed landmarks, grouped by first sighting into windows of {self.window_m:g} m of "
            f"true path every {self.window_stride_m:g} m; yaw and translation aligned in each window with at least "
            f"{self.window_least_landmarks} landmarks; statistics over the residuals of all windows.",
            "landmark_global_error": "Confirmed landmarks after the alignment of the trajectory.",
            "landmark_matching": "By the identity above; without a truth of the detections, the nearest true object of "
            f"the same class within {self.match_distance_m:g} m after the alignment of the trajectory.",
            "landmark_precision": "Confirmed landmarks that show an object.",
            "landmark_recall": f"True objects detected at least {self.least_detections} times that a confirmed "
            "landmark shows.",
            "class_accuracy": "Confirmed landmarks whose most probable class is that of their object.",
        }
