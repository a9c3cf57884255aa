"""The drive that the files of this folder share."""

import pytest

from tests.helpers.surveyed_drives import NOISE, SurveyedDrive


@pytest.fixture(scope="session")
def drive() -> SurveyedDrive:
    """Two minutes without any fault."""
    return SurveyedDrive(0, NOISE, scans=600, objects=80)
