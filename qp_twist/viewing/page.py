"""The page: display of the session, and its controls."""

from __future__ import annotations

import io
import logging
import math
import threading
import time
from typing import Any

import mink
import numpy as np
import viser
from PIL import Image

from qp_twist.pages.local_server import LocalServer
from qp_twist.pages.roadmap import applies_to, roadmap_figure
from qp_twist.paths import METHODS
from qp_twist.viewing.bars import clearance_bar, joint_bars
from qp_twist.viewing.one_run import Moment, Run
from qp_twist.viewing.projectors import projector_choices
from qp_twist.viewing.readings import LEGEND, NEAR_LEGEND, heading, note, readings, sentence
from qp_twist.viewing.session import Session
from qp_twist.viewing.settings import WEIGHTS, method_choices, solver_choices
from qp_twist.viewing.stage import Stage

RATE_HZ = 40.0
"""Clock: period of the dragged arm's steps and of the pictures, s."""
_READ_EVERY = 3
"""Number of clock ticks between two updates of the readings."""
log = logging.getLogger(__name__)
_WRITTEN = ("status", "bars", "clearance", "readings")
"""What the panel of readings consists of, from the top."""
_LIMITS = {"slow down": "scale", "come as close as they let it": "relax"}


class Page:
    """The page of one session.

    Attributes:
        url: Its address.
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
        self._drawn: tuple[Run | None, object] = (None, session.task)
        self._shown: Moment | None = None
        self._marked: mink.SE3 | None = None
        self._texts: dict[str, str] = {}
        self._ticks = 0
        self._slid = 0  # the waypoint, from 0, that the slider shows
        self._add_readings()
        self._add_controls()
        self._add_keys()
        self._enable()
        self._show(session.moment())

    # Readings

    def _add_readings(self) -> None:
        gui = self.server.gui
        panel = gui.add_panel()
        with panel.add_tab(self.session.base.name):
            gui.add_html(heading(self.session.base.title))
            self._html = {name: gui.add_html("") for name in _WRITTEN}
            gui.add_html(LEGEND + (NEAR_LEGEND if self.session.base.clearances else ""))
        panel.expand()  # on a narrow page it is a section below the controls, closed otherwise
        panel.dock_left()
        panel.set_width(330)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(310)

    def _read(self, moment: Moment) -> None:
        session = self.session
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
        near = self.stage.near
        self._write("clearance", "" if near is None else clearance_bar(near))
        self._write("readings", readings(session.ranges, moment))
        self._progress.visible = computing is not None
        if computing is not None:
            _set(self._progress, round(100.0 * computing[0], 1))

    def _write(self, name: str, content: str) -> None:
        if self._texts.get(name) != content:
            self._texts[name] = self._html[name].content = content

    # Controls

    def _add_controls(self) -> None:
        gui, session = self.server.gui, self.session
        settings, count = session.settings, len(session.task.waypoints)
        self._progress = gui.add_progress_bar(0.0, animated=True, visible=False)
        with gui.add_folder("Path"):
            self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, hint="key P")
            self._slider = gui.add_slider(
                "Waypoint", min=1, max=max(2, count), step=1, initial_value=1,
                hint="keys N (next) and B (back)",
            )  # fmt: skip
            self._speed = gui.add_slider(
                "Speed [1/s]", min=1, max=200, step=1, initial_value=int(session.speed),
                hint="waypoints per second",
            )  # fmt: skip
            _RoadmapButton(gui, session)
        with gui.add_folder("Method"):
            self._method = gui.add_dropdown(
                "Method", tuple(method_choices(session.base)), initial_value=settings.method
            )
            self._title = gui.add_html("")
            self._projector = gui.add_dropdown(
                "Task holds", tuple(projector_choices(session.base)),
                initial_value=settings.projector,
                hint="the projector T: what of the tool's pose counts",
            )  # fmt: skip
            self._solver = gui.add_dropdown(
                "Solver", tuple(solver_choices()), initial_value=settings.solver
            )
            self._weight = gui.add_dropdown(
                "Centring", WEIGHTS, initial_value=_known(settings.weight),
                hint="weight of the secondary: gradient of z, the paper's, or natural",
            )  # fmt: skip
            self._gain = gui.add_number(
                "Gain", initial_value=settings.gain, min=0.0, max=1000.0, step=0.01,
                hint="of the secondary, per waypoint",
            )  # fmt: skip
            self._limits = gui.add_checkbox(
                "Hold the limits", initial_value=settings.limits, hint="key L"
            )
        with gui.add_folder("Hand"):
            self._hand = gui.add_checkbox("Drag the tool", initial_value=False, hint="key T")
            self._at_limits = gui.add_dropdown(
                "At limits", tuple(_LIMITS), hint="what the arm does where the target does not fit"
            )
            self._part = gui.add_checkbox("Drag the workpiece", initial_value=False)
            self._back = gui.add_button("Put the workpiece back", icon=viser.Icon.ARROW_BACK_UP)
        with gui.add_folder("Picture"):
            self._shadows = gui.add_checkbox(
                "Shadows", initial_value=False, hint="slow without a graphics card"
            )
        self._react()

    def _react(self) -> None:
        """Callbacks of the controls. A change by the page itself has no client."""
        session = self.session

        def on(handle: Any, action: Any) -> None:
            def changed(event: Any) -> None:
                if event.client is None:
                    return
                if not _offered(handle):
                    log.warning("ignored a value of %s that it does not offer", handle.label)
                    return
                action(handle.value)

            handle.on_update(changed)

        on(self._slider, self._slide)
        on(self._speed, lambda value: setattr(session, "speed", float(value)))
        on(self._method, lambda value: self._change(method=value))
        on(self._projector, lambda value: self._change(projector=value))
        on(self._solver, lambda value: self._change(solver=value))
        on(self._weight, lambda value: self._change(weight=value))
        on(self._gain, lambda value: self._change(gain=float(value)))
        on(self._limits, lambda value: self._change(limits=value))
        on(self._hand, self.take_hand)
        on(self._at_limits, lambda value: session.at_limits(_LIMITS[value]))  # type: ignore[arg-type]
        on(self._part, lambda value: setattr(self.stage.workpiece, "visible", value))
        on(self._shadows, self.stage.cast_shadows)
        self._play.on_click(lambda _: self._toggle_play())
        self._back.on_click(lambda _: self._put_back())
        # Coroutines keep the order of the drag events.
        self.stage.target.on_update(self._target_moved)
        self.stage.workpiece.on_update(self._workpiece_moved)

    def _add_keys(self) -> None:
        def command(label: str, key: Any, action: Any) -> None:
            self.server.gui.add_command(label, hotkey=key).on_trigger(lambda _: action())

        command("Play or pause", "P", self._toggle_play)
        command("Next waypoint", "N", lambda: self._seek(int(self.session.index) + 1))
        command("Waypoint before", "B", lambda: self._seek(int(self.session.index) - 1))
        command("Limits on or off", "L", self._toggle_limits)
        command("Drag the tool, or back to the path", "T", self._toggle_hand)

    def _change(self, **changes: Any) -> None:
        self.session.change(**changes)
        self._enable()

    def _enable(self) -> None:
        """Show only the controls that affect the method."""
        settings = self.session.settings
        self._title.content = note(METHODS[settings.method].title)
        _set(self._gain, settings.gain)
        _set(self._weight, _known(settings.weight))
        _set(self._limits, settings.limits)
        hand = self.session.arm is not None
        self._gain.disabled = not settings.has_gain
        self._weight.disabled = not settings.has_weight
        self._projector.disabled = not settings.has_projector
        self._solver.disabled = not (settings.has_solver or hand)
        self._limits.disabled = not (settings.has_limits or hand)
        self._at_limits.disabled = not hand
        for handle in (self._play, self._slider, self._speed):
            handle.disabled = hand

    def _slide(self, value: int) -> None:
        with self.session.lock:
            self._seek(value - 1)
            self._slid = int(self.session.index)

    def _slide_along(self) -> None:
        """Move the slider where the run plays or a key moved on.

        Nowhere else: viser sets the slider's value before its callback sets the session, and a page
        that wrote the session's waypoint back in between would undo what the user has just done.
        """
        with self.session.lock:
            index = int(self.session.index)
            if index != self._slid:
                self._slid = index
                _set(self._slider, index + 1)

    def _seek(self, index: int) -> None:
        self.session.playing = False
        self.session.seek(index)

    def _toggle_play(self) -> None:
        if self.session.arm is None:
            self.session.playing = not self.session.playing

    def _toggle_limits(self) -> None:
        if not self._limits.disabled:
            self._change(limits=not self.session.settings.limits)

    def _toggle_hand(self) -> None:
        self.take_hand(self.session.arm is None)

    def take_hand(self, take: bool) -> None:
        """Start to drag the tool from its present pose, or return to the run."""
        if take:
            pose = self.session.grasp()
            self.stage.target.position = pose.translation()
            self.stage.target.wxyz = pose.rotation().wxyz
        else:
            self.session.release()
        _set(self._hand, take)
        self.stage.target.visible = take
        self.stage.waypoint.visible = not take
        self._enable()

    async def _target_moved(self, event: Any) -> None:
        pose = _pose(event.target)
        if pose is not None:
            self.session.drag(pose)

    async def _workpiece_moved(self, event: Any) -> None:
        pose = _pose(event.target)
        if pose is not None:
            self.session.place(pose)

    def _put_back(self) -> None:
        self.session.put_back()
        self.stage.workpiece.position = self.session.handle
        self.stage.workpiece.wxyz = np.array([1.0, 0.0, 0.0, 0.0])

    # The clock

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
                self._read(moment)
                self._slide_along()
                label = "Pause" if session.playing else "Play"
                if self._play.label != label:
                    self._play.label = label
                    self._play.icon = (
                        viser.Icon.PLAYER_PAUSE if session.playing else viser.Icon.PLAYER_PLAY
                    )
        self._shown = moment
        self._ticks += 1

    def close(self) -> None:
        """End the server and the session's worker."""
        self.session.close()
        self.server.stop()


