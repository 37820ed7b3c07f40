"""What the benchmarks do with the pages that they make."""

from __future__ import annotations

from pathlib import Path

from qp_twist.files import write_atomically


def publish(text: str, file: Path | None) -> None:
    """Print a page, and write it where that is asked for."""
    print(text)
    if file is not None:
        write_atomically(file, text)
