"""The task: a frame, its target, and the twist projector that selects its rows."""

from __future__ import annotations

import math
import operator
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import (
    Array,
    Revised,
    are_floats,
    checked,
    finite_array,
    float_array,
    number,
    read_only,
    unit_vector,
)
from qp_twist.errors import InvalidInput, InvalidTarget
from qp_twist.geometry import Projector, TwistProjector, clamp_twist, resolved_twist_error
from qp_twist.kinematics.frame import (
    check_configuration,
    check_frame,
    frame_jacobian,
    frame_pose,
    relative_jacobian,
    together,
)
from qp_twist.kinematics.frame_pair import FramePair
from qp_twist.kinematics.tolerance_band import BandRows, ToleranceBand, check_bands

AT_REST = read_only(np.zeros(6))
"""The twist of every target at rest, one shared object."""


class TaskState(NamedTuple):
    """State of a task at one configuration, in world axes."""

    projector: TwistProjector
    """T, with its axes resolved in the world."""
    basis: Array
    """U with T = U Uᵀ, shape (6, r)."""
    error: Array
    """Δt, the twist to the target, m and rad, shape (6,)."""
    jacobian: Array
    """J of the frame, relative to the frame that carries the target, shape (6, nv)."""
    feedforward: Array
    """Twist of the target relative to the frame that carries it, m/s and rad/s, shape (6,)."""


def _step_limit(_: Any, name: str, value: float) -> float:
    unlimited = isinstance(value, float) and value == math.inf
    return value if unlimited else number(name, value, above=0.0)


def _cost(task: TwistTask, name: str, value: npt.ArrayLike) -> Array:
    """One cost for each row of the task."""
    given, shape = float_array(f"{task.name}: {name}", value), (task.projector.rank,)
    if given.size == 1:
        given = np.full(shape, given.item())
    if given.shape != shape or not (np.isfinite(given) & (given >= 0.0)).all():
        raise InvalidInput(
            f"{task.name}: cost is one number or one for each row of the task, {shape}, the linear "
            f"rows first, finite and at least 0; got {value!r}."
        )
    return given


def _projector(task: TwistTask, _: str, value: Any) -> TwistProjector:
    """T of another rank takes the cost along if that is one number for all rows."""
    if not isinstance(value, TwistProjector):
        raise InvalidInput(
            f"TwistTask({task.frame_name!r}, {task.frame_type!r}): projector must be a "
            f"TwistProjector, got {value!r}. The frame that carries the target, mink's root_name "
            "and root_type, is relative_to=(name, type)."
        )
    cost = task.__dict__.get("_cost")
    if cost is not None and len(cost) != value.rank:
        if len(set(cost.tolist())) > 1:
            raise InvalidInput(
                f"{task.name}: its cost has one entry for each of {len(cost)} rows, and the new "
                f"projector {value.rank} rows; assign one number to cost first."
            )
        task.__dict__["_cost"] = np.full(value.rank, cost[0] if len(cost) else 1.0)
    return value


def _gain(task: TwistTask, _: str, value: Any) -> float:
    gain = number(f"{task.name}: gain", value)
    if not 0.0 <= gain <= 1.0:
        raise mink.InvalidGain(f"{task.name}: gain must be from 0 to 1, got {gain:g}.")
    return gain


def _carrier(task: TwistTask, _: str, value: Any) -> tuple[str | int, str] | None:
    """Check the frame that carries the target, as far as possible without a model."""
    if value is None:
        return None
    what = "TwistTask(relative_to=…)"
    if not isinstance(value, tuple) or len(value) != 2:
        raise InvalidInput(
            f"{what}: expected (name, type) of a frame, as in ('part', 'body'), got {value!r}."
        )
    name, kind = value
    check_frame(what, name, kind)
    if name == "" or (not isinstance(name, str) and name < 0):
        raise InvalidInput(f"{what}: no {kind} is called {name!r}.")
    if value == (task.frame_name, task.frame_type):
        raise InvalidInput(
            f"{what}: {name!r} is the controlled frame itself, which never moves relative to "
            "itself; name the frame that carries the target."
        )
    if task.projector.has_axis and task.projector.frame == "world":
        raise InvalidInput(
            f"TwistTask({task.frame_name!r}, {task.frame_type!r}): relative to {name!r} the "
            "axes of T are fixed to the frame or to its target; give the projector "
            "frame='body' or frame='target'."
        )
    return value


