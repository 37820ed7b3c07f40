"""The controls of the page, and what they do with the session."""

from __future__ import annotations

import io
import logging
import math
from typing import Any, NamedTuple

import mink
import numpy as np
import viser
from PIL import Image

from qp_twist.pages.local_server import LocalServer
from qp_twist.pages.roadmap import applies_to, roadmap_figure
from qp_twist.paths import METHODS
from qp_twist.viewing.projectors import projector_choices
from qp_twist.viewing.readings import note, sentence
from qp_twist.viewing.session import Session
from qp_twist.viewing.settings import WEIGHTS, method_choices, solver_choices
from qp_twist.viewing.stage import Stage

log = logging.getLogger(__name__)
_LIMITS = {"slow down": "scale", "come as close as they let it": "relax"}


class _PathControls(NamedTuple):
    """Those of the folder "Path"."""

    play: Any
    slider: Any
    speed: Any


class _MethodControls(NamedTuple):
    """Those of the folder "Method"."""

    method: Any
    title: Any
    projector: Any
    solver: Any
    weight: Any
    gain: Any
    limits: Any


class _HandControls(NamedTuple):
    """Those of the folders "Hand" and "Picture"."""

    hand: Any
    at_limits: Any
    part: Any
    back: Any
    shadows: Any


class Controls:
    """The controls of one session's page."""

    def __init__(self, server: LocalServer, session: Session, stage: Stage) -> None:
        """Add them to the page of ``server``."""
        self._session, self._stage = session, stage
        gui = server.gui
        self._progress = gui.add_progress_bar(0.0, animated=True, visible=False)
        self._path = _add_path(gui, session)
        self._method = _add_method(gui, session)
        self._hand = _add_hand(gui)
        self._slid = 0  # the waypoint, from 0, that the slider shows
        self._react()
        self._add_keys(server)
        self._enable()

    def update(self) -> None:
        """Show how far the session is: its waypoint, whether it plays, what it computes."""
        # Read once: the worker may change it.
        computing = self._session.computing
        self._progress.visible = computing is not None
        if computing is not None:
            _set(self._progress, round(100.0 * computing[0], 1))
        self._slide_along()
        playing, play = self._session.playing, self._path.play
        label = "Pause" if playing else "Play"
        if play.label != label:
            play.label = label
            play.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY

    def _react(self) -> None:
        """Callbacks of the controls. A change by the page itself has no client."""
        session, path, method, hand = self._session, self._path, self._method, self._hand

        def on(handle: Any, action: Any) -> None:
            def changed(event: Any) -> None:
                if event.client is None:
                    return
                if not _offered(handle):
                    log.warning("ignored a value of %s that it does not offer", handle.label)
                    return
                action(handle.value)

            handle.on_update(changed)

        on(path.slider, self._slide)
        on(path.speed, lambda value: setattr(session, "speed", float(value)))
        on(method.method, lambda value: self._change(method=value))
        on(method.projector, lambda value: self._change(projector=value))
        on(method.solver, lambda value: self._change(solver=value))
        on(method.weight, lambda value: self._change(weight=value))
        on(method.gain, lambda value: self._change(gain=float(value)))
        on(method.limits, lambda value: self._change(limits=value))
        on(hand.hand, self.take_hand)
        on(hand.at_limits, lambda value: session.at_limits(_LIMITS[value]))  # type: ignore[arg-type]
        on(hand.part, lambda value: setattr(self._stage.workpiece, "visible", value))
        on(hand.shadows, self._stage.cast_shadows)
        path.play.on_click(lambda _: self._toggle_play())
        hand.back.on_click(lambda _: self._put_back())
        # Coroutines keep the order of the drag events.
        self._stage.target.on_update(self._target_moved)
        self._stage.workpiece.on_update(self._workpiece_moved)

    def _add_keys(self, server: LocalServer) -> None:
        def command(label: str, key: Any, action: Any) -> None:
            server.gui.add_command(label, hotkey=key).on_trigger(lambda _: action())

        command("Play or pause", "P", self._toggle_play)
        command("Next waypoint", "N", lambda: self._seek(int(self._session.index) + 1))
        command("Waypoint before", "B", lambda: self._seek(int(self._session.index) - 1))
        command("Limits on or off", "L", self._toggle_limits)
        command("Drag the tool, or back to the path", "T", self._toggle_hand)

    def _change(self, **changes: Any) -> None:
        self._session.change(**changes)
        self._enable()

    def _enable(self) -> None:
        """Show only the controls that affect the method."""
        settings, method = self._session.settings, self._method
        method.title.content = note(METHODS[settings.method].title)
        _set(method.gain, settings.gain)
        _set(method.weight, _known(settings.weight))
        _set(method.limits, settings.limits)
        hand = self._session.arm is not None
        method.gain.disabled = not settings.has_gain
        method.weight.disabled = not settings.has_weight
        method.projector.disabled = not settings.has_projector
        method.solver.disabled = not (settings.has_solver or hand)
        method.limits.disabled = not (settings.has_limits or hand)
        self._hand.at_limits.disabled = not hand
        for handle in self._path:
            handle.disabled = hand

    def _slide(self, value: int) -> None:
        with self._session.lock:
            self._seek(value - 1)
            self._slid = int(self._session.index)

    def _slide_along(self) -> None:
        """Move the slider where the run plays or a key moved on.

        Nowhere else: viser sets the slider's value before its callback sets the session, and a page
        that wrote the session's waypoint back in between would undo what the user has just done.
        """
        with self._session.lock:
            index = int(self._session.index)
            if index != self._slid:
                self._slid = index
                _set(self._path.slider, index + 1)

    def _seek(self, index: int) -> None:
        self._session.playing = False
        self._session.seek(index)

    def _toggle_play(self) -> None:
        if self._session.arm is None:
            self._session.playing = not self._session.playing

    def _toggle_limits(self) -> None:
        if not self._method.limits.disabled:
            self._change(limits=not self._session.settings.limits)

    def _toggle_hand(self) -> None:
        self.take_hand(self._session.arm is None)

    def take_hand(self, take: bool) -> None:
        """Start to drag the tool from its present pose, or return to the run."""
        if take:
            pose = self._session.grasp()
            self._stage.target.position = pose.translation()
            self._stage.target.wxyz = pose.rotation().wxyz
        else:
            self._session.release()
        _set(self._hand.hand, take)
        self._stage.target.visible = take
        self._stage.waypoint.visible = not take
        self._enable()

    async def _target_moved(self, event: Any) -> None:
        pose = _pose(event.target)
        if pose is not None:
            self._session.drag(pose)

    async def _workpiece_moved(self, event: Any) -> None:
        pose = _pose(event.target)
        if pose is not None:
            self._session.place(pose)

    def _put_back(self) -> None:
        self._session.put_back()
        self._stage.workpiece.position = self._session.handle
        self._stage.workpiece.wxyz = np.array([1.0, 0.0, 0.0, 0.0])


