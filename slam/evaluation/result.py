"""The result of an evaluation: figures for JSON, and data for pictures."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from logs.records import frozen
from slam.evaluation.metrics.trajectory import TrajectoryErrors


@frozen
class Evaluation:
    """The evaluation of one output log; a part that could not be measured is empty, its reason is in ``unavailable``.

    ``results``: all figures, as :meth:`to_json_dict` returns them. ``estimate`` is the final trajectory, ``odometry``
    the input alone, ``online`` the poses as they were at their time; None where they could not be measured.
    ``closures``: the candidates, as :func:`slam.evaluation.place_recognition.closures.judge_closures` returns them.
    """

    results: Mapping[str, Any]
    estimate: TrajectoryErrors | None = None
    odometry: TrajectoryErrors | None = None
    online: TrajectoryErrors | None = None
    closures: pd.DataFrame | None = None

    @property
    def unavailable(self) -> Mapping[str, str]:
        """Why a part could not be measured, by its name."""
        return self.results["unavailable"]

    def to_json_dict(self) -> dict[str, Any]:
        """Plain dicts, lists, strings and finite numbers; what is undefined, such as a precision of none, is None."""
        return dict(self.results)


def describe_trajectories(trajectories: Mapping[str, TrajectoryErrors | None]) -> dict[str, Any]:
    """The main figures of each trajectory after its name (none for the estimate), and all figures by its name."""
    head = {
        f"{'' if name == 'estimate' else f'{name}_'}{figure}": getattr(errors, figure, None)
        for name, errors in trajectories.items()
        for figure in ("ate_m", "rpe_translation_percent", "rpe_rotation_deg_per_100m")
    }
    return {**head, **trajectories}
