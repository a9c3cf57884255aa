"""Objects in ROS 2 messages, in three dimensions. Each object is at the stamp and in the frame of its own header; where
that is empty, of the array's.

* vision_msgs/msg/Detection3DArray: the class and the score are those of the result with the highest score, the position
  is the centre of the box, or, where the box was left empty, the pose of that result; the covariance is that of the
  result's pose.
* autoware (auto_)perception_msgs DetectedObjects, TrackedObjects: the class is the most probable one, by the name that
  the log's own definition gives its number.
* visualization_msgs/msg/MarkerArray: cubes, spheres, cylinders and meshes that are added, not deleted; a class is the
  marker's text, else its namespace.
"""

from collections import defaultdict
from typing import Any

import numpy as np

from logs.decoders.parts import Context, Detection, Place, Records, detection_records, place_of, xyz
from logs.validation import FloatArray


def detections_3d(message: Any, context: Context) -> Records:
    """Records of a Detection3DArray."""
    own = place_of(message, context)
    scans: dict[Place, list[Detection]] = defaultdict(list, {own: []})
    for detection in message.detections:
        best = best_result(detection)
        position = xyz(detection.bbox.center.position)
        if best is not None and not any(position) and not any(xyz(detection.bbox.size)):
            position = xyz(best.pose.pose.position)
        scans[place_of(detection, context, own)].append(
            Detection(
                position,
                *hypothesis_of(best),
                covariance=np.zeros((3, 3)) if best is None else position_covariance(best.pose.covariance),
            )
        )
    return detection_records(scans, context.counters)


def autoware_objects(message: Any, context: Context) -> Records:
    """Records of DetectedObjects or TrackedObjects."""
    found = []
    for seen in message.objects:
        best = max(seen.classification, key=lambda c: c.probability, default=None)
        placed = seen.kinematics.pose_with_covariance
        is_known = getattr(seen.kinematics, "has_position_covariance", True)
        found.append(
            Detection(
                xyz(placed.pose.position),
                "" if best is None else _class_name(best),
                seen.existence_probability,
                covariance=position_covariance(placed.covariance) if is_known else np.zeros((3, 3)),
            )
        )
    return detection_records({place_of(message, context): found}, context.counters)


def _class_name(best: Any) -> str:
    """The name of a number, in small letters, by the constants of an ObjectClassification."""
    names: dict[Any, str] = {number: name.lower() for name, number in vars(type(best)).items() if name.isupper()}
    return names.get(best.label, f"class {best.label}")


def markers(message: Any, context: Context) -> Records:
    """Records of a MarkerArray."""
    scans: dict[Place, list[Detection]] = defaultdict(list)
    for marker in message.markers:
        # Added: a cube, a sphere, a cylinder or a mesh.
        if marker.action == 0 and marker.type in (1, 2, 3, 10):
            found = Detection(xyz(marker.pose.position), marker.text or marker.ns)
            scans[place_of(marker, context)].append(found)
    return detection_records(scans, context.counters)


def best_result(detection: Any) -> Any:
    """The result with the highest score; None where there is none."""
    return max(detection.results, key=lambda result: hypothesis_of(result)[1], default=None)


def hypothesis_of(result: Any) -> tuple[str, float]:
    """Class and score of a result, "" and 1 of None; early vision_msgs have them, the class by its number, in it."""
    if result is None:
        return "", 1.0
    hypothesis = getattr(result, "hypothesis", result)
    label = getattr(hypothesis, "class_id", None)
    return (str(hypothesis.id) if label is None else label), hypothesis.score


def position_covariance(values: Any) -> FloatArray:
    """``(3, 3)`` m^2 of the 36 numbers of ROS.

    A coordinate whose row is zero while others are not was not estimated: it gets the largest variance of the others.
    """
    P = np.array(values, dtype=np.float64).reshape(6, 6)[:3, :3]
    empty = ~(P.any(axis=0) | P.any(axis=1))
    P[empty, empty] = np.diagonal(P).max()
    return P
