"""The faults by their names, and how they are typed."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence

from slam.common.errors import ConfigurationError
from slam.simulation.faults import clocks, labels, lengths, objects, odometry, positions, sensor
from slam.simulation.faults.fault import Fault, FaultCase, Parameter

_MODULES = (sensor, odometry, clocks, positions, labels, objects, lengths)
FAULTS = {each.name: each for module in _MODULES for each in vars(module).values() if isinstance(each, Fault)}
DEGRADATIONS = (
    "reversed",
    "time_offset",
    "position_noise",
    "dropout",
    "field_of_view",
    "max_range",
    "keep_label",
    "drop_label",
    "label_confusion",
    "false_positives",
    "odometry_translation_noise",
    "odometry_yaw_noise",
)
"""Faults that make a log harder without an error in it, in the order in which they are applied together."""


def parse_fault(text: str) -> FaultCase:
    """A fault as it is typed: NAME, or NAME=VALUE with the values of several parameters joined by ":".

    Raises:
        ConfigurationError: a name that does not exist, or a value that is not allowed.
    """
    name, equals, values = (part.strip() for part in text.partition("="))
    fault = FAULTS.get(name.replace("-", "_"))
    if fault is None:
        near = difflib.get_close_matches(name, FAULTS, n=1)
        hint = f"did you mean {near[0]}?" if near else "'dslam degrade --list-faults' lists them"
        raise ConfigurationError(f"unknown fault {name!r}; {hint}")
    words = values.split(":") if equals else []
    if fault.takes_labels:
        if not all(words) or not words:
            raise ConfigurationError(f"fault {text!r} needs a label, for example {fault.name}=tree")
        return FaultCase(fault, tuple(words))
    if len(words) > len(fault.parameters):
        takes = f"write {fault.usage}" if fault.parameters else f"{fault.name} takes no value"
        raise ConfigurationError(
            f"fault {text!r}: {values!r} has {len(words)} values, not {len(fault.parameters)}; {takes}"
        )
    given = [_value(text, parameter, word) for parameter, word in zip(fault.parameters, words, strict=False)]
    return FaultCase(fault, (*given, *(p.default for p in fault.parameters[len(given) :])))


def parse_faults(texts: Sequence[str]) -> list[FaultCase]:
    """Each of the faults, in the order given.

    Raises:
        ConfigurationError: a name that does not exist, or a value that is not allowed.
    """
    return [parse_fault(text) for text in texts]


def all_cases(names: Sequence[str] = ()) -> list[FaultCase]:
    """Every case of every fault that is an error of the input, or of those named; a name with a value is one case.

    Raises:
        ConfigurationError: a name that does not exist, or a value that is not allowed.
    """
    found: dict[str, FaultCase] = {}
    for text in names or [name for name in FAULTS if name not in DEGRADATIONS or FAULTS[name].cases != ("",)]:
        first = parse_fault(text)
        values = first.fault.cases if "=" not in text else ()
        cases = [parse_fault(f"{first.fault.name}={value}") if value else first for value in values] or [first]
        found |= {case.name: case for case in cases}
    return list(found.values())


def _value(text: str, parameter: Parameter, word: str) -> float:
    allowed = parameter.range
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    is_allowed = math.isfinite(value) and allowed.min <= value <= allowed.max
    if not is_allowed or (allowed.is_whole and value != int(value)):
        kind = "a whole number" if allowed.is_whole else "a number"
        most = f" and <= {allowed.max:g}" if math.isfinite(allowed.max) else ""
        raise ConfigurationError(
            f"fault {text!r}: {word!r} is not allowed as {allowed.unit}; it is {kind} >= {allowed.min:g}{most}"
        )
    return value
