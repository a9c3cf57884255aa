"""The result of an evaluation: figures as JSON has them, and what pictures of them need besides."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np
import pandas as pd

from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.metrics.calibration import Consistency
from slam.evaluation.metrics.trajectory import TrajectoryErrors


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """What could be measured of one output log; ``unavailable`` has the reason of each part that could not.

    ``results``: all figures, as :meth:`to_json_dict` returns them. ``estimate`` is the final trajectory, ``odometry``
    the input alone, ``online`` the poses as they were at their time; None where they could not be measured.
    ``closures``: the candidates, as :func:`slam.evaluation.place_recognition.closures.judge_closures` returns them;
    ``missed_ns``: stamps of the revisits without an accepted true closure; ``consistency``: errors in units of their
    covariances.
    """

    protocol: Protocol
    results: Mapping[str, Any]
    unavailable: Mapping[str, str]
    estimate: TrajectoryErrors | None = None
    odometry: TrajectoryErrors | None = None
    online: TrajectoryErrors | None = None
    closures: pd.DataFrame | None = None
    missed_ns: tuple[int, ...] = ()
    consistency: Mapping[str, Consistency] = field(default_factory=dict)

    def to_json_dict(self) -> dict[str, Any]:
        """Plain dicts, lists, strings and finite numbers. Every key is always there; what is undefined is None."""
        return dict(self.results)


def describe_trajectories(trajectories: Mapping[str, TrajectoryErrors | None]) -> dict[str, Any]:
    """The main figures of each trajectory after its name (none for the estimate), and all figures by its name."""
    head: dict[str, Any] = {}
    for name, errors in trajectories.items():
        prefix = "" if name == "estimate" else f"{name}_"
        yaw = errors.absolute_yaw if errors else None
        head |= {
            f"{prefix}ate_m": errors.absolute.rmse_m if errors else None,
            f"{prefix}ate_yaw_m": yaw.rmse_m if yaw else None,
            f"{prefix}rpe_translation_percent": errors.relative.translation_percent if errors else None,
            f"{prefix}rpe_rotation_deg_per_100m": errors.relative.rotation_deg_per_100m if errors else None,
        }
    return {**head, **trajectories}


def plain(value: Any) -> Any:
    """Dataclasses, arrays and mappings as JSON has them; a number that is not finite is None."""
    if is_dataclass(value):
        return {each.name: plain(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, Mapping):
        return {name: plain(each) for name, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, tuple | list):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def undefined(figures: Any) -> Any:
    """The same keys where nothing could be measured: no number, no list."""
    if isinstance(figures, Mapping):
        return {name: undefined(each) for name, each in figures.items()}
    return [] if isinstance(figures, list) else None
