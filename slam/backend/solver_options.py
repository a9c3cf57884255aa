"""Options of the solvers on GTSAM."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FactorGraphConfig:
    """``observation_kernel_width``: of the Cauchy kernel of observations, in standard deviations;
    ``relinearize_threshold``: of iSAM2, the change of a variable that relinearises it, and
    ``relinearize_skip``, the updates between checks for it.
    """

    observation_kernel_width: float = 1.5
    relinearize_threshold: float = 0.05
    relinearize_skip: int = 10


GROUP_KEYFRAMES = 4
"""Consecutive keyframes that observe a landmark once, where the odometry between them is far better than a detection.
"""
UPDATE_KEYFRAMES = 5
"""Keyframes between two updates of iSAM2; in between only the local map follows."""
