"""Take the pictures of pages that the documentation shows, in a real browser.

    python docs/make_screenshots.py [--out FOLDER]

Needs playwright and a Chromium (``playwright install chromium`` brings one). Apart from
``make_figures.py``, since no two machines draw a page alike to the pixel.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
from pathlib import Path

import qp_twist as qt

DOCS = Path(__file__).parent
LARGEST = 400_000
"""Bytes of a picture."""


def main() -> None:
    """Write the pictures into docs/figures, or below the folder given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DOCS / "figures", help="folder to write to")
    out = parser.parse_args().out
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        qt.compare("deburring").report(folder)
        shot(folder / "report.html", out / "report.png", (1100, 1300), wait_s=9.0)
        task = qt.load_task("deburring")
        run = qt.time_trajectory(qt.refine_trajectory(qt.follow(task)))
        made = qt.report(run, task, folder / "motion", file="deburring.json")
        shot(made.path, out / "motion_report.png", (1100, 1000), wait_s=9.0)


def shot(
    page: str | Path,
    out: Path,
    size: tuple[int, int],
    *,
    scroll_to: str | None = None,
    wait_s: float = 1.0,
) -> None:
    """Write a picture of a page as PNG, with few colours so that it stays small.

    Args:
        page: Address, or a file.
        out: PNG file to write.
        size: Width and height of the window, px.
        scroll_to: CSS selector of what is to stand at the top.
        wait_s: How long the page is left to itself before, s; a 3D scene needs 8.
    """
    from PIL import Image

    sys.path.insert(0, str(DOCS.parent / "tests"))
    from oracles.browser import browser_page

    with browser_page(size) as opened:
        opened.go(page)
        if scroll_to is not None:
            opened.page.locator(scroll_to).evaluate("element => element.scrollIntoView()")
        opened.page.wait_for_timeout(1000 * wait_s)
        for frame in opened.page.frames:  # the player's remark on a machine without a graphics card
            frame.add_style_tag(content=".mantine-Notifications-root { display: none; }")
        picture = Image.open(io.BytesIO(opened.page.screenshot(timeout=120_000)))
    out.parent.mkdir(parents=True, exist_ok=True)
    picture.convert("RGB").quantize(128).save(out, optimize=True)
    if out.stat().st_size > LARGEST:
        raise SystemExit(f"{out}: {out.stat().st_size} bytes, more than {LARGEST}.")


if __name__ == "__main__":
    main()
