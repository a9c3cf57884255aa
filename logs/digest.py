"""SHA-256, to name in an output what it was made from."""

import hashlib
import json
import os

from logs.errors import UnreadableLogError
from logs.storage.regular_file import AnyPath, open_regular


def file_sha256(path: AnyPath) -> str:
    """Hexadecimal SHA-256 of the file at ``path``, read in pieces.

    Raises:
        UnreadableLogError: the file cannot be read.
    """
    try:
        with open_regular(path) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise UnreadableLogError(f"cannot read {os.fspath(path)}: {error.strerror}; check the path") from error


def content_key(*parts: object) -> str:
    """A name for what is made from these parts, which JSON can hold; 64 bits tell any number of results apart."""
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]
