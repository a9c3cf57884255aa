"""The configuration by which a saved map was made: what was given, and what was estimated from the log."""

from __future__ import annotations

import json
from collections.abc import Mapping

from slam.common.config import Config
from slam.common.errors import SavedMapError


def session_config(metadata: Mapping[str, str]) -> Config:
    """The effective configuration of the last drive of a map, from the metadata of the map.

    Raises:
        SavedMapError: the metadata have none that this version understands.
    """
    try:
        config = Config.model_validate_json(metadata.get("configuration", "{}"))
        branches: dict[str, dict[str, float]] = {}
        for key, value in json.loads(metadata.get("estimated", "{}")).items():
            branch, name = key.split(".")
            branches.setdefault(branch, {})[name] = float(value)
        changed = {name: getattr(config, name).model_copy(update=update) for name, update in branches.items()}
    except (ValueError, TypeError, AttributeError) as error:
        raise SavedMapError(
            f"the configuration in the metadata of a map cannot be read ({str(error).splitlines()[0]}); map its log "
            "again with this version"
        ) from error
    return config.model_copy(update=changed)
