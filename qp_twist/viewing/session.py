"""What the page is showing: a task, a choice of settings, a run or an arm in the hand."""

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
from qp_twist.path import PathTask, placed
from qp_twist.viewing.live_arm import LiveArm
from qp_twist.viewing.one_run import Moment, Run, run_once
from qp_twist.viewing.roll import Roll
from qp_twist.viewing.runs import Runs
from qp_twist.viewing.settings import Settings

DEBOUNCE_S = 0.3
"""The run of a part that is being moved is computed when it has stood still for so long."""


class Session:
    """The state behind the page; it knows nothing of browsers.

    All methods may be called from any thread.

    Attributes:
        task: The task where its workpiece now stands.
        settings: What is chosen.
        run: The run that is shown: of the settings, or, while that is computed, the one before;
            ``None`` before the first, and where the settings have none.
        index: The waypoint that is shown, from 0; between two while it plays.
        playing: Whether the run is being played.
        speed: Waypoints per second.
        arm: The arm in the hand; ``None`` while a run is shown.
        on_infeasible: What the arm in the hand does at its limits.
        problem: Why the settings have no run; empty where they have.
    """

    def __init__(self, path_task: PathTask, settings: Settings) -> None:
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
        self._ask()

    # The workpiece

    @property
    def handle(self) -> Array:
        """The point of the workpiece that it is moved by, where the task file has it, m, (3,)."""
        study = self.base.study
        if study is not None and study.placement is not None:
            return np.array(study.placement.point, dtype=np.float64)
        middle: Array = 0.5 * (self.base.positions.min(axis=0) + self.base.positions.max(axis=0))
        return middle

    @property
    def part(self) -> str | None:
        """The body of the scene that is the workpiece, if the task file names it."""
        study = self.base.study
        return None if study is None or study.placement is None else study.placement.body

    def place(self, pose: mink.SE3) -> None:
        """Put the workpiece's point and its axes elsewhere; the run follows in a moment.

        A pose that is no place for the task changes nothing but :attr:`problem`.
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
        """The workpiece where the task file has it."""
        with self.lock:
            self.task, self._placement, self._due = self.base, (), None
            self._ask()

    # The settings

    def change(self, **changes: Any) -> None:
        """Replace settings by name; another method comes with the task file's gain and weight."""
        with self.lock:
            method = changes.get("method", self.settings.method)
            if method != self.settings.method:
                stated = Settings.of(self.base, method)
                changes = {"gain": stated.gain, "weight": stated.weight, **changes}
            self.settings = dataclasses.replace(self.settings, **changes)
            self._ask()
            if self.arm is not None:
                self._grip(self.arm.configuration.q.copy(), self.arm.target)

    @property
    def key(self) -> tuple[object, ...]:
        """What the run that is wanted depends on."""
        return (self.settings, self._placement)

    @property
    def computing(self) -> tuple[float, str] | None:
        """The share of the run under way that is done, and what is being done."""
        return (0.0, "waiting") if self._due is not None else self.runs.progress

    def _ask(self) -> None:
        task, settings = self.task, self.settings
        self.problem = ""
        self.runs.want(self.key, lambda progress: run_once(task, settings, progress))
        self._take()

    def _take(self) -> None:
        """Show the run that is wanted if it has come."""
        found = self.runs.get(self.key)
        if isinstance(found, str):
            self.problem, self.run = found, None
        elif found is not None and found is not self.run:
            self.run = found
            self.index = min(self.index, len(found) - 1.0)

    # The hand

    def grasp(self) -> mink.SE3:
        """Take the arm in the hand where it stands; where its frame is."""
        with self.lock:
            self.playing = False
            return self._grip(self.moment().q, None).pose

    def release(self) -> None:
        """Back to the run."""
        with self.lock:
            self.arm = None

    def drag(self, target: mink.SE3) -> None:
        """Where the arm in the hand is to go."""
        with self.lock:
            if self.arm is not None:
                self.arm.target = target

    def at_limits(self, what: Literal["scale", "relax"]) -> None:
        """What the arm in the hand does where its target does not fit inside the limits."""
        with self.lock:
            self.on_infeasible = what
            if self.arm is not None:
                self._grip(self.arm.configuration.q.copy(), self.arm.target)

    def _grip(self, q: Array, target: mink.SE3 | None) -> LiveArm:
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
        """Let ``dt`` seconds pass, and say what is to be seen."""
        with self.lock:
            if self._due is not None and time.monotonic() >= self._due:
                self._due = None
                self._ask()
            self._take()
            if self.arm is not None:
                return self.arm.step()
            if self.playing and self.run is not None:
                self.index += self.speed * dt
                if self.index > len(self.run) - 1:
                    self.index = 0.0
            return self.moment()

    def moment(self) -> Moment:
        """The waypoint that is shown; without a run the start."""
        with self.lock:
            return self._start if self.run is None else self.run.moment(int(self.index))

    def status(self) -> str:
        """What is shown, in a sentence."""
        with self.lock:
            if self.problem:
                return f"{self.settings.method}: no run: {self.problem}"
            computing = self.computing  # once: the worker ends it at any time
            if computing is not None:
                share, what = computing
                return f"computing: {what} ({100 * share:.0f} %)"
            return f"{self.settings.method}: {self.run.status if self.run else 'no run yet'}"

    def close(self) -> None:
        """End the worker."""
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
