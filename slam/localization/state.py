"""What the robot knows of where it is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """What the robot knows of where it is: in the map that it makes, in one that it was given, or nothing."""

    MAPPING = "MAPPING"
    TRACKING = "TRACKING"
    LOST = "LOST"
    RELOCALIZED = "RELOCALIZED"


@dataclass(frozen=True, slots=True)
class Fix:
    """When the robot came to know where it is, and after how much travel."""

    stamp_ns: int
    travel_m: float
