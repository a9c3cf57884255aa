"""Class numbers of published labelled clouds, and which of them are objects that stand still."""

from __future__ import annotations

from collections.abc import Mapping

SEMANTIC_KITTI_OBJECTS: Mapping[int, str] = {
    10: "car",
    11: "bicycle",
    13: "bus",
    15: "motorcycle",
    16: "on-rails",
    18: "truck",
    20: "other-vehicle",
    71: "trunk",
    80: "pole",
    81: "traffic-sign",
}
"""Classes of SemanticKITTI (Behley et al., ICCV 2019) that are objects; moving ones (252 to 259) and people are not."""

_PUNCTUAL = (
    "post",
    "bollard",
    "floor lamp",
    "traffic light",
    "traffic sign",
    "signboard",
    "mailbox",
    "trash can",
    "meter",
    "bicycle terminal",
    "bicycle rack",
    "statue",
)
_LINEAR = ("barrier", "roasting", "grid", "chain", "wire", "low wall")
_EXTENDED = ("shelter", "kiosk", "scaffold", "bench", "distribution box", "lighting console", "windmill")
_NATURAL = ("tree", "bush", "potted plant", "hedge")

BOLLARD = 302_020_300
UNKNOWN = (0, 100_000_000, 300_000_000, 301_000_000)
_SURFACES, _OBJECTS, _DYNAMIC = 2, 3, 303


def _numbered(base: int, step: int, names: tuple[str, ...]) -> dict[int, str]:
    """The names from 2 on: the first of each group is what is of no other kind."""
    return {base + step * i: name for i, name in enumerate(names, start=2)}


URBAN_CLASSES: Mapping[int, str] = {
    **_numbered(302_020_000, 100, _PUNCTUAL),
    **_numbered(302_030_000, 100, _LINEAR),
    **_numbered(302_040_000, 100, _EXTENDED),
    **_numbered(304_000_000, 10_000, _NATURAL),
    302_010_000: "other static",
    302_020_100: "other punctual",
    302_030_100: "other linear",
    302_040_100: "other extended",
    304_010_000: "other natural",
}
"""Objects that stand still in the class tree of IQmulus & TerraMobilita and of Paris-Lille-3D: nine digits, from the
root down (Vallet et al., Computers & Graphics 2015; Roynard et al., IJRR 2018)."""


def urban_name(number: int) -> str:
    """Name of a class of that tree; its number where it has none."""
    return URBAN_CLASSES.get(number, str(number))


def why_left_out(number: int) -> str:
    """Why a class of that tree is no landmark: "surface", "unknown", "dynamic", "bollard"; "" if it is one.

    After "Descriptellation" (Xing et al., V-A): what moves or may move, what is of no known class, and bollards, which
    stand so densely and so regularly that they tell no place from another. Surfaces are no objects.
    """
    if number in UNKNOWN or number // 100_000_000 == 1:
        return "unknown"
    if number // 100_000_000 == _SURFACES:
        return "surface"
    if number // 1_000_000 == _DYNAMIC:
        return "dynamic"
    if number // 100_000_000 != _OBJECTS:
        return "unknown"
    return "bollard" if number == BOLLARD else ""
