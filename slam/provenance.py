"""Provenance of an output, as metadata: enough to reproduce it."""

import json
from collections.abc import Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING

from pydantic_core import from_json

from slam.common.calibration import Calibration
from slam.common.config import Config
from slam.common.config_tree import CHANGED_SETTINGS, changed_settings
from slam.common.errors import SavedMapError

if TYPE_CHECKING:
    from slam.localization.prior_map import PriorMap
    from slam.self_calibration.calibration import CalibratedLog


def settings_of(
    config: Config, calibration: "CalibratedLog", prior_map: "PriorMap | None", *, extend: bool
) -> dict[str, str]:
    """The version, the settings as given and as estimated, and the map, as text and JSON."""
    about = {
        "version": version("descriptellation-slam"),
        "configuration": config.model_dump_json(),
        CHANGED_SETTINGS: changed_settings(config),
        "estimated": json.dumps(dict(calibration.estimated)),
        "accuracy": calibration.config.calibration.model_dump_json(include={"sigmas", "evidence"}),
        "notes": json.dumps(list(calibration.notes)),
    }
    if prior_map is not None:
        about["map_drives"] = json.dumps([dict(drive) for drive in prior_map.drives])
        about["map_extended"] = json.dumps(extend)
        if prior_map.georeference is not None:  # the output is in the frame of that map
            about["georeference"] = prior_map.georeference.to_json()
    return about


def recorded_config(metadata: Mapping[str, str]) -> Config:
    """The effective configuration of a run, or of the last drive of a map: as given and as estimated.

    Raises:
        SavedMapError: the metadata have none that this version understands.
    """
    try:
        config = Config.model_validate_json(metadata.get("configuration", "{}"))
        calibration = config.calibration.with_values(from_json(metadata.get("estimated", "{}")))
        accuracy = Calibration.model_validate_json(metadata.get("accuracy", "{}")).model_dump(exclude_unset=True)
        found = config.model_copy(update={"calibration": calibration.model_copy(update=accuracy)})
        return Config.model_validate(found.model_dump(exclude_unset=True, warnings=False))
    except (ValueError, TypeError, AttributeError) as error:
        raise SavedMapError(
            f"the configuration in the metadata of a map cannot be read ({str(error).splitlines()[0]}); map its log "
            "again with this version"
        ) from error
