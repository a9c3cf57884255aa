"""dslam live."""

from __future__ import annotations

import json
import socket
import time
from io import BytesIO
from pathlib import Path
from threading import Thread

import pytest

from logs.storage.stream import write_stream
from slam.simulation.config import SimulationConfig
from tests.helpers.short_drives import drive, keep_until, write_log
from tests.tools.runs import Run, assert_refused

pytest.importorskip("foxglove")


@pytest.mark.slow
def test_log_is_mapped_as_fast_as_possible(dslam: Run, tmp_path: Path) -> None:
    log = write_log(tmp_path / "drive.mcap", keep_until(drive(SimulationConfig()), 4.0))
    run = dslam("live", log, "--speed", 0, "--port", 0, "-o", tmp_path / "out.mcap", "--json")
    found = json.loads(run.out)
    assert found["status"].startswith("optimised")
    assert set(found["latency_s"]) == {"p50", "p99", "max"}
    assert (tmp_path / "out.mcap").exists()


@pytest.mark.slow
def test_stream_from_a_socket_is_mapped(dslam: Run) -> None:
    stream = BytesIO()
    for topic, log_time_ns, record in keep_until(drive(SimulationConfig()), 4.0):
        write_stream(stream, topic, record, log_time_ns)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    sender = Thread(target=_send, args=(port, stream.getvalue()))
    sender.start()
    run = dslam("live", f"tcp:127.0.0.1:{port}", "--port", 0, "--json")
    sender.join()
    assert json.loads(run.out)["status"].startswith("optimised")


def _send(port: int, data: bytes) -> None:
    """Send to the port as soon as it is open."""
    for _ in range(200):
        try:
            with socket.create_connection(("127.0.0.1", port)) as connection:
                connection.sendall(data)
                return
        except ConnectionRefusedError:
            time.sleep(0.1)


def test_address_without_a_port_is_refused(dslam: Run) -> None:
    assert_refused(dslam("live", "tcp:localhost", "--port", 0), "tcp:HOST:PORT")