def _add_path(gui: viser.GuiApi, session: Session) -> _PathControls:
    count = len(session.task.waypoints)
    with gui.add_folder("Path"):
        play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, hint="key P")
        slider = gui.add_slider(
            "Waypoint", min=1, max=max(2, count), step=1, initial_value=1,
            hint="keys N (next) and B (back)",
        )  # fmt: skip
        speed = gui.add_slider(
            "Speed [1/s]", min=1, max=200, step=1, initial_value=int(session.speed),
            hint="waypoints per second",
        )  # fmt: skip
        _RoadmapButton(gui, session)
    return _PathControls(play, slider, speed)


def _add_method(gui: viser.GuiApi, session: Session) -> _MethodControls:
    settings = session.settings
    with gui.add_folder("Method"):
        method = gui.add_dropdown(
            "Method", tuple(method_choices(session.base)), initial_value=settings.method
        )
        title = gui.add_html("")
        projector = gui.add_dropdown(
            "Task holds", tuple(projector_choices(session.base)),
            initial_value=settings.projector,
            hint="the projector T: what of the tool's pose counts",
        )  # fmt: skip
        solver = gui.add_dropdown("Solver", tuple(solver_choices()), initial_value=settings.solver)
        weight = gui.add_dropdown(
            "Centring", WEIGHTS, initial_value=_known(settings.weight),
            hint="weight of the secondary: gradient of z, the paper's, or natural",
        )  # fmt: skip
        gain = gui.add_number(
            "Gain", initial_value=settings.gain, min=0.0, max=1000.0, step=0.01,
            hint="of the secondary, per waypoint",
        )  # fmt: skip
        limits = gui.add_checkbox("Hold the limits", initial_value=settings.limits, hint="key L")
    return _MethodControls(method, title, projector, solver, weight, gain, limits)


def _add_hand(gui: viser.GuiApi) -> _HandControls:
    with gui.add_folder("Hand"):
        hand = gui.add_checkbox("Drag the tool", initial_value=False, hint="key T")
        at_limits = gui.add_dropdown(
            "At limits", tuple(_LIMITS), hint="what the arm does where the target does not fit"
        )
        part = gui.add_checkbox("Drag the workpiece", initial_value=False)
        back = gui.add_button("Put the workpiece back", icon=viser.Icon.ARROW_BACK_UP)
    with gui.add_folder("Picture"):
        shadows = gui.add_checkbox(
            "Shadows", initial_value=False, hint="slow without a graphics card"
        )
    return _HandControls(hand, at_limits, part, back, shadows)


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
