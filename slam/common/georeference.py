"""Where on earth a map lies: its frame against the local tangent plane of WGS 84.

x and y are those of the tangent plane (east and north, turned by the heading of the map) of the point at height 0 of
the ellipsoid; z is the height above that of the origin. So a map of 100 km is distorted by less than 1e-4.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np

from logs.container.json_text import parse_json
from slam.common.arrays import FloatArray
from slam.common.errors import GeometryError

SEMI_MAJOR_M = 6378137.0
ECCENTRICITY_SQUARED = 6.69437999014e-3
_BASELINE_M = 100.0
"""Over that length the heading of one frame in another is taken."""
_ITERATIONS = 20
"""Each brings the point nearer by a factor, 0.1 at 100 km and 80 deg of latitude, less elsewhere."""


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
        offsets = _ecef(geodetic[:, :2]) - _ecef(np.array([[self.latitude_deg, self.longitude_deg]]))
        east_north = offsets @ self._axes()[:2].T
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        x, y = c * east_north[:, 0] + s * east_north[:, 1], c * east_north[:, 1] - s * east_north[:, 0]
        return np.column_stack([x, y, geodetic[:, 2] - self.altitude_m])

    def to_geodetic(self, positions: FloatArray) -> FloatArray:
        """Latitude [deg], longitude [deg] and altitude [m] (N, 3) of positions (N, 3) m in the map."""
        degrees_per_metre = self._degrees_per_metre()
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        turn = np.array([[c, -s], [s, c]])
        degrees = np.tile([self.latitude_deg, self.longitude_deg], (len(positions), 1))
        for _ in range(_ITERATIONS):
            reached = self.to_map(np.column_stack([degrees, np.zeros(len(degrees))]))
            east_north = (positions[:, :2] - reached[:, :2]) @ turn.T
            degrees = degrees + east_north[:, ::-1] * degrees_per_metre
        return np.column_stack([degrees, positions[:, 2] + self.altitude_m])

    def T_map_other(self, other: Georeference) -> FloatArray:
        """``T_map_other`` (4, 4): where the frame of another georeference lies in this one, both upright."""
        from slam.common.geometry import transform_from_xyz_yaw

        ends = np.array([[0.0, 0.0, 0.0], [_BASELINE_M, 0.0, 0.0]])
        origin, ahead = self.to_map(other.to_geodetic(ends))
        along = ahead - origin
        return transform_from_xyz_yaw(origin, float(np.arctan2(along[1], along[0])))

    def _axes(self) -> FloatArray:
        """East, north and up (3, 3) at the origin, in the earth's frame."""
        latitude, longitude = np.deg2rad([self.latitude_deg, self.longitude_deg])
        sin_b, cos_b, sin_l, cos_l = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
        return np.array(
            [[-sin_l, cos_l, 0.0], [-sin_b * cos_l, -sin_b * sin_l, cos_b], [cos_b * cos_l, cos_b * sin_l, sin_b]]
        )

    def _degrees_per_metre(self) -> FloatArray:
        """Of latitude and longitude (2,), at the origin."""
        latitude = np.deg2rad(self.latitude_deg)
        w = np.sqrt(1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
        meridian_m = SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQUARED) / w**3
        return np.rad2deg([1.0 / meridian_m, w / (SEMI_MAJOR_M * np.cos(latitude))])

    def to_json(self) -> str:
        """As it stands in the metadata of maps and logs."""
        return json.dumps({name: getattr(self, name) for name in self.__dataclass_fields__})

    @classmethod
    def from_json(cls, text: str) -> Georeference:
        """Read what :meth:`to_json` wrote.

        Raises:
            GeometryError: it is none.
        """
        try:
            return cls(**{name: float(value) for name, value in parse_json(text).items()})
        except (ValueError, TypeError, AttributeError) as error:
            raise GeometryError(f"{text[:60]!r} is not a georeference ({error})") from error


def _ecef(degrees: FloatArray) -> FloatArray:
    """Points (N, 3) m of the ellipsoid in the earth's frame, of latitude and longitude (N, 2)."""
    latitude, longitude = np.deg2rad(degrees).T
    radius_m = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    return np.stack(
        [
            radius_m * np.cos(latitude) * np.cos(longitude),
            radius_m * np.cos(latitude) * np.sin(longitude),
            radius_m * (1.0 - ECCENTRICITY_SQUARED) * np.sin(latitude),
        ],
        axis=1,
    )
