"""The text of a task file, with a comment beside everything that was decided."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from qp_twist.authoring.frame_choice import FrameChoice
from qp_twist.authoring.request import ANGULAR_SPEED, Request
from qp_twist.authoring.touching import Watched
from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.paths import DEFAULT_METHOD, METHODS, Toolpath, ToolpathOptions

_COLUMN = 36
_BARE = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-")


@dataclass(frozen=True)
class Parts:
    """Content of a task file; files as the task file names them.

    Attributes:
        request: The arguments of ``qp-twist new``.
        title: One line that names the task.
        scene: Robot file.
        packages: Folders of the robot file's ROS packages, by name.
        toolpath_file: Toolpath file.
        frame: The controlled frame.
        toolpath: What the toolpath file says.
        ranges: Of the robot's joints.
        velocity_limits: Of a URDF, by joint name, rad/s or m/s.
        left_out: Sentences on what the robot file states and the model lacks.
        position: Of the toolpath's frame in the world, m.
        rpy_deg: Its orientation there, degrees.
        watched: What must not touch; ``None`` where nothing can collide.
        carrier: Body of the scene that carries the path; ``None``: its world.
        part: Body of the scene that moves along with the path in a study; empty for none.
        controller: How the controller counts the joints.
        placement_notes: Sentences on where the workpiece stands.
        start: Joint positions, rad or m, (nv,); ``None``: to be found when the task is run.
        start_notes: Sentences on the start.
        middle: The middle of the path, in the world, m, (3,); ``None``: not known yet.
        margin: By how much a study moves it along each axis, m.
    """

    request: Request
    title: str
    scene: str
    packages: Mapping[str, str]
    toolpath_file: str
    frame: FrameChoice
    toolpath: Toolpath
    ranges: JointRanges
    velocity_limits: Mapping[str, float]
    left_out: Sequence[str]
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
        *([] if parts.start is not None else [_central(parts)]),
        _robot(parts),
        _projector(parts),
        *_path(parts),
        *([] if parts.start is None else [_start(parts, parts.start)]),
        _feed(parts),
        _limits(parts),
        *([] if parts.watched is None else [_clearance(parts.watched)]),
        _methods(),
        *([] if parts.middle is None else [_study(parts, parts.middle)]),
    ]
    return "\n\n".join(blocks) + "\n"


def _central(parts: Parts) -> str:
    return "\n".join([*map(_comment, parts.start_notes), 'start = "central"'])


def _robot(parts: Parts) -> str:
    lines = [
        "[robot]",
        _line(f"scene = {_quoted(parts.scene)}", "MJCF or URDF, relative to this file"),
        _line(f"frame = {_quoted(parts.frame.name)}", parts.frame.why),
        _line(f'frame_type = "{parts.frame.kind}"'),
    ]
    if parts.carrier is not None:
        carrier = f"relative_to = {_quoted(parts.carrier)}"
        lines.append(_line(carrier, "the body that carries the path"))
    if parts.controller is not None:
        controller = f"controller = {_quoted(parts.controller)}"
        lines.append(_line(controller, "how programs count the joints"))
    lines += [_comment(f"Left out of the robot file: {sentence}") for sentence in parts.left_out]
    of_xacro = {} if parts.request.has_cell else parts.request.arguments
    for name, table in (("packages", parts.packages), ("arguments", of_xacro)):
        if table:
            lines += ["", f"[robot.{name}]"]
            lines += [f"{_key(key)} = {_quoted(str(value))}" for key, value in table.items()]
    return "\n".join(lines)


def _projector(parts: Parts) -> str:
    meaning = parts.toolpath.meaning
    if meaning == "none":
        head, angular = "position only, rank 3: the file has no directions", ['angular = "none"']
    elif meaning == "rotation":
        head = "the whole pose, rank 6, as the file states it"
        angular = [
            'angular = "full"',
            _comment(
                "To free the roll about the tool's z, which a tool of revolution does not need, "
                "write instead (rank 5):"
            ),
            "# angular = { plane = [0, 0, 1] }",
            '# frame = "body"',
        ]
    else:
        head = "position and axis, rank 5: the roll is free"
        angular = [
            _line("angular = { plane = [0, 0, 1] }", "free about z of the frame below"),
            _line('frame = "body"', "the axis moves with the tool"),
        ]
    return "\n".join([_line("[projector]", head), 'linear = "full"', *angular])


def _path(parts: Parts) -> list[str]:
    request, toolpath = parts.request, parts.toolpath
    points = sum(map(len, toolpath.curves))
    curves = len(toolpath.curves)
    summary = f"{points} points" + (f" in {curves} curves" if curves > 1 else "")
    lines = ["[path]", 'kind = "file"', _line(f"file = {_quoted(parts.toolpath_file)}", summary)]
    if request.length_unit is None:
        lines.append(_line('# length_unit = "mm"', "the file says its unit itself"))
    lines += toolpath_lines(request)
    if toolpath.feeds is not None:
        lines.append(_line('feeds = "file"', f'{feeds_in_words(toolpath)}; "task": [feed] alone'))
    if parts.keeps_rapids:
        lines.append(_line('rapids = "keep"', "the tool comes and goes as in the file; or drop"))
    if request.orientation is None and toolpath.meaning in ("normal", "axis"):
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
    turned = "and its orientation in the robot's world"
    if parts.carrier is not None:
        turned = f"and its orientation in the frame of {parts.carrier}"
    placement = [
        "[path.placement]",
        *map(_comment, parts.placement_notes),
        _line(f"position = {_numbers(parts.position, 9)}", "m, of the file's origin"),
        _line(f"rpy_deg = {_numbers(parts.rpy_deg, 9)}", turned),
    ]
    blocks.append("\n".join(placement))
    if not parts.keeps_rapids:
        leads = [
            line
            for key, what in (("approach", "to"), ("retreat", "away from"))
            for line in (
                _line(f"[path.{key}]", f"straight {what} each curve, along the tool"),
                _line("distance = 0.05", "m"),
                "steps = 10",
            )
        ]
        blocks.append("\n".join(leads if curves > 1 else map(_off, leads)))
    if curves > 1:
        transfer = [
            _line("[path.transfer]", "from one curve to the next"),
            _line('motion = "joint"', "of the joints, as fast as they may, clear of everything"),
        ]
        on = request.transfer == "joint"
        blocks.append("\n".join(transfer if on else map(_off, transfer)))
    return blocks


def toolpath_lines(options: ToolpathOptions) -> list[str]:
    """The options of a toolpath that the user chose, each with what it is."""
    return [
        _line(f"{key} = {json.dumps(value)}", what)
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
    of_file = parts.toolpath.feeds is not None
    comment = "m/s, where the file has no feed" if of_file else "m/s, along the path"
    bound = parts.angular_speed
    angular = f"angular_speed_deg = {bound or ANGULAR_SPEED:g}"
    lines = [
        "[feed]",
        _line(f"speed = {parts.request.speed:g}", f"{comment}; it slows down at limits"),
        _line(angular if bound else _off(angular), "of the tool, degrees/s; the slower one counts"),
    ]
    return "\n".join(lines)


def _limits(parts: Parts) -> str:
    ranges, speeds = parts.ranges, parts.velocity_limits
    unlimited = [n for n, limited in zip(ranges.names, ranges.limited, strict=True) if not limited]
    units = {
        n: "rad" if hinge else "m" for n, hinge in zip(ranges.names, ranges.hinge, strict=True)
    }
    lines = []
    if unlimited:
        lines.append(_comment(f"Without a range in the robot file: {', '.join(unlimited)}."))
    if speeds:
        lines.append(_line("[limits.velocity]", "of the URDF"))
        lines += [
            _line(f"{_key(name)} = {speeds[name]:.10g}", f"{unit}/s")
            for name, unit in units.items()
            if name in speeds
        ]
    else:
        lines.append(_comment("Joint speeds: the robot file states none. From the data sheet:"))
        lines.append("# [limits.velocity]")
        lines += [
            _line(f"# {_key(name)} = {2.0 if unit == 'rad' else 0.5}", f"{unit}/s")
            for name, unit in units.items()
        ]
    lines += ["", "# [limits.acceleration]"]
    lines += [_line(f"# {_key(name)} = 10.0", f"{unit}/s²") for name, unit in units.items()]
    return "\n".join(lines)


def _clearance(watched: Watched) -> str:
    """The distance of what must not touch, and each pair that may, with the reason."""
    pairs = [
        _line(f"  [{_quoted(pair.one)}, {_quoted(pair.other)}],", pair.why)
        for pair in watched.ignored
    ]
    lines = [
        "[clearance]",
        _line(f"distance = {watched.distance:g}", "m, of every pair that may collide"),
        _line("ignore = [", "pairs of geoms or bodies that may touch"),
        *pairs,
        "]",
    ]
    return "\n".join(lines)


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


def _study(parts: Parts, middle: Array) -> str:
    """The placements that a study tries."""
    margin = parts.margin
    lines = [
        _comment("What qp-twist study varies: where the workpiece stands, around the place above."),
        "[study]",
        _line("position_error = 1e-4", "m, largest of a success"),
        "axis_error_deg = 0.05",
        _line("# max_step_deg = 15.0", "of a joint, in place of [feed] and [limits]"),
        "",
        "[study.placement]",
        _line(f"point = {_numbers(middle)}", "m, the middle of the path"),
        *([_line(f"body = {_quoted(parts.part)}", "it moves along")] if parts.part else []),
        _line(f"lower = {_numbers(middle - margin)}", "m, where that point is put"),
        f"upper = {_numbers(middle + margin)}",
        _line("yaw_deg = [-30.0, 30.0]", "turn about the vertical"),
        _line("tilt_deg = [0.0, 0.0]", "then a tilt to any side"),
    ]
    return "\n".join(lines)


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
