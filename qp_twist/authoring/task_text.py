"""The text of a task file, with a comment beside everything that was decided."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from qp_twist.authoring.frame_choice import FrameChoice
from qp_twist.authoring.request import ANGULAR_SPEED, Request
from qp_twist.authoring.touching import Watched
from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.paths import DEFAULT_METHOD, METHODS, Toolpath, ToolpathOptions
from qp_twist.robots import Robot

_COLUMN = 36
"""Column in which comments begin."""
_MARK = "\t# "
"""Between a line and its comment; a quoted text has no tab."""
_BARE = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-")


@dataclass(frozen=True)
class Parts:
    """Content of a task file; files as the task file names them.

    ``position``, m, and ``rpy_deg`` are the pose of the toolpath's frame in the world or in the
    frame of ``carrier``, the body that carries the path. ``part`` is the body that moves along with
    the path in a study; a study moves its ``middle``, m, by up to ``margin``, m. ``start``, rad or
    m, (nv,), is ``None`` if it is to be found when the task is run.
    """

    request: Request
    title: str
    scene: str
    packages: Mapping[str, str]
    toolpath_file: str
    frame: FrameChoice
    toolpath: Toolpath
    ranges: JointRanges
    robot: Robot
    position: Array
    rpy_deg: Array
    watched: Watched | None
    carrier: str | None
    part: str
    controller: str | None
    placement_notes: Sequence[str] = ()
    start: Array | None = None
    start_notes: Sequence[str] = ()
    middle: Array | None = None
    margin: float = 0.0

    @property
    def fixes_roll(self) -> bool:
        """Whether the roll is that of the file, which states one; otherwise it is free."""
        stated = "fixed" if self.toolpath.meaning == "rotation" else "free"
        return self.toolpath.has_roll and (self.request.roll or stated) == "fixed"

    @property
    def turns_in_place(self) -> int:
        """How often the tool turns in place."""
        return self.toolpath.turns_in_place(rapids=self.keeps_rapids)

    @property
    def angular_speed(self) -> float | None:
        """Largest speed at which the tool turns, degrees/s; ``None`` for no bound."""
        return self.request.angular_speed_deg or (ANGULAR_SPEED if self.turns_in_place else None)

    @property
    def keeps_rapids(self) -> bool:
        """Whether rapid motions of the file are part of the path."""
        if self.request.rapids is not None:
            return self.request.rapids == "keep"
        return self.toolpath.has_ways


def task_text(parts: Parts) -> str:
    """The whole file."""
    request = parts.request
    blocks = [
        _comment(
            f"Written by qp-twist new for {request.robot.name} and {request.toolpath.name}. Change "
            "what you like; docs/task_files.md lists every key. Lengths are in metres, angles in "
            "radians unless a key ends in _deg."
        ),
        f"title = {_quoted(parts.title)}",
        "" if parts.start is not None else _notes(parts.start_notes) + 'start = "central"',
        _robot(parts), _projector(parts), *_path(parts),
        "" if parts.start is None else _start(parts, parts.start), _feed(parts), _limits(parts),
        "" if parts.watched is None else _clearance(parts.watched), _methods(parts),
        "" if parts.middle is None else _study(parts, parts.middle),
    ]  # fmt: skip
    lines = "\n\n".join(block.strip() for block in blocks if block).split("\n")
    return "\n".join(map(_aligned, lines)) + "\n"


def _robot(parts: Parts) -> str:
    text = f"""
[robot]
scene = {_quoted(parts.scene)}\t# MJCF or URDF, relative to this file
frame = {_quoted(parts.frame.name)}\t# {parts.frame.why}
frame_type = "{parts.frame.kind}"
"""
    if parts.carrier is not None:
        text += f"relative_to = {_quoted(parts.carrier)}\t# the body that carries the path\n"
    if parts.controller is not None:
        text += f"controller = {_quoted(parts.controller)}\t# how programs count the joints\n"
    text += _notes(f"Left out of the robot file: {sentence}" for sentence in parts.robot.left_out)
    of_xacro = {} if parts.request.has_cell else parts.request.arguments
    for name, table in (("packages", parts.packages), ("arguments", of_xacro)):
        rows = "\n".join(f"{_key(key)} = {_quoted(str(value))}" for key, value in table.items())
        text += f"\n[robot.{name}]\n{rows}\n" if table else ""
    return text


def _projector(parts: Parts) -> str:
    if parts.toolpath.meaning == "none":
        return """
[projector]\t# position only, rank 3: the file has no directions
linear = "full"
angular = "none"
"""
    if parts.fixes_roll:
        return """