class TwistTask(Revised, mink.Task):
    r"""Drive a frame to a target in the directions that a twist projector keeps.

    A :class:`mink.Task` with r = rank(T) rows,

    .. math::

        \mathbf e = -\mathbf U^T \Delta\mathbf t, \qquad
        \mathbf J_{task} = \mathbf U^T \mathbf J, \qquad \mathbf T = \mathbf U\mathbf U^T,

    where J is the frame's world-aligned Jacobian and Δt the twist error
    (:func:`~qp_twist.geometry.twist_error`). The rows are minimal and consistent at any
    misalignment, so the task may stand in ``tasks=`` and in ``constraints=`` of
    :func:`mink.solve_ik`, with any solver, and in :class:`~qp_twist.Controller`.

    :meth:`axis_free`, :meth:`point`, :meth:`on_line`, :meth:`on_plane` and :meth:`line_on_line`
    construct the usual tasks, with the other arguments as keywords; :class:`~qp_twist.GazeTask`
    points a camera.

    Args:
        frame_name: Name or id of the frame to control.
        frame_type: ``"body"``, ``"geom"`` or ``"site"``.
        projector: T, the twist directions of the task, rebuilt in the world at every step.
        gain: Share of the error to remove in one step, in [0, 1].
        cost: Weight of each row where mink treats the task as soft, 1/m and 1/rad, (r,), the
            linear rows first, or one number for all.
        relative_to: The frame that carries the target, as (name or id, type), for a part in the
            other hand or on a positioner; the world if ``None``. J is then that of the frame
            relative to its carrier (:func:`~qp_twist.kinematics.relative_jacobian`), and the axes
            of T are fixed to the frame or to the target.
        max_linear_step: Length to which the linear error of one step is clamped, m.
        max_angular_step: Angle to which the angular error of one step is clamped, rad.
        bands: Ranges to keep in directions that T leaves free; with a T of rank 0 the task
            consists of them only. mink has no bands: pass it a :class:`~qp_twist.BandLimit`, too.

    All are attributes, too.

    Raises:
        InvalidInput: If an argument has the wrong type or range, or a band contradicts T.
        mink.InvalidGain: If the gain is outside [0, 1].

    Example:
        >>> import mink, qp_twist as qt
        >>> path_task = qt.load_task("deburring")
        >>> task = qt.TwistTask("tool", "site", path_task.projector)   # the roll is free
        >>> task.set_target(path_task.waypoints[0])
        >>> task.compute_jacobian(mink.Configuration(path_task.model)).shape
        (5, 6)
    """

    projector: TwistProjector = checked(_projector)
    gain: float = checked(_gain)
    cost: Array = checked(_cost)
    relative_to: tuple[str | int, str] | None = checked(_carrier)
    max_linear_step: float = checked(_step_limit)
    max_angular_step: float = checked(_step_limit)
    bands: tuple[ToleranceBand, ...] = checked(
        lambda task, _, bands: check_bands(task.name, bands, task.projector)
    )

    def __init__(
        self,
        frame_name: str | int,
        frame_type: str,
        projector: TwistProjector,
        gain: float = 1.0,
        *,
        cost: npt.ArrayLike = 1.0,
        relative_to: tuple[str | int, str] | None = None,
        max_linear_step: float = math.inf,
        max_angular_step: float = math.inf,
        bands: Sequence[ToleranceBand] = (),
    ) -> None:
        self.frame_name, self.frame_type = frame_name, frame_type
        self.projector = projector
        check_frame("TwistTask", frame_name, frame_type)
        self.relative_to = relative_to
        super().__init__(cost=cost, gain=number("gain", gain))  # type: ignore[arg-type]
        self.bands = bands  # type: ignore[assignment]
        self.max_linear_step, self.max_angular_step = max_linear_step, max_angular_step
        self._pose: bytes | None = None
        self._feedforward = AT_REST
        self._dt: float | None = None

    @staticmethod
    def axis_free(
        frame_name: str | int, frame_type: str, axis: npt.ArrayLike = (0, 0, 1), **options: Any
    ) -> TwistTask:
        """Position, and the direction of a tool axis: deburring, welding, spraying; rank 5.

        ``axis`` is that of the tool, in the axes of the frame, (3,): the roll about it is free.
        """
        axis = unit_vector("axis_free(axis=…)", axis)
        T = TwistProjector(linear=Projector.full(), angular=Projector.plane(axis), frame="body")
        return TwistTask(frame_name, frame_type, T, **options)

    @staticmethod
    def point(frame_name: str | int, frame_type: str, **options: Any) -> TwistTask:
        """Position alone, any orientation; rank 3."""
        T = TwistProjector(linear=Projector.full(), angular=Projector.none())
        return TwistTask(frame_name, frame_type, T, **options)

    @staticmethod
    def on_line(
        frame_name: str | int, frame_type: str, direction: npt.ArrayLike = (1, 0, 0), **options: Any
    ) -> TwistTask:
        """The frame's origin on a line through the target, any orientation; rank 2.

        ``direction`` is that of the line, in the axes of the target, (3,).
        """
        plane = Projector.plane(unit_vector("on_line(direction=…)", direction))
        T = TwistProjector(linear=plane, angular=Projector.none(), frame="target")
        return TwistTask(frame_name, frame_type, T, **options)

    @staticmethod
    def on_plane(
        frame_name: str | int,
        frame_type: str,
        normal: npt.ArrayLike = (0, 0, 1),
        *,
        flat: bool = False,
        **options: Any,
    ) -> TwistTask:
        """The frame's origin on a plane through the target: wiping, drawing; rank 1, flat 3.

        ``normal`` is that of the plane, in the axes of the target, (3,); with ``flat`` the same
        axis of the frame is aligned with it.
        """
        normal = unit_vector("on_plane(normal=…)", normal)
        angular = Projector.plane(normal) if flat else Projector.none()
        T = TwistProjector(linear=Projector.line(normal), angular=angular, frame="target")
        return TwistTask(frame_name, frame_type, T, **options)

    @staticmethod
    def line_on_line(
        frame_name: str | int, frame_type: str, direction: npt.ArrayLike = (0, 0, 1), **options: Any
    ) -> TwistTask:
        """An axis of the frame on the same axis of the target, as a peg in its hole; rank 4.

        It may slide along the axis and rotate about it. ``direction`` is that of the axis, in the
        axes of the frame and of the target, (3,).
        """
        plane = Projector.plane(unit_vector("line_on_line(direction=…)", direction))
        T = TwistProjector(linear=plane, angular=plane, frame="target")
        return TwistTask(frame_name, frame_type, T, **options)

    @property
    def name(self) -> str:
        """Name of this task in messages, e.g. ``TwistTask('tool', 'site')``."""
        carrier = "" if self.relative_to is None else f" relative to {self.relative_to[0]!r}"
        return f"{type(self).__name__}({self.frame_name!r}, {self.frame_type!r}){carrier}"

    @property
    def target(self) -> mink.SE3 | None:
        """The target pose, as set; assigning a pose is :meth:`set_target` at rest."""
        return None if self._pose is None else mink.SE3(np.frombuffer(self._pose))

    @target.setter
    def target(self, target: mink.SE3) -> None:
        self.set_target(target)

    @property
    def feedforward(self) -> Array:
        """Twist of the target, as set by :meth:`set_target`; read-only."""
        return self._feedforward

    target_floats: Any = property(operator.attrgetter("_pose"))
    """Unit quaternion and position of the target, a new ``bytes`` for each; ``None`` before."""

    def set_target(self, target: mink.SE3, twist: npt.ArrayLike | None = None) -> None:
        """Set the target pose, and the twist of a moving target.

        Args:
            target: Pose of the target in the world, or in the frame that carries it.
            twist: Feed-forward (linear, angular) velocity of the target, in the axes of the world
                or of that frame, reference point the target's origin, m/s and rad/s, shape (6,); at
                rest if ``None``. :func:`~qp_twist.target_twist` computes it from two poses.

        Raises:
            InvalidTarget: If the pose or the twist is not finite, or not a pose at all.
        """
        pose, kept, feedforward = checked_pose(self, target), self.__dict__, AT_REST
        if twist is not None:
            name = f"{self.name} twist"
            feedforward = read_only(finite_array(name, twist, (6,), error=InvalidTarget))
        # Two assignments would take 1 µs, to count no revision.
        kept["_pose"], kept["_feedforward"] = pose, feedforward

    def set_target_from_configuration(self, configuration: mink.Configuration) -> None:
        """Set the frame's present pose as the target, at rest."""
        check_configuration(configuration)
        self.set_target(self.pose(configuration))

    def pose(self, configuration: mink.Configuration) -> mink.SE3:
        """Pose of the controlled frame in the world, or in the frame that carries the target."""
        pose = configuration.get_transform_frame_to_world(self.frame_name, self.frame_type)
        if self.relative_to is None:
            return pose
        carrier = configuration.get_transform_frame_to_world(*self.relative_to)
        return carrier.inverse() @ pose

    def set_dt(self, dt: float) -> None:
        """Set the time step, s: only needed for feed-forward with ``mink.solve_ik``."""
        self._dt = number("dt", dt, above=0.0)

    def state(self, configuration: mink.Configuration) -> TaskState:
        """Basis, error and Jacobian at a configuration, in world axes.

        Without a target mink.TargetNotSet is raised, without such a frame mink.InvalidFrame.
        """
        pair = frames_of(self, configuration)
        world, error = resolved_twist_error(*pair[:4], self.projector)
        jacobian, twist = jacobian_of(self, configuration), pair.target_twist
        return TaskState(world, world.basis, error, jacobian, twist)

    def clamped(self, error: npt.ArrayLike) -> Array:
        """Δt (6,) clamped to the largest steps, before the gain."""
        error = finite_array("error", error, (6,))
        if self.max_linear_step == self.max_angular_step == math.inf:
            return error
        return clamp_twist(error, self.max_linear_step, self.max_angular_step)

    def compute_error(self, configuration: mink.Configuration) -> Array:
        r"""Error :math:`\mathbf e = -\mathbf U^T(\Delta\mathbf t + \mathbf t_{ff}\,dt/k)`, (r,).

        With it mink's :math:`\mathbf J\Delta\mathbf q = -k\,\mathbf e` moves with the target; a
        feed-forward without :meth:`set_dt` raises mink.IntegrationTimestepNotSet.
        """
        return self._error_and_jacobian(configuration)[0]

    def compute_jacobian(self, configuration: mink.Configuration) -> Array:
        """Task Jacobian UᵀJ, shape (r, nv)."""
        state = self.state(configuration)
        return state.basis.T @ state.jacobian

    def compute_qp_residual(self, configuration: mink.Configuration) -> tuple[Array, Array, float]:
        """The weighted residual for mink, from one evaluation of the configuration."""
        stated = self._error_and_jacobian(configuration)
        return self._weighted_residual(*stated)

    def velocity_rows(self, configuration: mink.Configuration, dt: float) -> tuple[Array, Array]:
        r"""The rows A q̇ = b of a step of dt s: A (r, nv), and b (r,), m/s and rad/s.

        .. math::

            \mathbf U^T \mathbf J \dot{\mathbf q}
            = k\,\mathbf U^T \Delta\mathbf t / dt + \mathbf U^T \mathbf t_{ff}
        """
        dt = number("dt", dt, above=0.0)
        state = self.state(configuration)
        rate = self.gain * self.clamped(state.error) / dt + state.feedforward
        return state.basis.T @ state.jacobian, state.basis.T @ rate

    def band_rows(self, configuration: mink.Configuration, dt: float) -> list[BandRows]:
        """The rows G q̇ ≤ g that the bands impose on a step of length ``dt``.

        One entry for each band with rows; a band on a value that T fixes has none.
        """
        dt = number("dt", dt, above=0.0)
        if not self.bands:
            return []
        pair, J = frames_of(self, configuration), jacobian_of(self, configuration)
        found = []
        for band in self.bands:
            rows, bounds = band.half_spaces(pair, dt, self.projector)
            if len(rows):
                label = f"{band.kind} band of {self.name}"
                found.append(BandRows(rows @ J, bounds, label, band.weight))
        return found

    def band_excess(self, configuration: mink.Configuration) -> Array:
        """Violation of each band, rad or m, shape (bands,); 0 inside."""
        if not self.bands:
            return np.zeros(0)
        pair = frames_of(self, configuration)
        return np.array([band.excess(pair) for band in self.bands])

    def _error_and_jacobian(self, configuration: mink.Configuration) -> tuple[Array, Array]:
        state = self.state(configuration)
        shift = self.clamped(state.error)
        if state.feedforward.any():
            if self._dt is None:
                raise mink.IntegrationTimestepNotSet(self.name)
            if self.gain == 0.0:
                raise InvalidInput(
                    f"{self.name}: with gain 0 mink drops the feed-forward twist; give a gain "
                    "above 0 or use qp_twist.Controller."
                )
            shift = shift + state.feedforward * (self._dt / self.gain)
        return -(state.basis.T @ shift), state.basis.T @ state.jacobian

    def __repr__(self) -> str:
        carried = "" if self.relative_to is None else f", relative_to={self.relative_to!r}"
        frame = f"{self.frame_name!r}, {self.frame_type!r}"
        return f"{type(self).__name__}({frame}, {self.projector!r}, gain={self.gain:g}{carried})"


