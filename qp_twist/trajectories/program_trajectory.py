"""Trajectories as robot programs: joint rows in the controller's axes, and back."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.errors import InvalidInput
from qp_twist.files import of_file, of_lines, read_bytes, text_lines
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.paths import PathTask
from qp_twist.programs import (
    AS_MODELLED,
    AXES,
    DIALECTS,
    DOES_NOT_PASS,
    WRITTEN_AS_MODELLED,
    Around,
    Dialect,
    ExternalColumn,
    JointMoves,
    check_header,
    dialect_of,
    header_lines,
    joint_moves,
    printed,
)
from qp_twist.robots import (
    ControllerJoints,
    ExternalAxis,
    KnownRobot,
    ToolChain,
    as_stated,
    controller_joints,
    hinges_of,
    known_robot,
    stated_robot,
)
from qp_twist.robots.tool_chain import Part
from qp_twist.robots.wording import listed
from qp_twist.trajectories.around_moves import around_rows
from qp_twist.trajectories.corners import Corners, task_rows
from qp_twist.trajectories.followed import followed
from qp_twist.trajectories.linear_moves import (
    LinearMotion,
    StraightMoves,
    rounded_shares,
    straight_moves,
)
from qp_twist.trajectories.spaced_rows import spaced
from qp_twist.trajectories.timed_path import TimedPath
from qp_twist.trajectories.within_limits import JointLimits, Way, within_limits

_ADVICE = (
    "Give its name (--robot), a table of your own (--robot FILE.toml), or, if the controller's "
    "zero positions and directions are those of the model, say so (--as-modelled)."
)

_HEADER_AS_MODELLED = re.compile(
    rb"^[ \t]*[#!;][ \t]*robot: " + AS_MODELLED.encode() + rb"\s*$", re.MULTILINE
)
"""The header's line in programs written as modelled, which LS programs are not."""


def joints_of(
    path_task: PathTask | None,
    joint_names: tuple[str, ...],
    *,
    robot: str | Path | None = None,
    as_modelled: bool = False,
    external: Sequence[str] = (),
) -> ControllerJoints:
    """How the controller counts the joints of a task's robot.

    Args:
        path_task: The task; ``None`` if there is only a trajectory, whose joints are then taken in
            its order, with the zero positions and signs of the robot that is named.
        joint_names: The joints of the trajectory.
        robot: Name of a known robot, or a file with one in the form of the package's table;
            ``None``: as the task states it, or recognised by name and geometry.
        as_modelled: Take the joints as the model counts them.
        external: What external axes show, as ``"E1 = rail"`` or ``"E2 = -tilt + 90 deg"``; empty:
            as the task states it, else in the scene's order, as the model counts.

    Raises:
        InvalidInput: If the robot is not known, or the arm is not that robot.
    """
    joints, known = _robot_joints(path_task, joint_names, robot, as_modelled=as_modelled)
    if path_task is None:
        if external:
            raise InvalidInput(
                "external: which joints slide, is known from a task's model; give the task, too."
            )
        return joints
    axes = _external_axes(path_task, joints)
    if stated := tuple(external) or path_task.external:
        axes = as_stated(axes, stated)
    return joints.with_external(axes).with_tool(_tool_of(path_task, axes), known)


def _tool_of(path_task: PathTask, axes: Sequence[ExternalAxis]) -> ToolChain:
    """What moves the task's frame on the part, with these external axes."""
    chain = SerialChain.of(path_task.model, path_task.frame_name, path_task.frame_type)
    names = JointRanges.of(path_task.model).names
    own = tuple(names[screw.dof] for screw in chain.screws)
    external = tuple(own.index(axis.joint) for axis in axes)
    held = path_task.relative_to is not None and path_task.arm[1:] == (
        path_task.relative_to,
        "body",
    )
    on_part = any(axis.on_part for axis in axes)
    part: Part = "positioner" if on_part else "hand" if held else ""
    return ToolChain(chain, own, path_task.frame_name, external, part)


def _external_axes(path_task: PathTask, joints: ControllerJoints) -> tuple[ExternalAxis, ...]:
    """The joints besides those of the arm that move the tool on its path, in the scene's order."""
    model, ranges = path_task.model, JointRanges.of(path_task.model)
    chain = SerialChain.of(model, path_task.frame_name, path_task.frame_type)
    moving = {ranges.names[screw.dof]: screw.slides for screw in chain.screws}
    arm = SerialChain.of(*path_task.arm)
    of_scene = JointRanges.of(path_task.shown.model).names
    carry_arm = {of_scene[screw.dof] for screw in arm.screws}
    return tuple(
        ExternalAxis(name, moving[name], name not in carry_arm)
        for name in of_scene
        if name in moving and name not in joints.joint_names
    )


