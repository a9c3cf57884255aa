"""Faults of the objects and of the unit of length. Each public function is a fault."""

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.simulation.faults.parameters import Share
from slam.simulation.faults.recording import Message, Recording, seconds_ns

_Speed = Annotated[float, Field(ge=0.0, le=1e3, description="m/s")]
_LengthFactor = Annotated[float, Field(ge=1e-6, le=1e6, description="factor")]


def objects_moving(log: Recording, share: Share = 0.5, speed_m_s: _Speed = 2.0, *, rng: np.random.Generator) -> None:
    """A share of the objects moves by M/S.

    Each time an object comes into view it moves straight on in a direction drawn at random.
    """
    objects = sorted({name for scan in log.scans for name in scan.ids if name})
    if not objects:
        raise SimulationError("the log holds no true ids (/ground_truth/detections), which this fault needs")
    drawn = rng.random(len(objects))
    moving = {name for name, number in zip(objects, drawn, strict=True) if number < share}
    frames, away_ns = log.body_frames(), seconds_ns(10.0)  # an object that comes back later has gone elsewhere
    passes: dict[str, tuple[int, int, FloatArray]] = {}  # when it came, when it was seen last, which way it goes
    pairs = [pair for pair in zip(log.scans, log.scan_poses(), strict=True) if pair[0].truth is not None]
    for scan, T_odom_body in sorted(pairs, key=lambda pair: pair[0].stamp_ns):
        stamp_ns, positions = scan.stamp_ns, scan.seen.positions.copy()
        R_sensor_odom = (T_odom_body @ frames(scan.seen.frame_id))[:3, :3].T
        for row, name in enumerate(scan.ids):
            if name not in moving:
                continue
            came_ns, seen_ns, direction = passes.get(name, (0, -away_ns, np.zeros(3)))
            if stamp_ns - seen_ns >= away_ns:
                angle_rad = rng.uniform(-np.pi, np.pi)
                came_ns, direction = stamp_ns, np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
            passes[name] = (came_ns, stamp_ns, direction)
            positions[row] += R_sensor_odom @ direction * speed_m_s * (stamp_ns - came_ns) * 1e-9
        scan.change(positions=positions)


def lengths_scaled(log: Recording, factor: _LengthFactor = 0.05) -> None:
    """All lengths of the log and of its truth are multiplied."""
    units, cells = np.repeat([1.0, factor], 3), np.ones((4, 4))
    cells[:3, 3] = factor
    powers = {"positions": factor, "covariances": factor**2, "covariance": np.outer(units, units)}
    powers |= dict.fromkeys(("T_odom_body", "T_parent_child", "T_world_body"), cells)

    def scaled(message: Message[Any]) -> Message[Any]:
        fields = {name: getattr(message.record, name, None) for name in powers}
        return message.having(**{k: powers[k] * value for k, value in fields.items() if value is not None})

    log.odometry, log.others = list(map(scaled, log.odometry)), list(map(scaled, log.others))
    for scan in log.scans:
        scan.message = scaled(scan.message)
