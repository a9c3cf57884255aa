"""Requirements on an evaluation: "trajectory.ate_m<=4.0"."""

import difflib
import math
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from slam.common.errors import EvaluationError
from slam.evaluation.report.figures import value_at

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

    def check(self, results: Mapping[str, Any]) -> tuple[bool, str]:
        """Whether the value meets the bar, and a description; an unknown or undefined value does not."""
        value = value_at(results, self.key)
        required = f"where {self.sign} {self.bar:g} was required"
        if isinstance(value, int | float):
            if _COMPARISONS[self.sign](value, self.bar):
                return True, f"{self.key} is {value:g} {self.sign} {self.bar:g}"
            return False, f"{self.key} is {value:g}, {required}"
        flat = pd.json_normalize(results).iloc[0]
        known = [key for key, each in flat.items() if not isinstance(each, list)]  # lists are curves, or tables
        near = difflib.get_close_matches(self.key, known, n=1)
        reason = value_at(results, f"unavailable.{self.key.partition('.')[0]}")
        why = f" ({reason})" if reason else f"; did you mean {near[0]}?" if near and self.key not in known else ""
        return False, f"{self.key} is undefined{why}, {required}"


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