[projector]\t# the whole pose, rank 6, as the file states it; --roll free frees the roll
linear = "full"
angular = "full"
"""
    return """
[projector]\t# position and axis, rank 5: the roll is free
linear = "full"
angular = { plane = [0, 0, 1] }\t# free about z of the frame below
frame = "body"\t# the axis moves with the tool
"""


def _path(parts: Parts) -> Iterator[str]:
    request, toolpath = parts.request, parts.toolpath
    curves = len(toolpath.curves)
    summary = f"{sum(map(len, toolpath.curves))} points"
    summary += f" in {curves} curves" if curves > 1 else ""
    text = f"""
[path]
kind = "file"
file = {_quoted(parts.toolpath_file)}\t# {summary}
"""
    if request.length_unit is None and toolpath.unit_in_file:
        text += '# length_unit = "mm"\t# the file says its unit itself\n'
    elif request.length_unit is None:
        text += f'length_unit = "{toolpath.unit}"\t# assumed, as a note below says\n'
    text += "".join(f"{line}\n" for line in toolpath_lines(request))
    if toolpath.feeds is not None:
        text += f'feeds = "file"\t# {feeds_in_words(toolpath)}; "task": [feed] alone\n'
    if parts.keeps_rapids:
        text += 'rapids = "keep"\t# the tool comes and goes as in the file; or drop\n'
    if toolpath.meaning in ("normal", "axis"):
        if request.orientation is None:
            text += f'# orientation = "{toolpath.meaning}"\t# found in the file\n'
        where = "into the part" if request.tool == "into" else "out of the part"
        text += f"""\
tool = "{request.tool}"\t# z of the frame points {where}; into or out
lead_deg = 0.0\t# lean of the tool, towards the way it goes
tilt_deg = 0.0\t# and to the left of it
"""
    yield (
        text
        + f"""\
max_spacing = 0.01\t# m, between waypoints
max_turn_deg = 3.0\t# of the tool, between waypoints
{_notes(toolpath.notes)}"""
    )
    if request.columns is not None:
        stated = request.columns.model_dump(exclude_none=True)
        rows = [f"{key} = {json.dumps(value)}" for key, value in stated.items()]
        yield "\n".join(["[path.columns]", *rows])
    world = "the robot's world" if parts.carrier is None else f"the frame of {parts.carrier}"
    yield f"""
[path.placement]
{_notes(parts.placement_notes)}\
position = {_numbers(parts.position, 9)}\t# m, of the file's origin
rpy_deg = {_numbers(parts.rpy_deg, 9)}\t# and its orientation in {world}
"""
    if not parts.keeps_rapids:
        text = """
[path.approach]\t# straight to each curve, along the tool
distance = 0.05\t# m
steps = 10
[path.retreat]\t# straight away from each curve, along the tool
distance = 0.05\t# m
steps = 10
"""
        yield text if curves > 1 else _off(text)
    if curves > 1:
        text = """
[path.transfer]\t# from one curve to the next
motion = "joint"\t# of the joints, as fast as they may, clear of everything
"""
        yield text if request.transfer == "joint" else _off(text)


def toolpath_lines(options: ToolpathOptions) -> list[str]:
    """The options of a toolpath that the user chose, each with what it is."""
    return [
        f"{key} = {json.dumps(value)}{_MARK}{what}"
        for key, value, what in options.stated_options()
        if key not in ("columns", "rapids")  # which have a place of their own
    ]


def feeds_in_words(toolpath: Toolpath) -> str:
    """The feeds that a toolpath states, in mm/min."""
    assert toolpath.feeds is not None
    lowest, highest = (f"{60e3 * feed:.4g}" for feed in toolpath.feeds)
    return f"{lowest} mm/min" if lowest == highest else f"{lowest} to {highest} mm/min"


def _start(parts: Parts, q: Array) -> str:
    values, key, unit = q, "q", "rad and m"
    if parts.ranges.hinge.all():
        values, key, unit = np.degrees(q), "q_deg", "degrees"
    return f"""
[start]
{_notes(parts.start_notes)}\
{key} = {_numbers(values)}\t# {unit}
# In place of this table, a line start = "central" above all tables looks for the most central
# start anew, start = "best" for that of the best plan.
"""


def _feed(parts: Parts) -> str:
    of_file = parts.toolpath.feeds is not None
    what = "where the file has no feed" if of_file else "along the path"
    off = "" if parts.angular_speed else "# "
    return f"""
