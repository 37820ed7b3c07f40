"""Trajectories as robot programs: joint rows in the controller's axes, and back."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.files import of_file, read_bytes, text_lines
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
    header_lines,
    joint_moves,
    printed,
)
from qp_twist.robots import (
    ControllerJoints,
    controller_joints,
    known_robot,
    stated_robot,
)
from qp_twist.robots.wording import listed
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
) -> ControllerJoints:
    """How the controller counts the joints of a task's robot.

    Args:
        path_task: The task; ``None`` if there is only a trajectory, whose joints are then taken in
            its order, with the zero positions and signs of the robot that is named.
        joint_names: The joints of the trajectory.
        robot: Name of a known robot, or a file with one in the form of the package's table;
            ``None``: as the task states it, or recognised by name and geometry.
        as_modelled: Take the joints as the model counts them.

    Raises:
        InvalidInput: If the robot is not known, or the arm is not that robot.
    """
    stated = None if path_task is None or as_modelled else path_task.controller
    if robot is None and stated is not None:
        as_modelled, robot = stated == AS_MODELLED, None if stated == AS_MODELLED else stated
    if as_modelled:
        if robot is not None:
            raise InvalidInput("give a robot, or take the joints as modelled, but not both.")
        if path_task is not None and not JointRanges.of(path_task.model).hinge.all():
            raise InvalidInput(
                f"{path_task.name}: the robot has joints that are no hinges; programs are written "
                f"for arms of {AXES} hinges."
            )
        return ControllerJoints.as_modelled(joint_names)
    given = None if robot is None else stated_robot(robot)
    if path_task is None:
        if given is None:
            raise InvalidInput(
                "which robot it is has to be said: give the task of the trajectory, whose robot is "
                "recognised, or a name (--robot)."
            )
        return ControllerJoints.of_robot(given, joint_names)
    if given is None:
        names = (path_task.scene.stem, path_task.scene.parent.name)
        given = known_robot(*path_task.arm, names)
        if given is None:
            raise InvalidInput(
                f"{path_task.name}: the robot is not one of the known robots, so that nothing says "
                f"where its controller counts from. {_ADVICE}"
            )
    joints = controller_joints(*path_task.arm, given)
    of_dofs = JointRanges.of(path_task.model).names
    chain = SerialChain.of(path_task.model, path_task.frame_name, path_task.frame_type)
    moving = [of_dofs[screw.dof] for screw in chain.screws]
    others = [name for name in moving if name not in joints.joint_names]
    if others:
        raise InvalidInput(
            f"{path_task.name}: the path also needs {listed('joint', others)}, and a program for "
            f"the {joints.robot} has only the axes of the robot: external axes are not written. "
            "Export a bag, which has all joints (--to mcap)."
        )
    return joints


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
    rows: TimedPath, dialect: Dialect, joints: ControllerJoints, name: str
) -> dict[str, str]:
    """The texts of a program's files, by name.

    Raises:
        InvalidInput: If the robot is not programmed in this language, the trajectory has no times
            or leaves the robot's ranges, or the name is none for the controller.
    """
    dialect.check_name(name)
    check_language(dialect, joints)
    rows = rows.of_joints(joints.joint_names)
    if outside := joints.outside(rows.q):
        raise InvalidInput(f"{outside}; the robot cannot go there.")
    scale = _scale(dialect)
    velocities = None if rows.velocities is None else scale * joints.shown_rates(rows.velocities)
    durations = None if rows.times is None else np.diff(rows.times)
    if len(rows.q) < 2:
        raise InvalidInput("the trajectory has one row; a program needs two or more.")
    moves = printed(JointMoves(scale * joints.shown(rows.q), durations, velocities), dialect)
    # In characters that every controller reads, and on one line.
    task = "".join(c if " " <= c <= "~" else "?" for c in str(rows.metadata.get("task", "")))
    equations = joints.equations(dialect.axis_names)
    task = " ".join(task.split())[:60]
    lines = header_lines(dialect, moves, joints.robot, equations, task)
    return dialect.encode(name, moves, lines)


def decode(path: Path, dialect: Dialect, joints: ControllerJoints) -> TimedPath:
    """The rows of a program.

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
        moves = joint_moves(path, dialect, lines)
        check_header(moves, dialect, joints.robot, joints.equations(dialect.axis_names))
    scale = _scale(dialect)
    times = None
    if moves.durations is not None:
        times = np.concatenate([[0.0], np.cumsum(moves.durations)])
    rates = None if moves.velocities is None else joints.rates(moves.velocities / scale)
    notes = [*joints.notes, *moves.notes]
    if rates is None and times is not None:
        notes.append(
            f"{path.name}: checked as straight joint moves at constant speed from point to point; "
            "the controller's ramps and roundings are its own"
        )
    if moves.header.get("seconds") is None:
        notes.append(
            f"{path.name} has no header of qp_twist: a line that was lost is not noticed as such"
        )
    metadata = {"task": moves.header["task"]} if "task" in moves.header else {}
    return TimedPath(
        joints.joint_names,
        joints.positions(moves.angles / scale),
        times,
        rates,
        metadata,
        notes=tuple(notes),
        sources=(joints.origin + (f" ({joints.source})" if joints.source else ""),),
        own_ramps=rates is None,
    )


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
    if len(joints.joint_names) != AXES:
        raise InvalidInput(
            f"{dialect.title} moves {AXES} axes, and there are {len(joints.joint_names)} joints: "
            f"{', '.join(joints.joint_names)}."
        )


def _scale(dialect: Dialect) -> float:
    """Factor from rad to the dialect's unit."""
    return float(np.degrees(1.0)) if dialect.unit == "deg" else 1.0
