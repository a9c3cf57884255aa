"""A fault of the input: a function from the messages of a log to others, with numbers that say how strong it is."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, get_type_hints

from logs.topics import RecordKind
from slam.simulation.faults.stream import Entry, Stream, alter_detections
from slam.simulation.faults.track import track_of, with_poses

ODOMETRY = (RecordKind.ODOMETRY,)
DETECTIONS = (RecordKind.DETECTIONS,)
SCANS = (RecordKind.DETECTIONS, RecordKind.DETECTION_TRUTH)
TRANSFORMS = (RecordKind.TRANSFORMS,)
TRUTH = (RecordKind.GROUND_TRUTH, RecordKind.OBJECT_TRUTH)
EVERYTHING = (*ODOMETRY, *SCANS, *TRANSFORMS, *TRUTH)


@dataclass(frozen=True, slots=True)
class Range:
    """Values that a parameter may have, and its unit or kind."""

    unit: str
    min: float = 0.0
    max: float = math.inf
    is_whole: bool = False


Part = Annotated[float, Range("part of the drive", max=1.0)]
Share = Annotated[float, Range("share", max=1.0)]
Seconds = Annotated[float, Range("s", min=-1e6, max=1e6)]
Duration = Annotated[float, Range("s", max=1e6)]
Degrees = Annotated[float, Range("deg", min=-360.0, max=360.0)]
Factor = Annotated[float, Range("factor", max=1e3)]
Metres = Annotated[float, Range("m", min=-1e6, max=1e6)]
Sigma = Annotated[float, Range("m", max=1e3)]
Hertz = Annotated[float, Range("Hz", min=1e-3, max=1e3)]
Number = Annotated[float, Range("number", min=1.0, max=1e6, is_whole=True)]


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number that a fault takes."""

    default: float
    range: Range


@dataclass(frozen=True, slots=True)
class Fault:
    """One kind of fault.

    ``function`` takes the messages of a log and a number for each of the ``parameters``, or any number of labels
    (``takes_labels``), and a generator where it is random. ``changes``: kinds of records that may differ after it;
    ``reads``: others that it looks at. ``neutral``: the value of its only parameter that changes nothing. ``cases``:
    values by which it is measured. ``keeps_others``: topics that hold neither of these kinds are copied.
    """

    name: str
    meaning: str
    function: Callable[..., list[Entry]]
    changes: tuple[RecordKind, ...]
    reads: tuple[RecordKind, ...]
    parameters: tuple[Parameter, ...]
    is_random: bool
    takes_labels: bool
    neutral: float | None
    cases: tuple[str, ...]
    keeps_others: bool

    @property
    def usage(self) -> str:
        """How it is written, with its defaults: "gyro_bias=3:10"."""
        default = ("LABEL",) if self.takes_labels else tuple(p.default for p in self.parameters)
        return FaultCase(self, default).name


@dataclass(frozen=True, slots=True)
class FaultCase:
    """A fault with a value for each of its parameters."""

    fault: Fault
    values: tuple[float | str, ...]

    @property
    def name(self) -> str:
        """The same for two that do the same, and what :func:`slam.simulation.faults.registry.parse_fault` reads."""
        values = ":".join(value if isinstance(value, str) else f"{value:g}" for value in self.values)
        return f"{self.fault.name}={values}" if values else self.fault.name

    @property
    def is_neutral(self) -> bool:
        """Whether it changes nothing."""
        return self.fault.neutral is not None and self.values == (self.fault.neutral,)


def fault(
    changes: tuple[RecordKind, ...],
    *,
    reads: tuple[RecordKind, ...] = (),
    cases: tuple[str, ...] = ("",),
    neutral: float | None = None,
    keeps_others: bool = True,
    name: str = "",
    adapt: Callable[[Callable[..., Any]], Callable[..., list[Entry]]] | None = None,
) -> Callable[[Callable[..., Any]], Fault]:
    """Make a fault of a function: its name, its docstring and the annotations of its parameters describe it.

    The function takes and returns messages of a log, unless ``adapt`` makes such a one of it.
    """

    def make(function: Callable[..., Any]) -> Fault:
        parameters = inspect.signature(function).parameters
        hints: dict[str, Any] = get_type_hints(function, include_extras=True)
        return Fault(
            name=name or function.__name__,
            meaning=(function.__doc__ or "").partition("\n")[0].rstrip("."),
            function=adapt(function) if adapt else function,
            changes=changes,
            reads=reads,
            parameters=tuple(
                Parameter(each.default, hints[key].__metadata__[0])
                for key, each in parameters.items()
                if hasattr(hints[key], "__metadata__")
            ),
            is_random="rng" in parameters,
            takes_labels=any(each.kind is inspect.Parameter.VAR_POSITIONAL for each in parameters.values()),
            neutral=neutral,
            cases=cases,
            keeps_others=keeps_others,
        )

    return make


def _on_odometry(function: Callable[..., Any]) -> Callable[..., list[Entry]]:
    def on_stream(stream: Stream, *values: float, **rng: Any) -> list[Entry]:
        return with_poses(stream, function(track_of(stream), *values, **rng))

    return on_stream


def _on_detections(function: Callable[..., Any]) -> Callable[..., list[Entry]]:
    def on_stream(stream: Stream, *values: float, **rng: Any) -> list[Entry]:
        return alter_detections(stream, lambda seen: function(seen, *values, **rng))

    return on_stream


odometry_fault = partial(fault, ODOMETRY, adapt=_on_odometry)
"""Makes a fault of a function from a :class:`~slam.simulation.faults.track.Track` to its new poses (N, 4, 4)."""
detection_fault = partial(fault, DETECTIONS, adapt=_on_detections)
"""Makes a fault of a function from one message of detections to another with the same stamp and number of objects."""
