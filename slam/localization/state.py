"""Localization state of the robot."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """Localization state: in the map being built (MAPPING), in a prior map (TRACKING), or lost."""

    MAPPING = "MAPPING"
    TRACKING = "TRACKING"
    LOST = "LOST"
    RELOCALIZED = "RELOCALIZED"


@dataclass(frozen=True, slots=True)
class Fix:
    """A relocalization: when it happened, and after how much travel."""

    stamp_ns: int
    travel_m: float
