"""The distributions that this one needs, as installed, and their licences."""

import re
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = "descriptellation-slam"
EXTRAS = ("learn", "live", "osm", "docs")
"""What users install; the tools of developers are not passed on."""
_COPYLEFT = re.compile(r"\bA?GPL|General Public License", re.IGNORECASE)
_WEAK = re.compile(r"\bLGPL|Lesser General Public|with GCC|-exception", re.IGNORECASE)


def find_dependencies(name: str = PROJECT, extras: tuple[str, ...] = EXTRAS) -> dict[str, Distribution]:
    """All distributions that ``name`` with its extras leads to, by name; those not installed are left out."""
    found: dict[str, Distribution] = {}
    waiting = [(name, extras)]
    seen = set()
    while waiting:
        name, extras = waiting.pop()
        if (name, extras) in seen:
            continue
        seen.add((name, extras))
        try:
            found[name] = distribution(name)
        except PackageNotFoundError:
            continue
        for text in found[name].requires or ():
            requirement = Requirement(text)
            environments = [{"extra": extra} for extra in ("", *extras)]
            if requirement.marker is None or any(requirement.marker.evaluate(each) for each in environments):
                waiting.append((canonicalize_name(requirement.name), tuple(sorted(requirement.extras))))
    found.pop(PROJECT, None)
    return dict(sorted(found.items()))


def licence_of(found: Distribution) -> str:
    """What a distribution says of its licence: its expression, its classifiers or its text."""

    def told(key: str) -> list[str]:
        return found.metadata.get_all(key) or []

    classifiers = [text.split(" :: ")[-1] for text in told("Classifier") if text.startswith("License ::")]
    return "; ".join(told("License-Expression") or classifiers) or "".join(told("License")).strip()[:200]


def is_permitted(licence: str) -> bool:
    """Whether a library with that licence may be imported: no GPL; a choice of which one part is permitted may."""
    if not licence:
        return False
    choices = re.split(r"\s+OR\s+", licence)
    return any(not _COPYLEFT.search(choice) or bool(_WEAK.search(choice)) for choice in choices)
