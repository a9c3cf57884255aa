"""Class numbers of published labelled clouds that are objects."""

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