def _robot_joints(
    path_task: PathTask | None,
    joint_names: tuple[str, ...],
    robot: str | Path | None,
    *,
    as_modelled: bool,
) -> tuple[ControllerJoints, KnownRobot | None]:
    """How the controller counts the joints of the arm itself, and the robot if it is known."""
    stated = None if path_task is None or as_modelled else path_task.controller
    if robot is None and stated is not None:
        as_modelled, robot = stated == AS_MODELLED, None if stated == AS_MODELLED else stated
    if as_modelled:
        if robot is not None:
            raise InvalidInput("give a robot, or take the joints as modelled, but not both.")
        if path_task is None:
            return ControllerJoints.as_modelled(joint_names), None
        of_scene = JointRanges.of(path_task.shown.model).names
        arm = hinges_of(*path_task.arm)[-AXES:]
        return ControllerJoints.as_modelled([of_scene[screw.dof] for screw in arm]), None
    given = None if robot is None else stated_robot(robot)
    if path_task is None:
        if given is None:
            raise InvalidInput(
                "which robot it is has to be said: give the task of the trajectory, whose robot is "
                "recognised, or a name (--robot)."
            )
        return ControllerJoints.of_robot(given, joint_names), given
    if given is None:
        names = (path_task.scene.stem, path_task.scene.parent.name)
        given = known_robot(*path_task.arm, names)
        if given is None:
            raise InvalidInput(
                f"{path_task.name}: the robot is not one of the known robots, so that nothing says "
                f"where its controller counts from. {_ADVICE}"
            )
    return controller_joints(*path_task.arm, given), given


def check_program(path: Path, joints: ControllerJoints, path_task: PathTask) -> None:
    """Refuse a program that could not be written, before its trajectory is computed.

    Raises:
        InvalidInput: If the controller does not take the file's name or the language, or the task
            has no feed.
    """
    dialect = dialect_of(path)
    assert dialect is not None
    with of_file(path):
        dialect.check_name(path.stem)
        check_language(dialect, joints)
    if path_task.durations is None:
        raise InvalidInput(
            f"{path_task.name}: has no [feed], so that a program would not know how fast to move; "
            "add one to the task file."
        )


def encode(
    rows: TimedPath,
    dialect: Dialect,
    joints: ControllerJoints,
    name: str,
    path_task: PathTask | None = None,
    linear: LinearMotion | None = None,
    shares: Array | None = None,
) -> dict[str, str]:
    """The texts of a program's files, by name.

    Rows closer in time than the controller interpolates are :func:`spaced
    <qp_twist.trajectories.spaced_rows.spaced>`, with the tolerances of the task, if there is one.
    With ``linear`` the tool moves straight along the path. Points are rounded by these ``shares``
    (N,) of what they would be, if there are so many.

    Raises:
        InvalidInput: If the robot is not programmed in this language, the trajectory has no times
            or leaves the robot's ranges, or the name is none for the controller.
    """
    dialect.check_name(name)
    check_language(dialect, joints)
    around = {} if path_task is None else around_rows(rows, path_task)
    held = np.isin(np.arange(len(rows.q)), list(around))
    kept = _kept(rows, dialect, joints, path_task, held, linear, shares)
    task = str(rows.metadata.get("task", ""))
    original, line, remarks = rows, kept.line, list(kept.remarks)
    rows = kept.rows.of_joints(joints.joint_names)
    if outside := joints.outside(rows.q):
        raise InvalidInput(f"{outside}; the robot cannot go there.")
    scale = joints.scale(dialect.unit)
    names = axis_names(dialect, joints)
    velocities = None if rows.velocities is None else scale * joints.shown_rates(rows.velocities)
    durations = None if rows.times is None else np.diff(rows.times)
    if len(rows.q) < 2:
        raise InvalidInput("the trajectory has one row; a program needs two or more.")
    columns = zip(names[AXES:], joints.external, strict=True)
    external = tuple(ExternalColumn(name, axis.unit) for name, axis in columns)
    planned = JointMoves(scale * joints.shown(rows.q), durations, velocities, external=external)

    def written(planned: JointMoves) -> JointMoves:
        moves = printed(planned, dialect)
        if line is None or linear is None:
            return moves
        return linear.moves(moves, planned, line, joints, dialect)

    moves, longer = _timed(planned, written, kept, dialect, joints, path_task, shares)
    if any(moves.circles) and line is not None and linear is not None:
        assert moves.shares is not None
        if ((moves.shares == 0.0) & (line.shares > 0.0)).any():  # the robot would stop beside one
            plain = linear._replace(circles=False)
            return encode(original, dialect, joints, name, path_task, plain, shares)
    if longer > 0.0:
        remarks.append(f"{longer:.3f} s longer, so that joints keep their limits")
    moves = _with_around(moves, {int(np.searchsorted(kept.at, k)): v for k, v in around.items()})
    # In characters that every controller reads, and on one line.
    task = " ".join("".join(c if " " <= c <= "~" else "?" for c in task).split())[:60]
    equations = joints.equations(names)
    lines = header_lines(dialect, moves, joints.robot, equations, task, "; ".join(remarks))
    return dialect.encode(name, moves, lines)


