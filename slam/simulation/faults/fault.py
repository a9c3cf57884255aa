"""A fault of the input: a function from a recording to another, with numbers that say how strong it is."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from slam.simulation.faults.recording import Recording

Part = Annotated[float, Field(ge=0.0, le=1.0, description="part of the drive")]
Share = Annotated[float, Field(ge=0.0, le=1.0, description="share")]
Seconds = Annotated[float, Field(ge=-1e6, le=1e6, description="s")]
Duration = Annotated[float, Field(ge=0.0, le=1e6, description="s")]
Degrees = Annotated[float, Field(ge=-360.0, le=360.0, description="deg")]
Factor = Annotated[float, Field(ge=0.0, le=1e3, description="factor")]
Metres = Annotated[float, Field(ge=-1e6, le=1e6, description="m")]
Sigma = Annotated[float, Field(ge=0.0, le=1e3, description="m")]
Hertz = Annotated[float, Field(ge=1e-3, le=1e3, description="Hz")]
Number = Annotated[int, Field(ge=1, le=1_000_000, description="number")]


@dataclass(frozen=True, slots=True)
class Fault:
    """One kind of fault, described by the docstring of ``function`` and by the annotations of its parameters.

    ``function`` takes a recording and a number for each parameter, or any number of labels (``takes_labels``), and a
    generator where it is random. ``cases``: values by which it is measured.
    """

    function: Callable[..., Recording]
    cases: tuple[str, ...] = ("",)

    @property
    def name(self) -> str:
        """Notation on the command line."""
        return self.function.__name__

    @property
    def meaning(self) -> str:
        """Description in one line."""
        return (self.function.__doc__ or "").partition("\n")[0].rstrip(".")

    @property
    def parameters(self) -> list[inspect.Parameter]:
        """The numbers that it takes, with their defaults."""
        return [p for p in self._signature if p.kind is p.POSITIONAL_OR_KEYWORD][1:]

    @property
    def is_random(self) -> bool:
        """Whether it takes a generator."""
        return any(p.name == "rng" for p in self._signature)

    @property
    def takes_labels(self) -> bool:
        """Whether its values are labels."""
        return any(p.kind is p.VAR_POSITIONAL for p in self._signature)

    @property
    def usage(self) -> str:
        """Notation with the defaults: "gyro_bias=3:10"."""
        default = ("LABEL",) if self.takes_labels else tuple(p.default for p in self.parameters)
        return FaultCase(self, default).name

    @property
    def _signature(self) -> list[inspect.Parameter]:
        return list(inspect.signature(self.function, eval_str=True).parameters.values())


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


def fault(*cases: str) -> Callable[[Callable[..., Recording]], Fault]:
    """Make a fault of a function; ``cases``: values by which it is measured, by default those of its parameters."""
    return lambda function: Fault(function, cases or ("",))
