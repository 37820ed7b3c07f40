"""Take the picture of the live page (docs/figures/live_page.png) in a real browser."""

from __future__ import annotations

import io
import sys
import threading
import time
from pathlib import Path

import mink
import numpy as np
from PIL import Image

import qp_twist as qt
from qp_twist.viewing.page import Page
from qp_twist.viewing.session import Session
from qp_twist.viewing.settings import PageSettings

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent / "tests"))
from oracles.browser import browser_page  # noqa: E402

SIZE = (1280, 800)
REACH = np.array([0.0, -0.7, 0.5])
"""How far the target is dragged from the first waypoint, m: further than the limits allow."""


def main() -> None:
    """Drag the tool of the deburring robot out of reach, and take the picture."""
    task = qt.load_task("deburring")
    session = Session(task, PageSettings.of(task, "qp_minimum_norm"))
    page, stop = Page(session, None), threading.Event()
    clock = threading.Thread(target=page.run, args=(stop,))
    clock.start()
    try:
        session.runs.wait(session.key, 300.0)
        with browser_page(SIZE) as opened:
            opened.go(page.server.url)
            opened.page.wait_for_selector(".qt-bars")
            # Where software draws, a notice says so, over the scene.
            opened.page.add_style_tag(content=".mantine-Notifications-root { display: none }")
            page.controls.take_hand(True)
            assert session.arm is not None
            pose = session.arm.pose
            target = mink.SE3.from_rotation_and_translation(
                pose.rotation(), pose.translation() + REACH
            )
            session.drag(target)
            page.stage.target.position = target.translation()
            for _ in range(1000):  # until the arm has arrived
                session.tick(0.0)
            time.sleep(20.0)  # the scene fades in
            picture = opened.page.screenshot(timeout=120_000)
    finally:
        stop.set()
        clock.join()
        page.close()
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    image.save(DOCS / "figures" / "live_page.png", optimize=True)


if __name__ == "__main__":
    main()
