from __future__ import annotations

import json

import pytest

from slam.common.config import Config
from slam.common.errors import SavedMapError
from slam.fleet.session_config import common_config
from slam.provenance import recorded_config


def metadata(sigma_m: float) -> dict[str, str]:
    return {
        "configuration": Config().model_dump_json(),
        "estimated": json.dumps({"objects.landmark_sigma_m": sigma_m, "detection.sensor_range_m": 60.0}),
    }


def test_what_was_estimated_from_the_log_is_in_force() -> None:
    config = recorded_config(metadata(0.2))
    assert (config.calibration.objects.landmark_sigma_m, config.sensor_range_m) == (0.2, 60.0)


def test_maps_are_compared_by_the_less_exact_of_them_but_not_by_an_outlier() -> None:
    assert common_config([metadata(0.1), metadata(0.4)]).calibration.objects.landmark_sigma_m == 0.4
    sigmas = [0.2] * 10 + [0.4] * 9 + [9.0]
    assert common_config(map(metadata, sigmas)).calibration.objects.landmark_sigma_m == 0.4


def test_metadata_of_another_version_are_refused_with_the_remedy() -> None:
    with pytest.raises(SavedMapError, match="again"):
        recorded_config({"configuration": "{", "estimated": "{}"})
