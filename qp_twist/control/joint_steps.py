"""Steps that move the joints alone, inside a controller's limits."""

from __future__ import annotations

import mink
import numpy as np

from qp_twist.checks import Array, largest
from qp_twist.control.controller import Controller
from qp_twist.control.newest_inputs import Input
from qp_twist.control.step import Step
from qp_twist.control.target_stream import StreamSettings
from qp_twist.control.tick import STILL, ServoState, Tick
from qp_twist.errors import QpTwistError
from qp_twist.geometry import Projector, TwistProjector
from qp_twist.kinematics import PostureReference, TwistTask


class JointSteps:
    """A controller without tasks, which a servo moves joints and brakes by.

    Attributes:
        asked: The newest joint velocity that was asked for; ``None`` while the tasks are followed.
        braking_since: When braking began, s, and the joint velocity then; ``None`` if it has not.
    """

    def __init__(
        self, controller: Controller, configuration: mink.Configuration, settings: StreamSettings
    ) -> None:
        """Make it with the limits of ``controller``, and load its machine code."""
        self._limited_by, self._configuration, self._settings = controller, configuration, settings
        self._posture = PostureReference(controller.model, configuration.q, gain=1.0)
        frame = controller.twist_tasks[0]
        nothing = TwistProjector(linear=Projector.none(), angular=Projector.none())
        asks_nothing = TwistTask(frame.frame_name, frame.frame_type, nothing)
        asks_nothing.set_target_from_configuration(configuration)
        self._controller = Controller(
            controller.model, [asks_nothing], limits=controller.limits, secondary=[self._posture],
            on_infeasible="relax",
        )  # fmt: skip
        self._controller.load(configuration, settings.period)
        self.asked: Input | None = None
        self.braking_since: tuple[float, Array] | None = None

    def tick(self, asked: Array, stamp: float, now: float, before: Array) -> Tick:
        """Move the joints at a velocity (nv,) that was asked for at a time, s, until it is stale.

        ``before`` is the joint velocity of the last tick, (nv,).
        """
        if now - stamp > self._settings.stale_after:
            wanted = self._braked(now, before)
            step = self._step(wanted, before)
            stands = not wanted.any() and largest(step.velocity) < STILL
            return Tick(step.velocity, ServoState.HOLDING if stands else ServoState.STOPPING, step)
        step = self._step(asked, before)
        self.braking_since = None
        state = ServoState.SLOWED if step.binding else ServoState.TRACKING
        return Tick(step.velocity, state, step)

    def brake(self, now: float, before: Array, failure: str) -> Tick:
        """Bring the joints to rest inside all limits; as hard as each may if none can be asked."""
        wanted = self._braked(now, before)
        try:
            step = self._step(wanted, before)
        except (QpTwistError, mink.MinkError):
            hardest = self._limited_by.hardest
            change = np.inf if hardest is None else self._settings.period * hardest
            velocity = np.copysign(np.maximum(np.abs(before) - change, 0.0), before)
            return Tick(velocity, ServoState.BLOCKED, None, failure)
        return Tick(step.velocity, ServoState.BLOCKED, step, failure)

    def _step(self, wanted: Array, before: Array) -> Step:
        """The step nearest to a joint velocity (nv,), after another one (nv,)."""
        period = self._settings.period
        if self._controller.limits != self._limited_by.limits:
            self._controller.limits = self._limited_by.limits
        self._posture.q_ref = self._configuration.integrate(wanted, period)
        return self._controller.step(self._configuration, period, velocity=before)

    def _braked(self, now: float, before: Array) -> Array:
        """What is left of the velocity with which bringing the joints to rest began, (nv,)."""
        if self.braking_since is None:
            self.braking_since = now, before
        since, velocity = self.braking_since
        return self._settings.braking(now - since) * velocity
