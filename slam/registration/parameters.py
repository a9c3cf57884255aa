"""Parameters of the registration of one constellation of objects with another."""

from __future__ import annotations

from pydantic import Field

from slam.common.config import Config
from slam.common.config_tree import Branch

HEIGHT_RANGES = 0.01
"""Noise of heights in sensor ranges, unless it is given."""
BASELINE_RANGES = 0.1
"""Least distance in sensor ranges of two objects that propose a heading, and how far a partner is looked for."""
DISTINCT_RANGES = 1.0 / 15.0
"""Distance in sensor ranges of two poses that are not the same."""


class RegistrationConfig(Branch):
    """Registration of one constellation of objects with another."""

    gate_sigma: float = Field(
        default=3.0, gt=0, description="gate of residuals and differences of lengths, in standard deviations"
    )
    height_sigma_m: float = Field(
        default=0.3, ge=0, description="additional noise of heights, e.g. of partly visible objects [m]"
    )
    tilt_sigma_rad: float = Field(
        default=0.005, gt=0, description="uncertainty of roll and pitch between the two frames [rad]"
    )
    min_baseline_m: float = Field(
        default=3.0, gt=0, description="minimum horizontal distance of two objects that propose a heading [m]"
    )
    min_inliers: int = Field(default=3, ge=2, description="minimum number of pairs of objects that support a pose")
    search_radius_m: float = Field(
        default=3.0, gt=0, description="initial matching distance of the refinement from an approximate pose [m]"
    )
    max_iterations: int = Field(default=8, ge=1, description="rounds of association and least squares")
    distinct_m: float = Field(
        default=2.0,
        gt=0,
        description="poses are the same if they are closer at the centre of the objects than this [m] ...",
    )
    distinct_deg: float = Field(default=10.0, gt=0, le=180, description="... and in heading than this [deg]")
    estimate_scale: bool = Field(
        default=False, description="also estimate a scale of the query, for ranges that are too long or too short"
    )
    scale_sigma: float = Field(default=0.05, gt=0, lt=1, description="standard deviation of that scale from 1")


def registration_config(config: Config) -> RegistrationConfig:
    """The parameters by settings and calibration: lengths are fractions of the sensor range."""
    range_m, height_m = config.sensor_range_m, config.calibration.objects.height_sigma_m
    return RegistrationConfig(
        **config.registration.model_dump(),
        height_sigma_m=HEIGHT_RANGES * range_m if height_m is None else height_m,
        min_baseline_m=BASELINE_RANGES * range_m,
        search_radius_m=BASELINE_RANGES * range_m,
        distinct_m=DISTINCT_RANGES * range_m,
    )
