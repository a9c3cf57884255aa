"""The configuration by which maps of several sessions are compared."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from slam.common.config import Config
from slam.provenance import recorded_config


def common_config(maps: Iterable[Mapping[str, str]]) -> Config:
    """The configuration for maps with these metadata, one at least: that of :func:`common_metadata`.

    Raises:
        SavedMapError: as :func:`slam.provenance.recorded_config`.
    """
    return recorded_config(common_metadata(maps))


def common_metadata(maps: Iterable[Mapping[str, str]]) -> Mapping[str, str]:
    """Of these metadata of maps, one at least, those by whose configuration their landmarks are compared.

    It is that of the map whose landmarks are less exact than in nine of ten maps: landmarks of one object are as far
    apart as the errors of the worse of two maps, but one robot that is lost in noise is not to decide for all.

    Raises:
        SavedMapError: as :func:`slam.provenance.recorded_config`.
    """
    ordered = sorted(maps, key=lambda metadata: recorded_config(metadata).calibration.objects.landmark_sigma_m)
    return ordered[math.ceil(0.9 * (len(ordered) - 1))]
