"""The lines of a text file that somebody else wrote."""

from __future__ import annotations

import codecs
from pathlib import Path

from qp_twist.errors import InvalidInput
from qp_twist.files import read_bytes


def read_lines(path: Path) -> list[str]:
    """The lines of a file, without their ends; UTF-8, UTF-16 with its mark, or Latin-1.

    Raises:
        InvalidInput: If there is no such file, it cannot be read, is empty, or is no text.
    """
    content = read_bytes(path, "toolpath file")
    text = _decoded(path, content)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if not text.strip():
        raise InvalidInput(f"{path.name}: the file is empty.")
    return lines


def _decoded(path: Path, content: bytes) -> str:
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encodings = ["utf-16"]
    else:
        encodings = ["utf-8-sig", "latin-1"]
    for encoding in encodings:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        # A few form feeds are found in text; other control characters are not.
        if not any(ord(c) < 32 and c not in "\t\n\r\f\x1a" for c in set(text)):
            return text.replace("\x1a", "")
        break
    raise InvalidInput(f"{path.name}: this is no text file; a toolpath is read from CSV or APT-CL.")
