"""Files: read only if they are regular ones, written whole or not at all."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from qp_twist.errors import InvalidInput

LARGEST = 500_000_000
"""Bytes; a file that is larger is refused before it fills the memory."""


def check_regular(path: Path, noun: str = "file") -> None:
    """Refuse what is no regular file, such as a pipe, which whoever reads it waits for without end.

    Args:
        path: What was given.
        noun: What it should be, for the message: ``"task file"``.

    Raises:
        InvalidInput: If there is no such file, it is a folder, a pipe, a socket, a device or larger
            than ``LARGEST``, or nothing can be known of it.
    """
    try:
        status = path.stat()
    except (FileNotFoundError, ValueError):  # a name that no file can have is a ValueError
        raise InvalidInput(f"{path}: there is no such {noun}; check the path.") from None
    except OSError as error:
        raise _unreadable(path, error) from None
    if stat.S_ISDIR(status.st_mode):
        raise InvalidInput(f"{path}: is a folder; give the {noun} in it.")
    if not stat.S_ISREG(status.st_mode):
        raise InvalidInput(
            f"{path}: is a pipe, a socket or a device; write what comes out of it to a file, and "
            "give that one."
        )
    if status.st_size > LARGEST:
        raise InvalidInput(
            f"{path}: has {status.st_size / 1e6:.0f} MB, and at most {LARGEST / 1e6:.0f} MB are "
            f"read; give a smaller {noun}."
        )


def read_bytes(path: Path, noun: str = "file") -> bytes:
    """The content of a regular file; see :func:`check_regular`."""
    check_regular(path, noun)
    try:
        return path.read_bytes()
    except OSError as error:
        raise _unreadable(path, error) from None


def read_text(path: Path, noun: str = "file") -> str:
    """The same of a text in UTF-8, with or without its mark."""
    try:
        return read_bytes(path, noun).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidInput(
            f"{path}: cannot be read: {error}; expected a {noun} in UTF-8."
        ) from None


def _unreadable(path: Path, error: OSError) -> InvalidInput:
    return InvalidInput(f"{path}: cannot be read ({error.strerror or error}); check the path.")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; what is there afterwards is renamed to ``path``.

    The temporary name ends as ``path`` does, for writers that look at the ending. After a failure
    there is neither a half-written file nor a temporary one, and an older file is as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}.", suffix=path.suffix)
    os.close(handle)
    unfinished = Path(name)
    try:
        yield unfinished
        unfinished.chmod(0o644)
        os.replace(unfinished, path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise


def write_atomically(path: Path, content: str | bytes) -> Path:
    """Write a text (UTF-8) or bytes to a temporary file in the same folder, then rename it."""
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
    return path
