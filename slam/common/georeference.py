"""Georeference of a map: its frame against the local tangent plane of WGS 84.

x and y are those of the tangent plane (east and north, turned by the heading of the map) of the point at height 0 of
the ellipsoid; z is the height above that of the origin. So a map of 100 km is distorted by less than 1e-4.
"""

import json
from dataclasses import asdict, dataclass

import numpy as np
from pydantic_core import from_json
from pymap3d import enu2geodetic, geodetic2enu

from slam.common.arrays import FloatArray
from slam.common.errors import GeometryError


@dataclass(frozen=True, slots=True)
class Georeference:
    """The origin of a map on WGS 84, and ``yaw_rad``, the heading of its x axis from east to north."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        if not (abs(self.latitude_deg) < 89.0 and abs(self.longitude_deg) <= 180.0):
            raise GeometryError(
                f"origin at latitude {self.latitude_deg:g}, longitude {self.longitude_deg:g}: give degrees, latitude "
                "first, between -89 and 89, and longitude between -180 and 180"
            )

    def to_map(self, geodetic: FloatArray) -> FloatArray:
        """Positions (N, 3) m in the map of latitude [deg], longitude [deg] and altitude [m] (N, 3)."""
        east, north, _ = geodetic2enu(*geodetic[:, :2].T, 0.0, self.latitude_deg, self.longitude_deg, 0.0)
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        x, y = c * east + s * north, c * north - s * east
        return np.column_stack([x, y, geodetic[:, 2] - self.altitude_m])

    def to_geodetic(self, positions: FloatArray) -> FloatArray:
        """Latitude [deg], longitude [deg] and altitude [m] (N, 3) of positions (N, 3) m in the map."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        x, y = positions[:, 0], positions[:, 1]
        up, height = np.zeros(len(positions)), np.zeros(len(positions))
        for _ in range(5):  # each brings the points nearer to the ellipsoid by a factor of about 1e-3 at 100 km
            up -= height
            latitude, longitude, height = enu2geodetic(
                c * x - s * y, s * x + c * y, up, self.latitude_deg, self.longitude_deg, 0.0
            )
        return np.column_stack([latitude, longitude, positions[:, 2] + self.altitude_m])

    def to_json(self) -> str:
        """JSON for the metadata of maps and logs."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "Georeference":
        """Read what :meth:`to_json` wrote.

        Raises:
            GeometryError: it is none.
        """
        try:
            return cls(**{name: float(value) for name, value in from_json(text).items()})
        except (ValueError, TypeError, AttributeError) as error:
            raise GeometryError(f"{text[:60]!r} is not a georeference ({error})") from error
