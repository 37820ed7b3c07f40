"""The controls of the page, and what they do with the session."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import mink
import numpy as np
import viser

from qp_twist.drawing.palette import QUIET
from qp_twist.paths import METHODS
from qp_twist.qp import installed_solvers
from qp_twist.viewing.projectors import projector_choices
from qp_twist.viewing.session import Session
from qp_twist.viewing.settings import effective
from qp_twist.viewing.stage import Stage

_WEIGHTS = ("gradient", "paper", "natural")
_LIMITS = {"slow down": "scale", "come as close as they let it": "relax"}


class Controls:
    """The controls of one session's page.

    Attributes:
        path: Those of the folder "Path": play, slider, speed.
        method: Those of the folder "Method", named as the settings, and its title.
        hand: Those of the folder "Hand".
    """

    def __init__(self, gui: viser.GuiApi, session: Session, stage: Stage) -> None:
        """Add them to the page."""
        self._session, self._stage = session, stage
        self._progress = gui.add_progress_bar(0.0, animated=True, visible=False)
        self._slid = 0  # the waypoint, from 0, that the slider shows
        with gui.add_folder("Path"):
            self.path = self._add_path(gui)
        with gui.add_folder("Method"):
            self.method = self._add_method(gui)
        with gui.add_folder("Hand"):
            self.hand = self._add_hand(gui)
        with gui.add_folder("Picture"):
            shadows = gui.add_checkbox("Shadows", False, hint="slow without a graphics card")
            _on(shadows, stage.cast_shadows)
        self._add_keys(gui)
        self._enable()

    def update(self) -> None:
        """Show how far the session is: its waypoint, whether it plays, what it computes."""
        computing = self._session.computing  # read once: the worker may change it
        self._progress.visible = computing is not None
        if computing is not None:
            _set(self._progress, round(100.0 * computing[0], 1))
        # Where the run plays or a key moved on, and nowhere else: viser sets the slider's value
        # before its callback sets the session, and what is written in between would undo it.
        with self._session.lock:
            index = int(self._session.playback.index)
            if index != self._slid:
                self._slid = index
                _set(self.path.slider, index + 1)
        playing, play = self._session.playback.playing, self.path.play
        label = "Pause" if playing else "Play"
        if play.label != label:
            play.label = label
            play.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY

    def take_hand(self, take: bool) -> None:
        """Start to drag the tool from its present pose, or return to the run."""
        if take:
            pose = self._session.grasp()
            self._stage.target.position = pose.translation()
            self._stage.target.wxyz = pose.rotation().wxyz
        else:
            self._session.release()
        _set(self.hand.drag, take)
        self._stage.target.visible = take
        self._stage.waypoint.visible = not take
        self._enable()

    def _add_path(self, gui: viser.GuiApi) -> SimpleNamespace:
        session, count = self._session, len(self._session.task.waypoints)
        play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, hint="key P")
        play.on_click(lambda _: self._toggle_play())
        hint = "keys N (next) and B (back)"
        slider = gui.add_slider("Waypoint", 1, max(2, count), 1, initial_value=1, hint=hint)
        _on(slider, self._slide)
        initial, hint = int(session.playback.speed), "waypoints per second"
        speed = gui.add_slider("Speed [1/s]", 1, 200, 1, initial_value=initial, hint=hint)
        _on(speed, lambda value: setattr(session.playback, "speed", float(value)))
        return SimpleNamespace(play=play, slider=slider, speed=speed)

    def _add_method(self, gui: viser.GuiApi) -> SimpleNamespace:
        base, settings = self._session.base, self._session.settings
        method = gui.add_dropdown(
            "Method", tuple(base.method_names()), initial_value=settings.method
        )
        title = gui.add_html("")
        projector = gui.add_dropdown(
            "Task holds", tuple(projector_choices(base)), initial_value=settings.projector,
            hint="the projector T: what of the tool's pose counts",
        )  # fmt: skip
        solver = gui.add_dropdown(
            "Solver", tuple(sorted(installed_solvers())), initial_value=settings.solver
        )
        weight = gui.add_dropdown(
            "Centering",
            _WEIGHTS,
            hint="weight of the secondary: gradient of z, the paper's, or natural",
        )
        gain = gui.add_number(
            "Gain", settings.gain, min=0.0, max=1000.0, step=0.01,
            hint="of the secondary, per waypoint",
        )  # fmt: skip
        limits = gui.add_checkbox("Hold the limits", settings.limits, hint="key L")
        found = SimpleNamespace(
            method=method, projector=projector, solver=solver, weight=weight, gain=gain,
            limits=limits,
        )  # fmt: skip
        for name, handle in vars(found).items():
            _on(handle, partial(self._change, name))
        found.title = title
        return found

    def _add_hand(self, gui: viser.GuiApi) -> SimpleNamespace:
        session, stage = self._session, self._stage
        drag = gui.add_checkbox("Drag the tool", False, hint="key T")
        _on(drag, self.take_hand)
        hint = "what the arm does where the target does not fit"
        at_limits = gui.add_dropdown("At limits", tuple(_LIMITS), hint=hint)
        _on(at_limits, lambda value: session.at_limits(_LIMITS[value]))  # type: ignore[arg-type]
        part = gui.add_checkbox("Drag the workpiece", False)
        _on(part, lambda value: setattr(stage.workpiece, "visible", value))
        back = gui.add_button("Put the workpiece back", icon=viser.Icon.ARROW_BACK_UP)
        back.on_click(lambda _: self._put_back())

        # Coroutines keep the order of the drag events.
        @stage.target.on_update
        async def _(event: Any) -> None:
            session.drag(_pose(event.target))

        @stage.workpiece.on_update
        async def _(event: Any) -> None:
            session.place(_pose(event.target))

        return SimpleNamespace(drag=drag, at_limits=at_limits)

    def _add_keys(self, gui: viser.GuiApi) -> None:
        session = self._session
        commands: list[tuple[str, Any, Callable[[], None]]] = [
            ("Play or pause", "P", self._toggle_play),
            ("Next waypoint", "N", lambda: self._seek(int(session.playback.index) + 1)),
            ("Waypoint before", "B", lambda: self._seek(int(session.playback.index) - 1)),
            ("Limits on or off", "L", self._toggle_limits),
            ("Drag the tool, or back to the path", "T", self._toggle_hand),
        ]
        for label, key, action in commands:
            gui.add_command(label, hotkey=key).on_trigger(_calling(action))

    def _change(self, name: str, value: Any) -> None:
        self._session.change(**{name: value})
        self._enable()

    def _enable(self) -> None:
        """Show the settings; those without effect are grey."""
        settings, hand = self._session.settings, self._session.arm is not None
        self.method.title.content = (
            f'<div style="font-size:11px;color:{QUIET};padding:0 12px 4px">'
            f"{METHODS[settings.method].title}</div>"
        )
        changeable = effective(settings) | ({"solver", "limits"} if hand else set())
        for name in ("projector", "solver", "weight", "gain", "limits"):
            handle = getattr(self.method, name)
            handle.disabled = name not in changeable
            # "equal", a weight of other libraries, cannot be chosen.
            if name != "weight" or settings.weight in _WEIGHTS:
                _set(handle, getattr(settings, name))
        self.hand.at_limits.disabled = not hand
        for handle in vars(self.path).values():
            handle.disabled = hand

    def _slide(self, value: int) -> None:
        with self._session.lock:
            self._seek(value - 1)
            self._slid = int(self._session.playback.index)

    def _seek(self, index: int) -> None:
        self._session.playback.playing = False
        self._session.seek(index)

    def _toggle_play(self) -> None:
        if self._session.arm is None:
            playback = self._session.playback
            playback.playing = not playback.playing

    def _toggle_limits(self) -> None:
        if not self.method.limits.disabled:
            self._change("limits", not self._session.settings.limits)

    def _toggle_hand(self) -> None:
        self.take_hand(self._session.arm is None)

    def _put_back(self) -> None:
        self._session.put_back()
        self._stage.workpiece.position = self._session.handle
        self._stage.workpiece.wxyz = np.array([1.0, 0.0, 0.0, 0.0])


def _on(handle: Any, action: Callable[[Any], Any]) -> None:
    """Call an action with the value that a user gives a control; the page's own changes do not."""
    handle.on_update(lambda event: event.client and action(handle.value))


def _calling(action: Callable[[], None]) -> Callable[[Any], None]:
    return lambda _: action()


def _set(handle: Any, value: object) -> None:
    """Set the value of a control, if it differs."""
    if handle.value != value:
        handle.value = value


def _pose(handle: Any) -> mink.SE3:
    """Pose of a handle of the scene."""
    rotation = mink.SO3(np.array(handle.wxyz)).normalize()
    return mink.SE3.from_rotation_and_translation(rotation, np.array(handle.position))
