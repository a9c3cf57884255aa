"""The configuration by which a saved map was made: what was given, and what was estimated from the log."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from logs.container.json_text import parse_json
from slam.common.calibration import Calibration
from slam.common.config import Config
from slam.common.errors import SavedMapError

EXACT_SHARE = 0.9
"""Share of the maps whose landmarks are at least as exact as the common configuration says."""


def session_config(metadata: Mapping[str, str]) -> Config:
    """The effective configuration of the last drive of a map, from the metadata of the map.

    Raises:
        SavedMapError: the metadata have none that this version understands.
    """
    try:
        config = Config.model_validate_json(metadata.get("configuration", "{}"))
        calibration = config.calibration.with_values(parse_json(metadata.get("estimated", "{}")))
        accuracy = Calibration.model_validate_json(metadata.get("accuracy", "{}")).model_dump(exclude_unset=True)
        return config.model_copy(update={"calibration": calibration.model_copy(update=accuracy)})
    except (ValueError, TypeError, AttributeError) as error:
        raise SavedMapError(
            f"the configuration in the metadata of a map cannot be read ({str(error).splitlines()[0]}); map its log "
            "again with this version"
        ) from error


def common_config(maps: Iterable[Mapping[str, str]]) -> Config:
    """The configuration for maps with these metadata, one at least: that of :func:`common_metadata`.

    Raises:
        SavedMapError: as :func:`session_config`.
    """
    return session_config(common_metadata(maps))


def common_metadata(maps: Iterable[Mapping[str, str]]) -> Mapping[str, str]:
    """Of these metadata of maps, one at least, those by whose configuration their landmarks are compared.

    It is that of the map whose landmarks are less exact than in nine of ten maps: landmarks of one object are as far
    apart as the errors of the worse of two maps, but one robot that is lost in noise is not to decide for all.

    Raises:
        SavedMapError: as :func:`session_config`.
    """
    ordered = sorted(maps, key=lambda metadata: session_config(metadata).calibration.objects.landmark_sigma_m)
    return ordered[math.ceil(EXACT_SHARE * (len(ordered) - 1))]
