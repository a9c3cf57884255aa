import json
from dataclasses import replace

from slam.common.config import Config
from slam.fleet.part import common_metadata
from slam.object_map.map_io import SavedMap
from slam.provenance import recorded_config
from tests.helpers.driven_maps import driven_map, town


def common_sigma_m(saved: SavedMap, sigmas_m: list[float]) -> float:
    estimated = [json.dumps({"objects.landmark_sigma_m": sigma_m}) for sigma_m in sigmas_m]
    maps = [
        replace(saved, metadata={"configuration": Config().model_dump_json(), "estimated": text}) for text in estimated
    ]
    return recorded_config(common_metadata(maps)).calibration.objects.landmark_sigma_m


def test_maps_are_compared_by_the_less_exact_of_them_but_not_by_an_outlier() -> None:
    saved = driven_map(town(), 0.0, 10.0)
    assert common_sigma_m(saved, [0.1, 0.4]) == 0.4
    assert common_sigma_m(saved, [0.2] * 10 + [0.4] * 9 + [9.0]) == 0.4
