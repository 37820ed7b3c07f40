"""Trajectories as robot programs: joint rows in the controller's axes, and back."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from qp_twist.checks import Array
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
    Dialect,
    JointMoves,
    check_header,
    dialect_of,
    joint_moves,
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
from qp_twist.trajectories.followed import Followed, followed
from qp_twist.trajectories.timed_path import TimedPath

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
        _refuse_no_time(moves, found)
    rates = None if moves.velocities is None else joints.rates(moves.velocities / scale)
    notes = [*joints.notes, *moves.notes, *external]
    if rates is None and found.times is not None:
        straight = np.array(moves.straight or [0] * len(moves.in_times), dtype=bool)
        by_speed = (~moves.in_times & ~straight).any()
        notes.append(
            f"{path.name}: checked as {'' if moves.straight is None else 'its straight moves and '}"
            "straight joint moves at constant speed from point to point"
            f"{', but those at a speed v from rest to rest by their v and a' if by_speed else ''}; "
            "the controller's ramps are its own, for which it has half of both moves at a point"
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
        at_rests=found.at_rests if rates is None else None,
        lines=moves.lines,
        stops=tuple(found.points[[*moves.rests]].tolist()),
        unjudged=tuple(unjudged),
        program=f"{len(lines)} lines, {moves.points} points",
        beside=tuple(filter(None, moves.header.get("beside", "").split(", ")))
        if moves.header
        else None,
    )


def _refuse_no_time(moves: JointMoves, found: Followed) -> None:
    """Refuse a move in which no time passes, with its line."""
    times = np.zeros(0) if found.times is None else found.times
    if len(rows := 1 + np.flatnonzero(np.diff(times) <= 0.0)):
        raise InvalidInput(
            f"the move takes no time that counts, {times[rows[0]]:.9g} s after the start: it leads "
            "to where the robot is, or a move before it takes far too long. Remove it, or correct "
            "the time.",
            line=moves.lines[int(np.searchsorted(found.points, rows[0]))],
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
