"""Command lines of the fuzzer, and the mutated files that they read."""

import gzip
import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam.common.config import Config
from slam.common.config_tree import settings_of
from tests.fuzz.byte_mutations import FLOATS, INTEGERS, TEXTS, mutate_bytes, mutate_text, one_of
from tests.fuzz.log_mutations import mutate_json, mutate_log
from tests.fuzz.mcap_file import Layout, write_file
from tests.fuzz.odd_paths import make_odd_paths, odd_arguments
from tests.fuzz.seeds import WEIGHTS, Seeds
from tests.helpers.forked_commands import write_files

_SETTINGS = [setting.key for setting in settings_of(Config())]
_OUTPUT = re.compile(r"(out|saved)\.\w+")
_FILE = re.compile(r"([?=])([A-Za-z][\w.|]*)(?:@([\w.]+))?")

_COMMANDS: dict[str, tuple[float, str]] = {
    "info": (5, """
        info ?ANY
        info ?ANY --json
        info ?ANY --closures
        info ?ANY --json --closures"""),
    "replay": (6, """
        replay ?drive|ros|json -o out.mcap
        replay ?drive|ros|json -o out.mcap --json
        replay ?drive|ros|json -o out.mcap --save-map saved.mcap"""),
    "map": (2, """
        relocalize =drive --map ?map -o out.mcap
        replay =drive --map ?map -o out.mcap"""),
    "evaluate": (2, """
        evaluate ?mapped
        evaluate ?mapped --json
        evaluate ?mapped --picture out.png"""),
    "export": (1, """
        export ?mapped --tum a.txt --kitti b.txt --g2o c.g2o"""),
    "degrade": (1, """
        degrade ?drive -o out.mcap --fault dropout=0.3
        degrade ?drive -o out.mcap --fault lengths_scaled
        degrade ?drive -o out.mcap --fault false_positives=3
        degrade ?drive -o out.mcap --fault label_confusion=0.2"""),
    "import": (1.5, """
        import csv out.mcap --odometry ?trajectory.tum --detections =detections.csv
        import csv out.mcap --odometry ?trajectory.kitti --times =times.txt --detections =detections.csv
        import csv out.mcap --odometry =trajectory.kitti --times ?times.txt --detections =detections.csv
        import csv out.mcap --odometry =trajectory.tum --detections ?detections.csv
        import csv out.mcap --odometry ?poses.txt --calib ?calib.txt --times =clock.txt --detections ?centroids"""),
    "objects": (1, """
        import map out.mcap --file ?objects.csv|objects.csv|objects.csv.gz
        import map out.mcap --file ?objects.geojson|objects.geojson|objects.geojson.gz
        import map out.mcap --file ?objects.osm|objects.osm|objects.osm.gz"""),
    "bags": (1, """
        info ?bag --json
        replay ?bag -o out.mcap"""),
    "weights": (0.5, f"""
        replay =drive -o out.mcap --set loop_closure.descriptor=?{WEIGHTS.name}"""),
    "toml": (0.5, """
        config --simulation --config ?simulation.toml --json
        config --config ?settings.toml --json"""),
    "maps": (1, """
        info ?map --json
        view ?map --save out.png
        export ?map --csv a.csv
        replay =drive --map ?map -o out.mcap --save-map saved.mcap"""),
    "several": (0.7, """
        sweep ?drive -o sweep --degrade dropout=0.3 --seeds 1 --jobs 1
        evaluate =mapped --reference ?trajectory.tum|trajectory.kitti --json"""),
    # A training itself would take too long: the second map is refused.
    "training": (0.1, """
        train network --maps ?objects.csv|map --maps =none.csv --epochs 1"""),
}  # fmt: skip
"""By family: how frequent it is, and command lines; "?NAME" is that seed with mutations, "=NAME" as it is, of several
names any, and "@FILE" the name under which it is written.
"""


