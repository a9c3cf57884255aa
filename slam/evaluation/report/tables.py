"""All figures of an evaluation as tables, named by the keys of its JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from slam.evaluation.metrics.statistics import UNDEFINED
from slam.evaluation.report.figures import format_number, leaves

_TRAJECTORIES = ("estimate", "odometry", "online")
_RELATIVE = {"translation_percent": "%", "rotation_deg_per_100m": "deg/100 m"}
_APART = ("trajectory", "unavailable", "protocol")


def make_tables(results: Mapping[str, Any]) -> dict[str, pd.DataFrame]:
    """Tables of texts by their titles: trajectories side by side, then each part with a row a figure, then losses.

    Args:
        results: as :meth:`slam.evaluation.result.Evaluation.to_json_dict` returns it.
    """
    trajectories = {name: results["trajectory"][name] for name in _TRAJECTORIES if results["trajectory"][name]}
    absolute = {name: dict(leaves(errors)) for name, errors in trajectories.items()}
    parts = {name: dict(leaves(values)) for name, values in results.items() if name not in _APART}
    frames = {
        "trajectory": pd.DataFrame(absolute),
        "relative error over stretches of path": _relative_table(trajectories),
        **{name: pd.DataFrame({"value": pd.Series(values, dtype=object)}) for name, values in parts.items()},
        "losses": pd.DataFrame(results["relocalization"]["losses"]).T.rename(columns=str),
    }
    return {title: frame.map(_text) for title, frame in frames.items() if frame.notna().any(axis=None)}


def _relative_table(trajectories: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    columns = {}
    for name, errors in trajectories.items():
        rows = {f"{row['length_m']:g} m": row for row in errors["short_relative"]["rows"] + errors["relative"]["rows"]}
        rows["all of KITTI's lengths"] = errors["relative"]
        for key, unit in _RELATIVE.items():
            columns[f"{name} {unit}"] = {title: row[key] for title, row in rows.items()}
        columns.setdefault("stretches", {title: row["stretch_count"] for title, row in rows.items()})
    return pd.DataFrame(columns)


def _text(value: Any) -> str:
    if value is None or value is pd.NA or value == "" or value != value:
        return UNDEFINED
    return format_number(value) if isinstance(value, float) else str(value)
