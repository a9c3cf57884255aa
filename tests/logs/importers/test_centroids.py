from pathlib import Path

import numpy as np
import pytest

from logs.errors import DatasetError
from logs.importers.text_log import read_centroids, read_text_log
from logs.messages import ObjectDetections

FILES = {
    "bow.txt": "1,0,1\n0,1,0\n0,0,0\n",
    "centroids/000000.txt": "1 2 3\n4e0 5 -6.5\n",
    "centroids/000001.txt": "7 8 9\n",
    "centroids/000002.txt": "",
}
STAMPS_NS = np.array([0, 100_000_000, 200_000_000])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "07/centroids").mkdir(parents=True)
    for name, text in FILES.items():
        (tmp_path / "07" / name).write_text(text)
    return tmp_path / "07"


def test_scans_of_drive(folder: Path) -> None:
    poses, times = folder.with_name("poses.txt"), folder.with_name("times.txt")
    poses.write_text("".join(f"1 0 0 {x} 0 1 0 0 0 0 1 0\n" for x in range(3)))
    times.write_text("0.0\n0.1\n0.2\n")
    drive = read_text_log(odometry=poses, detections=folder, times=times)
    scans = [record for record in drive.records() if isinstance(record, ObjectDetections)]
    assert [(scan.stamp_ns, scan.labels) for scan in scans] == [
        (0, ("vehicle", "pole")),
        (100_000_000, ("trunk",)),
        (200_000_000, ()),
    ]
    np.testing.assert_array_equal(scans[0].positions, [[1, 2, 3], [4, 5, -6.5]])
    assert (drive.source["detections"], len(drive.source["detections_sha256"])) == ("07", 64)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("bow.txt", "1,0\n0,1,0\n0,0,0\n", "bow.txt, line 1: 2 values where 3"),
        ("bow.txt", "1,1,1\n0,1,0\n0,0,0\n", r"000000.txt has 2 centroids, but .*bow.txt counts"),
        ("bow.txt", "3,0,-1\n0,1,0\n0,0,0\n", r"000000.txt has 2 centroids, but .*bow.txt counts"),
        ("bow.txt", "1,0,1\n0,1,0\n", "bow.txt counts 2 scans, of 3 poses"),
        ("centroids/000002.txt", "\n1 2 x\n", "000002.txt, line 2, column z: 'x' is not a finite number"),
        ("centroids/000001.txt", None, "000001.txt: cannot be read"),
    ],
)
def test_damage_is_refused(folder: Path, name: str, text: str | None, message: str) -> None:
    (folder / name).unlink() if text is None else (folder / name).write_text(text)
    with pytest.raises(DatasetError, match=message):
        read_centroids(folder, STAMPS_NS)