class _Kept(NamedTuple):
    """The points, straight moves between them, at or between which rows they are, and remarks."""

    rows: TimedPath
    line: StraightMoves | None
    at: Array
    remarks: Sequence[str]


def _kept(
    rows: TimedPath, dialect: Dialect, joints: ControllerJoints, path_task: PathTask | None,
    held: Mask, linear: LinearMotion | None, shares: Array | None,
) -> _Kept:  # fmt: skip
    """The rows that become points, ``held`` ones among them, no closer than a period."""
    remarks, line, original, at = list[str](), None, rows, np.arange(float(len(rows.q)))
    if linear is not None:
        line = _straight(rows, dialect, joints, path_task, held, circles=linear.circles)
        line = line._replace(shares=_less(line.shares, shares, dialect))
        rows, held = line.rows, np.zeros(len(line.rows.q), dtype=bool)
        at = np.searchsorted(original.motion.times, rows.motion.times).astype(float)
        if line.instead:
            remarks.append(f"{line.instead} joint moves where the joints do not follow a straight "
                           "one, or not within their limits")  # fmt: skip
    if dialect.period and rows.times is not None and (np.diff(rows.times) > 0.0).all():
        of = None if line is not None else path_task  # straight moves keep their points
        times, tick = rows.times, 10.0**-dialect.time_decimals
        rows, left_out, longer, points, moved = spaced(rows, dialect.period, tick, of, held)
        at = np.interp(points, times, at)
        if left_out or longer:
            remarks.append(f"{left_out} rows left out, {longer} moves longer: none is below the "
                           f"controller's {1e3 * dialect.period:g} ms")  # fmt: skip
        if moved:
            remarks.append(f"{moved} points between rows, so that times are whole {tick:g} s")
    return _Kept(rows, line, at, remarks)


def _timed(
    planned: JointMoves, written: Callable[[JointMoves], JointMoves], kept: _Kept,
    dialect: Dialect, joints: ControllerJoints, path_task: PathTask | None, less: Array | None,
) -> tuple[JointMoves, float]:  # fmt: skip
    """The moves as written, and by how much they are longer, s, so that joints keep limits."""
    if path_task is None or joints.tool is None or planned.durations is None:
        return written(planned), 0.0
    q, line = kept.rows.of_joints(joints.tool.names).q, kept.line
    if line is None:
        corners = Corners.of(joints.tool, q, [None] * (len(q) - 1))
        within = task_rows(path_task), path_task.tolerances
        shares = _less(rounded_shares(corners, *within, dialect.zone), less, dialect)
        planned = replace(planned, shares=shares)
        if dialect.cubic and planned.velocities is not None:
            return written(planned), 0.0
    ways = [Way.to(each) for each in q[1:]] if line is None else [each.way for each in line.moves]
    limits = JointLimits.of(path_task, joints.tool.names, ramps=dialect.constant > 0.0)
    return within_limits(planned, q[0], ways, limits, written)


def _less(shares: Array, by: Array | None, dialect: Dialect) -> Array:
    """Rounding that is less by some shares (N,); none where points are rounded from a zone on."""
    if by is None or len(by) != len(shares):
        return shares
    return shares * (by == 1.0) if np.isfinite(dialect.zone) else shares * by


