"""Estimates over a WebSocket, read by a client that is not Foxglove's."""

import json
import struct
from contextlib import closing

import numpy as np
import pytest
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

from logs.messages import SlamPose
from tests.helpers.poses import pose_at

connect = pytest.importorskip("websockets.sync.client").connect
FoxgloveFeed = pytest.importorskip("slam.display.foxglove_feed").FoxgloveFeed
SUBPROTOCOL, MESSAGE_DATA = "foxglove.sdk.v1", 1


def test_client_receives_the_poses_that_it_subscribes_to() -> None:
    with closing(FoxgloveFeed("127.0.0.1", 0)) as feed:
        feed.show("/slam/pose", SlamPose(5, np.eye(4)), 5)
        with connect(f"ws://127.0.0.1:{feed.port}", subprotocols=[SUBPROTOCOL]) as client:
            channel = _advertised(client, "/slam/pose")
            assert (channel["encoding"], channel["schemaName"]) == ("protobuf", "foxglove.PoseInFrame")
            subscription = {"id": 1, "channelId": channel["id"]}
            client.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))
            stamps_ns, pose = _next_pose(client, feed, SlamPose(7, pose_at(1.0, 2.0, z=3.0)))
    assert stamps_ns == 7
    position = pose.pose.position
    assert (position.x, position.y, position.z) == (1.0, 2.0, 3.0)


def _advertised(client, topic):
    """The channel of a topic, from what the server advertises first."""
    for _ in range(10):
        message = json.loads(client.recv(timeout=10.0))
        for channel in message.get("channels", []):
            if channel["topic"] == topic:
                return channel
    raise AssertionError(f"{topic} was not advertised")


def _next_pose(client, feed, pose):
    """Publish until the subscription is known; returns log time and message."""
    for _ in range(100):
        feed.show("/slam/pose", pose, pose.stamp_ns)
        try:
            data = client.recv(timeout=0.1)
        except TimeoutError:
            continue
        if isinstance(data, bytes) and data[0] == MESSAGE_DATA:
            _, _, log_time_ns = struct.unpack("<BIQ", data[:13])
            return log_time_ns, PoseInFrame.FromString(data[13:])
    raise AssertionError("no message came")
