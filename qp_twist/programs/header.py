"""The comment at the top of a program: what it claims, and whether that is so.

The claims are facts that a person can look up in the program: its robot, unit, axes, number of
points and time. A program whose lines contradict them has been changed, and is refused; the time
counts where all moves state theirs, since that of speeds changes with a corrected point. What the
motion does is not claimed here, but checked against the task.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import mink
import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.programs.joint_moves import Dialect, JointMoves

_TITLE = re.compile(r"qp_twist (\S+)")
_KEYS = ("robot", "unit", "points", "seconds", "order")
DOES_NOT_PASS = "DOES NOT PASS ITS CHECK"
"""How a program begins that is written although its motion does not pass: no statement of any of
the languages, so that a controller stops at it."""
AS_MODELLED = "as modelled"
"""What stands for the robot where joints are taken as the model counts them."""
WRITTEN_AS_MODELLED = (
    "this program was written as modelled: add --as-modelled (or controller = "
    f'"{AS_MODELLED}" in the task file).'
)
"""What to do with a program whose header says so."""


_NUMBERS = {
    "tool": r"Tool (\d+) has to have its TCP",
    "frame": r"(?:Frame |UFRAME |wobj|BASE_DATA\[|base, frame )(\d+)(?:\]? has to be|; )",
}
"""Numbers that a person has to compare, by the sentences of :func:`_about_frames`."""
_IN_FLANGE = re.compile(r"the task's frame in the flange:(.*)", re.IGNORECASE)
_VALUE = re.compile(r"-?\d+(?:\.\d+)?")
_LAST = "No controller has run this."
_UNSET = "Tool, base and load: none is set here."
_OF_VALUE = (
    "Tool: the task's frame in the model's flange; compare it, and axis 6, and state its load."
)
_EXACT = 9
"""Decimals to which sums are rounded before six are printed: one that ends in half a digit is then
the same in mm/s and in m/s."""


def header_lines(
    dialect: Dialect,
    moves: JointMoves,
    robot: str,
    equations: Sequence[str],
    task: str = "",
    spacing: str = "",
    beside: Sequence[str] = (),
) -> tuple[str, ...]:
    """The lines of the header, without comment marks.

    Args:
        dialect: The language.
        moves: The moves with the digits that are printed.
        robot: Name of the robot; empty where joints are taken as the model counts them.
        equations: What each axis shows.
        task: Name of the task, if known.
        spacing: What became of rows too close to each other in time.
        beside: On which sides of the path the motion goes beside it.
    """
    from qp_twist import __version__  # whose package has all modules, those of paths too

    assert moves.durations is not None
    total = float(moves.durations.sum())
    return (
        f"qp_twist {__version__}",
        *([f"task: {task}"] if task else []),
        *([f"spacing: {spacing}"] if spacing else []),
        *([f"beside: {', '.join(beside)}"] if beside else []),
        f"robot: {robot or AS_MODELLED}",
        f"unit: {dialect.unit}",
        f"points: {moves.points}",
        f"seconds: {total:.{dialect.time_decimals}f}",
        *([f"speeds: {sums}"] if (sums := _sums(moves, dialect)) else []),
        f"order: {_order(moves)}",
        *equations,
        *_about_frames(moves, dialect),
        *(
            f"fill in: {statement}"
            for statement in (
                *(() if moves.straight else dialect.frames_to_fill_in),
                *dialect.to_fill_in,
            )
        ),
        _LAST,
    )


def _sums(moves: JointMoves, dialect: Dialect) -> str:
    """The sums of speeds, times and accelerations that a program states; empty without speeds."""
    speeds = [speed.linear for speed in moves.speeds if speed is not None]
    if moves.durations is None or not speeds:
        return ""
    timed = np.array([speed is None for speed in moves.speeds])
    seconds = moves.durations[timed].sum()
    ramps = sum(
        a or 0.0 for a, other in zip(moves.accelerations[1:], timed, strict=False) if not other
    )
    total, ramps = round(sum(speeds), _EXACT), round(ramps, _EXACT)
    lines = moves.straight or (0,) * len(moves.speeds)
    joint = any(speed and not line for speed, line in zip(moves.speeds, lines, strict=True))
    unit, per = ("m/s or rad/s", "m/s2 or rad/s2") if joint else ("m/s", "m/s2")
    return f"{total:.6f} {unit} in {len(speeds)} moves, {seconds:.{dialect.time_decimals}f} s" + (
        f", accelerations {ramps:.6g} {per}" if ramps else ""
    )


def _order(moves: JointMoves) -> str:
    """The sum of each move's number times what the program states of it, which exchanges change.

    That is its speed, m/s, else its time, s, and its acceleration; and likewise of all rates at
    points, one by one. Empty without times.
    """
    if moves.durations is None:
        return ""
    stated = moves.durations.copy()
    for k, speed in enumerate(moves.speeds):
        stated[k] = stated[k] if speed is None else speed.linear
    ramps = [a or 0.0 for a in moves.accelerations[1:]] or 0.0
    order = float(np.arange(1, len(stated) + 1) @ (stated + ramps))
    if moves.velocities is not None:
        order += float(np.arange(1, moves.velocities.size + 1) @ moves.velocities.ravel())
    return f"{round(order, _EXACT):.6f}"


def _about_frames(moves: JointMoves, dialect: Dialect) -> list[str]:
    """What a person has to compare."""
    targets = [target for target in moves.targets if target is not None]
    tool_name = f"Tool {moves.tool}" if dialect.numbered else "The active tool"
    of_number = f"{tool_name} has to have its TCP at the task's frame."
    if moves.part:
        on_part = dialect.parts[f"{moves.part} {'poses' if targets else 'joints'}"]
        if targets and targets[0].tool.pose is not None:
            of_number = _OF_VALUE
        about = on_part.format(tool=moves.tool, frame=moves.frame)
        return [*([] if moves.part == "hand" else [of_number]), about, _UNSET]
    if not targets:
        return [*([of_number] if moves.straight else []), _UNSET]
    tool, frame = targets[0].tool, targets[0].frame
    return [
        of_number if tool.pose is None or not dialect.states_frames else _OF_VALUE,
        f"Frame {frame.name} has to be the world of the task." if frame.pose is None else
        "Frame: the task's world in the model's base; compare it, and axis 1."
        if dialect.states_frames else
        "Points are in the robot's base, frame 0; compare it with the model's, and axis 1.",
    ]  # fmt: skip


def read_header(comments: Sequence[str]) -> dict[str, str]:
    """The claims in a program's comments; empty if this package did not write them.

    Raises:
        InvalidInput: If the header is there, but a line of it is missing; two of its lines are one.
    """
    lines = [comment.strip() for comment in comments]
    starts = [k for k, line in enumerate(lines) if _TITLE.fullmatch(line)]
    if not starts:
        own = [x for x in lines if x == _LAST or x.partition(": ")[0] in (*_KEYS, "speeds")]
        if len(own) > 1:
            raise InvalidInput(
                f"the comments have lines of a header ({own[0]!r}), but not its first one, which "
                "begins with qp_twist; restore it, or remove the whole header."
            )
        return {}
    found: dict[str, str] = {}
    equations = []
    for line in lines[starts[0] + 1 :]:
        key, colon, value = line.partition(":")
        if colon and key in (*_KEYS, "speeds", "task", "spacing", "beside") and key not in found:
            found[key] = value.strip()
        elif re.match(r"\w+ = \S", line):
            equations.append(line)
        if stated := _IN_FLANGE.search(line):
            found["flange"] = ", ".join(_VALUE.findall(stated[1]))
        for what, pattern in _NUMBERS.items():
            if number := re.search(pattern, line):
                found[what] = number[1]
    missing = [key for key in _KEYS if key not in found]
    if missing:
        raise InvalidInput(
            f"the header has no line {missing[0]!r}; restore it, or remove the whole header, whose "
            "first line begins with qp_twist."
        )
    return {**found, "axes": "\n".join(equations)}


def check_header(
    moves: JointMoves, dialect: Dialect, robot: str, equations: Sequence[str],
    tcp: mink.SE3 | None = None,
) -> None:  # fmt: skip
    """Refuse a program whose lines contradict its header, or whose header the robot's axes.

    ``tcp``: the task's frame in the flange of a known robot, which a person compares by the header.

    Raises:
        InvalidInput: What is claimed, and what is there.
    """
    header: Mapping[str, str] = moves.header
    if not header:
        return
    total = math.nan if moves.durations is None else float(moves.durations.sum())
    sums = _sums(moves, dialect)
    try:
        same = bool(sums) or (
            abs(float(header["seconds"]) - total) < 0.6 * 10.0**-dialect.time_decimals
        )
    except ValueError:
        same = False
    wait, untimed = next(iter(moves.waits), None), moves.untimed
    modelled = header["robot"] == AS_MODELLED
    by_value = dialect.states_frames and any(moves.targets)  # what has no number
    for key, there, culprit, do in (
        ("unit", dialect.unit, None, "the program is for something else, or was changed."),
        ("robot", robot or AS_MODELLED, None, WRITTEN_AS_MODELLED if modelled
         else "export the trajectory for this robot."),
        ("points", str(moves.points), wait, "a line was lost or added."),
        *((what, moves.numbers.get(what, ""), None, "a number was changed.")
          for what in _NUMBERS if what in header or by_value),
        *([("flange", ", ".join(_VALUE.findall(dialect.tool_text(tcp))), None,
            "the task's frame is elsewhere in the flange, or a number was changed.")]
          if tcp is not None and "flange" in header else []),
        ("speeds", sums, untimed, "a speed or a time, or an acceleration, was changed."),
        ("seconds", header["seconds"] if same else f"{total:.9g}", untimed, "a time was changed."),
        ("order", _order(moves), untimed, "times, speeds or rates were changed or were exchanged."),
    ):  # fmt: skip
        if (says := header.get(key, "")) != there:
            line, what = culprit or (None, "")
            raise InvalidInput(
                f"{what}{what and '; '}the header says {key}: {says or 'none'}, but here it is "
                f"{there or 'none'}; {do}",
                line=line,
            )
    claimed = header["axes"].split("\n") if header["axes"] else []
    if len(claimed) != len(equations):
        raise InvalidInput(
            f"the header has {len(claimed)} lines of axes, and there are {len(equations)} axes; "
            "restore them, or remove the whole header."
        )
    for ours, theirs in zip(equations, claimed, strict=True):
        if ours != theirs:
            raise InvalidInput(
                f"the header says {theirs}, but for this model and robot it is {ours}; the model's "
                "zero positions or signs are others than when the program was written."
            )
