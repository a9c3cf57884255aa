"""Localization state of the robot."""

from enum import StrEnum

from logs.messages import DetectionAssociations, LoopClosureRecord
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose

CALIBRATIONS = "calibrations"
"""Counter of a status: how often the map was built again with another calibration. What follows replaces the records of
an earlier map.
"""
OF_ONE_MAP = (DetectionAssociations, LoopClosureRecord)
"""Records that name landmarks or keyframes of a map."""
CONTRADICTED = "localization lost: observations are inconsistent with the map"
DISCONTINUITY, KIDNAPPED = "odometry discontinuity (jump, gap or restart)", "kidnapped"
"""Why a segment begins."""


class State(StrEnum):
    """Localization state: in the map being built (MAPPING), in a prior map (TRACKING), or lost."""

    MAPPING = "MAPPING"
    TRACKING = "TRACKING"
    LOST = "LOST"
    RELOCALIZED = "RELOCALIZED"


class LocalizationState:
    """The state, keyframe by keyframe: lost unless odometry and closures connect the newest keyframe to the map.

    ``fixes``: the poses of the odometry at the relocalizations so far.
    """

    def __init__(self, *, has_prior_map: bool) -> None:
        self._localized = State.TRACKING if has_prior_map else State.MAPPING
        self.state = State.LOST if has_prior_map else State.MAPPING
        self.fixes: list[OdometryPose] = []

    def update(self, keyframe: Keyframe, *, is_localized: bool, began: str = "") -> list[tuple[State, str, str]]:
        """Follow to the newest keyframe; ``began``: why a segment begins there or before.

        Returns the changes: each time the state, what led to it, for people, and the level in the log, info or warning.
        """
        if not is_localized:
            was_lost, self.state = self.state == State.LOST, State.LOST
            if was_lost and not began:
                return []
            message = f"{began}: active landmarks dropped" if began else CONTRADICTED
            return [(self.state, message, "warning")]
        if self.state != State.LOST:
            return []
        self.fixes.append(keyframe.odometry)
        self.state = self._localized
        return [(State.RELOCALIZED, "relocalized in the map", "info"), (self.state, "localization continues", "info")]
