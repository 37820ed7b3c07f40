"""What stands around the moves of a program: the parts of the path, and the process."""

from __future__ import annotations

import numpy as np

from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.paths.process_words import call_of
from qp_twist.programs import Around
from qp_twist.trajectories.matching import times_at_waypoints
from qp_twist.trajectories.timed_path import TimedPath

_LONGEST = 60
"""Characters of a comment."""


def around_rows(rows: TimedPath, path_task: PathTask) -> dict[int, tuple[Around, ...]]:
    """What stands behind rows of a trajectory, by their index.

    A comment names each part of the path where it begins: approach, curve, retreat, transfer, joint
    move. What the toolpath switches is a call, if the task names a procedure for it, else a
    comment; where a curve ends it stands before the part that follows. A row is the one nearest in
    time to the waypoint.
    """
    behind: dict[int, list[Around]] = {}
    curves, before = 0, ""
    for k, way in enumerate((*path_task.ways, "")):
        words = [_word(text, path_task) for at, text in path_task.process if at == k]
        named = []
        if way != before and (path_task.parts or path_task.joint_moves):
            curves += way == "contact"
            named = [Around(f"> curve {curves}" if way == "contact" else f"> {way or 'end'}")]
        found = [*words, *named] if before == "contact" else [*named, *words]
        if found:
            behind[k] = found
        before = way
    if not behind or rows.times is None:
        return {}
    motion = rows.of_joints(JointRanges.of(path_task.model).names).motion
    times = times_at_waypoints(path_task, motion, path_task.tolerances)
    by_row: dict[int, tuple[Around, ...]] = {}
    for k, found in behind.items():
        row = int(np.argmin(np.abs(motion.times - times[k])))
        by_row[row] = (*by_row.get(row, ()), *found)
    return by_row


def _word(text: str, path_task: PathTask) -> Around:
    """A word of the toolpath, in characters that every controller reads in a comment."""
    if (name := call_of(text, path_task.calls)) is not None:
        return Around(name, call=True)
    plain = "".join(c if " " <= c <= "~" and c not in ";{}" else " " for c in text)
    return Around(f"> {' '.join(plain.split())}"[:_LONGEST])