def _with_around(moves: JointMoves, around: dict[int, tuple[Around, ...]]) -> JointMoves:
    """The moves with what stands around them; the robot stops where a procedure is called."""
    calls = [k for k, found in around.items() if any(each.call for each in found)]
    if not calls:
        return replace(moves, around=around)
    shares = np.where(moves.stops, 0.0, 1.0) if moves.shares is None else moves.shares.copy()
    shares[calls] = 0.0
    return replace(moves, around=around, shares=shares)


def _straight(
    rows: TimedPath, dialect: Dialect, joints: ControllerJoints, path_task: PathTask | None,
    held: Mask, *, circles: bool,
) -> StraightMoves:  # fmt: skip
    """The rows between which the tool moves straight.

    Raises:
        InvalidInput: If the language has no such moves here, or the tool is not known.
    """
    if not dialect.points:
        raise InvalidInput(
            f"straight moves are not written in {dialect.title}; write joint moves (--motion "
            "joint)."
        )
    if path_task is None or joints.tool is None or rows.times is None:
        raise InvalidInput("straight moves need a trajectory with times and its task.")
    return straight_moves(rows, path_task, joints.tool, held, dialect=dialect, circles=circles)


def decode(
    path: Path, dialect: Dialect, joints: ControllerJoints, calls: Collection[str] = ()
) -> TimedPath:
    """The rows of a program, which may call these procedures although it does not have them.

    Raises:
        InvalidInput: If the file cannot be read, has more than joint moves, or contradicts its
            header; with the line.
    """
    content = read_bytes(path, "program")
    with of_file(path):
        modelled = _HEADER_AS_MODELLED.search(content)
        other = WRITTEN_AS_MODELLED if modelled else "the program is for another robot"
        check_language(dialect, joints, other)
        if re.search(rb"\r(?!\n)|\x1a(?!\s*$)", content):
            raise InvalidInput(
                "a carriage return or an end-of-file mark stands within the text; a controller may "
                "read the lines after it in another way. Write the program with plain line ends."
            )
        lines = text_lines(content)
        if lines[0].startswith(DOES_NOT_PASS):
            raise InvalidInput(f"{lines[0]} (written all the same, by --force).", line=1)
        moves = joint_moves(path, dialect, lines, calls)
        claimed = moves.header.get("axes", "").split("\n")[AXES:]
        if joints.external and claimed and not any(each.axis for each in joints.external):
            joints = joints.with_external(as_stated(joints.external, claimed))
        names = axis_names(dialect, joints)
        equations = joints.equations(names)
        tcp = None if joints.arm is None else joints.arm.tool_in_flange
        check_header(moves, dialect, joints.robot, equations, tcp)
        angles, external = _columns(moves, joints, names)
        scale = joints.scale(dialect.unit)
        vias = [
            None if each is None or each.angles is None or joints.external
            else joints.positions(np.array([each.angles]) / scale)[0]
            for each in moves.circles
        ]  # fmt: skip
        found = followed(moves, joints.positions(angles / scale), joints, vias)
    rates = None if moves.velocities is None else joints.rates(moves.velocities / scale)
    notes = [*joints.notes, *moves.notes, *external]
    if rates is None and found.times is not None:
        notes.append(
            f"{path.name}: checked as {'' if moves.straight is None else 'its straight moves and '}"
            "straight joint moves at constant speed from point to point; the controller's ramps "
            "are its own, for which it has half of both moves at a point"
        )
    if "spacing" in moves.header:
        notes.append(f"{path.name}: {moves.header['spacing']}")
    if moves.header.get("seconds") is None:
        notes.append(
            f"{path.name} has no header of qp_twist: a line that was lost is not noticed as such"
        )
    unjudged = []
    if moves.zones and found.corners is None:
        unjudged.append(
            "rounded points not checked: the program was read without the task's tool (joints_of)"
        )
    if found.short:
        unjudged.append(
            f"{len(found.short)} moves are too short for their speed v at their acceleration a, so "
            f"that they take longer than checked ({of_lines(found.short)})"
        )
    metadata = {"task": moves.header["task"]} if "task" in moves.header else {}
    return TimedPath(
        joints.joint_names,
        found.q,
        found.times,
        rates,
        metadata,
        notes=tuple(notes),
        sources=(joints.origin + (f" ({joints.source})" if joints.source else ""),),
        own_ramps=rates is None,
        points=found.points if rates is None else None,
        zones=moves.zones,
        corners=found.corners,
        ramps=found.ramps,
        stops=tuple(found.points[[*moves.rests]].tolist()),
        unjudged=tuple(unjudged),
        program=f"{len(lines)} lines, {moves.points} points",
    )


