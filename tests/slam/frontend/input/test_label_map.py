"""Renaming, merging and dropping classes."""

import numpy as np
import pytest

from logs.messages import ObjectDetections
from slam.common.calibration import DetectionCalibration
from slam.common.config import LabelsConfig
from slam.common.errors import ConfigurationError
from slam.frontend.input.label_map import DROPPED, LabelMap
from slam.frontend.input.scan import is_wanted
from tests.helpers.landmarks import detections_of

NAMES = ("car", "van", "person", "pole_1", "tree")


def detections(labels: tuple[str, ...] = NAMES) -> ObjectDetections:
    return detections_of(np.eye(len(labels), 3), labels)


def test_classes_are_renamed_merged_and_dropped() -> None:
    config = LabelsConfig(rename={"pole_*": "pole", "car": "vehicle", "van": "vehicle"}, drop=("person",))
    renamed = LabelMap(config).apply(detections())
    assert renamed.labels == ("vehicle", "vehicle", DROPPED, "pole", "tree")
    assert is_wanted(renamed, DetectionCalibration()).tolist() == [True, True, False, True, True]


def test_names_that_differ_in_case_only_are_one_class() -> None:
    labels = LabelMap(LabelsConfig(rename={"pole_*": "Pole"}))
    assert labels.apply(detections(("Car", "car", "CAR", "pole_1", "pole", "tree"))).labels == (
        *("Car", "Car", "Car", "Pole", "Pole", "tree"),
    )
    assert [note for note in labels.notes() if "case only" in note] == [
        f"class {name} is read as {to}: they differ in case only"
        for name, to in (("car", "Car"), ("CAR", "Car"), ("pole", "Pole"))
    ]


def test_names_that_no_detection_has_are_told() -> None:
    labels = LabelMap(LabelsConfig(rename={"cars": "car", "van": "vehicle", "bus": "vehicle"}, drop=("person", "dog*")))
    labels.apply(detections())
    unused = ("labels.drop: dog*", "labels.rename: cars", "labels.rename: bus")
    assert labels.notes() == [f"{setting}: no detection has this class" for setting in unused]


def test_a_name_in_two_settings_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="'car' is both in drop and in rename"):
        LabelMap(LabelsConfig(rename={"car": "vehicle"}, drop=("car",)))