[feed]
speed = {parts.request.speed:g}\t# m/s, {what}; it slows down at limits
{off}angular_speed_deg = {parts.angular_speed or ANGULAR_SPEED:g}\t\
# of the tool, degrees/s; the slower one counts
"""


def _limits(parts: Parts) -> str:
    ranges, speeds = parts.ranges, parts.robot.velocity_limits
    units = ["rad" if hinge else "m" for hinge in ranges.hinge]
    joints = [(name, _key(name), unit) for name, unit in zip(ranges.names, units, strict=True)]
    unlimited = [n for n, limited in zip(ranges.names, ranges.limited, strict=True) if not limited]
    lines = []
    if unlimited:
        lines.append(_comment(f"Without a range in the robot file: {', '.join(unlimited)}."))
    if speeds:
        lines.append("[limits.velocity]\t# of the URDF")
        lines += [
            f"{key} = {speeds[name]:.10g}\t# {unit}/s"
            for name, key, unit in joints
            if name in speeds
        ]
    else:
        lines.append(_comment("Joint speeds: the robot file states none. From the data sheet:"))
        lines.append("# [limits.velocity]")
        lines += [
            f"# {key} = {2.0 if unit == 'rad' else 0.5}\t# {unit}/s" for _, key, unit in joints
        ]
    lines += ["", "# [limits.acceleration]"]
    lines += [f"# {key} = 10.0\t# {unit}/s²" for _, key, unit in joints]
    lines += ["", "# [limits.jerk]"]
    return "\n".join([*lines, *(f"# {key} = 200.0\t# {unit}/s³" for _, key, unit in joints)])


def _clearance(watched: Watched) -> str:
    """The distance of what must not touch, and each pair that may, with the reason."""
    pairs = [
        f"  [{_quoted(pair.one)}, {_quoted(pair.other)}],\t# {pair.why}\n"
        for pair in watched.ignored
    ]
    return f"""
[clearance]
distance = {watched.distance:g}\t# m, of every pair that may collide
ignore = [\t# pairs of geoms or bodies that may touch
{"".join(pairs)}]
"""


def _methods(parts: Parts) -> str:
    default = METHODS[DEFAULT_METHOD].defaults
    if parts.toolpath.has_roll and not parts.fixes_roll:
        return f"""
# How the free motion is spent: the roll follows that of the file, as far as the limits permit.
[methods.{DEFAULT_METHOD}]
secondary = "roll"
gain = 1.0\t# share of the way a waypoint
"""
    return f"""
# How the free motion is spent, for each method; what is not stated has the method's own value.
[methods.{DEFAULT_METHOD}]\t# towards the middle of the joint ranges
weight = "{default.weight}"
gain = {default.gain}\t# share of the way a waypoint
[methods.qp]\t# the paper's secondary, in twist space
gain = 0.05
[methods.twa]\t# its closed form
gain = 0.05
"""


def _study(parts: Parts, middle: Array) -> str:
    """The placements that a study tries."""
    body = f"body = {_quoted(parts.part)}\t# it moves along\n" if parts.part else ""
    return f"""
# What qp-twist study varies: where the workpiece stands, around the place above.
[study]
position_error = 1e-4\t# m, largest of a success
axis_error_deg = 0.05
# max_step_deg = 15.0\t# of a joint, in place of [feed] and [limits]

[study.placement]
point = {_numbers(middle)}\t# m, the middle of the path
{body}lower = {_numbers(middle - parts.margin)}\t# m, where that point is put
upper = {_numbers(middle + parts.margin)}
yaw_deg = [-30.0, 30.0]\t# turn about the vertical
tilt_deg = [0.0, 0.0]\t# then a tilt to any side
"""


def _aligned(line: str) -> str:
    """A line whose comment, behind a tab, begins in one column with the others."""
    text, mark, comment = line.partition(_MARK)
    return f"{text.ljust(_COLUMN - 1)} # {comment}" if mark and comment else text


def _off(text: str) -> str:
    """A table as comments."""
    return "\n".join(f"# {line}" for line in text.strip().split("\n"))


def _notes(sentences: Iterable[str]) -> str:
    """Sentences as comments above a line."""
    return "".join(f"{_comment(sentence)}\n" for sentence in sentences)


def _comment(text: str) -> str:
    text = text[0].upper() + text[1:]
    return textwrap.fill(text, 98, initial_indent="# ", subsequent_indent="# ")


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _key(name: str) -> str:
    return name if name and set(name) <= _BARE else _quoted(name)


def _numbers(values: Array, decimals: int = 4) -> str:
    return "[" + ", ".join(f"{round(float(v), decimals) + 0.0:.12g}" for v in values) + "]"
