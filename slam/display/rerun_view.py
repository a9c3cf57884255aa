"""A drive in Rerun: the layout, and the log of a drive.

Rerun draws the point clouds, frames, texts and images of a log by itself; lines and the robot are added to them.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from logs.container.limits import RESULT_LIMITS
from logs.reader import LogReader
from logs.scene import decode_lines, decode_points, decode_position
from slam.common.arrays import FloatArray
from slam.common.errors import ViewerError
from slam.display.map_topics import (
    CLOSURE_COLOR,
    CLOSURES,
    LANDMARK_POINTS,
    MAP_FRAME,
    PATH,
    PATH_COLOR,
    SUBMAP,
)
from slam.object_map.map_io import POINTS_TOPIC

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

TIMELINE = "message_log_time"
POSE, ROBOT, LOG = "/slam/pose", "/slam/robot", "/slam/log"
ROBOT_COLOR = (1.0, 0.85, 0.1, 1.0)
_LINE_COLORS = {PATH: PATH_COLOR, CLOSURES: CLOSURE_COLOR}
_IMAGES = ("foxglove.CompressedImage", "foxglove.RawImage", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")
_PIXELS = {LANDMARK_POINTS: 4.5, POINTS_TOPIC: 4.5, SUBMAP: 2.0, ROBOT: 7.0, PATH: 1.5, CLOSURES: 2.0}


def _blueprint_of(log: Path) -> rrb.Blueprint:
    """The layout for a log: its whole path or map from above, beside it the texts and a view for each image topic."""
    import rerun.blueprint as rrb

    with LogReader(log, RESULT_LIMITS) as reader:
        images = [info.topic for info in reader.topics() if info.schema_name in _IMAGES]
        paths = [decode_lines(raw.data) for raw in reader.messages([PATH])]
        clouds = [decode_points(raw.data) for raw in reader.messages([POINTS_TOPIC])]
    points = np.concatenate([np.zeros((1, 3)), *(paths[-1] if paths else ()), *clouds])
    low, high = points.min(axis=0), points.max(axis=0)
    centre = 0.5 * (low + high)
    position = centre + float(np.linalg.norm(high - low)) * np.array([0.0, -0.35, 0.75])
    the_map = rrb.Spatial3DView(
        name="map",
        spatial_information=rrb.SpatialInformation(target_frame=MAP_FRAME),
        eye_controls=rrb.EyeControls3D(position=position, look_target=centre, eye_up=(0.0, 0.0, 1.0)),
    )
    beside = [rrb.TextLogView(origin=LOG, name="log")]
    beside += [rrb.Spatial2DView(origin=topic, name=topic) for topic in images]
    return rrb.Blueprint(
        rrb.Horizontal(the_map, rrb.Vertical(*beside), column_shares=[3, 1]),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def write_recording(path: Path, log: Path) -> None:
    """Write all of a log as a recording for Rerun, with the layout.

    Raises:
        ViewerError: Rerun cannot read the log, which is damaged.
    """
    import rerun as rr

    recording = rr.RecordingStream("dslam", recording_id=log.stem)
    recording.save(path, default_blueprint=_blueprint_of(log))
    _send_log(log, recording)
    recording.disconnect()


def _send_log(log: Path, recording: rr.RecordingStream) -> None:
    import rerun as rr
    from rerun.chunk import McapReader

    with LogReader(log, RESULT_LIMITS) as reader:
        deque(reader.messages(), maxlen=0)
        if damage := ", ".join(f"{name} {count}" for name, count in reader.counters.items()):
            raise ViewerError(f"Rerun cannot read {log}, which is damaged ({damage}); make the log again")
    try:
        recording.send_chunks(McapReader(log).stream())
    except (ValueError, RuntimeError) as error:
        raise ViewerError(f"Rerun cannot read {log}: {str(error).splitlines()[0]}; make the log again") from error
    _style(recording)
    poses_ns, positions = [], []
    with LogReader(log) as reader:
        for raw in reader.messages([PATH, CLOSURES, POSE]):
            if raw.topic == POSE:
                poses_ns.append(raw.log_time_ns)
                positions.append(decode_position(raw.data))
            else:
                _set_time(recording, raw.log_time_ns)
                recording.log(raw.topic, _lines(decode_lines(raw.data), raw.topic))
    if positions:
        times = rr.TimeColumn(TIMELINE, timestamp=np.array(poses_ns, dtype="datetime64[ns]"))
        recording.send_columns(ROBOT, [times], rr.Points3D.columns(positions=np.array(positions)))


def _style(recording: rr.RecordingStream) -> None:
    """Frames and sizes of what is drawn, for all times."""
    import rerun as rr

    for topic in (LANDMARK_POINTS, POINTS_TOPIC, SUBMAP, PATH, CLOSURES, ROBOT):
        recording.log(topic, rr.CoordinateFrame(MAP_FRAME), static=True)
    for topic in (LANDMARK_POINTS, POINTS_TOPIC, SUBMAP):
        recording.log(topic, rr.Points3D.from_fields(radii=_radius(topic)), static=True)
    color = _bytes(ROBOT_COLOR)
    recording.log(ROBOT, rr.Points3D.from_fields(radii=_radius(ROBOT), colors=[color]), static=True)


def _lines(polylines: tuple[FloatArray, ...], topic: str) -> rr.LineStrips3D:
    import rerun as rr

    return rr.LineStrips3D(polylines, colors=[_bytes(_LINE_COLORS[topic])], radii=_radius(topic))


def _radius(topic: str) -> float:
    import rerun as rr

    return float(rr.Radius.ui_points(_PIXELS.get(topic, 2.0)))


def _bytes(color: tuple[float, float, float, float]) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in color)


def _set_time(recording: rr.RecordingStream, log_time_ns: int) -> None:
    recording.set_time(TIMELINE, timestamp=np.datetime64(log_time_ns, "ns"))
