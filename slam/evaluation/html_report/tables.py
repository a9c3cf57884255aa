"""The numbers of an evaluation as tables, from its JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from slam.evaluation.html_report.markup import UNDEFINED, format_number, format_value, table

TRAJECTORIES = ("estimate", "odometry", "online")
TITLES = {
    "associations": "Associations of detections with landmarks",
    "landmarks": "Landmarks of the final map",
    "closures": "Loop closures",
    "retrieval": "Retrieval of places alone",
    "literature_protocols": "Two published protocols",
}
LONGEST_LIST = 12
"""A longer list is a curve, which the charts show."""
_UNITS = {
    "_deg_per_100m": "deg/100 m",
    "_percent": "%",
    "_deg": "deg",
    "_rad": "rad",
    "_ms": "ms",
    "_ns": "ns",
    "_m": "m",
    "_s": "s",
}
_WORDS = {"rmse": "RMSE", "ate": "ATE", "rpe": "RPE", "p95": "95\N{NO-BREAK SPACE}%", "f1": "F1", "nees": "NEES"}
_APART = ("trajectory", "unavailable", "protocol")


def render_tables(results: Mapping[str, Any]) -> str:
    """All numbers of :meth:`slam.evaluation.result.Evaluation.to_json_dict`, a table for each of its parts."""
    parts = [_absolute_table(results["trajectory"]), _relative_table(results["trajectory"])]
    for name, values in results.items():
        if name not in _APART and isinstance(values, Mapping):
            parts.append(_pairs_table(name, values))
    parts.append(_losses_table(results["relocalization"]["losses"]))
    return "".join(parts)


def name_of(key: str) -> str:
    """A key of the JSON in words, with its unit apart: ``p95_error_m`` is "95 % error [m]"."""
    suffix, unit = next(((suffix, f" [{unit}]") for suffix, unit in _UNITS.items() if key.endswith(suffix)), ("", ""))
    words = key.removesuffix(suffix).replace(".", "_·_").split("_")
    return " ".join(_WORDS.get(word, word) for word in words) + unit


def _absolute_table(trajectory: Mapping[str, Any]) -> str:
    columns = {name: trajectory[name] for name in TRAJECTORIES if trajectory.get(name)}
    if not columns:
        return ""
    first = next(iter(columns.values()))
    rows = [
        (name_of(key), [format_value(errors["absolute"][key]) for errors in columns.values()])
        for key in first["absolute"]
    ]
    rows += [
        (name_of(key), [format_value(errors[key]) for errors in columns.values()])
        for key, value in first.items()
        if not isinstance(value, Mapping)
    ]
    rows.append(("aligned by", [errors["alignment"]["kind"].replace("_", " ") for errors in columns.values()]))
    return table("Absolute trajectory error", ["", *columns], rows)


def _relative_table(trajectory: Mapping[str, Any]) -> str:
    columns = {name: trajectory[name] for name in TRAJECTORIES if trajectory.get(name)}
    if not columns:
        return ""
    every = [[*errors["short_relative"]["rows"], *errors["relative"]["rows"]] for errors in columns.values()]
    rows = []
    for stretches in zip(*every, strict=True):
        if any(row["stretch_count"] for row in stretches):
            rows.append((f"{stretches[0]['length_m']:g} m", _drift_cells(stretches)))
    rows.append(("all of KITTI's", _drift_cells([errors["relative"] for errors in columns.values()])))
    header = [f"{name} {unit}" for name in columns for unit in ("%", "deg/100\N{NO-BREAK SPACE}m")]
    return table("Relative error over stretches of path", ["length", *header], rows)


def _drift_cells(rows: Any) -> list[str]:
    names = ("translation_percent", "rotation_deg_per_100m")
    return [format_number(row[name]) if row[name] is not None else UNDEFINED for row in rows for name in names]


def _pairs_table(part: str, values: Mapping[str, Any]) -> str:
    rows = [(name_of(key), [format_value(value), f"{part}.{key}"]) for key, value in _flatten(values)]
    if not rows:
        return ""
    caption = TITLES.get(part, name_of(part).capitalize())
    if all(cells[0] == UNDEFINED for _, cells in rows):
        return ""
    return table(caption, ["", "value", "key"], rows, kind="pairs")


def _losses_table(losses: Sequence[Mapping[str, Any]]) -> str:
    if not losses:
        return ""
    keys = [key for key in losses[0] if not key.endswith("_ns")]
    rows = [(str(number), [format_value(loss[key]) for key in keys]) for number, loss in enumerate(losses, 1)]
    return table("Where the robot was lost", ["loss", *(name_of(key) for key in keys)], rows)


def _flatten(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Leaves by their dotted keys; curves and lists of objects, which no cell can hold, are left out."""
    leaves: list[tuple[str, Any]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            leaves += _flatten(value, f"{prefix}{key}.")
        elif not isinstance(value, list) or (
            0 < len(value) <= LONGEST_LIST and not any(isinstance(item, list | Mapping) for item in value)
        ):
            leaves.append((prefix + key, value))
    return leaves
