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
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask, placed, refuse_joint_moves
from qp_twist.viewing.live_arm import LiveArm
from qp_twist.viewing.one_run import Moment, Run, run_once
from qp_twist.viewing.projectors import Roll
from qp_twist.viewing.runs import Runs
from qp_twist.viewing.settings import PageSettings

DEBOUNCE_S = 0.3
"""Delay, s, between the last move of the workpiece and the computation of its run."""


class Session:
    """The state behind the page, independent of the browser.

    All methods may be called from any thread.

    Attributes:
        task: The task at the workpiece's current placement.
        settings: The user's settings.
        run: The run that is shown. While a new one is computed this is the previous one; ``None``
            before the first, and if the settings have no run.
        index: The waypoint that is shown, from 0; fractional while the run plays.
        playing: Whether the run is being played.
        speed: Waypoints per second.
        arm: The arm that the user drags; ``None`` while a run is shown.
        on_infeasible: What the dragged arm does at its limits.
        problem: Why the settings have no run; empty if they have one.
    """

    def __init__(self, path_task: PathTask, settings: PageSettings) -> None:
        refuse_joint_moves(path_task, "view")
        self.lock = threading.RLock()
        self.base = path_task
        self.task = path_task
        self.settings = settings
        self.ranges = JointRanges.of(path_task.model)
        self.runs = Runs()
        self.run: Run | None = None
        self.index = 0.0
        self.playing = False
        self.speed = 30.0
        self.arm: LiveArm | None = None
        self.on_infeasible: Literal["scale", "relax"] = "scale"
        self.problem = ""
        self._placement: tuple[float, ...] = ()
        self._due: float | None = None
        self._start = self._at_start()
        self._request_run()

    # The workpiece

    @property
    def handle(self) -> Array:
        """The workpiece's handle point, in the task file's placement, m, (3,)."""
        study = self.base.study
        if study is not None and study.placement is not None:
            return np.array(study.placement.point, dtype=np.float64)
        middle: Array = 0.5 * (self.base.positions.min(axis=0) + self.base.positions.max(axis=0))
        return middle

    @property
    def part(self) -> str | None:
        """Name of the workpiece's body in the scene, if the task file has it."""
        study = self.base.study
        return None if study is None or study.placement is None else study.placement.body

    def place(self, pose: mink.SE3) -> None:
        """Move the workpiece's handle to a pose; its run is computed :data:`DEBOUNCE_S` later.

        If the task cannot be placed there, only :attr:`problem` changes.
        """
        with self.lock:
            rotation, position = pose.rotation(), pose.translation()
            try:
                self.task = placed(self.base, rotation, self.handle, position, self.part)
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
            if self.arm is not None:
                self._make_arm(self.arm.configuration.q.copy(), self.arm.target)

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
        self.runs.want(self.key, lambda progress: run_once(task, settings, progress))
        self._take()

    def _take(self) -> None:
        """Show the requested run if it is computed."""
        found = self.runs.get(self.key)
        if isinstance(found, str):
            self.problem, self.run = found, None
        elif found is not None and found is not self.run:
            self.run = found
            self.index = min(self.index, len(found) - 1.0)

    # The dragged arm

    def grasp(self) -> mink.SE3:
        """Start to drag the arm from the configuration that is shown; return its frame's pose."""
        with self.lock:
            self.playing = False
            return self._make_arm(self.moment().q, None).pose

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
            self.on_infeasible = what
            if self.arm is not None:
                self._make_arm(self.arm.configuration.q.copy(), self.arm.target)

    def _make_arm(self, q: Array, target: mink.SE3 | None) -> LiveArm:
        arm = LiveArm(self.task, self.settings, q, on_infeasible=self.on_infeasible)
        if target is not None:
            arm.target = target
        self.arm = arm
        return arm

    # The clock

    def seek(self, index: float) -> None:
        """Show a waypoint, from 0."""
        with self.lock:
            last = len(self.task.waypoints) - 1
            self.index = float(np.clip(index, 0, last))

    def tick(self, dt: float) -> Moment:
        """Advance by ``dt`` seconds and return what to show."""
        with self.lock:
            if self._due is not None and time.monotonic() >= self._due:
                self._due = None
                self._request_run()
            self._take()
            if self.arm is not None:
                return self.arm.step()
            if self.playing and self.run is not None:
                self.index += self.speed * dt
                if self.index > len(self.run) - 1:
                    self.index = 0.0
            return self.moment()

    def moment(self) -> Moment:
        """The state at the waypoint that is shown; at the start if there is no run."""
        with self.lock:
            return self._start if self.run is None else self.run.moment(int(self.index))

    def status(self) -> str:
        """A sentence about what is shown."""
        with self.lock:
            if self.problem:
                return f"{self.settings.method}: no run: {self.problem}"
            computing = self.computing  # read once: the worker may finish at any time
            if computing is not None:
                share, what = computing
                return f"computing: {what} ({100 * share:.0f} %)"
            return f"{self.settings.method}: {self.run.status if self.run else 'no run yet'}"

    def close(self) -> None:
        """Stop the worker."""
        self.runs.close()

    def _at_start(self) -> Moment:
        q = self.base.start
        configuration = mink.Configuration(self.base.model, q)
        return Moment(
            q=q,
            scale=1.0,
            position_error=0.0,
            axis_error=0.0,
            sigma_min=0.0,
            z=float(self.ranges.centring(q)),
            margins=self.ranges.margins(q),
            roll=Roll(self.base).at(configuration, self.base.waypoints[0]),
        )
