import json

import pytest

from slam.common.config import Config
from slam.common.errors import SavedMapError
from slam.provenance import recorded_config


def test_what_was_estimated_from_the_log_is_in_force() -> None:
    estimated = json.dumps({"objects.landmark_sigma_m": 0.2, "detection.sensor_range_m": 60.0})
    config = recorded_config({"configuration": Config().model_dump_json(), "estimated": estimated})
    assert (config.calibration.objects.landmark_sigma_m, config.sensor_range_m) == (0.2, 60.0)


def test_metadata_of_another_version_are_refused_with_the_remedy() -> None:
    with pytest.raises(SavedMapError, match="again"):
        recorded_config({"configuration": "{", "estimated": "{}"})
