"""The commands that are killed, each with small inputs, and what they are to leave in their folder."""

from dataclasses import dataclass
from pathlib import Path

from slam.replay import replay
from tests.helpers.short_drives import drive, keep_until, write_log
from tests.logs.importers.text_drives import TextDrive


@dataclass(frozen=True)
class Command:
    """``line`` of dslam, run in a folder of its own; ``is_repeatable``: the same bytes each time."""

    line: str
    is_repeatable: bool = True

    @property
    def arguments(self) -> list[str]:
        return self.line.split()

    @property
    def name(self) -> str:
        return self.arguments[0]


def make_commands(folder: Path) -> list[Command]:
    """Make the inputs in ``folder``; a training is made small by its number of maps."""
    from descriptors.training import trainer

    trainer.STEPS_PER_EPOCH = 2
    log, other, mapped = folder / "drive.mcap", folder / "other.mcap", folder / "mapped.mcap"
    write_log(log, keep_until(drive(), 4.0))
    write_log(other, keep_until(drive(), 5.0))
    replay(log, mapped)
    tables = (f"--{role.replace('_', '-')} {path}" for role, path in TextDrive.make(folder).files().items())
    return [
        Command(f"replay {log} -o out.mcap --save-map map.mcap"),
        Command(f"evaluate {mapped} --picture map.png"),
        Command(f"export {mapped} --tum a.txt --g2o a.g2o --csv a.csv"),
        Command(f"import csv imported.mcap {' '.join(tables)}"),
        Command(f"sweep {log} -o sweep --degrade dropout=0.3 --seeds 2 --jobs 1", is_repeatable=False),
        Command(f"fleet add city {log} {other} --workers 1"),
        Command("train net --epochs 2 --threads 1", is_repeatable=False),
    ]
