"""The faults by their names, and how they are typed."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Sequence

from pydantic import TypeAdapter, ValidationError

from slam.common.errors import ConfigurationError
from slam.simulation.faults import detections, objects, odometry, stamps
from slam.simulation.faults.fault import Fault, FaultCase

FAULTS = {
    each.name: each
    for module in (detections, odometry, stamps, objects)
    for each in vars(module).values()
    if isinstance(each, Fault)
}


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
    words, parameters = values.split(":") if equals else [], fault.parameters
    if fault.takes_labels:
        if not all(words) or not words:
            raise ConfigurationError(f"fault {text!r} needs a label, for example {fault.name}=tree")
        return FaultCase(fault, tuple(words))
    if len(words) > len(parameters):
        takes = f"write {fault.usage}" if parameters else f"{fault.name} takes no value"
        raise ConfigurationError(f"fault {text!r}: {values!r} has {len(words)} values, not {len(parameters)}; {takes}")
    given = [_value(text, parameter, word) for parameter, word in zip(parameters, words, strict=False)]
    return FaultCase(fault, (*given, *(parameter.default for parameter in parameters[len(given) :])))


def parse_faults(texts: Sequence[str]) -> list[FaultCase]:
    """The faults in the order given; each of the texts holds some, joined by commas.

    Raises:
        ConfigurationError: a name that does not exist, or a value that is not allowed.
    """
    return [parse_fault(part) for text in texts for part in text.split(",")]


def all_cases() -> list[FaultCase]:
    """Every case of every fault, but those that need a label."""
    measured = [fault for fault in FAULTS.values() if not fault.takes_labels]
    return [parse_fault(f"{each.name}={case}" if case else each.name) for each in measured for case in each.cases]


def _value(text: str, parameter: inspect.Parameter, word: str) -> float:
    try:
        value: float = TypeAdapter(parameter.annotation).validate_python(word)
    except ValidationError as error:
        unit = parameter.annotation.__metadata__[0].description
        raise ConfigurationError(
            f"fault {text!r}: {word!r} is not allowed as {unit}: {error.errors()[0]['msg']}"
        ) from error
    return value
