"""Requirements on an evaluation: "trajectory.ate_m<=4.0"."""

import difflib
import math
import operator
import re
from collections.abc import Callable, Mapping
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


def check_requirement(text: str, results: Mapping[str, Any]) -> tuple[bool, str]:
    """Whether the number that a requirement names in an evaluation's JSON meets its bar, and a description; an unknown
    or undefined value does not.

    Raises:
        EvaluationError: as :func:`parse_requirement`.
    """
    key, sign, bar = parse_requirement(text)
    value = value_at(results, key)
    required = f"where {sign} {bar:g} was required"
    if isinstance(value, int | float):
        if _COMPARISONS[sign](value, bar):
            return True, f"{key} is {value:g} {sign} {bar:g}"
        return False, f"{key} is {value:g}, {required}"
    flat = pd.json_normalize(results).iloc[0]
    known = [name for name, each in flat.items() if not isinstance(each, list)]  # lists are curves, or tables
    near = difflib.get_close_matches(key, known, n=1)
    reason = value_at(results, f"unavailable.{key.partition('.')[0]}")
    why = f" ({reason})" if reason else f"; did you mean {near[0]}?" if near and key not in known else ""
    return False, f"{key} is undefined{why}, {required}"


def parse_requirement(text: str) -> tuple[str, str, float]:
    """The dotted key, the sign and the bar of a requirement.

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
    return match["key"], match["sign"], bar
