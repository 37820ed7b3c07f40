"""How a servo leaves a singularity in whose direction the operator pushes."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.control.controller import Controller
from qp_twist.control.step import Step
from qp_twist.control.target_stream import Fade, StreamSettings
from qp_twist.kernel.constants import REGULAR
from qp_twist.kinematics import JointRanges, TaskState, TwistTask

_LOOK = 0.3
"""r: how far along a candidate the arm is looked at, rad or m."""
_SPEED, _SHARE = 1.0, 0.5
"""Speed of the joints out of the singularity, rad/s or m/s, and as a share of their limits."""
_LACKING = 0.5
"""Share of the task's error that lies in lost directions, from which on the arm is stuck."""
_NULL = 1e-2
"""Directions of the joints with a smaller singular value move nothing of the task at first."""
_GAIN = 0.02
"""Least increase of p that is worth a motion."""
_BACKWARDS = 1e-3
"""How far a candidate may move the tool against the push, as a share of r² σ_max."""
_STAYS = 0.05
"""Head start of the direction in which the arm is moving already."""
_EVERY = 0.05
"""Time after which the direction is looked for again, s."""
_NAMED = 0.1
"""Entry of the direction from which on a joint is named."""


class SingularExit:
    r"""A motion of the joints that move nothing of the task, to where they can.

    At a singularity the task rows A = UᵀJ = Σ σᵢ uᵢ vᵢᵀ have a direction u with σ = 0. If the task
    asks for it, no joint velocity helps, and at a symmetric posture, as that of all zeros often is,
    the gradient of any measure of manipulability vanishes, too: what leads out is of second order.
    So the arm is looked at a little further on: of the candidates

    .. math::

        \mathbf q \pm r\,\mathbf d, \qquad
        \mathbf d \in \{v_i,\ (v_i \pm v_j)/\sqrt2 \;|\; \sigma_i, \sigma_j \approx 0\}

    inside the joints' ranges that one is taken that makes most of the missing motion m possible,

    .. math:: p = 1 - \lambda^2\,\frac{\mathbf m^T(\mathbf A\mathbf A^T
        + \lambda^2\mathbf 1)^{-1}\mathbf m}{\mathbf m^T\mathbf m} ,

    without moving the tool against m. λ is ``REGULAR``, the singular value from which on the steps
    meet a direction exactly. At the edge of the reach there is none: whatever bends the arm moves
    the tool back. While the arm moves along d, the secondary objectives wait.

    Attributes:
        joints: Names of the joints that lead out; empty where nothing does or has to.
        fade: How far the motion has faded in.
    """

    def __init__(self, controller: Controller, settings: StreamSettings) -> None:
        """For a controller's first level; the motion fades within ``settings.stop_within``, s."""
        self.joints: tuple[str, ...] = ()
        self.fade = Fade(settings)
        stating = [item for item in controller.levels[0] if not isinstance(item, mink.Limit)]
        self._tasks = [item for item in stating if isinstance(item, TwistTask)]
        if len(self._tasks) < len(stating):  # the rows of other tasks have no state at q ± r d
            self._tasks = []
        self._controller, self._ranges = controller, JointRanges.of(controller.model)
        self._period = settings.period
        self._ahead = mink.Configuration(controller.model)
        self._direction: Array | None = None
        self._wait = 0

    def displacement(self) -> Array | None:
        """d with its length for one step, rad or m, (nv,); ``None`` where there is none."""
        if self._direction is None:
            return None
        speed, fastest = _SPEED, self._controller.fastest
        if fastest is not None:
            with np.errstate(divide="ignore"):
                speed = min(speed, float((_SHARE * fastest / np.abs(self._direction)).min()))
        return self.fade.share * speed * self._period * self._direction

    def look(self, configuration: mink.Configuration, step: Step | None) -> None:
        """Decide on the motion of the next tick.

        ``step`` is the tick's, if the robot is behind its targets; otherwise ``None``.
        """
        found = step is not None and self._look(configuration, step)
        share = self.fade.towards(found)
        if not found:
            self.joints = ()
            if share == 0.0:
                self._direction, self._wait = None, 0

    def _look(self, configuration: mink.Configuration, step: Step) -> bool:
        if not step.lost or not self._tasks:
            return False
        lost = np.array([direction.direction for direction in step.lost])
        states = [task.state(configuration) for task in self._tasks]
        asked = np.concatenate([state.basis.T @ state.error for state in states])
        missing = lost.T @ (lost @ asked)
        if np.linalg.norm(missing) < _LACKING * np.linalg.norm(asked):
            return False
        self._wait -= 1
        if self._wait > 0:
            return self._direction is not None and bool(self.joints)
        self._wait = max(1, round(_EVERY / self._period))
        self._direction = best = self._best(configuration, states, missing)
        names = self._ranges.names
        self.joints = (
            () if best is None else tuple(names[j] for j in np.flatnonzero(np.abs(best) > _NAMED))
        )
        return best is not None

    def _best(
        self, configuration: mink.Configuration, states: list[TaskState], missing: Array
    ) -> Array | None:
        """The best candidate, (nv,)."""
        twists = np.split(missing, np.cumsum([task.projector.rank for task in self._tasks])[:-1])
        A = _rows(states)
        push = [state.basis @ part for state, part in zip(states, twists, strict=True)]
        now, size, length = _possible(A, missing), np.linalg.norm(A, 2), np.linalg.norm(missing)
        best, most = None, 0.0
        for candidate in _candidates(A):
            self._go(configuration, _LOOK * candidate)
            room = float(self._ranges.room(self._ranges.positions(self._ahead.q)).min())
            if room < 0.0:
                continue
            there = [task.state(self._ahead) for task in self._tasks]
            along = sum(
                float(part @ (before.error - after.error))
                for part, before, after in zip(push, states, there, strict=True)
            )
            if along < -_BACKWARDS * _LOOK**2 * float(size * length):
                continue
            wanted = np.concatenate(
                [state.basis.T @ part for state, part in zip(there, push, strict=True)]
            )
            gain = _possible(_rows(there), wanted) - now
            if gain < _GAIN:
                continue
            # Of two that are alike the one that stays further from the ends of the ranges.
            gain += 1e-3 * min(room, 1.0)
            if self._direction is not None and float(candidate @ self._direction) > 0.0:
                gain += _STAYS
            if gain > most:
                best, most = candidate, gain
        return best

    def _go(self, configuration: mink.Configuration, displacement: Array) -> None:
        """Put the scratch configuration where a displacement leads."""
        data = self._ahead.data
        data.mocap_pos[:], data.mocap_quat[:] = (
            configuration.data.mocap_pos, configuration.data.mocap_quat,
        )  # fmt: skip
        self._ahead.update(configuration.integrate(displacement, 1.0))


def _rows(states: list[TaskState]) -> Array:
    """A, (m, nv)."""
    return np.vstack([state.basis.T @ state.jacobian for state in states])


def _candidates(A: Array) -> Iterator[Array]:
    """Unit vectors in the joints that the rows A hardly see, with both signs."""
    _, sigma, right = np.linalg.svd(A)
    unseen = right[int((sigma > _NULL).sum()) :]
    single = list(unseen)
    pairs = [
        (one + sign * other) / np.sqrt(2.0)
        for one, other in combinations(unseen, 2)
        for sign in (1.0, -1.0)
    ]
    for direction in (*single, *pairs):
        yield direction
        yield -direction


def _possible(A: Array, motion: Array) -> float:
    """p: share of a motion (m,), in the rows of A, that the joints can make."""
    m = len(A)
    damped = np.linalg.solve(A @ A.T + REGULAR**2 * np.eye(m), motion)
    return 1.0 - REGULAR**2 * float(motion @ damped) / max(float(motion @ motion), 1e-300)
