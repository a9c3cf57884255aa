"""Bars that an evaluation has to clear: "trajectory.ate_m<=4.0"."""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from slam.common.errors import EvaluationError
from slam.evaluation.report.figures import leaves

_COMPARISONS: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "<": operator.lt,
    ">": operator.gt,
}
_FORM = re.compile(r"^\s*(?P<key>[\w.]+)\s*(?P<sign><=|>=|==|<|>)\s*(?P<bar>\S+)\s*$")


@dataclass(frozen=True, slots=True)
class Requirement:
    """The number at the dotted ``key`` of an evaluation's JSON must compare by ``sign`` with ``bar``."""

    key: str
    sign: str
    bar: float

    def shortfall(self, results: Mapping[str, Any]) -> str:
        """What is wrong with ``results``; "" where they meet the bar. An unknown or undefined value is wrong."""
        numbers = _numbers(results)
        if self.key not in numbers:
            near = difflib.get_close_matches(self.key, numbers, n=1)
            return f"{self.key}: there is no such value" + (f", did you mean {near[0]}?" if near else "")
        value = numbers[self.key]
        if value is None:
            return f"{self.key} is undefined, where {self.sign} {self.bar:g} was required"
        if not _COMPARISONS[self.sign](value, self.bar):
            return f"{self.key} is {value:g}, where {self.sign} {self.bar:g} was required"
        return ""

    def describe(self, results: Mapping[str, Any]) -> str:
        """The value and the bar that it meets."""
        return f"{self.key} is {_numbers(results)[self.key]:g} {self.sign} {self.bar:g}"


def parse_requirement(text: str) -> Requirement:
    """The requirement that ``text`` states.

    Raises:
        EvaluationError: it is not KEY, one of <= >= == < >, and a finite number.
    """
    match = _FORM.match(text)
    try:
        bar = float(match["bar"]) if match else math.nan
    except ValueError:
        bar = math.nan
    if match is None or not math.isfinite(bar):
        raise EvaluationError(f"requirement {text!r}: expected for example 'trajectory.ate_m<=4.0'")
    return Requirement(match["key"], match["sign"], bar)


def _numbers(results: Mapping[str, Any]) -> dict[str, float | None]:
    """All numbers of an evaluation by their dotted keys; None where one is undefined."""
    return {
        key: value
        for key, value in leaves(results)
        if value is None or (isinstance(value, int | float) and not isinstance(value, bool))
    }
