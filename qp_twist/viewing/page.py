"""The page: display of the session, and its controls."""

from __future__ import annotations

import threading
import time
import warnings

from qp_twist.kinematics import JointRanges
from qp_twist.pages.local_server import LocalServer
from qp_twist.viewing.controls import Controls
from qp_twist.viewing.one_run import Moment
from qp_twist.viewing.panel import panel_html, status_html
from qp_twist.viewing.session import Session
from qp_twist.viewing.stage import Stage

RATE_HZ = 40.0
"""Steps of the dragged arm, and pictures, per second."""
_READ_EVERY = 3
"""Number of pictures between two updates of the readings."""


class Page:
    """The page of one session.

    Attributes:
        session: The session that it shows.
        server: Its server.
        stage: The robot, the path and the target in space.
        controls: What a user may change.
    """

    def __init__(self, session: Session, port: int | None) -> None:
        """Serve the page at a port, the first free one if ``None``; :meth:`run` updates it."""
        self.session = session
        self.server = LocalServer(port, label="qp-twist")
        gui = self.server.gui
        gui.configure_theme(
            control_width="medium", show_logo=False, show_share_button=False,
            brand_color=(0, 114, 178),
        )  # fmt: skip
        self.stage = Stage(self.server, session.task, session.handle)
        panel = gui.add_panel()
        with panel.add_tab(session.base.name):
            self._status, self._readings = gui.add_html(""), gui.add_html("")
        panel.expand()  # on a narrow page it is a section below the controls, closed otherwise
        panel.dock_left()
        panel.set_width(330)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(310)
        self.controls = Controls(gui, session, self.stage)
        self._ranges = JointRanges.of(session.base.model)
        self._drawn: dict[str, object] = {"task": session.task}
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
        task, run = self.session.task, self.session.run  # another thread may replace them
        waypoint = task.waypoints[int(self.session.playback.index)]
        with self.server.atomic():
            placed = self._changed("task", task)
            if placed:
                self.stage.draw_path(task)
            if self._changed("q", tuple(moment.q.tolist())) or placed:
                self.stage.scene.show(moment.q)
            if self._changed("run", run):
                self.stage.draw_trace(None if run is None else run.trace)
            if self._changed("waypoint", waypoint):
                self.stage.mark(waypoint)
            if self._ticks % _READ_EVERY == 0:
                text, wrong = self.session.status(moment)
                status = status_html(self.session.base.title, text, wrong=wrong)
                if self._changed("status", status):
                    self._status.content = status
                readings = panel_html(self._ranges, moment, self.stage.scene.near)
                if self._changed("readings", readings):
                    self._readings.content = readings
                self.controls.update()
        self._ticks += 1

    def _changed(self, name: str, value: object) -> bool:
        """Whether something is another one than was drawn last."""
        drawn, self._drawn[name] = self._drawn.get(name), value
        return not (drawn is value or (isinstance(value, (str, tuple)) and drawn == value))

    def close(self) -> None:
        """End the server and the session's worker."""
        self.session.close()
        self.stop()

    def stop(self) -> None:
        """End the server; viser warns of every slider that was moved at that moment."""
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
        self.server.stop()
