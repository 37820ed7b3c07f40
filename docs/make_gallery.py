"""Draw the pictures of the gallery, each by the script that the page shows.

    python docs/make_gallery.py [--out FOLDER]

Takes about half a minute. A picture is reduced to 64 colours, which line drawings do not miss, so
that the repository stays small.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import runpy
import sys
from pathlib import Path
from typing import Any

from PIL import Image

DOCS = Path(__file__).parent
sys.path.append(str(DOCS.parent / "examples"))  # the simulated robot
SCRIPTS = sorted((DOCS / "gallery").glob("[0-9][0-9]_*.py"))


def main() -> None:
    """Run every script of the gallery."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DOCS / "figures", help="folder to write to")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    for script in SCRIPTS:
        draw(script, picture := out / picture_name(script))
        print(f"wrote {picture}")


def picture_name(script: Path) -> str:
    """``gallery_03.png`` of ``03_free_roll.py``."""
    return f"gallery_{script.name[:2]}.png"


def draw(script: Path, picture: Path) -> dict[str, Any]:
    """Run a script as the reader would, and return what it has in its hands at its end."""
    arguments, sys.argv = sys.argv, [str(script), str(picture)]
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            found = runpy.run_path(str(script), run_name="__main__")
    finally:
        sys.argv = arguments
    with Image.open(picture) as drawn:
        reduced = drawn.convert("RGB").quantize(64)
    reduced.save(picture, optimize=True)
    return found


if __name__ == "__main__":
    main()
