"""Files: only regular ones are read; writing is atomic."""

from __future__ import annotations

import contextlib
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from qp_twist.errors import InvalidInput

LARGEST_FILE = 500_000_000
"""Largest file that is read, bytes; larger ones would fill the memory."""


inputs: ContextVar[set[Path] | None] = ContextVar("inputs", default=None)
"""The files that a command has read, onto which it does not write."""


def file_path(argument: str, value: object) -> Path:
    """A path that was passed as an argument.

    Raises:
        InvalidInput: If it is neither a str nor a Path.
    """
    if isinstance(value, (str, Path)):
        return Path(value)
    raise InvalidInput(f"expected a str or a Path, got {type(value).__name__}.", key=argument)


def check_regular(path: Path, noun: str = "file", *, largest: float = LARGEST_FILE) -> None:
    """Refuse what is no regular file, such as a pipe, which would block the reader.

    Raises:
        InvalidInput: If there is no such ``noun``, it is a folder, a pipe, a socket, a device
            or larger than ``largest`` bytes, or cannot be accessed.
    """
    try:
        status = path.stat()
    except (FileNotFoundError, ValueError):  # an invalid file name raises ValueError
        raise InvalidInput(f"there is no such {noun}; check the path.", file=path) from None
    except OSError as error:
        raise _unreadable(path, error) from None
    if stat.S_ISDIR(status.st_mode):
        raise InvalidInput(f"is a folder; give the {noun} in it.", file=path)
    if not stat.S_ISREG(status.st_mode):
        raise InvalidInput(
            "is a pipe, a socket or a device; write what comes out of it to a file, and give that "
            "one.",
            file=path,
        )
    if status.st_size > largest:
        raise InvalidInput(
            f"has {status.st_size / 1e6:.0f} MB, and at most {largest / 1e6:.0f} MB are read; give "
            f"a smaller {noun}.",
            file=path,
        )
    read = inputs.get()
    if read is not None:
        read.add(path.resolve())


def is_folder(path: Path) -> bool:
    """Whether there is a folder; ``False`` also for a name that no file can have."""
    return os.path.isdir(path)  # noqa: PTH112


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
            f"cannot be read: {error}; expected a {noun} in UTF-8.", file=path
        ) from None


def _unreadable(path: Path, error: OSError) -> InvalidInput:
    return InvalidInput(f"cannot be read ({error.strerror or error}); check the path.", file=path)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; the file there is then renamed to ``path``.

    The temporary name has the suffix of ``path``, which some writers need. After a failure there is
    neither a partial nor a temporary file, and an older file is unchanged. A new file has the
    permissions that the umask leaves, an older one keeps its own.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.stem[:20]}.{secrets.token_hex(6)}{path.suffix}")
    os.close(os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    try:
        yield unfinished
        with contextlib.suppress(FileNotFoundError):
            unfinished.chmod(stat.S_IMODE(path.stat().st_mode))
        os.replace(unfinished, path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise


def write_atomically(path: Path, content: str | bytes) -> Path:
    """Write a text (UTF-8) or bytes to a temporary file in the same folder, then rename it."""
    with whole_file(path) as unfinished:
        unfinished.write_bytes(
            printable(content).encode("utf-8") if isinstance(content, str) else content
        )
    return path


def printable(text: str) -> str:
    r"""A text that can be encoded: names of files may have bytes that are not UTF-8.

    Such a byte becomes ``\udcXX``, which JSON reads as Python's name of that file.
    """
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
