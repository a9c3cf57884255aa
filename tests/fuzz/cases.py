"""What is run on what: command lines, and the mutated files that they read."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import zstandard

from slam.common.config import Config
from slam.common.config_tree import settings_of
from tests.fuzz.byte_mutations import FLOATS, INTEGERS, TEXTS, mutate_bytes, mutate_text
from tests.fuzz.dataset_cases import checkpoint_arguments, cloud_arguments, dataset_arguments, write_bag_of
from tests.fuzz.log_mutations import mutate_log
from tests.fuzz.mcap_file import Layout, write_file
from tests.fuzz.odd_paths import make_odd_paths, odd_arguments
from tests.fuzz.seeds import WEIGHTS, Seeds
from tests.fuzz.training_mutations import mutate_weights

_SETTINGS = [setting.key for setting in settings_of(Config())]


@dataclass(frozen=True)
class Case:
    """One command line in ``folder``; ``outputs`` are the files that it is to write."""

    arguments: list[str]
    outputs: list[Path] = field(default_factory=list)


def make_case(seeds: Seeds, folder: Path, rng: np.random.Generator, family: str = "") -> Case:
    """A case of ``family``, or of any, in which logs are the most frequent."""
    family = family or str(rng.choice(list(_FAMILIES), p=_WEIGHTS))
    return _FAMILIES[family][0](seeds, folder, rng)


def _log(seeds: Seeds, folder: Path, rng: np.random.Generator, name: str = "") -> str:
    name = name or str(rng.choice(["drive", "drive", "ros", "json", "mapped", "map", "kinds"]))
    path = folder / f"{name}.mcap"
    if rng.random() < 0.15:
        path.write_bytes(mutate_bytes(write_file(seeds.logs[name], Layout()), rng))
    else:
        path.write_bytes(mutate_log(seeds.logs[name], rng))
    if rng.random() < 0.03:
        path.write_bytes(mutate_bytes(zstandard.compress(path.read_bytes()), rng))
    return path.name


def _intact(seeds: Seeds, folder: Path, name: str) -> str:
    path = folder / f"{name}.mcap"
    path.write_bytes(write_file(seeds.logs[name], Layout()))
    return path.name


def _text(seeds: Seeds, folder: Path, rng: np.random.Generator, name: str) -> str:
    (folder / name).write_bytes(mutate_text(seeds.files[name], rng))
    return name


def _info(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    more = [[], ["--json"], ["--closures"], ["--json", "--all"]][int(rng.integers(4))]
    return Case(["info", _log(seeds, folder, rng), *more])


def _replay(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    more = [[], ["--json"], ["--save-map", "saved.mcap"]][int(rng.integers(3))]
    name = str(rng.choice(["drive", "ros", "json"]))
    outputs = [folder / "out.mcap", *([folder / "saved.mcap"] if "--save-map" in more else [])]
    return Case(["replay", _log(seeds, folder, rng, name), "-o", "out.mcap", *more], outputs)


def _map(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    command = [["relocalize"], ["replay"]][int(rng.integers(2))]
    given = _log(seeds, folder, rng, "map")
    return Case([*command, _intact(seeds, folder, "drive"), "--map", given, "-o", "out.mcap"])


def _evaluate(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    more = [[], ["--json"], ["--html", "out.html"], ["--picture", "out.png"]][int(rng.integers(4))]
    outputs = [folder / more[1]] if len(more) == 2 else []
    return Case(["evaluate", _log(seeds, folder, rng, "mapped"), *more], outputs)


def _export(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    log = _log(seeds, folder, rng, "mapped")
    return Case(["export", log, "--tum", "a.txt", "--kitti", "b.txt", "--g2o", "c.g2o"])


def _degrade(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    choice = [["--dropout", "0.3"], ["--reversed"], ["--false-positives", "3"], ["--label-confusion", "0.2"]]
    more = choice[int(rng.integers(len(choice)))]
    return Case(["degrade", _log(seeds, folder, rng, "drive"), "-o", "out.mcap", *more], [folder / "out.mcap"])


def _optimize(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    return Case(["optimize", _text(seeds, folder, rng, "graph.g2o"), "-o", "out.g2o", "--json"])


def _import(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    poses = str(rng.choice(["trajectory.tum", "trajectory.kitti"]))
    for name in (poses, "detections.csv"):
        (folder / name).write_bytes(seeds.files[name])
    _text(seeds, folder, rng, str(rng.choice([poses, "detections.csv"])))
    return Case(
        ["import", "csv", "out.mcap", "--odometry", poses, "--detections", "detections.csv"], [folder / "out.mcap"]
    )


def _objects(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    """A map of the objects in a file of others."""
    command, name = {0: ("csv-map", "objects.csv"), 1: ("geojson", "objects.geojson"), 2: ("osm", "objects.osm")}[
        int(rng.integers(3))
    ]
    given = ["--file", _text(seeds, folder, rng, name)]
    if rng.random() < 0.1:
        packed = folder / f"{name}.gz"
        packed.write_bytes(mutate_bytes(gzip.compress((folder / name).read_bytes()), rng))
        given = ["--file", packed.name]
    return Case(["import", command, "out.mcap", *given], [folder / "out.mcap"])


def _weights(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    """A drive that is as it should be, and weights of a network that are not."""
    (folder / WEIGHTS.name).write_bytes(mutate_weights(seeds.files[WEIGHTS.name], rng))
    given = ["--set", f"loop_closure.descriptor={WEIGHTS.name}"]
    return Case(["replay", _intact(seeds, folder, "drive"), "-o", "out.mcap", *given], [folder / "out.mcap"])


def _maps(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    """A saved map that is looked into, cut, or joined to one that is as it should be."""
    given = _log(seeds, folder, rng, "map")
    match int(rng.integers(4)):
        case 0:
            return Case(["map", "info", given, "--json"])
        case 1:
            area = [["--circle", "0,0,20"], ["--box", "-9,-9,9,9"], ["--polygon", "0,0 9,0 9,9"]][int(rng.integers(3))]
            return Case(["map", "crop", given, "-o", "out.mcap", *area], [folder / "out.mcap"])
        case 2:
            return Case(["view", given, "--save", "out.rrd"])
        case _:
            (folder / "other.mcap").write_bytes(write_file(seeds.logs["map"], Layout()))
            names = ["other.mcap", given][:: int(rng.choice([1, -1]))]
            return Case(["map", "merge", *names, "-o", "out.mcap"], [folder / "out.mcap"])


def _several(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    """Commands that take several logs, or map one several times."""
    match int(rng.integers(3)):
        case 0:
            (folder / "other.mcap").write_bytes(write_file(seeds.logs["mapped"], Layout()))
            names = ["other.mcap", _log(seeds, folder, rng, "mapped")]
            more = [["--json"], ["--table", "out.html"], ["--table", "out.tex"]][int(rng.integers(3))]
            return Case(["compare", *names, *more])
        case 1:
            degrade = ["--degrade", "dropout=0.3", "--seeds", "1", "--jobs", "1"]
            return Case(["sweep", _log(seeds, folder, rng, "drive"), "-o", "sweep", *degrade])
        case _:
            reference = _text(seeds, folder, rng, str(rng.choice(["trajectory.tum", "trajectory.kitti"])))
            return Case(["evaluate", _intact(seeds, folder, "mapped"), "--reference", reference, "--json"])


def _training(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    """A map of one's own to train on; a training itself would take too long."""
    given = _text(seeds, folder, rng, "objects.csv") if rng.random() < 0.5 else _log(seeds, folder, rng, "map")
    (folder / "none.csv").write_bytes(b"x_m,y_m,z_m,class\n")
    return Case(["train", "network", "--maps", given, "--maps", "none.csv", "--epochs", "1"])


