"""Command lines on data of others: clouds, folders of centroids, and bags."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.fuzz.byte_mutations import mutate_bytes, mutate_text
from tests.fuzz.cloud_mutations import mutate_ply

_OBJECTS = {
    "objects/07/bow.txt": b"1,0,1\n0,1,0\n0,0,0\n",
    "objects/07/centroids/000000.txt": b"1 2 3\n4e0 5 -6.5\n",
    "objects/07/centroids/000001.txt": b"7 8 9\n",
    "objects/07/centroids/000002.txt": b"",
    "poses.txt": b"".join(b"1 0 0 0 0 1 0 0 0 0 1 %d\n" % z for z in range(3)),
    "calib.txt": b"P0: 0 0 0 0 0 0 0 0 0 0 0 0\nTr: 0 -1 0 0.1 0 0 -1 0.2 1 0 0 -0.3\n",
    "times.txt": b"0.000000e+00\n1.037359e-01\n2.05816123456789e-01\n",
}


def cloud_arguments(folder: Path, rng: np.random.Generator) -> list[str]:
    """A labelled cloud that is altered."""
    named = [[], ["--name", "80=pole"], ["--name", "80=pole", "--name", "81=trunk"]][int(rng.integers(3))]
    (folder / "cloud.ply").write_bytes(mutate_ply(rng))
    return ["import", "map", "out.mcap", "--file", "cloud.ply", *named]


def dataset_arguments(folder: Path, rng: np.random.Generator) -> list[str]:
    """A sequence of KITTI with centroids, of which one file is altered."""
    files = dict(_OBJECTS)
    name = str(rng.choice(list(files)))
    files[name] = mutate_text(files[name], rng)
    for each, content in files.items():
        (folder / each).parent.mkdir(parents=True, exist_ok=True)
        (folder / each).write_bytes(content)
    given_files = ["--odometry", "poses.txt", "--calib", "calib.txt", "--times", "times.txt"]
    return ["import", "csv", "out.mcap", "--detections", "objects/07", *given_files]


def write_bag_of(files: dict[str, bytes], folder: Path, rng: np.random.Generator) -> str:
    """A recording of rosbag2 with its description or its file altered; its name."""
    bag = folder / "bag"
    bag.mkdir()
    altered = str(rng.choice(sorted(files)))
    mutate = mutate_text if altered == "metadata.yaml" else mutate_bytes
    for name, content in files.items():
        (bag / name).write_bytes(mutate(content, rng) if name == altered else content)
    return "bag"
