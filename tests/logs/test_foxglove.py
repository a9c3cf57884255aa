import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from logs.decoders.decode import decode
from tests.logs.test_validation import raw


def entity(update, *, id="", frame="lidar", seconds=1, label=None, text=None, score=None):
    added = update.entities.add(id=id, frame_id=frame)
    added.timestamp.seconds = seconds
    if label is not None:
        added.metadata.add(key="label", value=label)
    if score is not None:
        added.metadata.add(key="score", value=score)
    if text is not None:
        added.texts.add(text=text).pose.position.x = 9.0
    return added


def place(primitive, x, size=None):
    primitive.pose.position.x = x
    primitive.pose.orientation.w = 1.0
    if size is not None:
        primitive.size.x = primitive.size.y = primitive.size.z = size


def test_primitives_are_detections_and_their_class_is_looked_for_in_order():
    update = SceneUpdate()
    place(entity(update, id="tree/1", label="oak", text="text", score="0.25").cubes.add(), 1.0, 2.0)
    place(entity(update, id="tree/2", text="elm").spheres.add(), 2.0, 3.0)
    place(entity(update, id="street_lamp_17").cylinders.add(), 3.0, 4.0)
    entity(update, id="x", text="only a text")
    with_class = entity(update, id="y")
    with_class.metadata.add(key="class", value="pole")
    place(with_class.models.add(), 5.0)
    entity(update, id="nothing").lines.add()
    (record,) = decode(raw(update), "detections")
    assert record.labels == ("oak", "elm", "street_lamp", "only a text", "pole")
    np.testing.assert_array_equal(record.positions[:, 0], [1, 2, 3, 9, 5])
    np.testing.assert_array_equal(record.scores, [0.25, 1, 1, 1, 1])
    assert (record.stamp_ns, record.frame_id) == (1_000_000_000, "lidar")


def test_other_frames_and_times_become_records_of_their_own():
    update = SceneUpdate()
    for frame, seconds in [("left", 1), ("right", 1), ("left", 2), ("left", 1)]:
        place(entity(update, frame=frame, seconds=seconds, label="tree").cubes.add(), 1.0, 2.0)
    records = decode(raw(update), "detections")
    assert [(r.frame_id, r.stamp_ns // 10**9, len(r.labels)) for r in records] == [
        ("left", 1, 2),
        ("right", 1, 1),
        ("left", 2, 1),
    ]


@pytest.mark.parametrize("many", [True, False])
def test_frame_transforms(many):
    transform = FrameTransform(parent_frame_id="/odom", child_frame_id="base")
    transform.translation.y = 4.0
    transform.rotation.w = 1.0
    other = FrameTransform(parent_frame_id="map", child_frame_id="odom")
    other.rotation.w = 1.0
    message = FrameTransforms(transforms=[transform, other]) if many else transform
    records = decode(raw(message), "transforms")
    assert len(records) == (2 if many else 1)
    assert records[0].T_parent_child[1, 3] == 4.0
    (odometry,) = decode(raw(message), "odometry")
    assert (odometry.frame_id, odometry.child_frame_id) == ("/odom", "base")