@dataclass(frozen=True)
class Case:
    """One command line in ``folder``; ``outputs`` are the files that it is to write."""

    arguments: list[str]
    folder: Path

    @property
    def outputs(self) -> list[Path]:
        return [self.folder / word for word in self.arguments if _OUTPUT.fullmatch(word)]


def make_case(seeds: Seeds, folder: Path, rng: np.random.Generator) -> Case:
    """A case of any family; logs are the most frequent."""
    family = str(rng.choice(_FAMILIES, p=_WEIGHTS))
    if family in _MAKERS:
        return Case(_MAKERS[family][1](seeds, folder, rng), folder)
    lines = _COMMANDS[family][1].strip().splitlines()
    words = shlex.split(lines[int(rng.integers(len(lines)))])
    return Case([_FILE.sub(lambda found: _written(found, seeds, folder, rng), word) for word in words], folder)


def _written(found: re.Match[str], seeds: Seeds, folder: Path, rng: np.random.Generator) -> str:
    """The name of the file, or of the folder with one altered file, that a word of a command line asks for."""
    names = found[2].replace("ANY", "drive|drive|ros|json|mapped|map|kinds").split("|")
    name = str(rng.choice(names))
    target = found[3] or (f"{name}.mcap" if name in seeds.logs else name)
    inside = [each for each in seeds.files if each.startswith(f"{name}/")]
    altered = str(rng.choice(inside)) if inside else name
    for each in inside or [name]:
        is_intact = found[1] == "=" or each != altered
        content = _intact(each, seeds) if is_intact else _mutated(each, seeds, rng)
        write_files(folder, {each if inside else target: content})
    return target


def _intact(name: str, seeds: Seeds) -> bytes:
    if name == "none.csv":
        return b"x_m,y_m,z_m,class\n"
    return write_file(seeds.logs[name], Layout()) if name in seeds.logs else seeds.files[name]


def _mutated(name: str, seeds: Seeds, rng: np.random.Generator) -> bytes:
    if name == WEIGHTS.name:
        return _mutated_weights(seeds.files[name], rng)
    if name.endswith(".mcap"):
        return mutate_bytes(seeds.files[name], rng)
    if name.endswith(".gz"):
        return mutate_bytes(gzip.compress(_mutated(name.removesuffix(".gz"), seeds, rng)), rng)
    if name not in seeds.logs:
        return mutate_text(seeds.files[name], rng)
    whole = rng.random() < 0.15
    return mutate_bytes(_intact(name, seeds), rng) if whole else mutate_log(seeds.logs[name], rng)


def _mutated_weights(content: bytes, rng: np.random.Generator) -> bytes:
    """Weights (safetensors) with another header, which is JSON after its length, or with other bytes anywhere."""
    if rng.random() < 0.5:
        return mutate_bytes(content, rng)
    size = int.from_bytes(content[:8], "little")
    header = mutate_json(content[8 : 8 + size], rng)
    return len(header).to_bytes(8, "little") + header + content[8 + size :]


def _setting(seeds: Seeds, folder: Path, rng: np.random.Generator) -> list[str]:
    """One setting at a limit, with a drive that is as it should be."""
    (folder / "drive.mcap").write_bytes(_intact("drive", seeds))
    value = str(one_of([*FLOATS, *INTEGERS, "true", "none", *TEXTS[:8], "[" * 3000], rng))
    return ["replay", "drive.mcap", "-o", "out.mcap", "--set", f"{rng.choice(_SETTINGS)}={value}"]


_MAKERS: dict[str, tuple[float, Callable[[Seeds, Path, np.random.Generator], list[str]]]] = {
    "setting": (1.5, _setting),
    "paths": (1.5, lambda seeds, folder, rng: odd_arguments(make_odd_paths(seeds, folder), rng)),
}
"""Families whose files are as they should be."""
_FAMILIES = (*_COMMANDS, *_MAKERS)
_WEIGHTS = np.array([weight for weight, _ in (*_COMMANDS.values(), *_MAKERS.values())])
_WEIGHTS /= _WEIGHTS.sum()