_SEVEN, _SE3 = struct.Struct("7d").unpack, mink.SE3  # looked up once


def checked_pose(task: TwistTask, target: mink.SE3) -> bytes:
    """Unit quaternion and position of a target for a task: seven floats."""
    if not isinstance(target, _SE3):
        raise InvalidTarget(
            f"{task.name}: the target must be a mink.SE3, got {type(target).__name__}."
        )
    pose = target.wxyz_xyz
    if not are_floats(pose, 7):
        pose = finite_array(f"{task.name} target", pose, (7,), error=InvalidTarget)
    found: bytes = pose.tobytes()  # a copy, which also another thread leaves as it is
    a, b, c, d, x, y, z = _SEVEN(found)
    # One comparison that is false for what is not finite, or nearly not normalised; then more.
    if abs(a * a + b * b + c * c + d * d - 1.0 + 0.0 * (x + y + z)) <= 1e-6:
        return found
    finite_array(f"{task.name} target", np.frombuffer(found), (7,), error=InvalidTarget)
    length = math.hypot(a, b, c, d)
    if not abs(length - 1.0) <= 1e-6:
        raise InvalidTarget(
            f"{task.name}: the target's quaternion has length {length:.6g}; normalise it."
        )
    return found


def frames_of(task: TwistTask, configuration: mink.Configuration) -> FramePair:
    """Poses of a task's frame and of its target, in the world, which it has to have."""
    target, carrier = task.target, task.relative_to
    if target is None:
        raise mink.TargetNotSet(task.name)
    rotation, position = frame_pose(configuration, task.frame_name, task.frame_type)
    if not math.isfinite(rotation.sum() + position.sum()):
        finite = bool(np.isfinite(configuration.q).all())
        cause = " although q is; check the model's positions and axes" if finite else "; check q"
        raise InvalidInput(f"{task.name}: the pose of the frame is not finite{cause}.")
    R_d, p_d, twist = target.rotation().as_matrix(), target.translation(), task.feedforward
    if carrier is None:
        return FramePair(rotation, position, R_d, p_d, twist)
    if together(configuration.model, task.frame_name, task.frame_type, *carrier):
        raise InvalidInput(
            f"{task.name}: no joint is between the two, so that none can move the one relative "
            "to the other; name a frame on another part of the robot."
        )
    turned, origin = frame_pose(configuration, *carrier)
    twist = (turned @ twist.reshape(2, 3, 1)).ravel()
    return FramePair(rotation, position, turned @ R_d, origin + turned @ p_d, twist)


def jacobian_of(task: TwistTask, configuration: mink.Configuration) -> Array:
    """World-aligned Jacobian (6, nv) of a task's frame, relative to what carries its target."""
    if task.relative_to is None:
        return frame_jacobian(configuration, task.frame_name, task.frame_type)
    return relative_jacobian(configuration, task.frame_name, task.frame_type, *task.relative_to)
