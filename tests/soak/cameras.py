"""``python -m tests.soak.cameras drive.mcap``: a log with camera pictures and point clouds of 2 GB beside its drive.

Prints the largest memory of a replay of the drive alone and of all. What is added cannot be compressed, and is not
used.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from logs.reader import LogReader

CAMERA_BYTES, CLOUD_BYTES = 600_000, 1_000_000
CHUNK_BYTES = 4_000_000
TOPICS = {"/camera/image": ("foxglove.CompressedImage", CAMERA_BYTES), "/points": ("foxglove.PointCloud", CLOUD_BYTES)}


def main() -> int:
    """Exit code 1 if the large log needs more than 1.5 GB."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak.cameras", description=__doc__)
    parser.add_argument("log", type=Path, help="a drive")
    parser.add_argument("--gigabytes", type=float, default=2.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="cameras-") as folder:
        large = add_sensors(options.log, Path(folder) / "large.mcap", round(1e9 * options.gigabytes))
        peaks = [peak_mb(path, Path(folder) / "map.mcap") for path in (options.log, large)]
        for path, peak in zip((options.log, large), peaks, strict=True):
            print(f"{path.name}: {path.stat().st_size / 1e9:.3f} GB, replayed in {peak:.0f} MB")
    return int(peaks[1] > 1500.0)


def add_sensors(source: Path, path: Path, size_bytes: int) -> Path:
    """The messages of ``source`` with a picture and a cloud beside every few of them, ``size_bytes`` in all."""
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, 40_000_000, dtype=np.uint8).tobytes()
    with LogReader(source) as reader, open(path, "wb") as stream:
        messages = sum(topic.message_count for topic in reader.topics())
        every = max(messages * (CAMERA_BYTES + CLOUD_BYTES) // size_bytes, 1)
        writer = Writer(stream, chunk_size=CHUNK_BYTES)
        writer.start()
        added = {}
        for topic, (schema, _) in TOPICS.items():
            added[topic] = writer.register_channel(topic, "protobuf", writer.register_schema(schema, "protobuf", b""))
        known: dict[str, int] = {}
        for number, raw in enumerate(reader.messages()):
            channel = raw.channel
            if channel.topic not in known:
                assert channel.schema is not None
                schema_id = writer.register_schema(channel.schema.name, channel.schema.encoding, channel.schema.data)
                known[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            writer.add_message(known[channel.topic], raw.log_time_ns, raw.data, raw.publish_time_ns)
            if number % every == 0:
                for topic, (_, size) in TOPICS.items():
                    begin = int(rng.integers(0, len(noise) - size))
                    writer.add_message(added[topic], raw.log_time_ns, noise[begin : begin + size], raw.log_time_ns)
        writer.finish()
    return path


def peak_mb(log: Path, output: Path) -> float:
    """The largest memory of a replay in a process of its own."""
    command = [sys.executable, "-m", "dslam", "replay", str(log), "-o", str(output)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise RuntimeError(f"the replay of {log} ended with status {status}")
    return usage.ru_maxrss / 1000.0


if __name__ == "__main__":
    sys.exit(main())
