"""Command lines on data sets of others: clouds, archives of centroids, Victoria Park, and trainings that go on."""

from __future__ import annotations

import io
import tarfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.byte_mutations import mutate_bytes, mutate_text
from tests.fuzz.cloud_mutations import mutate_pcd, mutate_ply, write_sequence
from tests.fuzz.training_mutations import mutate_checkpoint

NETWORKS = {"towers": "descriptellation", "network": "descriptellation_paper"}
"""Whose checkpoints are altered, by the name of the folder."""
_PARK = b"""ODOMETRY 0 1 2 0 1.5707963267948966 0.0001 0 0 4e-06 0 4e-06
LANDMARK 1 7 3 -1 0.4 0.1 0.3
LANDMARK 1 8 5 0 0.4 0 0.4
ODOMETRY 1 9 1 0 0 0.0001 0 0 4e-06 0 4e-06
LANDMARK 9 7 2 -1 0.4 0 0.4
"""
_OBJECTS = {
    "objects/07/bow.txt": b"1,0,1\n0,1,0\n0,0,0\n",
    "objects/07/centroids/000000.txt": b"1 2 3\n4e0 5 -6.5\n",
    "objects/07/centroids/000001.txt": b"7 8 9\n",
    "objects/07/centroids/000002.txt": b"",
    "poses.txt": b"".join(b"1 0 0 0 0 1 0 0 0 0 1 %d\n" % z for z in range(3)),
    "calib.txt": b"P0: 0 0 0 0 0 0 0 0 0 0 0 0\nTr: 0 -1 0 0.1 0 0 -1 0.2 1 0 0 -0.3\n",
    "times.txt": b"0.000000e+00\n1.037359e-01\n4.705816123456789e+02\n",
}


def make_trainings_small() -> None:
    """Let every training of this process be one of a few constellations: its configuration is not what is tried."""
    from descriptors.descriptellation import training as networks
    from descriptors.descriptellation.dataset import DatasetConfig
    from descriptors.towers import training as towers

    small: Any = partial(networks.TrainingConfig, dataset=DatasetConfig(anchors=6, positives=2))
    networks.TrainingConfig = small  # type: ignore[misc]
    of_towers: Any = partial(towers.TowersTraining, validation_maps=1)
    towers.TowersTraining = of_towers  # type: ignore[misc]
    towers.STEPS_PER_EPOCH = 1


def training_arguments(folder: str) -> list[str]:
    return ["train", folder, "--network", NETWORKS[folder], "--epochs", "1", "--threads", "1", "--json"]


def cloud_arguments(folder: Path, rng: np.random.Generator) -> list[str]:
    """A labelled cloud, or a sequence of scans, that is altered."""
    named = [[], ["--name", "80=pole"], ["--name", "80=pole", "--name", "81=trunk"]][int(rng.integers(3))]
    match int(rng.integers(5)):
        case 0:
            (folder / "cloud.pcd").write_bytes(mutate_pcd(rng))
            return ["import", "pcd", "out.mcap", "--file", "cloud.pcd", *named]
        case 1 | 2:
            (folder / "cloud.ply").write_bytes(mutate_ply(rng))
            command = str(rng.choice(["ply", "paris-lille", "iqmulus"]))
            return ["import", command, "out.mcap", "--file", "cloud.ply", *(named if command == "ply" else [])]
        case _:
            write_sequence(folder, rng)
            return ["import", "semantic-kitti", "out.mcap", "--sequence", ".", "--odometry", "poses.txt"]


def dataset_arguments(folder: Path, rng: np.random.Generator) -> list[str]:
    """Victoria Park, or a sequence of KITTI with centroids in a folder or an archive, of which one file is altered."""
    if rng.random() < 0.3:
        (folder / "park.txt").write_bytes(mutate_text(_PARK, rng))
        return ["import", "victoria-park", "out.mcap", "--file", "park.txt"]
    files = dict(_OBJECTS)
    name = str(rng.choice(list(files)))
    files[name] = mutate_text(files[name], rng)
    given = "objects"
    if rng.random() < 0.5:
        given = str(rng.choice(["objects.tar", "objects.tar.gz", "objects.tar.xz"]))
        content = _packed({each: files[each] for each in files if each.startswith("objects/")}, given.split(".")[-1])
        (folder / given).write_bytes(mutate_bytes(content, rng) if rng.random() < 0.5 else content)
    for each, content in files.items():
        (folder / each).parent.mkdir(parents=True, exist_ok=True)
        (folder / each).write_bytes(content)
    given_files = ["--odometry", "poses.txt", "--calib", "calib.txt", "--times", "times.txt"]
    return ["import", "kitti-objects", "out.mcap", "--detections", given, *given_files]


def checkpoint_arguments(trainings: dict[str, bytes], folder: Path, rng: np.random.Generator) -> list[str]:
    """A training that is to go on from a checkpoint that is altered."""
    name = str(rng.choice(list(trainings)))
    (folder / name).mkdir()
    (folder / name / "checkpoint.pt").write_bytes(mutate_checkpoint(trainings[name], rng))
    return training_arguments(name)


def _packed(files: dict[str, bytes], kind: str) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:" + kind.removeprefix("tar")) as archive:  # type: ignore[call-overload]
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return out.getvalue()
