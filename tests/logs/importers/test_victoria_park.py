from __future__ import annotations

import subprocess
import sys
from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from logs.errors import DatasetError
from logs.importers.victoria_park import VictoriaPark, read_victoria_park
from logs.messages import DetectionTruth, ObjectDetections, Odometry

MADE_UP = """ODOMETRY 0 1 2 0 1.5707963267948966 0.0001 0 0 4e-06 0 4e-06
LANDMARK 1 7 3 -1 0.4 0.1 0.3
LANDMARK 1 8 5 0 0.4 0 0.4
ODOMETRY 1 9 1 0 0 0.0001 0 0 4e-06 0 4e-06
LANDMARK 9 7 2 -1 0.4 0 0.4
"""


@pytest.fixture(scope="module")
def park() -> VictoriaPark:
    return read_victoria_park()


def test_made_up_drive_belongs_to_the_right_poses(tmp_path: Path) -> None:
    path = tmp_path / "park.txt"
    path.write_text(MADE_UP)
    drive = read_victoria_park(path)
    np.testing.assert_allclose(drive.T_odom_body[:, :3, 3], [[0, 0, 0], [2, 0, 0], [2, 1, 0]], atol=1e-12)
    assert [[sighting.tree_id for sighting in seen] for seen in drive.sightings] == [[], ["7", "8"], ["7"]]
    # Tree 7 is the same place from both poses.
    for i in (1, 2):
        place = drive.T_odom_body[i] @ np.append(drive.sightings[i][0].position, 1.0)
        np.testing.assert_allclose(place[:3], [3, 3, 0], atol=1e-12)
    np.testing.assert_allclose(
        drive.sightings[1][0].covariance, [[0.4, 0.1, 0.0], [0.1, 0.3, 0.0], [0.0, 0.0, 0.35]], atol=1e-12
    )


def test_records_have_one_rate_and_truth_beside_detections(tmp_path: Path) -> None:
    path = tmp_path / "park.txt"
    path.write_text(MADE_UP)
    records = list(read_victoria_park(path).records())
    kinds = [Odometry, Odometry, ObjectDetections, DetectionTruth, Odometry, ObjectDetections, DetectionTruth]
    assert [type(record) for record in records] == kinds
    assert [record.stamp_ns for record in records] == [0, *[200_000_000] * 3, *[400_000_000] * 3]
    assert isinstance(records[3], DetectionTruth)
    assert records[3].object_ids == ("7", "8")


def test_bundled_file_has_the_known_numbers(park: VictoriaPark) -> None:
    assert len(park.T_odom_body) == 6969
    assert sum(len(seen) for seen in park.sightings) == 3640
    assert len({sighting.tree_id for seen in park.sightings for sighting in seen}) == 151
    steps_m = np.linalg.norm(np.diff(park.T_odom_body[:, :3, 3], axis=0), axis=1)
    assert steps_m.sum() == pytest.approx(4027, abs=1)
    assert np.all(park.T_odom_body[:, 2, 3] == 0.0)


def test_trees_stay_where_they_are_while_they_are_passed(park: VictoriaPark) -> None:
    assert np.median(_jumps_m(park, park.T_odom_body)) < 0.12


def _jumps_m(park: VictoriaPark, T_odom_body: np.ndarray) -> np.ndarray:
    """How far each tree seems to move between sightings that are at most ten poses apart."""
    places: dict[str, list[tuple[int, np.ndarray]]] = defaultdict(list)
    for i, seen in enumerate(park.sightings):
        for sighting in seen:
            place = T_odom_body[i] @ np.append(sighting.position, 1.0)
            places[sighting.tree_id].append((i, place[:3]))
    return np.array(
        [
            np.linalg.norm(there - here)
            for seen in places.values()
            for (i, here), (j, there) in pairwise(seen)
            if j - i <= 10
        ]
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("VERTEX 0 1 2\n", "line 1: 'VERTEX' is neither"),
        ("ODOMETRY 0 1 2 0 0 1 0 0 1 0\n", "line 1: 10 values where 11"),
        ("ODOMETRY 0 1 2 0 x 1 0 0 1 0 1\n", "line 1: 'x' is not a finite number"),
        ("ODOMETRY 0 1.5 2 0 0 1 0 0 1 0 1\n", "line 1: '1.5' is not the number"),
        (f"ODOMETRY 0 {'9' * 5000} 2 0 0 1 0 0 1 0 1\n", "line 1: '9+' is not a finite"),
        (f"ODOMETRY 0 {'9' * 300} 2 0 0 1 0 0 1 0 1\n", "line 1: '9+' is not the number"),
        ("ODOMETRY 0 1 2 0 0 1 0 0 1 0 1\nLANDMARK 0 5 1 1 1 0 1\n", "line 2: LANDMARK from pose 0, .* at pose 1"),
        ("ODOMETRY 0 1 2 0 0 1 0 0 1 0 1\nODOMETRY 2 3 2 0 0 1 0 0 1 0 1\n", "line 2: ODOMETRY from pose 2"),
        ("ODOMETRY 0 1 2 0 0 1 0 0 1 0 1\nLANDMARK 1 5 1 1 1 2 1\n", "line 2: covariance .* not positive definite"),
        ("", "no ODOMETRY line"),
    ],
)
def test_damage_is_refused_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "park.txt"
    path.write_text(text)
    with pytest.raises(DatasetError, match=message):
        read_victoria_park(path)


def test_gtsam_is_found_but_not_imported() -> None:
    code = (
        "import sys; from logs.importers.victoria_park import bundled_victoria_park; "
        "bundled_victoria_park(); sys.exit('gtsam' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