def _checkpoints(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    return Case(checkpoint_arguments(seeds.trainings, folder, rng))


def _clouds(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    return Case(cloud_arguments(folder, rng), [folder / "out.mcap"])


def _datasets(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    return Case(dataset_arguments(folder, rng), [folder / "out.mcap"])


def _bags(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    given = write_bag_of(seeds.bag, folder, rng)
    if rng.random() < 0.5:
        return Case(["info", given, "--json"])
    return Case(["replay", given, "-o", "out.mcap"], [folder / "out.mcap"])


def _paths(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    return Case(odd_arguments(make_odd_paths(seeds, folder), rng))


def _toml(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    if rng.random() < 0.3:
        return Case(["config", "--simulation", "--config", _text(seeds, folder, rng, "simulation.toml"), "--json"])
    return Case(["config", "--config", _text(seeds, folder, rng, "settings.toml"), "--json"])


def _setting(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    """One setting at a limit, with a drive that is as it should be."""
    key = str(rng.choice(_SETTINGS))
    value = str(rng.choice(np.array([*FLOATS, *INTEGERS, "true", "none", *TEXTS[:8], "[" * 3000], dtype=object)))
    arguments = ["replay", _intact(seeds, folder, "drive"), "-o", "out.mcap", "--set", f"{key}={value}"]
    return Case(arguments, [folder / "out.mcap"])


_FAMILIES: dict[str, tuple[Callable[[Seeds, Path, np.random.Generator], Case], float]] = {
    "info": (_info, 5),
    "replay": (_replay, 6),
    "map": (_map, 2),
    "evaluate": (_evaluate, 2),
    "export": (_export, 1),
    "degrade": (_degrade, 1),
    "optimize": (_optimize, 1),
    "import": (_import, 1.5),
    "objects": (_objects, 1),
    "weights": (_weights, 0.5),
    "toml": (_toml, 0.5),
    "setting": (_setting, 1.5),
    "maps": (_maps, 1),
    "several": (_several, 0.7),
    "training": (_training, 0.1),
    "checkpoints": (_checkpoints, 0.7),
    "clouds": (_clouds, 1.5),
    "datasets": (_datasets, 0.7),
    "bags": (_bags, 1),
    "paths": (_paths, 1.5),
}
FAMILIES = tuple(_FAMILIES)
_WEIGHTS = np.array([weight for _, weight in _FAMILIES.values()]) / sum(w for _, w in _FAMILIES.values())