def axis_names(dialect: Dialect, joints: ControllerJoints) -> tuple[str, ...]:
    """The names of all axes in a language."""
    given = [(each.axis, each.on_part) for each in joints.external]
    return (*dialect.axis_names, *dialect.external_names(given))


def _columns(
    moves: JointMoves, joints: ControllerJoints, names: Sequence[str]
) -> tuple[Array, list[str]]:
    """A program's axes in the order of the joints, and notes about external ones.

    Raises:
        InvalidInput: If an external axis is not stated from the first move on, or in another unit,
            or one moves that is no joint of the path.
    """
    axes, found = list(range(AXES)), {each.name: each for each in moves.external}
    for name, joint in zip(names[AXES:], joints.external, strict=True):
        column = found.pop(name, None)
        place = len(axes) if column is None else AXES + moves.external.index(column)
        if column is None or np.isnan(moves.angles[0, place]):
            raise InvalidInput(
                f"the program does not state the external axis {name} ({joint.joint}) from its "
                "first move on; if it is another one, say which (--external, or external in "
                "[robot] of the task file)."
            )
        if column.unit not in ("", joint.unit):
            raise InvalidInput(
                f"{name} is in {column.unit}, but {joint.joint} of the model "
                f"{'slides' if joint.slides else 'turns'}: expected {joint.unit}."
            )
        axes.append(place)
    for column in found.values():
        if column.moved is not None:
            line, what = column.moved
            raise InvalidInput(
                f"{what}, and the path needs no joint that is this one: external axes of other "
                "joints have to stand still.",
                line=line,
            )
    still = [
        f"{k} at {moves.angles[-1, AXES + moves.external.index(c)]:g}" for k, c in found.items()
    ]
    notes = []
    if still:
        notes.append(
            f"external axes stand still, {', '.join(still)}: whether the task has them there is "
            "not checked"
        )
    if joints.external:
        listed = ", ".join(joints.equations(names)[AXES:])
        notes.append(
            f"external axes, {listed}: no table has their zero and direction; compare the first "
            "point with the pendant"
        )
    return moves.angles[:, axes], notes


def check_language(dialect: Dialect, joints: ControllerJoints, instead: str | None = None) -> None:
    """Refuse a language in which the robot is not programmed.

    ``instead`` says what to do; ``None``: choose a file with the suffix of the robot's language.

    Raises:
        InvalidInput: With the language to use.
    """
    if joints.robot and joints.program != dialect.name:
        if instead is None:
            suffix = DIALECTS[joints.program].suffix if joints.program else ".mcap (a bag)"
            instead = f"choose a file that ends in {suffix}"
        if dialect.name != "ls" and instead != WRITTEN_AS_MODELLED:  # no model counts Fanuc's J3
            instead += ", or say that joints count as in the model (--as-modelled)"
        raise InvalidInput(
            f"the {joints.robot} is programmed in {joints.program or 'none of them'}, not in "
            f"{dialect.name}; {instead.rstrip('.')}."
        )
    if not joints.robot and dialect.name == "ls":
        raise InvalidInput(
            "the controllers of Fanuc show J3 as the angle of the forearm to the floor, the angle "
            "between the links less J2, which no model counts (--as-modelled); give the robot's "
            "name, or a table of your own with its coupling (--robot FILE.toml)."
        )
    if joints.robot_axes != AXES:
        raise InvalidInput(
            f"{dialect.title} moves {AXES} axes, and there are {joints.robot_axes} joints at the "
            f"arm's end that are hinges: {', '.join(joints.joint_names[: joints.robot_axes])}."
        )
    if joints.external and not dialect.external:
        others = listed("joint", [each.joint for each in joints.external])
        raise InvalidInput(
            f"the path also needs {others}, and {dialect.title} moves the robot's {AXES} joints "
            "alone: other axes are driven by further software (MotionPlus, a PLC), whose programs "
            "are not written. Export a bag, which has all joints (--to mcap)."
        )
    axis_names(dialect, joints)  # refuses what the language does not have
