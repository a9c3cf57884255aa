"""The protocol: its lengths go with the sensor range of a run."""

import json
from dataclasses import asdict

import pytest

from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords


def test_for_range_scales_only_lengths():
    assert Protocol().for_range(30.0) == Protocol()
    small = asdict(Protocol().for_range(7.5))
    for name, value in asdict(Protocol()).items():
        assert small[name] == (0.25 * value if name.endswith("_m") else value)


@pytest.mark.parametrize(
    ("estimated", "given", "expected"),
    [
        ('{"detection.sensor_range_m": 7.5}', 30.0, 7.5),
        ("{}", 60.0, 60.0),
        ("", None, None),
        ('{"detection.sensor_range_m": "far"}', 60.0, None),
        ('{"detection.sensor_range_m": -1.0}', 60.0, None),
    ],
)
def test_sensor_range_is_estimated_or_given(estimated, given, expected):
    detection = {} if given is None else {"sensor_range_m": given}
    made = {"configuration": json.dumps({"calibration": {"detection": detection}}), "estimated": estimated}
    records = EvaluationRecords(provenance=made)
    assert records.sensor_range_m == expected
    revisit_m = 100.0 if expected is None else expected / 30.0 * 100.0
    assert evaluate(records).results["protocol"]["revisit_m"] == pytest.approx(revisit_m)
