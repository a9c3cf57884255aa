"""Topics for viewers."""

from logs.messages import Record

MAP_FRAME, FRAMES, LOG = "map", "/tf", "/slam/log"
LANDMARKS, LANDMARK_POINTS, SUBMAP = "/slam/landmarks", "/slam/landmark_points", "/slam/submap"
PATH, CLOSURES = "/slam/path", "/slam/closure_lines"

Message = tuple[str, Record]
"""Topic and record."""
