"""Degradations as they are typed: "dropout=0.3,position_noise=0.2", faults that belong together."""

from __future__ import annotations

from collections.abc import Sequence

from slam.common.errors import ConfigurationError
from slam.simulation.faults.fault import FaultCase
from slam.simulation.faults.registry import all_cases, parse_fault

DEFAULT_SPECIFICATIONS = (
    "dropout=0.7",
    "position_noise=1",
    "label_confusion=0.5",
    "false_positives=10",
    "odometry_yaw_noise=0.005",
)
UNDEGRADED, EVERY_FAULT = "undegraded", "every fault"


def parse_degradations(specifications: Sequence[str]) -> list[str]:
    """The names of the undegraded log, then of each degradation once, in the order given.

    Two degradations that do the same have the same name. :data:`EVERY_FAULT` means all faults, one at a time.

    Raises:
        ConfigurationError: a fault that does not exist, or a value that is not allowed.
    """
    found = [UNDEGRADED]
    for text in specifications or DEFAULT_SPECIFICATIONS:
        found += [case.name for case in all_cases()] if text == EVERY_FAULT else [_parse(text)]
    return list(dict.fromkeys(found))


def cases_of(degradation: str) -> tuple[FaultCase, ...]:
    """The faults of a degradation by its name, in the order in which they are applied."""
    return () if degradation == UNDEGRADED else tuple(parse_fault(part) for part in degradation.split(","))


def is_random(degradation: str) -> bool:
    """Whether the seed matters."""
    return any(case.fault.is_random for case in cases_of(degradation))


def _parse(text: str) -> str:
    """The name of a degradation; its faults are applied in the order in which they are typed."""
    try:
        return ",".join(parse_fault(part).name for part in text.split(","))
    except ConfigurationError as error:
        raise ConfigurationError(f"--degrade {text!r}: {error}") from error
