"""The panel of readings: what the arm does at the moment that is shown."""

from __future__ import annotations

import viser

from qp_twist.pages.near_pairs import NearPair
from qp_twist.viewing.bars import clearance_bar, joint_bars
from qp_twist.viewing.one_run import Moment
from qp_twist.viewing.readings import LEGEND, NEAR_LEGEND, heading, readings, sentence
from qp_twist.viewing.session import Session

_WRITTEN = ("status", "bars", "clearance", "readings")
"""What the panel consists of, from the top."""


class ReadingsPanel:
    """The panel of one session's page."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._session = session
        panel = gui.add_panel()
        with panel.add_tab(session.base.name):
            gui.add_html(heading(session.base.title))
            self._html = {name: gui.add_html("") for name in _WRITTEN}
            gui.add_html(LEGEND + (NEAR_LEGEND if session.base.clearances else ""))
        panel.expand()  # on a narrow page it is a section below the controls, closed otherwise
        panel.dock_left()
        panel.set_width(330)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(310)

    def update(self, moment: Moment, near: NearPair | None) -> None:
        """Show a moment, and the pair of shapes that is nearest in it."""
        session = self._session
        # Read each of them once: viser's threads and the worker may change them.
        arm, run, computing = session.arm, session.run, session.computing
        if arm is not None:
            text = f"in the hand, by {arm.method}: {moment.sentence}"
            wrong = not moment.sentence.startswith("solved")
        else:
            text = session.status()
            ok = run is not None and run.status == "ok"
            wrong = bool(session.problem) or not (ok or computing is not None)
        self._write("status", sentence(text, wrong=wrong))
        self._write("bars", joint_bars(session.ranges, moment.q, moment.binding))
        self._write("clearance", "" if near is None else clearance_bar(near))
        self._write("readings", readings(session.ranges, moment))

    def _write(self, name: str, content: str) -> None:
        if self._html[name].content != content:
            self._html[name].content = content
