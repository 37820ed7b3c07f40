"""State of the live page: a task, its settings, and a run or an arm that the user drags."""

from __future__ import annotations

import dataclasses
import threading
import time
from typing import Any, Literal

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths import PathTask, placed, refuse_joint_moves
from qp_twist.viewing.live_arm import LiveArm
from qp_twist.viewing.one_run import Moment, Run, run_once
from qp_twist.viewing.runs import Runs
from qp_twist.viewing.settings import PageSettings

DEBOUNCE_S = 0.3
"""Delay, s, between the last move of the workpiece and the computation of its run."""


@dataclasses.dataclass
class Playback:
    """The waypoint that is shown, and how the run is played.

    Attributes:
        index: The waypoint, from 0; fractional while the run plays.
        playing: Whether the run is being played.
        speed: Waypoints per second.
    """

    index: float = 0.0
    playing: bool = False
    speed: float = 30.0

    def advance(self, dt: float, last: int) -> None:
        """Play on for ``dt`` seconds; behind the last waypoint begin again."""
        if self.playing:
            self.index += self.speed * dt
            if self.index > last:
                self.index = 0.0


class Session:
    """The state behind the page, independent of the browser.

    All methods may be called from any thread.

    Attributes:
        base: The task as its file states it.
        task: The task at the workpiece's current placement.
        settings: The user's settings.
        run: The run that is shown. While a new one is computed this is the previous one; ``None``
            before the first, and if the settings have no run.
        playback: The waypoint that is shown, and how the run is played.
        arm: The arm that the user drags; ``None`` while a run is shown.
        problem: Why the settings have no run; empty if they have one.
    """

    def __init__(self, path_task: PathTask, settings: PageSettings) -> None:
        refuse_joint_moves(path_task, "view")
        self.lock = threading.RLock()
        self.base = self.task = path_task
        self.settings = settings
        self.runs = Runs()
        self.run: Run | None = None
        self.playback = Playback()
        self.arm: LiveArm | None = None
        self.problem = ""
        self._on_infeasible: Literal["scale", "relax"] = "scale"
        self._placement: tuple[float, ...] = ()
        self._due: float | None = None
        self._request_run()

    # The workpiece

    @property
    def handle(self) -> Array:
        """The workpiece's handle point, in the task file's placement, m, (3,)."""
        placement = None if self.base.study is None else self.base.study.placement
        if placement is not None:
            return np.array(placement.point, dtype=np.float64)
        return np.asarray(0.5 * (self.base.positions.min(axis=0) + self.base.positions.max(axis=0)))

    def place(self, pose: mink.SE3) -> None:
        """Move the workpiece's handle to a pose; its run is computed :data:`DEBOUNCE_S` later.

        If the task cannot be placed there, only :attr:`problem` changes.
        """
        placement = None if self.base.study is None else self.base.study.placement
        body = None if placement is None else placement.body
        rotation, position = pose.rotation(), pose.translation()
        with self.lock:
            try:
                self.task = placed(self.base, rotation, self.handle, position, body)
            except InvalidInput as error:
                self.problem = str(error)
                return
            self._placement = tuple(np.round([*rotation.wxyz, *position], 9).tolist())
            self._due = time.monotonic() + DEBOUNCE_S

    def put_back(self) -> None:
        """Move the workpiece back to the task file's placement."""
        with self.lock:
            self.task, self._placement, self._due = self.base, (), None
            self._request_run()

    # The settings

    def change(self, **changes: Any) -> None:
        """Replace settings by name; a new method resets gain and weight to the task file's."""
        with self.lock:
            method = changes.get("method", self.settings.method)
            if method != self.settings.method:
                defaults = PageSettings.of(self.base, method)
                changes = {"gain": defaults.gain, "weight": defaults.weight, **changes}
            self.settings = dataclasses.replace(self.settings, **changes)
            self._request_run()
            self._renew_arm()

    @property
    def key(self) -> tuple[object, ...]:
        """All that the requested run depends on."""
        return (self.settings, self._placement)

    @property
    def computing(self) -> tuple[float, str] | None:
        """Progress of the computation, 0 to 1, and its current phase; ``None`` if it is done."""
        return (0.0, "waiting") if self._due is not None else self.runs.progress

    def _request_run(self) -> None:
        task, settings = self.task, self.settings
        self.problem = ""
        self.runs.request(self.key, lambda progress: run_once(task, settings, progress))

    # The dragged arm

    def grasp(self) -> mink.SE3:
        """Start to drag the arm from the configuration that is shown; return its frame's pose."""
        with self.lock:
            self.playback.playing = False
            self.arm = self._arm_at(self.moment().q)
            return self.arm.pose

    def release(self) -> None:
        """Stop dragging and show the run again."""
        with self.lock:
            self.arm = None

    def drag(self, target: mink.SE3) -> None:
        """Set the target of the dragged arm."""
        with self.lock:
            if self.arm is not None:
                self.arm.target = target

    def at_limits(self, what: Literal["scale", "relax"]) -> None:
        """Set what the dragged arm does where its target is infeasible."""
        with self.lock:
            self._on_infeasible = what
            self._renew_arm()

    def _arm_at(self, q: Array) -> LiveArm:
        return LiveArm(self.task, self.settings, q, on_infeasible=self._on_infeasible)

    def _renew_arm(self) -> None:
        """Let the dragged arm have the present settings, where it is."""
        if self.arm is not None:
            target = self.arm.target
            self.arm = self._arm_at(self.arm.configuration.q.copy())
            self.arm.target = target

    # The clock

    def seek(self, index: float) -> None:
        """Show a waypoint, from 0."""
        with self.lock:
            self.playback.index = float(np.clip(index, 0, len(self.task.waypoints) - 1))

    def tick(self, dt: float) -> Moment:
        """Advance by ``dt`` seconds and return what to show."""
        with self.lock:
            if self._due is not None and time.monotonic() >= self._due:
                self._due = None
                self._request_run()
            found = self.runs.get(self.key)
            if isinstance(found, str):
                self.problem, self.run = found, None
            elif found is not None:
                self.run = found
                self.playback.index = min(self.playback.index, len(found.trace) - 1.0)
            if self.arm is not None:
                return self.arm.step()
            if self.run is not None:
                self.playback.advance(dt, len(self.run.trace) - 1)
            return self.moment()

    def moment(self) -> Moment:
        """The state at the waypoint that is shown; at the start if there is no run."""
        with self.lock:
            if self.run is None:
                return Moment.at(self.base, self.base.start, self.base.waypoints[0])
            return self.run.moment(int(self.playback.index))

    def status(self, moment: Moment) -> tuple[str, bool]:
        """A sentence about the moment that is shown, and whether something is wrong."""
        with self.lock:
            name = self.settings.method
            if self.arm is not None:
                return f"in the hand, by {self.arm.method}: {moment.sentence}", not moment.solved
            if self.problem:
                return f"{name}: no run: {self.problem}", True
            if (computing := self.computing) is not None:
                return f"computing: {computing[1]} ({100 * computing[0]:.0f} %)", False
            if self.run is None:
                return f"{name}: no run yet", True
            return f"{name}: {self.run.status}", self.run.status != "ok"

    def close(self) -> None:
        """Stop the worker."""
        self.runs.close()