class _RoadmapButton:
    """Draws the roadmap with the run, in viser's thread of the click, in a window of its own.

    For the present placement of the workpiece and the run's projector.
    """

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._gui, self._session = gui, session
        self._panel: viser.PanelHandle | None = None
        self._button = gui.add_button(
            "Roadmap", icon=viser.Icon.MAP, visible=applies_to(session.base),
            hint="what the limits leave of the free motion along the path; takes seconds",
        )  # fmt: skip
        self._button.on_click(lambda _: self._draw())

    def _draw(self) -> None:
        run = self._session.run
        if run is None or self._button.disabled:
            return
        self._button.disabled, self._button.label = True, "Drawing the roadmap"
        trajectory, buffer, problem = run.trajectory, io.BytesIO(), ""
        try:
            figure = roadmap_figure(trajectory.path_task, {trajectory.method: trajectory})
            figure.savefig(buffer, format="png", dpi=100)
        except mink.MinkError as error:
            problem = str(error)
        if self._panel is not None:
            self._panel.remove()
        self._panel = panel = self._gui.add_panel()
        with panel.add_tab("Roadmap"):
            if problem:
                self._gui.add_html(sentence(problem, wrong=True))
            else:
                pixels = np.asarray(Image.open(buffer).convert("RGB"))
                self._gui.add_image(pixels, label=f"with {trajectory.method}", format="png")
        panel.float(x=15, y=15, width=760)
        self._button.disabled, self._button.label = False, "Roadmap"


