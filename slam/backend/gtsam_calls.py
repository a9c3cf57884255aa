"""Graphs of GTSAM's factors, and its exceptions as errors of ours."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import gtsam

from slam.common.errors import FactorGraphError


@contextmanager
def gtsam_errors(what: str) -> Iterator[None]:
    """Exceptions of GTSAM become a ``FactorGraphError``: ``what`` failed, with the keyframe or landmark it concerns."""
    try:
        yield
    except (RuntimeError, ValueError, IndexError) as error:
        raise FactorGraphError(f"{what} failed{_variable_in(str(error))}: {first_line(error)}") from error


def first_line(error: Exception) -> str:
    """The first line of the message of an exception."""
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)


def _variable_in(message: str) -> str:
    """The keyframe or landmark that a GTSAM message names as a symbol, e.g. x12 or l7."""
    found = re.search(r"\b([xl])(\d+)\b", message)
    if found is None:
        return ""
    return f" at {'keyframe' if found[1] == 'x' else 'landmark'} {found[2]}"


def graph_of(factors: Iterable[gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    """A graph of factors, in their order."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    return graph
