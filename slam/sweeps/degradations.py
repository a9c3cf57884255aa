"""Degradations as they are typed: "dropout=0.3,position_noise=0.2", faults that belong together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from slam.common.errors import ConfigurationError
from slam.simulation.faults.fault import FaultCase
from slam.simulation.faults.registry import DEGRADATIONS, parse_fault

DEFAULT_SPECIFICATIONS = (
    "dropout=0.7",
    "position_noise=1",
    "label_confusion=0.5",
    "false_positives=10",
    "odometry_yaw_noise=0.005",
)
UNDEGRADED = "undegraded"
_ORDER = {name: number for number, name in enumerate(DEGRADATIONS)}


@dataclass(frozen=True, slots=True)
class Degradation:
    """Faults of a log, by a ``name`` that is the same for two that do the same."""

    name: str

    @property
    def cases(self) -> tuple[FaultCase, ...]:
        """The faults in the order in which they are applied."""
        return () if self.is_undegraded else tuple(parse_fault(part) for part in self.name.split(","))

    @property
    def is_undegraded(self) -> bool:
        """Whether the log is not changed."""
        return self.name == UNDEGRADED

    @property
    def is_random(self) -> bool:
        """Whether the seed matters."""
        return any(case.fault.is_random for case in self.cases)

    @property
    def strength(self) -> tuple[str, float] | None:
        """The fault and its value, where there is one fault with one number."""
        values = [(case.fault.name, value) for case in self.cases for value in case.values]
        if len(self.cases) != 1 or len(values) != 1:
            return None
        name, value = values[0]
        return None if isinstance(value, str) else (name, value)


def parse_degradations(specifications: Sequence[str]) -> list[Degradation]:
    """The undegraded log, then each degradation once, in the order given.

    Raises:
        ConfigurationError: a fault that does not exist, or a value that is not allowed.
    """
    found = [Degradation(UNDEGRADED), *(_parse(text) for text in specifications or DEFAULT_SPECIFICATIONS)]
    return list({degradation.name: degradation for degradation in found}.values())


def _parse(text: str) -> Degradation:
    cases: dict[str, FaultCase] = {}
    try:
        for part in text.split(","):
            case = parse_fault(part)
            name = case.fault.name
            if name in cases and not case.fault.takes_labels:
                raise ConfigurationError(f"{name} is given twice; give it once")
            before = cases[name].values if name in cases else ()
            cases[name] = FaultCase(case.fault, (*before, *case.values))
    except ConfigurationError as error:
        raise ConfigurationError(f"--degrade {text!r}: {error}") from error
    # Degradations in their fixed order, then other faults as they are given.
    ordered = sorted(cases.values(), key=lambda case: _ORDER.get(case.fault.name, len(_ORDER)))
    return Degradation(",".join(case.name for case in ordered if not case.is_neutral) or UNDEGRADED)
