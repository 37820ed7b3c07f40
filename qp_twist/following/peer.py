"""The step of another library, by its own tasks, limits and solver."""

from __future__ import annotations

import abc
import importlib
import warnings
from typing import Any

import mink
import numpy as np
import qpsolvers

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.fast import COMPILED
from qp_twist.following.peer_terms import PeerRows, Posture
from qp_twist.following.resolver import Displacement, Resolver, twist_task
from qp_twist.following.waypoint_limits import WaypointLimits
from qp_twist.geometry import TwistProjector
from qp_twist.kinematics import JointRanges
from qp_twist.path import METHODS, MethodSettings, PathTask
from qp_twist.qp import NoSolutionFound
from qp_twist.qp.backend import SETTINGS

_STANDING = 1e-9
"""The least speed limit, rad/s or m/s: pink takes one of zero for none."""


class PeerLimits(WaypointLimits):
    """The time of a waypoint, and the speeds that its iterations have left.

    A peer's speed limit holds for one step. The iterations of a waypoint share its time, so each is
    given what the ones before have left of |q̇| Δt.
    """

    def __init__(self, path_task: PathTask) -> None:
        super().__init__(path_task)
        self.ranges = JointRanges.of(path_task.model)
        self._began = self.ranges.positions(path_task.start)

    def begin_waypoint(self, configuration: mink.Configuration, duration: float | None) -> None:
        """Note where the waypoint begins."""
        super().begin_waypoint(configuration, duration)
        self._began = self.ranges.positions(configuration.q)

    def speeds(self, configuration: mink.Configuration) -> Array:
        """Largest joint speeds, rad/s or m/s, (nv,); ∞ where none is stated."""
        moved = np.abs(self.ranges.positions(configuration.q) - self._began) / self.dt
        left: Array = np.maximum(self.velocity_limits - moved, _STANDING)
        return left


class PeerResolver(Resolver):
    """One step of another library, as it comes: nothing here verifies or repairs it.

    Iterations and tolerances are those of all methods, and the posture pulls in the first iteration
    of a waypoint, unless the settings say otherwise. What the library calls solved is reported as
    solved; what it raises ends the run with its name.

    Attributes:
        limits: The time of the waypoint and the speeds; the peers hold their own limits.
        rows: What of the pose counts.
        posture: What the free motion is spent on.
        failures: What the library raises where it has no step.
    """

    limits: PeerLimits
    failures: tuple[type[Exception], ...] = ()

    def __init__(
        self,
        path_task: PathTask,
        method: str,
        settings: MethodSettings,
        projector: TwistProjector,
        solver: str,
        limits: PeerLimits,
    ) -> None:
        self.method = METHODS[method]
        self.rows = PeerRows.of(path_task, projector, self.method)
        self.posture = Posture.of(path_task, settings, self.method)
        self.task = twist_task(path_task, projector)
        self.limits = limits
        self.timed = path_task.durations is not None
        # Our own compiled method is known to nobody else.
        self.solver = "daqp" if solver == COMPILED else solver
        # A peer at its best has the tolerances that our own QPs have. Polishing is left out: OSQP
        # says on standard output where there is nothing to polish.
        tuned = {} if method == "mink_default" else SETTINGS.get(self.solver, {})
        self.solver_settings = {key: v for key, v in tuned.items() if key != "polishing"}
        self.set_up(path_task)

    @abc.abstractmethod
    def set_up(self, path_task: PathTask) -> None:
        """Build the library's tasks and limits."""

    @abc.abstractmethod
    def step(self, configuration: mink.Configuration, gain: float) -> Displacement:
        """The library's step towards the target, its posture at this gain."""

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Displacement:
        """The library's step."""
        gain = self.posture.gain if first or self.posture.repeated else 0.0
        failures: tuple[type[Exception], ...] = (
            *self.failures, qpsolvers.exceptions.QPError, qpsolvers.exceptions.SolverNotFound
        )  # fmt: skip
        try:
            with warnings.catch_warnings():
                # qpsolvers warns of each dense matrix that it converts for a sparse solver.
                warnings.simplefilter("ignore")
                return self.step(configuration, gain)
        except failures as error:
            raise NoSolutionFound(f"{self.method.peer}: {error}") from error


def peer_module(name: str, package: str) -> Any:
    """A module of a library that need not be there.

    Raises:
        InvalidInput: If it is not installed.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pinocchio's import warns of its own parts
            return importlib.import_module(name)
    except ImportError as error:
        raise InvalidInput(
            f"{name} cannot be imported ({error}); install it: pip install {package}."
        ) from None
