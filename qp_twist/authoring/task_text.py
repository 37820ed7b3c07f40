"""The text of a task file, with a comment beside everything that was decided."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from qp_twist.authoring.frame_choice import FrameChoice
from qp_twist.authoring.request import ANGULAR_SPEED, Request
from qp_twist.authoring.touching import Watched
from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.paths import DEFAULT_METHOD, METHODS, Toolpath

_COLUMN = 36
_BARE = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-")


@dataclass(frozen=True)
class VariedPlacement:
    """Range of placements around the present one.

    Attributes:
        point: The middle of the path, in the world, m, (3,).
        body: Body of the scene that moves along; empty for none.
        margin: By how much the point is moved along each axis, m.
    """

    point: Array
    body: str
    margin: float


@dataclass(frozen=True)
class Parts:
    """Content of a task file.

    Attributes:
        request: The arguments of ``qp-twist new``.
        title: One line that names the task.
        scene: Robot file as the task file names it.
        packages: Folders of the robot file's ROS packages likewise, by name.
        toolpath_file: Toolpath file likewise.
        frame: The controlled frame.
        toolpath: What the toolpath file says.
        ranges: Of the robot's joints.
        velocity_limits: Of a URDF, by joint name, rad/s or m/s.
        left_out: Sentences on what the robot file states and the model lacks.
        position: Of the toolpath's frame in the world, m.
        rpy_deg: Its orientation there, degrees.
        placement_notes: Sentences on where the workpiece stands.
        start: Joint positions, rad or m, (nv,); ``None``: to be found when the task is run.
        start_notes: Sentences on the start.
        watched: What must not touch; ``None`` where nothing can collide.
        varied: Where a study puts the workpiece; ``None`` without that section.
        carrier: Body of the scene that carries the path; ``None``: its world.
        controller: How the controller counts the joints, a file as the task file names it.
    """

    request: Request
    title: str
    scene: str
    packages: Mapping[str, str]
    toolpath_file: str
    frame: FrameChoice
    toolpath: Toolpath
    ranges: JointRanges
    velocity_limits: dict[str, float]
    left_out: Sequence[str]
    position: Array
    rpy_deg: Array
    placement_notes: Sequence[str] = ()
    start: Array | None = None
    start_notes: Sequence[str] = field(default=())
    watched: Watched | None = None
    varied: VariedPlacement | None = None
    carrier: str | None = None
    controller: str | None = None

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
    ]
    if parts.start is None:
        blocks[-1] += "\n\n" + "\n".join(
            [*map(_comment, parts.start_notes), 'start = "central"']
        )  # fmt: skip
    blocks += [_robot(parts), _projector(parts), _path(parts)]
    if parts.start is not None:
        blocks.append(_start(parts))
    blocks += [_feed(parts), _limits(parts), *_clearance(parts), _methods(), *_study(parts)]
    return "\n\n".join(blocks) + "\n"


def _robot(parts: Parts) -> str:
    lines = [
        "[robot]",
        _line(f"scene = {_quoted(parts.scene)}", "MJCF or URDF, relative to this file"),
        _line(f"frame = {_quoted(parts.frame.name)}", parts.frame.why),
        _line(f'frame_type = "{parts.frame.kind}"'),
        *(
            []
            if parts.carrier is None
            else [
                _line(f"relative_to = {_quoted(parts.carrier)}", "the body that carries the path")
            ]
        ),
        *(
            []
            if parts.controller is None
            else [
                _line(f"controller = {_quoted(parts.controller)}", "how programs count the joints")
            ]
        ),
        *(_comment(f"Left out of the robot file: {sentence}") for sentence in parts.left_out),
    ]
    of_xacro = {} if parts.request.has_cell else parts.request.arguments
    for name, table in (("packages", parts.packages), ("arguments", of_xacro)):
        if table:
            lines += ["", f"[robot.{name}]"]
            lines += [f"{_key(key)} = {_quoted(str(value))}" for key, value in table.items()]
    return "\n".join(lines)


def _projector(parts: Parts) -> str:
    meaning = parts.toolpath.meaning
    lines = ["[projector]"]
    if meaning == "none":
        lines[0] = _line(lines[0], "position only, rank 3: the file has no directions")
        lines += ['linear = "full"', 'angular = "none"']
    elif meaning == "rotation":
        lines[0] = _line(lines[0], "the whole pose, rank 6, as the file states it")
        lines += [
            'linear = "full"',
            'angular = "full"',
            _comment("To free the roll about the tool's z, which a tool of revolution does not "
                     "need, write instead (rank 5):"),
            '# angular = { plane = [0, 0, 1] }',
            '# frame = "body"',
        ]  # fmt: skip
    else:
        lines[0] = _line(lines[0], "position and axis, rank 5: the roll is free")
        lines += [
            'linear = "full"',
            _line("angular = { plane = [0, 0, 1] }", "free about z of the frame below"),
            _line('frame = "body"', "the axis moves with the tool"),
        ]
    return "\n".join(lines)


def _path(parts: Parts) -> str:  # noqa: PLR0912
    request, toolpath = parts.request, parts.toolpath
    points = sum(map(len, toolpath.curves))
    curves = len(toolpath.curves)
    summary = f"{points} points" + (f" in {curves} curves" if curves > 1 else "")
    lines = ["[path]", 'kind = "file"', _line(f"file = {_quoted(parts.toolpath_file)}", summary)]
    if request.length_unit:
        lines.append(_line(f'length_unit = "{request.length_unit}"', "of the positions"))
    else:
        lines.append(_line('# length_unit = "mm"', "the file says its unit itself"))
    if request.angle_unit:
        lines.append(f'angle_unit = "{request.angle_unit}"')
    if request.feed_unit:
        lines.append(f'feed_unit = "{request.feed_unit}"')
    if toolpath.feeds is not None:
        lines.append(_line('feeds = "file"', f'{feeds_in_words(toolpath)}; "task": [feed] alone'))
    if parts.keeps_rapids:
        lines.append(_line('rapids = "keep"', "the tool comes and goes as in the file; or drop"))
    if request.arc_axis:
        lines.append(_line(f'arc_axis = "{request.arc_axis}"', "sense of CIRCLE about its axis"))
    if request.rotary:
        lines.append(_line(f'rotary = "{request.rotary}"', "how rotary axes turn the tool"))
    if request.rollover:
        lines.append(_line(f'rollover = "{request.rollover}"', "of rotary axes over 360 degrees"))
    if request.orientation:
        lines.append(f'orientation = "{request.orientation}"')
    elif toolpath.meaning in ("normal", "axis"):
        lines.append(_line(f'# orientation = "{toolpath.meaning}"', "found in the file"))
    if toolpath.meaning in ("normal", "axis"):
        where = "into the part" if request.tool == "into" else "out of the part"
        lines += [
            _line(f'tool = "{request.tool}"', f"z of the frame points {where}; into or out"),
            _line("lead_deg = 0.0", "lean of the tool, towards the way it goes"),
            _line("tilt_deg = 0.0", "and to the left of it"),
        ]
    lines += [
        _line("max_spacing = 0.01", "m, between waypoints"),
        _line("max_turn_deg = 3.0", "of the tool, between waypoints"),
        *map(_comment, toolpath.notes),
    ]
    blocks = ["\n".join(lines)]
    if request.columns is not None:
        stated = request.columns.model_dump(exclude_none=True)
        rows = [f"{key} = {json.dumps(value)}" for key, value in stated.items()]
        blocks.append("\n".join(["[path.columns]", *rows]))
    blocks.append(
        "\n".join(
            [
                "[path.placement]",
                *map(_comment, parts.placement_notes),
                _line(f"position = {_numbers(parts.position, 9)}", "m, of the file's origin"),
                _line(
                    f"rpy_deg = {_numbers(parts.rpy_deg, 9)}",
                    "and its orientation in the robot's world"
                    if parts.carrier is None
                    else f"and its orientation in the frame of {parts.carrier}",
                ),
            ]
        )
    )
    if not parts.keeps_rapids:
        blocks.append(_leads(curves > 1))
    if curves > 1:
        lines = [
            _line("[path.transfer]", "from one curve to the next"),
            _line('motion = "joint"', "of the joints, as fast as they may, clear of everything"),
        ]
        on = request.transfer == "joint"
        blocks.append("\n".join(lines if on else [_off(line) for line in lines]))
    return "\n\n".join(blocks)


def feeds_in_words(toolpath: Toolpath) -> str:
    """The feeds that a toolpath states, in mm/min."""
    assert toolpath.feeds is not None
    lowest, highest = (f"{60e3 * feed:.4g}" for feed in toolpath.feeds)
    return f"{lowest} mm/min" if lowest == highest else f"{lowest} to {highest} mm/min"


def _leads(needed: bool) -> str:
    """Approach and retreat; of one curve as comments."""
    lines = []
    for key, what in (("approach", "to"), ("retreat", "away from")):
        lines += [
            _line(f"[path.{key}]", f"straight {what} each curve, along the tool"),
            _line("distance = 0.05", "m"),
            "steps = 10",
        ]
    return "\n".join(lines if needed else [_off(line) for line in lines])


def _start(parts: Parts) -> str:
    assert parts.start is not None
    if parts.ranges.hinge.all():
        values, key, unit = np.degrees(parts.start), "q_deg", "degrees"
    else:
        values, key, unit = parts.start, "q", "rad and m"
    lines = [
        "[start]",
        *map(_comment, parts.start_notes),
        _line(f"{key} = {_numbers(values)}", unit),
        _comment(
            'In place of this table, a line start = "central" above all tables looks for the most '
            'central start anew, start = "best" for that of the best plan.'
        ),
    ]
    return "\n".join(lines)


def _feed(parts: Parts) -> str:
    speed = f"speed = {parts.request.speed:g}"
    of_file = parts.toolpath.feeds is not None
    comment = "m/s, where the file has no feed" if of_file else "m/s, along the path"
    bound = parts.angular_speed
    angular = f"angular_speed_deg = {bound or ANGULAR_SPEED:g}"
    return "\n".join(
        [
            "[feed]",
            _line(speed, f"{comment}; it slows down at limits"),
            _line(
                angular if bound else _off(angular), "of the tool, degrees/s; the slower one counts"
            ),
        ]
    )


def _limits(parts: Parts) -> str:
    ranges, speeds = parts.ranges, parts.velocity_limits
    unlimited = [name for name, limited in zip(ranges.names, ranges.limited, strict=True)
                 if not limited]  # fmt: skip
    lines = []
    if unlimited:
        lines.append(_comment(f"Without a range in the robot file: {', '.join(unlimited)}."))
    units = ["rad/s" if hinge else "m/s" for hinge in ranges.hinge]
    if speeds:
        lines.append(_line("[limits.velocity]", "of the URDF"))
        lines += [
            _line(f"{_key(name)} = {speeds[name]:.10g}", unit)
            for name, unit in zip(ranges.names, units, strict=True)
            if name in speeds
        ]
    else:
        lines.append(_comment("Joint speeds: the robot file states none. From the data sheet:"))
        lines.append("# [limits.velocity]")
        lines += [
            _line(f"# {_key(name)} = {2.0 if unit == 'rad/s' else 0.5}", unit)
            for name, unit in zip(ranges.names, units, strict=True)
        ]
    lines += [
        "",
        "# [limits.acceleration]",
        *(
            _line(f"# {_key(name)} = 10.0", f"{unit[:-2]}/s²")
            for name, unit in zip(ranges.names, units, strict=True)
        ),
    ]
    return "\n".join(lines)


def _clearance(parts: Parts) -> list[str]:
    """The distance of what must not touch, and each pair that may, with the reason."""
    if parts.watched is None:
        return []
    lines = [
        "[clearance]",
        _line(f"distance = {parts.watched.distance:g}", "m, of every pair that may collide"),
        _line("ignore = [", "pairs of geoms or bodies that may touch"),
        *(
            _line(f"  [{_quoted(pair.one)}, {_quoted(pair.other)}],", pair.why)
            for pair in parts.watched.ignored
        ),
        "]",
    ]
    return ["\n".join(lines)]


def _methods() -> str:
    default = METHODS[DEFAULT_METHOD].defaults
    return "\n".join(
        [
            _comment(
                "How the free motion is spent, for each method; what is not stated has the "
                "method's own value."
            ),
            _line(f"[methods.{DEFAULT_METHOD}]", "towards the middle of the joint ranges"),
            f'weight = "{default.weight}"',
            _line(f"gain = {default.gain}", "share of the way a waypoint"),
            _line("[methods.qp]", "the paper's secondary, in twist space"),
            "gain = 0.05",
            _line("[methods.twa]", "its closed form"),
            "gain = 0.05",
        ]
    )


def _study(parts: Parts) -> list[str]:
    """The placements that a study tries."""
    varied = parts.varied
    if varied is None:
        return []
    lines = [
        _comment("What qp-twist study varies: where the workpiece stands, around the place above."),
        "[study]",
        _line("position_error = 1e-4", "m, largest of a success"),
        "axis_error_deg = 0.05",
        _line("# max_step_deg = 15.0", "of a joint, in place of [feed] and [limits]"),
        "",
        "[study.placement]",
        _line(f"point = {_numbers(varied.point)}", "m, the middle of the path"),
        *([_line(f"body = {_quoted(varied.body)}", "it moves along")] if varied.body else []),
        _line(f"lower = {_numbers(varied.point - varied.margin)}", "m, where that point is put"),
        f"upper = {_numbers(varied.point + varied.margin)}",
        _line("yaw_deg = [-30.0, 30.0]", "turn about the vertical"),
        _line("tilt_deg = [0.0, 0.0]", "then a tilt to any side"),
    ]
    return ["\n".join(lines)]


def _line(text: str, comment: str = "") -> str:
    return f"{text.ljust(_COLUMN - 1)} # {comment}" if comment else text


def _off(line: str) -> str:
    """A line as a comment, its own comment where it was."""
    text, mark, comment = line.partition("#")
    return _line(f"# {text.rstrip()}", comment.strip() if mark else "")


def _comment(text: str) -> str:
    text = text[0].upper() + text[1:]
    return textwrap.fill(text, 98, initial_indent="# ", subsequent_indent="# ")


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _key(name: str) -> str:
    return name if name and set(name) <= _BARE else _quoted(name)


def _numbers(values: Array, decimals: int = 4) -> str:
    return "[" + ", ".join(f"{round(float(v), decimals) + 0.0:.12g}" for v in values) + "]"
