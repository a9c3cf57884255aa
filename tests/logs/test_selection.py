"""Which topic plays which part."""

import pytest

from logs.decoders.decode import kinds_of
from logs.errors import TopicSelectionError
from logs.selection import Selection, select_all, select_topics
from logs.topics import Channel, Schema, TopicInfo

ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "foxglove.PoseInFrame"
TF = "tf2_msgs/msg/TFMessage"
DETECTIONS = "dslam.ObjectDetections"
SCENE = "foxglove.SceneUpdate"
IMAGE = "sensor_msgs/msg/Image"


def topic(name: str, schema: str, count: int = 10) -> TopicInfo:
    is_ros = "/" in schema
    encoding = "cdr" if is_ros else "protobuf"
    channel = Channel(name, encoding, Schema(schema, "ros2msg" if is_ros else "protobuf", b""))
    return TopicInfo(name, schema, encoding, count, kinds_of(channel), None, None)


ODOM = topic("/odom", ODOMETRY)
COMMON = [topic("/detections", DETECTIONS), topic("/camera", IMAGE)]
MARKERS = topic("/markers", "visualization_msgs/msg/MarkerArray")
TRACKED = topic("/tracked", "autoware_perception_msgs/msg/TrackedObjects")


@pytest.mark.parametrize(
    ("kind", "topics", "chosen"),
    [
        ("odometry", [topic("/pose", POSE), topic("/ground_truth", POSE), topic("/slam/pose", POSE)], "/pose"),
        ("odometry", [ODOM, topic("/pose", POSE), topic("/tf", TF), topic("/ground_truth/odom", ODOMETRY)], "/odom"),
        ("odometry", [ODOM, topic("/odom2", ODOMETRY, count=0)], "/odom"),
        ("detections", [MARKERS, topic("/scene", SCENE), TRACKED], "/tracked"),
        ("detections", [MARKERS, topic("/scene", SCENE), topic("/slam/landmarks", SCENE)], "/scene"),
        ("detections", [MARKERS], "/markers"),
    ],
)
def test_strongest_topic_is_chosen(kind: str, topics: list[TopicInfo], chosen: str) -> None:
    assert select_topics(topics, needed=[kind]).topics_of(kind) == (chosen,)


@pytest.mark.parametrize(
    ("topics", "told"),
    [
        (COMMON, r"gives odometry.*/detections \(dslam.ObjectDetections, 10\)"),
        ([], "The log has no topics"),
        ([ODOM], "no topic gives detections.*name its fields, for example --topic 'detections="),
        ([*COMMON, topic("/tf", TF), topic("/slam/tf", TF)], r"if one of /tf is meant, say --topic odometry=/tf\."),
        ([*COMMON, ODOM, topic("/wheel", ODOMETRY, 8)], r"/odom, /wheel; choose one with --topic odometry=/odom\."),
        ([ODOM, *COMMON, topic("/right", DETECTIONS)], "or use all: --topic detections=/detections,/right"),
    ],
)
def test_missing_and_ambiguous_topics_are_refused(topics: list[TopicInfo], told: str) -> None:
    with pytest.raises(TopicSelectionError, match=told) as caught:
        select_topics(topics)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("overrides", "complaint"),
    [
        ({"odometry": "/nowhere"}, "--topic odometry=/nowhere: the log has no such topic"),
        ({"odometry": "/detections"}, "dslam.ObjectDetections does not decode to odometry"),
        ({"odometry": "/odom,/wheel"}, "the odometry is a single topic"),
        ({"odometri": "/odom"}, "unknown part"),
    ],
)
def test_overrides_that_do_not_fit_are_refused(overrides: dict[str, str], complaint: str) -> None:
    with pytest.raises(TopicSelectionError, match=complaint):
        select_topics([*COMMON, ODOM, topic("/wheel", ODOMETRY)], overrides)


def test_overrides() -> None:
    there = [ODOM, topic("/left", DETECTIONS), topic("/right", DETECTIONS), topic("/tf", TF)]
    chosen = select_topics(there, {"detections": "/left, /right", "odometry": "/tf"})
    assert chosen.topics_of("detections") == ("/left", "/right")
    assert chosen.kinds["/tf"] == ("odometry", "transforms")
    assert select_topics(there, needed=["odometry"]).topics_of("detections") == ()


def test_truth_has_topics_of_its_own() -> None:
    topics = [
        *COMMON,
        ODOM,
        topic("/ground_truth", POSE),
        topic("/ground_truth/detections", "dslam.DetectionTruth"),
        topic("/ground_truth/objects", "dslam.ObjectMap"),
        topic("/tf_static", TF),
        topic("/ground_truth/tf", TF),
        topic("/slam/tf", TF),
    ]
    assert select_topics(topics) == Selection.of(
        {
            "/detections": "detections",
            "/odom": "odometry",
            "/ground_truth": "ground_truth",
            "/ground_truth/detections": "detection_truth",
            "/ground_truth/objects": "object_truth",
            "/tf_static": "transforms",
        }
    )
    with pytest.raises(TopicSelectionError, match="no topic gives ground_truth"):
        select_topics([*COMMON, ODOM], needed=["ground_truth"])


def test_cameras_are_chosen_where_objects_are_in_images() -> None:
    camera = [topic(f"/{name}/image", IMAGE) for name in ("color", "depth", "aligned_depth")]
    camera.append(topic("/camera_info", "sensor_msgs/msg/CameraInfo"))
    chosen = select_topics([ODOM, *camera, topic("/boxes", "vision_msgs/msg/Detection2DArray")])
    assert chosen.topics == ("/aligned_depth/image", "/boxes", "/camera_info", "/odom")
    assert select_topics([ODOM, *camera, TRACKED]).topics == ("/odom", "/tracked")
    assert "/color/image" not in select_all([ODOM, *camera]).topics


@pytest.mark.parametrize("encoding", ["ros2idl", "ros2msg", ""])
def test_ros2_messages_need_a_definition_in_a_known_language(encoding: str) -> None:
    channel = Channel("/odom", "cdr", Schema(ODOMETRY, encoding, b""))
    assert bool(kinds_of(channel)) == bool(encoding)
