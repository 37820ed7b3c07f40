"""What the benchmarks do with the pages that they make."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from qp_twist.files import write_atomically


def publish(text: str, file: Path | None) -> None:
    """Print a page, and write it where that is asked for."""
    print(text)
    if file is not None:
        write_atomically(file, text)


def command(about: str | None, lines: Callable[..., Iterable[str]], **defaults: Any) -> None:
    """The command line of a script that makes a page: its options, and ``--markdown FILE``.

    Args:
        about: What the script says of itself; its first line stands in the help.
        lines: Makes those of the page, given the options by name.
        defaults: Of the options.
    """
    parser = argparse.ArgumentParser(description=(about or "").partition("\n")[0])
    for name, default in defaults.items():
        parser.add_argument(f"--{name}", type=type(default), default=default)
    parser.add_argument("--markdown", type=Path, help="file to write the page to")
    options = vars(parser.parse_args())
    file = options.pop("markdown")
    publish("\n".join(lines(**options)) + "\n", file)
