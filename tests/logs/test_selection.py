import pytest

from logs.decoders.registry import kinds_of
from logs.errors import TopicSelectionError
from logs.selection import Selection, select_topics
from logs.topics import Channel, RecordKind, Schema, TopicInfo

ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "foxglove.PoseInFrame"
TF = "tf2_msgs/msg/TFMessage"
DETECTIONS = "dslam.ObjectDetections"
SCENE = "foxglove.SceneUpdate"


def topic(name, schema, count=10):
    is_ros = "/" in schema
    encoding = "cdr" if is_ros else "protobuf"
    channel = Channel(1, name, encoding, Schema(1, schema, "ros2msg" if is_ros else "protobuf", b""))
    return TopicInfo(name, schema, encoding, count, kinds_of(channel), None, None)


COMMON = [topic("/detections", DETECTIONS), topic("/camera", "sensor_msgs/msg/Image")]


@pytest.mark.parametrize(
    ("topics", "chosen"),
    [
        ([topic("/odom", ODOMETRY)], "/odom"),
        ([topic("/pose", POSE)], "/pose"),
        ([topic("/odom", ODOMETRY), topic("/pose", POSE), topic("/tf", TF)], "/odom"),
        ([topic("/pose", POSE), topic("/ground_truth", POSE), topic("/slam/pose", POSE)], "/pose"),
        ([topic("/odom", ODOMETRY), topic("/ground_truth/odom", ODOMETRY)], "/odom"),
        ([topic("/odom", ODOMETRY), topic("/odom2", ODOMETRY, count=0)], "/odom"),
    ],
)
def test_the_strongest_odometry_is_chosen(topics, chosen):
    assert select_topics([*COMMON, *topics]).topics_of("odometry") == (chosen,)


def test_two_equally_good_topics_are_told_with_the_remedy():
    topics = [*COMMON, topic("/odom", ODOMETRY, 7), topic("/wheel", "foxglove.Odometry", 8)]
    with pytest.raises(TopicSelectionError) as caught:
        select_topics(topics)
    message = str(caught.value)
    for part in ("/odom", "/wheel (foxglove.Odometry, 8)", "--topic odometry=/odom", "/camera"):
        assert part in message
    assert "\n" not in message
    assert select_topics(topics, {"odometry": "/wheel"}).topics_of("odometry") == ("/wheel",)


def test_no_topic_is_told_with_what_is_there():
    with pytest.raises(TopicSelectionError, match=r"gives odometry.*/detections \(dslam.ObjectDetections, 10\)"):
        select_topics(COMMON)
    with pytest.raises(TopicSelectionError, match="The log has no topics"):
        select_topics([])


def test_frames_are_odometry_only_when_asked_for():
    topics = [*COMMON, topic("/tf", TF)]
    with pytest.raises(TopicSelectionError, match="--topic odometry=/tf"):
        select_topics(topics)
    selection = select_topics(topics, {"odometry": "/tf"})
    assert selection.kinds["/tf"] == ("odometry", "transforms")


def test_a_scene_gives_detections_where_nothing_better_does():
    odometry = topic("/odom", ODOMETRY)
    assert select_topics([odometry, topic("/markers", SCENE)]).topics_of("detections") == ("/markers",)
    both = [odometry, topic("/markers", SCENE), topic("/objects", DETECTIONS)]
    assert select_topics(both).topics_of("detections") == ("/objects",)
    with pytest.raises(TopicSelectionError):
        select_topics([odometry, topic("/slam/landmarks", SCENE), topic("/ground_truth/scene", SCENE)])


def test_truth_has_topics_of_its_own():
    topics = [
        *COMMON,
        topic("/odom", ODOMETRY),
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
        select_topics([*COMMON, topic("/odom", ODOMETRY)], needed=["ground_truth"])


@pytest.mark.parametrize(
    ("overrides", "complaint"),
    [
        ({"odometry": "/nowhere"}, "--topic odometry=/nowhere: the log has no such topic"),
        ({"odometry": "/detections"}, "dslam.ObjectDetections does not decode to odometry"),
        ({"odometry": "/camera"}, "sensor_msgs/msg/Image does not decode to odometry"),
        ({"odometri": "/odom"}, "unknown part"),
    ],
)
def test_overrides_that_do_not_fit(overrides, complaint):
    with pytest.raises(TopicSelectionError, match=complaint):
        select_topics([*COMMON, topic("/odom", ODOMETRY)], overrides)


@pytest.mark.parametrize("encoding", ["ros2idl", "ros2msg", ""])
def test_ros2_messages_need_a_definition_in_a_known_language(encoding):
    channel = Channel(1, "/odom", "cdr", Schema(1, ODOMETRY, encoding, b""))
    assert bool(kinds_of(channel)) == bool(encoding)


def test_several_topics_can_be_the_detections_but_one_the_odometry():
    there = [topic("/odom", ODOMETRY), topic("/left", DETECTIONS), topic("/right", DETECTIONS)]
    with pytest.raises(TopicSelectionError, match="or use all: --topic detections=/left,/right"):
        select_topics(there)
    assert select_topics(there, {"detections": "/left, /right"}).topics_of("detections") == ("/left", "/right")
    with pytest.raises(TopicSelectionError, match="the odometry is a single topic"):
        select_topics([*there, topic("/wheels", ODOMETRY)], {"odometry": "/odom,/wheels"})


def test_a_hint_never_names_the_truth_or_an_output():
    poses = ("/ground_truth", "/slam/pose", "/tf")
    there = [
        TopicInfo(topic, "foxglove.FrameTransform", "protobuf", 5, (RecordKind.TRANSFORMS, RecordKind.ODOMETRY), 0, 1)
        for topic in poses
    ]
    with pytest.raises(TopicSelectionError, match="if one of /tf is meant"):
        select_topics(there)


def test_several_of_a_kind_that_is_not_needed_are_none():
    topics = [topic("/odom", ODOMETRY), topic("/a", DETECTIONS), topic("/b", DETECTIONS)]
    assert select_topics(topics, needed=["odometry"]).topics_of("detections") == ()
