"""Writes a log: records in, an MCAP file out that is either whole under its name, or partial under NAME.part."""

import contextlib
import os
from collections.abc import Iterator, Mapping
from functools import cache
from io import BufferedWriter, BytesIO, FileIO
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from logs.encoders import definition_of, encode
from logs.errors import InvalidRecordError, UnwritableLogError
from logs.messages import Record
from logs.storage.placement import check_replaceable, partial_path, put_in_place
from logs.storage.regular_file import AnyPath
from logs.topics import RawMessage, Schema
from logs.validation import LAST_NS

_ARRAY_MEDIA_TYPE = "application/x-npy"
_LIBRARY = "dslam"  # fixed: the library's own version must not change the bytes of a log


class LogWriter:
    """Writes records and raw messages to ``path``; a context manager.

    Everything goes to ``path`` + ".part" and is renamed when the ``with`` block ends without an exception, so that
    a file under its own name is always whole. The same calls give the same bytes: there is no wall clock, and ids
    count up in the order of first use.

    Args:
        path: the log to write; an existing file is replaced.
        refusals: exceptions that remove the partial file, because the input is of no use. Any other one leaves it,
            closed and readable, if it holds a message.

    Raises:
        UnwritableLogError: by every method, when the file cannot be created, written or finished.
    """

    def __init__(self, path: AnyPath, *, refusals: tuple[type[Exception], ...] = ()) -> None:
        self.path = Path(path)
        self._refusals = refusals
        self.partial_path = partial_path(self.path)
        check_replaceable(self.path)
        with _refusing(self.partial_path):
            self._stream = _OutputStream(FileIO(self.partial_path, "w"))
        try:
            # A killed run loses at most the chunk in progress; zstd finds enough to compress in small ones.
            self._writer = Writer(self._stream, chunk_size=256 * 1024, compression=CompressionType.ZSTD)
            self._writer.start(library=_LIBRARY)
        except BaseException as error:  # also a signal
            error.add_note(f"an empty log is left in {self.partial_path}")
            raise
        self._schema_id = cache(self._writer.register_schema)
        self._channel_id = cache(self._register_channel)

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self._finish()
            return
        # Whatever made the caller give up is the error to tell, not that the footer did not fit either.
        with contextlib.suppress(UnwritableLogError):
            self._writer.finish()  # type: ignore[no-untyped-call]
        with contextlib.suppress(OSError):
            self._stream.close()
        is_empty = isinstance(error, Exception) and not self._channel_id.cache_info().currsize
        if is_empty or isinstance(error, self._refusals):
            self.partial_path.unlink(missing_ok=True)
        else:
            error.add_note(f"what was written until then is left in {self.partial_path}")

    def write(self, topic: str, record: Record, log_time_ns: int | None = None) -> None:
        """Write ``record`` on ``topic`` at ``log_time_ns``, by default the stamp of the record.

        Raises:
            InvalidRecordError: no record, or a time or text that a log cannot hold.
        """
        message = encode(record)
        time_ns = int(record.stamp_ns if log_time_ns is None else log_time_ns)
        for each_ns in (record.stamp_ns, time_ns):
            if not 0 <= each_ns <= LAST_NS:
                raise InvalidRecordError(f"{topic}: a log cannot hold the time {each_ns} ns; times count up from 0")
        channel_id = self._channel_id(topic, "protobuf", definition_of(message.DESCRIPTOR), ())
        self._writer.add_message(channel_id, time_ns, message.SerializeToString(deterministic=True), time_ns)

    def write_raw(self, raw: RawMessage) -> None:
        """Copy a message of another log unchanged: topic, schema, times, sequence number and bytes."""
        channel = raw.channel
        metadata = tuple(sorted(channel.metadata.items()))
        channel_id = self._channel_id(channel.topic, channel.message_encoding, channel.schema, metadata)
        self._writer.add_message(channel_id, raw.log_time_ns, raw.data, raw.publish_time_ns, raw.sequence)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Store key-value text under ``name``, keys in sorted order. Writing one name twice stores both.

        Bytes of file names that are no UTF-8 are written out, as ``\\udcff``.
        """
        self._writer.add_metadata(
            name, {key: text.encode("utf-8", "backslashreplace").decode() for key, text in sorted(values.items())}
        )

    def add_array(self, name: str, array: NDArray[Any]) -> None:
        """Attach ``array`` in NumPy's file format, for :func:`logs.storage.arrays.read_arrays`.

        The media type ends in as many blanks as make its values begin at a multiple of 64 bytes in the file.
        """
        self.flush()
        payload = BytesIO()
        np.lib.format.write_array(payload, np.ascontiguousarray(array), allow_pickle=False)
        # Before the content stand opcode, length, two times, and the lengths of name, media type and content: 41 bytes.
        begin = self._stream.tell() + 41 + len(name.encode()) + len(_ARRAY_MEDIA_TYPE)
        media_type = _ARRAY_MEDIA_TYPE + " " * (-begin % np.lib.format.ARRAY_ALIGN)
        self._writer.add_attachment(0, 0, name, media_type, payload.getvalue())

    def flush(self) -> None:
        """Hand everything written so far to the operating system, so that a kill after this loses none of it."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def _finish(self) -> None:
        with _refusing(self.partial_path), self._stream:
            self._writer.finish()  # type: ignore[no-untyped-call]
            os.fsync(self._stream.fileno())
        try:
            put_in_place(self.partial_path, self.path)
            _sync_folder(self.path.parent)
        except OSError as error:
            raise UnwritableLogError(
                f"{self.partial_path} is complete but cannot be renamed to {self.path}: {error.strerror}"
            ) from error

    def _register_channel(
        self, topic: str, encoding: str, schema: Schema | None, metadata: tuple[tuple[str, str], ...]
    ) -> int:
        schema_id = 0 if schema is None else self._schema_id(*schema)
        return self._writer.register_channel(topic, encoding, schema_id, dict(metadata))


class _OutputStream(BufferedWriter):
    """A file for the MCAP library: every failure becomes our error, and every write reaches the system at once."""

    def write(self, data: Any) -> int:
        with _refusing(self.name):
            written = super().write(data)
            # The library hands over whole chunks, so this is rare; without it a killed run would lose finished chunks.
            self.flush()
        return written


@contextlib.contextmanager
def _refusing(path: str | Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UnwritableLogError(
            f"cannot write {path}: {error.strerror}; "
            "check that the folder exists, that it may be written to, and that the disk has room"
        ) from error


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
