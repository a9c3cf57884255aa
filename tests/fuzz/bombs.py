"""``python -m tests.fuzz.bombs``: files that are much larger inside than outside, and what ``dslam info`` says."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, McapRecord
from mcap.records import Message as MessageRecord

from logs.storage.mcap_index import MAGIC
from tests.fuzz.mcap_file import Layout, McapFile, Message, write_file

GIGABYTE = 10**9
_SPARSE = b"\0" * 10**7


def encoded(*records: McapRecord) -> bytes:
    """The bytes of records, one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


_END = encoded(DataEnd(0), Footer(0, 0, 0)) + MAGIC
_START = MAGIC + encoded(Header("", "bomb"))


def _chunk_of(compressed: bytes, compression: str, size: int) -> bytes:
    return _START + encoded(Chunk(compression, compressed, 1, 0, 0, size)) + _END


def _zeros(size: int) -> Iterator[bytes]:
    for _ in range(size // len(_SPARSE)):
        yield _SPARSE


def _packed_10gb() -> bytes:
    compressor = zstandard.ZstdCompressor(level=1).compressobj()
    return b"".join([*map(compressor.compress, _zeros(10 * GIGABYTE)), compressor.flush()])


def zstd_10gb(size_told: int = 10 * GIGABYTE) -> bytes:
    return _chunk_of(_packed_10gb(), "zstd", size_told)


def zstd_10gb_told_as_1_mb() -> bytes:
    return zstd_10gb(10**6)


def lz4_10gb(size_told: int = 10 * GIGABYTE) -> bytes:
    compressor = lz4.frame.LZ4FrameCompressor()
    parts = [compressor.begin(), *map(compressor.compress, _zeros(10 * GIGABYTE)), compressor.flush()]
    return _chunk_of(b"".join(parts), "lz4", size_told)


def lz4_10gb_told_as_1_mb() -> bytes:
    return lz4_10gb(10**6)


def declared_2_to_the_60() -> bytes:
    return _chunk_of(zstandard.compress(b"\0" * 1000), "zstd", 2**60)


def channels_1e6() -> bytes:
    return _START + encoded(*(Channel(i % 65_536, f"/topic_{i}", "json", {}, 0) for i in range(10**6))) + _END


def channels_65e3_with_index() -> bytes:
    channels = {i: (0, f"/topic_{i}", "json") for i in range(65_535)}
    return write_file(McapFile({}, channels, [Message(i, i, b"{}") for i in range(65_535)]), Layout())


def empty_messages_1e7() -> bytes:
    content = encoded(Channel(1, "/topic", "json", {}, 0)) + encoded(MessageRecord(1, 5, b"", 5, 0)) * 100_000
    chunk = Chunk("zstd", zstandard.compress(content), 5, 5, 0, len(content))
    return _START + encoded(chunk) * 100 + _END


def attachment_2gb() -> bytes:
    """The file itself is sparse: only its size is told here."""
    return b""


def class_name_10mb() -> bytes:
    from logs.schemas import dslam_pb2

    record = dslam_pb2.ObjectDetections(stamp_ns=1, labels=["x" * 10**7], positions=[1, 2, 3], scores=[1])
    channels = {1: (1, "/detections", "protobuf")}
    messages = [Message(1, i, record.SerializeToString()) for i in range(20)]
    schemas = {1: ("dslam.ObjectDetections", "protobuf", b"")}
    return write_file(McapFile(schemas, channels, messages), Layout(messages_per_chunk=4))


BOMBS: tuple[Callable[[], bytes], ...] = (zstd_10gb, zstd_10gb_told_as_1_mb, lz4_10gb,
    lz4_10gb_told_as_1_mb, declared_2_to_the_60, channels_1e6, channels_65e3_with_index, empty_messages_1e7,
    attachment_2gb, class_name_10mb)  # fmt: skip


def write_bomb(path: Path, make: Callable[[], bytes]) -> None:
    if make is not attachment_2gb:
        path.write_bytes(make())
        return
    size = 2 * GIGABYTE
    head = encoded(Attachment(1, 1, "big", "x", b""))[: -4 - 8]  # without the size and the checksum of its content
    head = head[:1] + struct.pack("<Q", len(head) - 9 + 8 + size + 4) + head[9:] + struct.pack("<Q", size)
    with path.open("wb") as stream:
        stream.write(_START + head)
        stream.seek(size + 4, os.SEEK_CUR)
        stream.write(encoded(Channel(1, "/topic", "json", {}, 0), MessageRecord(1, 5, b"", 5, 0)) + _END)


def main() -> int:
    """Exit code 1 if one took more than 300 MB."""
    print(f"{'bomb':32} {'file':>9} {'peak':>8} {'time':>7}  what it says")
    worst_mb = 0.0
    for make in BOMBS:
        with tempfile.TemporaryDirectory(prefix="bombs-") as folder:
            path = Path(folder) / "bomb.mcap"
            with ProcessPoolExecutor(1) as apart:  # the memory that it took would count as that of the command
                apart.submit(write_bomb, path, make).result()
            command = [sys.executable, "-m", "tools.cli", "info", str(path)]
            child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
            assert child.stderr is not None
            said, size = child.stderr.read().decode(errors="replace").strip(), f"{path.stat().st_size / 1e6:.2f} MB"
            _, status, usage = os.wait4(child.pid, 0)
        megabytes, seconds = usage.ru_maxrss * 1024 / 1e6, usage.ru_utime + usage.ru_stime
        worst_mb = max(worst_mb, megabytes)
        line = said.replace(str(path), "LOG").replace("\n", " | ")[:150]
        print(f"{make.__name__:32} {size:>9} {megabytes:5.0f} MB {seconds:5.1f} s  exit "
              f"{os.waitstatus_to_exitcode(status)} {line}", flush=True)  # fmt: skip
    return int(worst_mb > 300.0)


if __name__ == "__main__":
    sys.exit(main())
