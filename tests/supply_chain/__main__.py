"""``python -m tests.supply_chain``: known weaknesses of the dependencies, and a list of them for the wheel."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

from packaging.utils import canonicalize_name

from tests.supply_chain.dependencies import PROJECT, find_dependencies
from tests.tools.runs import ROOT


def main() -> int:
    """Exit code 1 if a dependency has a known weakness; 0 where the database cannot be reached, which is said."""
    parser = argparse.ArgumentParser(prog="python -m tests.supply_chain", description=__doc__)
    parser.add_argument("tools", type=Path, help="folder of pip-audit and cyclonedx-py")
    parser.add_argument("--sbom", type=Path, help="write the list to this file, CycloneDX as JSON, instead")
    options = parser.parse_args()
    return write_sbom(options.tools, options.sbom) if options.sbom else audit(options.tools)


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


def write_sbom(tools: Path, path: Path) -> int:
    """List what the wheel needs, with versions and licences, as installed here."""
    command = [str(tools / "cyclonedx-py"), "environment", "--pyproject", "pyproject.toml", "--of", "JSON",
               "--output-reproducible", sys.executable]  # fmt: skip
    told = json.loads(subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout)
    needed = {canonicalize_name(name) for name in (PROJECT, *find_dependencies(extras=()))}
    told["components"] = [each for each in told["components"] if canonicalize_name(each["name"]) in needed]
    root = told.get("metadata", {}).get("component", {}).get("bom-ref")
    kept = {each["bom-ref"] for each in told["components"]} | {root}
    told["dependencies"] = [
        {**each, "dependsOn": [ref for ref in each.get("dependsOn", ()) if ref in kept]}
        for each in told["dependencies"]
        if each["ref"] in kept
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    print(f"{path}: {len(told['components'])} components")
    return 0


if __name__ == "__main__":
    sys.exit(main())
