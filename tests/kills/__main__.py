"""``python -m tests.kills``: kill commands with SIGKILL at random times and give them again."""

import argparse
import os
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from tests.helpers.forked_commands import SCRATCH, import_commands
from tests.kills.commands import make_commands
from tests.kills.trial import kill_and_repeat, run_whole


def main() -> int:
    """Exit code 1 if a file was lost or half there, or a command needed help."""
    parser = argparse.ArgumentParser(prog="python -m tests.kills", description=__doc__)
    parser.add_argument("--count", type=int, default=200, help="kills before the end of a command")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="commands whose name contains this")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    import_commands()
    with tempfile.TemporaryDirectory(prefix="kills-", dir=SCRATCH) as name:
        return _kill(Path(name), options.count, options.only, rng)


def _kill(folder: Path, count: int, only: str, rng: np.random.Generator) -> int:
    commands = [each for each in make_commands(folder) if only in each.name]
    whole = {each.name: run_whole(each, folder / f"whole-{each.name}") for each in commands}
    shortest_s = {name: reference.seconds for name, reference in whole.items()}
    killed: Counter[str] = Counter()
    runs = faults = 0
    while killed.total() < count:
        command = commands[runs % len(commands)]
        seconds = float(rng.uniform(0.0, shortest_s[command.name]))
        trial = kill_and_repeat(command, folder / "trial", seconds, whole[command.name], is_new=bool(rng.integers(2)))
        shortest_s[command.name] = min(shortest_s[command.name], trial.seconds)
        runs += 1
        killed[command.name] += trial.was_killed
        faults += bool(trial.wrong)
        for each in trial.wrong:
            print(f"{runs}: {command.name} after {seconds:.2f} s: {each}", flush=True)
        if runs % 20 == 0:
            print(f"{runs} runs, {killed.total()} killed before their end", flush=True)
    print(f"{runs} runs, {killed.total()} killed before their end {dict(killed)}: {faults} with a fault")
    return int(faults > 0)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
