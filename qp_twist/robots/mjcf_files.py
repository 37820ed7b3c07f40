"""The files that an MJCF names: only regular ones are left to MuJoCo, which opens them itself."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from qp_twist.files import check_regular, is_folder, read_bytes

_FILE = re.compile(r"\bfile\w*\s*=\s*[\"']([^\"']+)[\"']")
_NESTED = re.compile(r"<\s*(?:include|model)\s[^>]*?\bfile\s*=\s*[\"']([^\"']+)[\"']")
_FOLDER = re.compile(r"\b(?:mesh|texture|asset)dir\s*=\s*[\"']([^\"']+)[\"']")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


def check_files(file: Path) -> None:
    """Refuse an MJCF that names a pipe, which MuJoCo would wait for, a device or a huge file.

    Meshes, textures, height fields, included files and attached models are looked for in each
    folder in which MuJoCo may look for them. A file that is missing is left to MuJoCo.

    Args:
        file: The MJCF.

    Raises:
        InvalidInput: If one of them is there and not a regular file.
    """
    texts: dict[Path, str] = {}
    waiting = [file]
    while waiting:
        at = waiting.pop()
        if at not in texts:
            texts[at] = _COMMENT.sub("", read_bytes(at).decode("utf-8", "replace"))
            waiting += _there({file.parent, at.parent}, _NESTED.findall(texts[at]))
    folders = {
        at.parent / name for at in [file, *texts] for text in texts.values()
        for name in ("", *_FOLDER.findall(text))
    }  # fmt: skip
    for text in texts.values():
        for place in _there(folders, _FILE.findall(text)):
            check_regular(place)


def _there(folders: Iterable[Path], names: Iterable[str]) -> Iterator[Path]:
    """The files of some names in some folders, also by their last part, as with ``strippath``."""
    for name in names:
        for part in dict.fromkeys((name, Path(name).name)):
            for place in (folder / part for folder in folders):
                if os.path.lexists(place) and not is_folder(place):
                    yield place
