"""``python -m tests.supply_chain``: known weaknesses of the dependencies."""

import argparse
import json
import subprocess
import sys
from pathlib import Path

from tests.tools.runs import ROOT


def main() -> int:
    """Exit code 1 if a dependency has a known weakness; 0 where the database cannot be reached, which is said."""
    parser = argparse.ArgumentParser(prog="python -m tests.supply_chain", description=__doc__)
    parser.add_argument("tools", type=Path, help="folder of pip-audit")
    return audit(parser.parse_args().tools)


def audit(tools: Path) -> int:
    """Ask the database of known weaknesses about every version in ``constraints.txt``."""
    command = [str(tools / "pip-audit"), "-r", "constraints.txt", "--no-deps", "--disable-pip", "--format", "json",
               "--timeout", "10", "--progress-spinner", "off"]  # fmt: skip
    try:
        result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120)
        found = json.loads(result.stdout)["dependencies"]
    except (OSError, subprocess.TimeoutExpired, ValueError) as error:
        print(f"audit skipped: no answer from the database of weaknesses ({type(error).__name__})")
        return 0
    weak = [(each["name"], each["version"], weakness) for each in found for weakness in each.get("vulns", ())]
    for name, version, weakness in weak:
        print(f"{name} {version}: {weakness['id']}, mended in {', '.join(weakness['fix_versions']) or 'no version'}")
    unknown = sum("skip_reason" in each for each in found)
    if unknown == len(found):
        print(f"audit skipped: the index that answers knows none of the {unknown} dependencies")
    else:
        print(f"{len(found)} dependencies, {unknown} of them unknown to the database, {len(weak)} known weaknesses")
    return int(bool(weak))


if __name__ == "__main__":
    sys.exit(main())
