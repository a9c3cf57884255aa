"""``python -m tests.fuzz.bombs``: files that are much larger inside than outside, and what ``dslam info`` says."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, McapRecord
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
    head = RecordBuilder()
    for time_ns in (1, 1):
        head.write8(time_ns)
    for text in ("big", "x"):
        head.write_prefixed_string(text)
    head.write8(size)
    start = RecordBuilder()
    start.write1(Opcode.ATTACHMENT)
    start.write8(head.count + size + 4)
    with path.open("wb") as stream:
        stream.write(_START + start.end() + head.end())
        stream.seek(size + 4, os.SEEK_CUR)
        stream.write(encoded(Channel(1, "/topic", "json", {}, 0), MessageRecord(1, 5, b"", 5, 0)) + _END)


def main() -> int:
    print(f"{'bomb':32} {'file':>9} {'peak':>8} {'time':>7}  what it says")
    worst = 0
    with tempfile.TemporaryDirectory(prefix="bombs-") as folder:
        for make in BOMBS:
            path = Path(folder) / "bomb.mcap"
            _write_apart(path, make)
            worst = max(worst, _measure(make.__name__, path))
            path.unlink()
    return int(worst > 300)


def _write_apart(path: Path, make: Callable[[], bytes]) -> None:
    """In a process of its own: the memory that this one had would be counted as that of the command."""
    child = os.fork()
    if child == 0:
        write_bomb(path, make)
        os._exit(0)
    os.waitpid(child, 0)


def _measure(name: str, path: Path) -> int:
    """Run the command; returns its largest memory in MB."""
    child = subprocess.Popen(
        [sys.executable, "-m", "tools.cli", "info", str(path)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert child.stderr is not None
    said = child.stderr.read().decode(errors="replace").strip()
    _, status, usage = os.wait4(child.pid, 0)
    megabytes = round(usage.ru_maxrss * 1024 / 1e6)
    code, seconds = os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime
    line = said.replace(str(path), "LOG").replace("\n", " | ")[:150]
    size = f"{path.stat().st_size / 1e6:.2f} MB"
    print(f"{name:32} {size:>9} {megabytes:5d} MB {seconds:5.1f} s  exit {code} {line}", flush=True)
    return megabytes


if __name__ == "__main__":
    sys.exit(main())
