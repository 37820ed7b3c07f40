"""What a motion was made of, in the words of a person who did not program the robot."""

from __future__ import annotations

import datetime
import math
from importlib.metadata import version

import numpy as np

from qp_twist import __version__
from qp_twist.geometry import ProjectorKind, TwistProjector
from qp_twist.paths import PathTask, in_joint_moves
from qp_twist.robots import known_robot
from qp_twist.trajectories import Check

_HELD = {
    ProjectorKind.FULL: ("position", "orientation", ""),
    ProjectorKind.PLANE: (
        "position in a plane", "direction of one axis", "; free: the rotation about it",
    ),
    ProjectorKind.LINE: (
        "position along a line", "rotation about one axis", "; free: the direction of that axis",
    ),
    ProjectorKind.NONE: ("", "", "; free: the orientation"),
}  # fmt: skip
"""What a projector holds as a linear block, as an angular one, and what this leaves free."""


def facts(path_task: PathTask, check: Check, file: str) -> dict[str, str]:
    """Robot, path, files, versions; ``file`` is the name of the motion's, empty without one."""
    steps = np.linalg.norm(np.diff(path_task.positions, axis=0), axis=1)
    length = float(steps[~in_joint_moves(path_task)].sum())
    held = dict.fromkeys(map(_held, path_task.projectors))
    toolpath = path_task.toolpath
    elsewhere = check.speed.sentences if check.speed else ()  # in a section of their own
    found = {
        "Robot": _robot(path_task),
        "Moving frame": f"{path_task.frame_name} ({path_task.frame_type})",
        "Path lies on": path_task.relative_to or "",
        "Held along the path": "; then ".join(held),
        "Toolpath": "stated in the task file"
        if toolpath is None
        else f"{toolpath.source.name}, number of curves: {len(toolpath.curves)}",
        "Path": f"{len(path_task.waypoints)} waypoints, {length:.4g} m",
        "Task file": "built in Python" if path_task.source is None else path_task.source.name,
        "Motion": f"{file + ', ' if file else ''}{check.rows} points",
        "Program": check.program,
        "Tolerances": f"{1e3 * check.tolerances.position:.4g} mm, "
        f"{math.degrees(check.tolerances.axis):.4g}°",
        "Notes": "; ".join(note for note in check.notes if note not in elsewhere),
        "Date": datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M"),
        "Made by": f"qp_twist {__version__}, MuJoCo {version('mujoco')}",
    }
    return {name: text for name, text in found.items() if text}


def _held(projector: TwistProjector) -> str:
    """What the task holds, and what it leaves free."""
    _, turn, free = _HELD[projector.angular.kind]
    return " and ".join(filter(None, (_HELD[projector.linear.kind][0], turn))) + free


def _robot(path_task: PathTask) -> str:
    """The known robot and where its figures are from; else the scene's name."""
    known = known_robot(*path_task.arm, (path_task.scene.stem, path_task.scene.parent.name))
    if known is not None:
        return f"{known.name}, recognised by name and geometry ({known.source})"
    title = path_task.model.names.split(b"\0", 1)[0].decode(errors="replace")
    name = title if title and title != "MuJoCo Model" else path_task.scene.stem
    return f"{name}, {path_task.scene.name}; not in the table of known robots"
