"""``python -m tests.fuzz.bombs``: files that are much larger inside than outside, and what ``dslam info`` says."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, McapRecord
from mcap.records import Message as MessageRecord

from logs.storage.mcap_index import MAGIC

CHANNEL, MESSAGE = Channel(1, "/topic", "json", {}, 0), MessageRecord(1, 5, b"", 5, 0)


def encoded(*records: McapRecord) -> bytes:
    """The bytes of records, one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


def log_of(*parts: bytes) -> bytes:
    """A log without an index."""
    return b"".join([MAGIC, encoded(Header("", "bomb")), *parts, encoded(DataEnd(0), Footer(0, 0, 0)), MAGIC])


def packed_10gb(declared_size: int) -> bytes:
    """A chunk of zeros."""
    compressor = zstandard.ZstdCompressor(level=1).compressobj()
    parts = [compressor.compress(bytes(10**7)) for _ in range(1000)]
    return log_of(encoded(Chunk("zstd", b"".join([*parts, compressor.flush()]), 1, 0, 0, declared_size)))


def empty_messages_1e7() -> bytes:
    content = encoded(CHANNEL) + encoded(MESSAGE) * 100_000
    return log_of(encoded(Chunk("zstd", zstandard.compress(content), 5, 5, 0, len(content))) * 100)


BOMBS: dict[str, Callable[[], bytes]] = {
    "zstd, 10 GB": partial(packed_10gb, 10**10),
    "zstd, 10 GB declared as 1 MB": partial(packed_10gb, 10**6),
    "a million channels": lambda: log_of(*(encoded(Channel(i % 65_536, f"/{i}", "json", {}, 0)) for i in range(10**6))),
    "ten million empty messages": empty_messages_1e7,
    "attachment of 500 MB": lambda: log_of(encoded(Attachment(1, 1, "", "", bytes(5 * 10**8)), CHANNEL, MESSAGE)),
}
"""One of each kind; each limit by itself is tested in tests/logs/test_limits.py."""


def write_bomb(path: Path, name: str) -> None:
    path.write_bytes(BOMBS[name]())


def main() -> int:
    """Exit code 1 if one took more than 300 MB."""
    print(f"{'bomb':32} {'file':>9} {'peak':>8} {'time':>7}  what it says")
    worst_mb = 0.0
    for name in BOMBS:
        with tempfile.TemporaryDirectory(prefix="bombs-") as folder:
            path = Path(folder) / "bomb.mcap"
            with ProcessPoolExecutor(1) as apart:  # the memory that it took would count as that of the command
                apart.submit(write_bomb, path, name).result()
            command = [sys.executable, "-m", "tools.cli", "info", str(path)]
            child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
            said, size = child.stderr.read().decode(errors="replace").strip(), f"{path.stat().st_size / 1e6:.2f} MB"
            _, status, usage = os.wait4(child.pid, 0)
        megabytes, seconds = usage.ru_maxrss * 1024 / 1e6, usage.ru_utime + usage.ru_stime
        worst_mb = max(worst_mb, megabytes)
        line = said.replace(str(path), "LOG").replace("\n", " | ")[:150]
        print(f"{name:32} {size:>9} {megabytes:5.0f} MB {seconds:5.1f} s  exit "
              f"{os.waitstatus_to_exitcode(status)} {line}", flush=True)  # fmt: skip
    return int(worst_mb > 300.0)


if __name__ == "__main__":
    sys.exit(main())
