"""Parameters of the registration of one constellation of objects with another."""

from __future__ import annotations

from dataclasses import dataclass

from slam.common.config import Config

MIN_INLIERS = 3
"""Fewest pairs of objects that support a pose, unless the query has fewer."""


@dataclass(frozen=True, slots=True)
class RegistrationConfig:
    """Registration of one constellation of objects with another.

    ``height_sigma_m``: additional noise of heights, for example of partly visible objects; ``search_radius_m``: initial
    matching distance; ``min_inliers``: minimum number of pairs of objects that support a pose; ``gate_sigma``: gate of
    residuals, in standard deviations; ``tilt_sigma_rad``: uncertainty of roll and pitch between the two frames.
    """

    height_sigma_m: float = 0.3
    search_radius_m: float = 3.0
    min_inliers: int = MIN_INLIERS
    gate_sigma: float = 3.0
    tilt_sigma_rad: float = 0.005


def registration_config(config: Config) -> RegistrationConfig:
    """The parameters by the calibration: lengths are fractions of the sensor range."""
    range_m, height_m = config.sensor_range_m, config.calibration.objects.height_sigma_m
    return RegistrationConfig(
        height_sigma_m=0.01 * range_m if height_m is None else height_m,
        search_radius_m=0.1 * range_m,
    )
