"""Publishes estimates for Foxglove over a WebSocket during the drive."""

from typing import Any

import foxglove

from logs.encoders import definition_of, encode
from logs.messages import Record


class FoxgloveFeed:
    """Publishes records on a WebSocket server, each topic as in an output log, until it is closed."""

    def __init__(self, host: str, port: int) -> None:
        """Start the server; ``port`` 0 takes a free one."""
        self._context = foxglove.Context()
        self._server = foxglove.start_server(name="dslam", host=host, port=port, context=self._context)
        self._channels: dict[str, Any] = {}

    @property
    def port(self) -> int:
        """The port that the server listens on."""
        return int(self._server.port)

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()

    def show(self, topic: str, record: Record, log_time_ns: int) -> None:
        """Publish a record."""
        message = encode(record)
        if topic not in self._channels:
            schema = foxglove.Schema(**definition_of(message.DESCRIPTOR)._asdict())
            self._channels[topic] = foxglove.Channel(
                topic, schema=schema, message_encoding="protobuf", context=self._context
            )
        self._channels[topic].log(message.SerializeToString(deterministic=True), log_time=log_time_ns)
