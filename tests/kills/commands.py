"""The commands that are killed, each with small inputs, and what they are to leave in their folder."""

from dataclasses import dataclass
from pathlib import Path

from slam.replay import replay
from tests.helpers.short_drives import drive, keep_until, write_log
from tests.logs.importers.text_drives import TextDrive


@dataclass(frozen=True)
class Command:
    """``arguments`` of dslam, run in a folder of its own; ``is_repeatable``: the same bytes each time."""

    name: str
    arguments: tuple[str, ...]
    is_repeatable: bool = True


def make_commands(folder: Path) -> list[Command]:
    """Make the inputs in ``folder``; a training is made small by its number of maps."""
    from descriptors.training import trainer

    trainer.STEPS_PER_EPOCH = 2
    log, other, mapped = folder / "drive.mcap", folder / "other.mcap", folder / "mapped.mcap"
    write_log(log, keep_until(drive(), 4.0))
    write_log(other, keep_until(drive(), 5.0))
    replay(log, mapped)
    text = TextDrive.make(folder)
    tables = [part for role, path in text.files().items() for part in (f"--{role.replace('_', '-')}", str(path))]
    network = ("--epochs", "2", "--threads", "1")
    return [
        Command("replay", ("replay", str(log), "-o", "out.mcap", "--save-map", "map.mcap")),
        Command("evaluate", ("evaluate", str(mapped), "--picture", "map.png")),
        Command("export", ("export", str(mapped), "--tum", "a.txt", "--g2o", "a.g2o", "--csv", "a.csv")),
        Command("import", ("import", "csv", "imported.mcap", *tables)),
        Command("sweep", ("sweep", str(log), "-o", "sweep", "--degrade", "dropout=0.3", "--seeds", "2", "--jobs", "1"),
                is_repeatable=False),
        Command("fleet", ("fleet", "add", "city", str(log), str(other), "--workers", "1")),
        Command("train", ("train", "net", *network), is_repeatable=False),
    ]  # fmt: skip