def _set(handle: Any, value: object) -> None:
    """Set the value of a control, if it differs."""
    if handle.value != value:
        handle.value = value


def _known(weight: str) -> str:
    """A weight for the dropdown; "equal" (other libraries only) cannot be chosen."""
    return weight if weight in WEIGHTS else WEIGHTS[0]


def _offered(handle: Any) -> bool:
    """Whether a control's value is one of its options; a message may contain others."""
    value = handle.value
    if hasattr(handle, "options"):
        return value in handle.options
    if hasattr(handle, "min"):
        return bool(handle.min <= value <= handle.max)
    return True


def _pose(handle: Any) -> mink.SE3 | None:
    """Pose of a handle of the scene; ``None`` if its message had no pose."""
    numbers = [*np.ravel(handle.wxyz).tolist(), *np.ravel(handle.position).tolist()]
    try:
        fits = len(numbers) == 7 and all(map(math.isfinite, numbers)) and any(numbers[:4])
    except TypeError:  # not numbers
        fits = False
    if not fits:
        log.warning("ignored a message of the page (no pose for %s)", handle.name)
        return None
    wxyz, position = np.array(numbers[:4]), np.array(numbers[4:])
    return mink.SE3.from_rotation_and_translation(mink.SO3(wxyz).normalize(), position)
