"""The page: display of the session, and its controls."""

from __future__ import annotations

import threading
import time

import mink
import numpy as np

from qp_twist.pages.local_server import LocalServer
from qp_twist.viewing.controls import Controls
from qp_twist.viewing.one_run import Moment, Run
from qp_twist.viewing.panel import ReadingsPanel
from qp_twist.viewing.session import Session
from qp_twist.viewing.stage import Stage

RATE_HZ = 40.0
"""Clock: period of the dragged arm's steps and of the pictures, s."""
_READ_EVERY = 3
"""Number of clock ticks between two updates of the readings."""


class Page:
    """The page of one session.

    Attributes:
        session: The session that it shows.
        server: Its server.
        url: Its address.
        stage: The robot, the path and the target in space.
        controls: What a user may change.
    """

    def __init__(self, session: Session, port: int) -> None:
        """Serve the page; :meth:`run` updates it.

        Args:
            session: The session that it shows.
            port: A free port of this machine.
        """
        self.session = session
        self.server = LocalServer(port, label="qp-twist")
        self.url = self.server.url
        self.server.gui.configure_theme(
            control_width="medium", show_logo=False, show_share_button=False,
            brand_color=(0, 114, 178),
        )  # fmt: skip
        self.stage = Stage(self.server, session.task, session.handle)
        self._panel = ReadingsPanel(self.server.gui, session)
        self.controls = Controls(self.server, session, self.stage)
        self._drawn: tuple[Run | None, object] = (None, session.task)
        self._shown: Moment | None = None
        self._marked: mink.SE3 | None = None
        self._ticks = 0
        self._show(session.moment())

    def run(self, stop: threading.Event | None = None) -> None:
        """Update the page until ``stop`` is set, or Ctrl-C."""
        stop = stop or threading.Event()
        period = 1.0 / RATE_HZ
        before = time.monotonic()
        while not stop.is_set():
            now = time.monotonic()
            # After a pause the playback continues where it was, instead of jumping.
            self._show(self.session.tick(min(now - before, 4 * period)))
            before = now
            stop.wait(max(0.001, period - (time.monotonic() - now)))

    def _show(self, moment: Moment) -> None:
        session = self.session
        task, run = session.task, session.run  # another thread may replace them
        with self.server.atomic():
            drawn_run, drawn_task = self._drawn
            moved = self._shown is None or not np.array_equal(moment.q, self._shown.q)
            if task is not drawn_task:
                self.stage.draw_path(task)
            if moved or task is not drawn_task:
                self.stage.show(moment.q)
            if run is not drawn_run:
                self.stage.draw_trace(None if run is None else run.trace)
            self._drawn = (run, task)
            index = int(session.index)
            waypoint = task.waypoints[index]
            if waypoint is not self._marked:
                self.stage.mark(waypoint)
                self._marked = waypoint
            if self._ticks % _READ_EVERY == 0:
                self._panel.update(moment, self.stage.near)
                self.controls.update()
        self._shown = moment
        self._ticks += 1

    def close(self) -> None:
        """End the server and the session's worker."""
        self.session.close()
        self.server.stop()
