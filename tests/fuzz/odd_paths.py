"""Command lines in which one name is missing, no file, or a file of another kind."""

import os
from pathlib import Path

import numpy as np

from tests.fuzz.byte_mutations import one_of
from tests.fuzz.mcap_file import Layout, write_file
from tests.fuzz.seeds import Seeds
from tests.helpers.forked_commands import write_files

_NAMES = ("", ".", "..", "no/such", "drive.mcap/x", "x" * 300, "a\0b", "/dev/null", "/dev/zero", "http://localhost:1/x",
          "-", "a\nb", "\x1b[2J", "[red]", "\udcff")  # fmt: skip
_ODD = "ODD"
_READING = """
info ODD
replay ODD -o out.mcap
replay drive.mcap -o out.mcap --map ODD
replay drive.mcap -o out.mcap --config ODD
replay drive.mcap -o out.mcap --set loop_closure.descriptor=ODD
relocalize drive.mcap -o out.mcap --map ODD
evaluate ODD
evaluate mapped.mcap --reference ODD
evaluate mapped.mcap --reference trajectory.kitti --calib ODD
export ODD --tum out.txt
degrade ODD -o out.mcap --fault dropout=0.1
import csv out.mcap --odometry ODD --detections detections.csv
import csv out.mcap --odometry trajectory.tum --detections ODD
import map out.mcap --file ODD
import csv out.mcap --detections ODD --odometry trajectory.kitti --calib ODD --times ODD
simulate out.mcap --config ODD
simulate out.mcap --objects ODD --trajectory ODD
config --config ODD
fleet add fleet ODD
sweep ODD -o sweep
""".strip().splitlines()
_WRITING = """
replay drive.mcap -o ODD
replay drive.mcap -o out.mcap --save-map ODD
replay drive.mcap -o out.mcap --picture ODD
evaluate mapped.mcap --picture ODD
export mapped.mcap --tum ODD
export mapped.mcap --csv ODD
degrade drive.mcap --fault dropout=0.1 -o ODD
import csv ODD --odometry trajectory.tum --detections detections.csv
""".strip().splitlines()


def make_odd_paths(seeds: Seeds, folder: Path) -> list[str]:
    """Put all seeds, and what is no file, into ``folder``; returns their names and those of nothing."""
    write_files(folder, {f"{name}.mcap": write_file(log, Layout()) for name, log in seeds.logs.items()} | seeds.files)
    (folder / "folder").mkdir()
    (folder / "loop").symlink_to("loop")
    (folder / "dangling").symlink_to("nowhere")
    (folder / "empty").touch()
    os.mkfifo(folder / "pipe")
    return [*(path.name for path in sorted(folder.iterdir())), *_NAMES]


def odd_arguments(names: list[str], rng: np.random.Generator) -> list[str]:
    """A command line that reads or writes one of ``names``; devices are not written to."""
    odd = str(one_of(names, rng))
    commands = _READING if odd.startswith("/") or rng.random() < 0.7 else _WRITING
    words = commands[int(rng.integers(len(commands)))].split()
    return [word.replace(_ODD, odd) for word in words]
