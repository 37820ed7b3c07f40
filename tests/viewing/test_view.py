"""The live page in a real browser, served by the command."""

import io
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest
from matplotlib.image import imread
from oracles.browser import open_page

# Where the tests run in the background, Ctrl-C is ignored, and what they start inherits that.
COMMAND = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "from qp_twist.cli import main; main()"
)
SIZE = (1000, 460)
CANVAS = slice(350, 670)  # columns between the two panels


@contextmanager
def viewed(*arguments):
    """The command as a process; yields it and the page's address, and ends it by Ctrl-C."""
    process = subprocess.Popen(
        [sys.executable, "-c", COMMAND, "view", *arguments, "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"},
    )
    guard = threading.Timer(240.0, process.kill)
    guard.start()
    try:
        line = process.stdout.readline()
        found = re.search(r"http://\S+", line)
        if found is None:
            raise AssertionError(line + process.communicate()[1])
        yield process, found[0]
    finally:
        guard.cancel()
        if process.poll() is None:
            process.kill()
        process.communicate()


def links(page):
    """How many pixels of the picture between the panels have the blue of the planar arm's links."""
    picture = imread(io.BytesIO(page.screenshot(timeout=90_000)), format="png")[:, CANVAS, :3]
    red, green, blue = np.moveaxis(picture, -1, 0)
    return int(((blue > red + 0.1) & (blue > green + 0.03)).sum())


def marks(page):
    """Where the joints stand on their bars, by name."""
    return {
        row.get_attribute("data-bar"): float(row.locator(".track").get_attribute("data-x"))
        for row in page.locator(".qt-bars [data-bar]").all()
    }


def test_the_page_shows_the_robot_and_its_bars_move_when_scrubbed():
    with open_page(SIZE) as opened, viewed("planar_line", "--method", "twa") as (process, url):
        page = opened.page
        page.set_default_timeout(60_000)
        opened.go(url)
        # The method's own sentence: its run has been computed.
        page.wait_for_selector("text=twa: leaves the limits")
        # Where software draws, a notice says so, over the scene.
        page.add_style_tag(content=".mantine-Notifications-root { display: none }")
        seen, until = 0, time.monotonic() + 60.0
        while seen < 1500 and time.monotonic() < until:  # the scene fades in
            time.sleep(1.0)
            seen = links(page)
        assert seen >= 1500
        before = marks(page)
        assert set(before) == {"joint_1", "joint_2", "joint_3"}
        waypoint = page.get_by_role("slider").first
        waypoint.focus()
        for _ in range(3):
            page.keyboard.press("ArrowRight")  # with the keys alone
        page.wait_for_function(
            "x => document.querySelector('[data-bar=joint_1] .track').dataset.x != x",
            arg=f"{before['joint_1']:.2f}",
        )
        after = marks(page)
        assert all(after[name] != before[name] for name in before)
        assert page.locator(".qt-bars [data-state=outside]").count() > 0
        assert page.locator("svg.qt-dial").count() == 1
        assert opened.errors == []
        assert opened.requests
        foreign = [r for r in opened.requests if not r.startswith((url, url.replace("http", "ws")))]
        assert foreign == []
        # Another address of the same machine finds nobody.
        port = int(url.rsplit(":", 1)[1])
        with pytest.raises(OSError), socket.create_connection(("127.0.0.2", port), timeout=10.0):
            pass
        process.send_signal(signal.SIGINT)
        rest, error = process.communicate(timeout=30.0)
        assert (process.returncode, rest, error) == (0, "ended.\n", "")
