"""A path task: robot, path, projectors, limits and settings."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, all_arguments, did_you_mean, finite_array, instance, number
from qp_twist.constraints import (
    Clearance,
    Constraint,
    JointCouplings,
    check_constraints,
    couplings_of,
    refuse_other_equalities,
)
from qp_twist.drawing import Picture, picture_of
from qp_twist.errors import InvalidInput
from qp_twist.geometry import ProjectorKind, TwistProjector, task_redundancy
from qp_twist.geometry.projector import SAME_DIRECTION
from qp_twist.kinematics import JointRanges, ToleranceBand, TwistTask, frame_pose, together
from qp_twist.paths.chosen_waypoints import with_waypoints
from qp_twist.paths.joint_moves import ways_between
from qp_twist.paths.methods import METHODS, MethodSettings
from qp_twist.paths.orientation import poses
from qp_twist.paths.preference import Preference
from qp_twist.paths.process_words import check_calls
from qp_twist.paths.rerooted import OLD_WORLD, check_body, rerooted
from qp_twist.paths.segment import Segment, check_joint_moves, check_segments, projectors_in_force
from qp_twist.paths.shown import Shown
from qp_twist.paths.task_schema import IterationSection, StudySection
from qp_twist.paths.tolerances import Tolerances
from qp_twist.paths.toolpath import Lines, Part, Toolpath
from qp_twist.paths.turning import transported
from qp_twist.paths.waypoints import Waypoints
from qp_twist.robots import KnownRobot, known_limits

FromStart = Literal["nothing", "roll", "orientation"]


@all_arguments("qt.load_task(file) makes a task of a task file, dataclasses.replace changes one")
@dataclass(frozen=True, eq=False)
class PathTask:
    """Robot, path, projectors, limits and settings for following a path.

    Attributes:
        name: Short name, the file's stem.
        title: Title line.
        source: The task file, if there is one.
        scene: The MJCF file.
        model: The robot and what is around it. With ``relative_to`` pass the scene as it stands,
            and the arrays by joint in its order; the task has the scene as seen from that body
            (:func:`~qp_twist.paths.rerooted`), whose joints may have another order.
        frame_name: Name of the controlled frame.
        frame_type: Its type.
        projector: T of the task; where it changes along the path, T of the first waypoint.
        operational: T_O of the robot.
        waypoints: Poses in the world, with the roll of the roll rule.
        flipped_waypoints: The same with the rule's other sign; ``None`` without a rule.
        start: Starting configuration, before it is corrected onto the first waypoint, (nq,).
        durations: Time for each waypoint, s, (N,); the first is 0; ``None`` for an untimed path. A
            joint move may take any time: 0 asks for none.
        velocity_limits: Of the joints, rad/s or m/s, (nv,); ∞ without a limit.
        acceleration_limits: Of the joints, rad/s² or m/s², (nv,); ∞ likewise.
        jerk_limits: Of the joints, rad/s³ or m/s³, (nv,), kept by timing alone; ∞ likewise, or
            ``None`` where none are stated.
        iteration: Tolerances and step clamps.
        methods: Settings by method name, as far as the file has them.
        segments: Sections of the path with other projectors, in the order of the path.
        bands: Tolerance bands in directions that T leaves free.
        constraints: Further constraints on every configuration. The model's joint couplings
            (:class:`~qp_twist.JointCouplings`) are always appended, and what must not touch.
        best_start: Whether to search the start: ``True`` that of the best plan, ``"central"`` that
            of least z on the first waypoint.
        starts: Starting configurations of single methods, by name, instead of ``start``.
        roll_normal: Normal of the roll rule's plane, (3,); ``None`` without a rule.
        study: What a study varies, and its criterion of success.
        toolpath: The toolpath file as read, if the path is from one.
        lines: Line of that file at or before each waypoint, (N,).
        from_start: Which part of the waypoints' orientation is taken from the start.
        joint_moves: Indices, from 0, of the waypoints that a joint move leads to, inside limits and
            constraints: no path holds from the waypoint before. One between two is a via point.
        relative_to: Name of the body that carries the path, in whose frame then is what is stated
            in the world: a part on a turn table or in another robot's hand; ``None``: none.
        scene_model: With ``relative_to``: the scene as it stands, which pictures show.
        controller: How programs count the joints: name of a known robot, path of a table of one's
            own (``.toml``), or ``"as modelled"``; ``None``: recognised by name and geometry.
        external: What external axes show in programs, such as ``"E1 = rail"``; empty: in the
            scene's order, as the model counts.
        parts: Of a toolpath, the part that each waypoint belongs to: ``"approach"``, ``"contact"``,
            ``"retreat"`` or ``"transfer"``, (N,); empty without one.
        process: What a toolpath switches, such as ``"SPINDL/ON"``, each with the index, from 0, of
            the waypoint at which it stands, in the order of the path.
        calls: Procedures of the controller that programs call for such words, by the words; others
            are comments in programs.
        constant_speed: Whether the tool is to have the speed of the feed everywhere but on ramps:
            redundancy is spent on it, and each dip is reported.
        max_dip: Largest dip of its speed that passes, as a share of the programmed one; ``None``:
            any, reported.
        cuts: ``"fewest"``: where no motion follows the whole path, a plan may lift the tool off, as
            rarely as possible. Of a path with lift-offs (``paths.LiftOffs``) the waypoints, from 1,
            after which they are, as counted without them.
        preference: How the tool should lean and turn where that is free, which a plan weighs.

    Raises:
        InvalidInput: If segments or joint moves do not fit, a constraint cannot be evaluated on a
            path, the scene has equality constraints other than couplings of joints, there is no
            body ``relative_to``, or no joint moves the frame against it.
    """

    name: str
    title: str
    source: Path | None
    scene: Path
    model: mujoco.MjModel
    frame_name: str
    frame_type: str
    projector: TwistProjector
    operational: TwistProjector
    waypoints: tuple[mink.SE3, ...]
    flipped_waypoints: tuple[mink.SE3, ...] | None
    start: Array
    durations: Array | None
    velocity_limits: Array
    acceleration_limits: Array
    iteration: IterationSection = field(default_factory=IterationSection)
    methods: dict[str, MethodSettings] = field(default_factory=dict)
    segments: tuple[Segment, ...] = ()
    bands: tuple[ToleranceBand, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    best_start: bool | Literal["central"] = False
    starts: Mapping[str, Array] = field(default_factory=dict)
    roll_normal: Array | None = None
    study: StudySection | None = None
    toolpath: Toolpath | None = None
    lines: Lines | None = None
    from_start: FromStart = "nothing"
    joint_moves: tuple[int, ...] = ()
    relative_to: str | None = None
    scene_model: mujoco.MjModel | None = None
    controller: str | None = None
    external: tuple[str, ...] = ()
    parts: tuple[Part, ...] = ()
    process: tuple[tuple[int, str], ...] = ()
    calls: Mapping[str, str] = field(default_factory=dict)
    constant_speed: bool = False
    max_dip: float | None = None
    cuts: Literal["fewest"] | tuple[int, ...] = ()
    jerk_limits: Array | None = None
    preference: Preference | None = None

    def __post_init__(self) -> None:
        if isinstance(self.scene, str):
            object.__setattr__(self, "scene", Path(self.scene))
        _check_types(self)
        if self.relative_to is not None and self.scene_model is None:
            for name, value in _seen_from(self, self.relative_to).items():
                object.__setattr__(self, name, value)
        refuse_other_equalities("scene", self.scene_model or self.model)
        object.__setattr__(self, "constraints", _with_those_of_the_model(self))
        check_segments(self.operational, self.projector, self.segments, len(self.waypoints))
        check_joint_moves(self.joint_moves, self.segments, len(self.waypoints))
        check_calls(self.calls)
        _check_wishes(self)

    @property
    def stated_constraints(self) -> tuple[Constraint, ...]:
        """The constraints that have margins: a clearance may ignore every pair."""
        return tuple(constraint for constraint in self.constraints if len(constraint.names))

    @property
    def clearances(self) -> tuple[Clearance, ...]:
        """Those of them that are clearances."""
        return tuple(c for c in self.stated_constraints if isinstance(c, Clearance))

    def without_clearance(self) -> PathTask:
        """The same task, in which everything may touch."""
        if not self.clearances:
            return self
        constraints = [
            c.without_pairs() if isinstance(c, Clearance) else c for c in self.constraints
        ]
        return replace(self, constraints=tuple(constraints))

    def show(self, *, width: int = 960, height: int = 720) -> Picture:
        """A picture of the robot at its start, the part and the path, px, which notebooks display.

        Raises:
            QpTwistError: If there is no OpenGL; the message says what to install.
        """
        text = f"{self.name}: the start and the path"
        return picture_of(self.shown, text, width=width, height=height)

    @cached_property
    def shown(self) -> Shown:
        """The scene as it stands, with the start and the path in it."""
        return Shown.of(self)

    @property
    def arm(self) -> tuple[mujoco.MjModel, str, str]:
        """The arm as it stands: its model, and name and type of a frame at its end.

        That is the controlled frame, or, if that stands still, the body that carries the path.
        """
        frame = self.frame_name, self.frame_type
        if self.relative_to is None or self.scene_model is None:
            return self.model, *frame
        scene = self.scene_model
        if together(scene, *frame, "world", "body"):
            return scene, self.relative_to, "body"
        return scene, *frame

    @cached_property
    def poses(self) -> tuple[Array, Array]:
        """Rotations (N, 3, 3) and positions (N, 3), m, of the waypoints; read-only."""
        return _poses(self.waypoints)

    @cached_property
    def flipped_poses(self) -> tuple[Array, Array]:
        """The same of the flipped waypoints.

        Raises:
            InvalidInput: If there are none.
        """
        if self.flipped_waypoints is None:
            raise InvalidInput(
                "flipped waypoints need a roll rule with two signs; this task has no [roll]."
            )
        return _poses(self.flipped_waypoints)

    @property
    def positions(self) -> Array:
        """Positions of the waypoints in the world, or in the body that carries them, m, (N, 3)."""
        return self.poses[1]

    def at(self, s: Array | None = None, *, flipped: bool = False) -> Waypoints:
        """The path at parameters s (K,), ascending; ``None``: at its waypoints.

        Raises:
            InvalidInput: If s is not from 0, the first waypoint, to the last one, and ascending, or
                there are no ``flipped`` waypoints.
        """
        return Waypoints.of(self, s, flipped=flipped)

    def part(self, index: npt.ArrayLike | slice) -> PathTask:
        """The task of some of its waypoints (K,), in their order; others are left out.

        It begins at its own first waypoint, from the same start, and takes the time of those that
        are left out, too.
        """
        return with_waypoints(self, np.arange(len(self.waypoints))[index])  # type: ignore[index]

    @property
    def ways(self) -> tuple[str, ...]:
        """What each interval between two waypoints is, (N − 1,).

        A part of the path (contact between two waypoints of contact), or ``"joint move"``; all of
        them contact where the path has no parts.
        """
        return ways_between(self)

    @property
    def projectors(self) -> tuple[TwistProjector, ...]:
        """The projectors of the path, in its order: ``projector``, then those of the segments."""
        return (self.projector, *(segment.projector for segment in self.segments))

    @property
    def feed_time(self) -> float | None:
        """Time of the path at the feed, s, joint moves not counted; ``None`` without a feed."""
        if self.durations is None:
            return None
        along = np.ones(len(self.durations), dtype=bool)
        along[list(self.joint_moves)] = False
        return float(self.durations[along].sum())

    @cached_property
    def in_force(self) -> tuple[TwistProjector, ...]:
        """The projector whose rows hold at each waypoint; in a blend that of the common rows."""
        return projectors_in_force(self.projector, self.segments, len(self.waypoints))

    @cached_property
    def known_limits(self) -> tuple[KnownRobot, Array, Array] | None:
        """The known robot that this arm is, and its largest joint speeds and accelerations.

        rad/s and rad/s², (nv,) each; ∞ for other joints, and where none are public; ``None`` for an
        unknown robot. Timing and checks use them where the task has no limits.
        """
        return _known_limits(self)

    @property
    def tolerances(self) -> Tolerances:
        """What passes: the errors of ``[study]``, else the defaults."""
        if self.study is None:
            return Tolerances()
        return Tolerances().stated(self.study.position_error, self.study.axis_error_deg)

    @property
    def redundancy(self) -> int:
        """r_t = rank(T_O) − rank(T_T); where T changes, the smallest on the path."""
        return min(task_redundancy(self.operational, t) for t in self.projectors)

    def constraint_excess(self, q: Array) -> Array:
        """Violation of each constraint at configurations q (N, nq), m or rad, (N, C)."""
        excess = [constraint.excess(q) for constraint in self.stated_constraints]
        return np.array(excess).reshape(len(excess), len(q)).T

    def started_at(self, start: Array) -> PathTask:
        """The task with another start (nq,), and the orientation that depends on it.

        Where the path leaves a roll open, its waypoints have that of the start, for methods that
        hold the whole twist. They are kept if a band or a segment depends on that roll.
        """
        return replace(self, start=start, best_start=False, waypoints=_oriented_at(self, start))

    def settings(self, method: str) -> MethodSettings:
        """Settings of a method: its defaults, overridden by those of the file.

        Raises:
            InvalidInput: If there is no such method.
        """
        defaults = METHODS[check_method(method)].defaults
        own = self.methods.get(method)
        if own is None:
            return defaults
        return defaults.model_copy(update=own.model_dump(exclude_unset=True))

    def method_names(self) -> list[str]:
        """The methods that apply to this task, closed forms before their counterparts."""
        return [name for name in METHODS if _applies(name, self)]

    def __repr__(self) -> str:
        ranks = ", then ".join(str(t.rank) for t in self.projectors)
        on = "" if self.relative_to is None else f" on {self.relative_to!r}"
        return (
            f"PathTask({self.name!r}, {len(self.waypoints)} waypoints{on}, "
            f"rank {ranks} of {self.operational.rank})"
        )


def _poses(waypoints: tuple[mink.SE3, ...]) -> tuple[Array, Array]:
    rotations = np.array([w.rotation().as_matrix() for w in waypoints])
    positions = np.array([w.translation() for w in waypoints])
    rotations.flags.writeable = positions.flags.writeable = False
    return rotations, positions


def _applies(name: str, task: PathTask) -> bool:
    """Whether a method is one for this task, and compared without being asked for."""
    method = METHODS[name]
    return not (
        method.on_request
        or (name == "sns" and task.stated_constraints)  # bounds only
        or (method.flipped and task.flipped_waypoints is None)
        # Bands and constraints are not translated for other libraries.
        or (method.peer and (task.bands or task.stated_constraints))
        # An arm with fewer joints than operational directions cannot fix its whole twist.
        or (method.whole_twist and task.operational.rank > task.model.nv)
    )


def _known_limits(task: PathTask) -> tuple[KnownRobot, Array, Array] | None:
    names = (task.scene.stem, task.scene.parent.name)
    found = known_limits(*task.arm, names)
    if found is None:
        return None
    robot, dofs = found
    # Joints are hinges and slides, so that degrees of freedom have the order of coordinates.
    dofs = task.shown.order[dofs].tolist()
    limits = np.full((2, task.model.nv), np.inf)
    limits[0, dofs] = robot.speeds
    if robot.accelerations is not None:
        limits[1, dofs] = robot.accelerations
    return robot, limits[0], limits[1]


def _check_types(task: PathTask) -> None:
    """Refuse arguments of other types, where what they lead to would be no clear message."""
    for name, kind in {
        "name": str, "scene": Path, "model": mujoco.MjModel, "frame_name": str,
        "projector": TwistProjector, "operational": TwistProjector,
    }.items():  # fmt: skip
        instance(f"PathTask({name}=…)", getattr(task, name), kind)
    ways = task.waypoints
    if not isinstance(ways, (list, tuple)) or not all(isinstance(w, mink.SE3) for w in ways):
        raise InvalidInput(f"PathTask(waypoints=…): expected poses, mink.SE3, got {ways!r:.80}.")
    if not ways:
        raise InvalidInput("PathTask(waypoints=…): there are none; a path has at least one.")
    finite_array("PathTask(start=…)", task.start, (task.model.nq,))


def _check_wishes(task: PathTask) -> None:
    """Refuse a preference, lift-offs or a dip of the speed that no motion can be asked for."""
    if task.preference is not None:
        instance("PathTask(preference=…)", task.preference, Preference)
        task.preference.at(len(task.waypoints))
    if task.cuts != "fewest" and not isinstance(task.cuts, tuple):
        raise InvalidInput(
            f'cuts: expected "fewest" or a tuple of waypoints, got {task.cuts!r:.80}.',
            key="plan.cuts",
        )
    if task.max_dip is not None:
        number("max_dip", task.max_dip, at_least=0.0, at_most=1.0)
    if task.max_dip is not None and not task.constant_speed:
        raise InvalidInput(
            'max_dip is for a constant speed of the tool: add mode = "constant" to [feed], '
            "constant_speed=True in Python.",
            key="feed.max_dip",
        )


def _seen_from(task: PathTask, body: str) -> dict[str, object]:
    """The model as seen from a body, and all arrays by joint in its order."""
    check_carrier(task.model, task.frame_name, task.frame_type, body)
    seen = rerooted(task.model, body)
    by_joint = ["start", "velocity_limits", "acceleration_limits"]
    by_joint += [] if task.jerk_limits is None else ["jerk_limits"]
    return {
        "model": seen.model,
        "scene_model": task.model,
        "starts": {name: seen.ordered(start) for name, start in task.starts.items()},
        **{name: seen.ordered(getattr(task, name)) for name in by_joint},
    }


def _with_those_of_the_model(task: PathTask) -> tuple[Constraint, ...]:
    """Constraints that were passed, with couplings and clearance of the current model.

    Where geoms of the model may collide, and no clearance is passed, they must not touch. A
    clearance of another model is made anew, with the name that the world has in this one.
    """
    given, model = task.constraints, task.model
    if not isinstance(given, (list, tuple)):
        return check_constraints(task.name, given, model)
    couplings = [c for c in given if isinstance(c, JointCouplings)]
    others = [c for c in given if not isinstance(c, (JointCouplings, Clearance))]
    world = "world" if task.relative_to is None else OLD_WORLD
    clearances = [_of_model(c, model, world) for c in given if isinstance(c, Clearance)]
    checked = check_constraints(task.name, others, model)
    if not clearances and JointRanges.of(model).only_hinges_and_slides:
        own = Clearance(model, 0.0)
        clearances = [own] if len(own.pairs) else []
    check_constraints(task.name, clearances, model)
    return *checked, *couplings_of(model, couplings), *clearances


def _of_model(clearance: Clearance, model: mujoco.MjModel, world: str) -> Clearance:
    """The clearance, if need be made anew of another model."""
    if clearance.model is model:
        return clearance
    pairs = [
        tuple(re.sub(r"^world(?=$| geom \d+$)", world, part) for part in pair)
        for pair in clearance.ignored
    ]
    speed = clearance.recovery_speed
    return Clearance(model, clearance.distance, pairs, recovery_speed=speed)


def _oriented_at(task: PathTask, start: Array) -> tuple[mink.SE3, ...]:
    """The waypoints, with the orientation at a start (nq,) where they have it from there."""
    if task.from_start == "nothing" or _sees_orientation(task):
        return task.waypoints
    configuration = mink.Configuration(task.model, start)
    held, _ = frame_pose(configuration, task.frame_name, task.frame_type)
    rotations = np.broadcast_to(held, (len(task.waypoints), 3, 3))
    if task.from_start == "roll":
        rotations = transported(held, task.poses[0][:, :, 2])
    return poses(task.positions, rotations)


def _sees_orientation(task: PathTask) -> bool:
    """Whether a band or projector depends on the orientation that comes from the start."""
    if task.bands:
        return True
    for projector in task.projectors:
        angular = projector.angular
        roll = angular.kind is ProjectorKind.PLANE and projector.frame == "body"
        if roll and task.from_start == "roll" and angular.axis is not None:
            roll = bool(abs(angular.axis[2]) > 1.0 - SAME_DIRECTION)
        elif task.from_start == "orientation":
            roll = False
        if not roll and angular.kind is not ProjectorKind.NONE:
            return True
        if projector.linear.axis is not None and projector.frame == "target":
            return True
    return False


def check_carrier(
    scene: mujoco.MjModel, frame_name: str, frame_type: str, relative_to: str
) -> None:
    """Refuse a body ``relative_to`` that a path cannot lie on.

    Raises:
        InvalidInput: If there is no such body, not all joints are hinges and slides, or none of
            them moves the frame against the body.
        mink.InvalidFrame: If there is no such frame.
    """
    check_body(scene, relative_to)
    if not JointRanges.of(scene).only_hinges_and_slides:
        raise InvalidInput(
            "a path on a body is for scenes whose joints are all hinges and slides.",
            key="relative_to",
        )
    if together(scene, frame_name, frame_type, relative_to, "body"):
        raise InvalidInput(
            f"no joint moves the {frame_type} {frame_name!r} against the body "
            f"{relative_to!r}, which is to carry the path; name the body that carries the part.",
            key="relative_to",
        )


def check_method(method: str) -> str:
    """``method`` if it is one of the known names.

    Raises:
        InvalidInput: If there is no such method.
    """
    if not isinstance(method, str) or method not in METHODS:
        hint = did_you_mean(str(method), METHODS)
        raise InvalidInput(f"unknown method {method!r}{hint} Methods: {', '.join(METHODS)}.")
    return method


def twist_task(path_task: PathTask, projector: TwistProjector) -> TwistTask:
    """The twist task of a path's frame with one of its projectors, and the path's bands.

    There are no bands with the whole operational twist, which leaves no freedom for them.
    """
    return TwistTask(
        path_task.frame_name,
        path_task.frame_type,
        projector,
        max_linear_step=path_task.iteration.max_linear_step,
        max_angular_step=path_task.iteration.max_angular_step,
        bands=() if projector is path_task.operational else path_task.bands,
    )
