"""The faults by their names, and how they are typed."""

import difflib
import inspect
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from pydantic import TypeAdapter, ValidationError

from logs.records import frozen
from slam.common.errors import ConfigurationError
from slam.simulation.faults import detections, objects, odometry, stamps
from slam.simulation.faults.recording import Recording


@frozen
class Fault:
    """A function that changes a recording, with a value for each of its parameters, or any number of labels."""

    function: Callable[..., None]
    values: tuple[float | str, ...]

    @property
    def name(self) -> str:
        """The same for two that do the same, and what :func:`parse_faults` reads: "gyro_bias=3:10"."""
        values = ":".join(value if isinstance(value, str) else f"{value:g}" for value in self.values)
        return f"{self.function.__name__}={values}" if values else self.function.__name__

    @property
    def meaning(self) -> str:
        """What it does, in a line."""
        return (self.function.__doc__ or "").partition("\n")[0].rstrip(".")

    @property
    def is_random(self) -> bool:
        """Whether it draws random numbers."""
        return "rng" in inspect.signature(self.function).parameters

    def apply(self, log: Recording, rng: np.random.Generator) -> None:
        """Change the recording.

        Raises:
            SimulationError: it has not what the fault needs.
        """
        self.function(log, *self.values, **({"rng": rng} if self.is_random else {}))


def _parameters(function: Callable[..., None]) -> list[inspect.Parameter]:
    """The numbers that a fault takes, with their defaults."""
    every = inspect.signature(function, eval_str=True).parameters.values()
    return [parameter for parameter in every if parameter.kind is parameter.POSITIONAL_OR_KEYWORD][1:]


_LABELS = detections.keep_label
"""The fault that takes labels instead of numbers."""
FAULTS = {
    name: Fault(function, ("LABEL",) if function is _LABELS else tuple(p.default for p in _parameters(function)))
    for module in (detections, odometry, stamps, objects)
    for name, function in vars(module).items()
    if inspect.isfunction(function) and function.__module__ == module.__name__ and not name.startswith("_")
}
"""The public functions of these modules, with their defaults."""


def parse_faults(texts: Sequence[str]) -> list[Fault]:
    """The faults in the order given; each of the texts holds some, joined by commas.

    A fault is typed as NAME, or NAME=VALUE with the values of several parameters joined by ":".

    Raises:
        ConfigurationError: a name that does not exist, or a value that is not allowed.
    """
    return [_parse(part) for text in texts for part in text.split(",")]


def _parse(text: str) -> Fault:
    name, equals, values = (part.strip() for part in text.partition("="))
    fault = FAULTS.get(name.replace("-", "_"))
    if fault is None:
        near = difflib.get_close_matches(name, FAULTS, n=1)
        hint = f"did you mean {near[0]}?" if near else "'dslam degrade --list-faults' lists them"
        raise ConfigurationError(f"unknown fault {name!r}; {hint}")
    words, parameters = values.split(":") if equals else [], _parameters(fault.function)
    if fault.function is _LABELS:
        if not all(words) or not words:
            raise ConfigurationError(f"fault {text!r} needs a label, for example {name}=tree")
        return replace(fault, values=tuple(words))
    if len(words) > len(parameters):
        takes = f"write {fault.name}" if parameters else f"{name} takes no value"
        raise ConfigurationError(f"fault {text!r}: {values!r} has {len(words)} values, not {len(parameters)}; {takes}")
    given = [_value(text, parameter, word) for parameter, word in zip(parameters, words, strict=False)]
    return replace(fault, values=(*given, *fault.values[len(given) :]))


def _value(text: str, parameter: inspect.Parameter, word: str) -> float:
    try:
        value: float = TypeAdapter(parameter.annotation).validate_python(word)
    except ValidationError as error:
        unit = parameter.annotation.__metadata__[0].description
        raise ConfigurationError(
            f"fault {text!r}: {word!r} is not allowed as {unit}: {error.errors()[0]['msg']}"
        ) from error
    return value
