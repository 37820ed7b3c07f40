"""What a motion was made of: robot, tool, path, files, versions."""

from __future__ import annotations

import datetime
from importlib.metadata import version

import numpy as np

from qp_twist.paths import PathTask, in_joint_moves
from qp_twist.reporting.words import digits, what_is_free
from qp_twist.robots import known_robot
from qp_twist.trajectories import Check


def facts(path_task: PathTask, check: Check, file: str) -> dict[str, str]:
    """The facts by their names, in plain text.

    Args:
        path_task: The task.
        check: The check of the motion.
        file: Name of the motion's file; empty without one.
    """
    steps = np.linalg.norm(np.diff(path_task.positions, axis=0), axis=1)
    length = float(steps[~in_joint_moves(path_task)].sum())
    found = {
        "Robot": _robot(path_task),
        "Moving frame": f"{path_task.frame_name} ({path_task.frame_type})",
        **({} if path_task.relative_to is None else {"Path lies on": path_task.relative_to}),
        "Held along the path": "; then ".join(
            dict.fromkeys(what_is_free(projector) for projector in path_task.projectors)
        ),
        "Toolpath": _toolpath(path_task),
        "Path": f"{len(path_task.waypoints)} waypoints, {digits(length)} m",
        "Task file": "built in Python" if path_task.source is None else path_task.source.name,
        "Motion": f"{file + ', ' if file else ''}{check.rows} points",
        "Tolerances": f"{digits(1e3 * check.tolerances.position)} mm, "
        f"{digits(float(np.degrees(check.tolerances.axis)))}°",
    }
    if check.sources:
        found["Limits"] = "; ".join(check.sources)
    if check.notes:
        found["Notes"] = "; ".join(check.notes)
    found["Date"] = datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M")
    found["Made by"] = f"qp_twist {version('qp_twist')}, MuJoCo {version('mujoco')}"
    return found


def _robot(path_task: PathTask) -> str:
    """The known robot and where its figures are from; else the scene's name."""
    names = (path_task.scene.stem, path_task.scene.parent.name)
    known = known_robot(*path_task.arm, names)
    if known is not None:
        return f"{known.name}, recognised by name and geometry ({known.source})"
    title = path_task.model.names.split(b"\0", 1)[0].decode(errors="replace")
    name = title if title and title != "MuJoCo Model" else path_task.scene.stem
    return f"{name}, {path_task.scene.name}; not in the table of known robots"


def _toolpath(path_task: PathTask) -> str:
    toolpath = path_task.toolpath
    if toolpath is None:
        return "stated in the task file"
    curves = len(toolpath.curves)
    return f"{toolpath.source.name}, {curves} {'curve' if curves == 1 else 'curves'}"
