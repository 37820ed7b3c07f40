"""Data of RAPID in a module: expressions, targets, speeds, zones, tools and work objects."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import mink

from qp_twist.errors import InvalidInput
from qp_twist.programs.joint_moves import ProgramFrame, Speed, Target, Turning, Zone
from qp_twist.programs.moves import Moves
from qp_twist.programs.program import Program
from qp_twist.programs.statements import CARRIES, refuse, shown, split
from qp_twist.programs.values import (
    IN_DEGREES,
    Unknown,
    Values,
    list_literal,
    pose_of,
    zyx_quaternion,
)

EXTERNAL = tuple(f"eax_{k}" for k in "abcdef")
"""External axes of targets."""
TOOL = "tool0"
WOBJ = "task_wobj"
Z0 = 0.3
"""Radius of ``z0``, mm; that of ``zN`` is N."""
_TURNING = 1.6
"""Largest ratio of pzone_ori to pzone_tcp of predefined zones: 8 mm to 5 mm, of ``z5``."""
_WORLD = "wobj0", mink.SE3.identity()
_FIELDS = {
    **dict.fromkeys(("trans", "x", "q1", "v_tcp"), 0), **dict.fromkeys(("rot", "y", "q2"), 1),
    "z": 2, "q3": 2, "robconf": 2, "q4": 3, "extax": 3, "uframe": 3, "oframe": 4,
}  # fmt: skip
"""Places of the components of data."""
_COMPARISON = [("<>", "!="), (r"(?<![<>!:=])=(?!=)", "==")]


def _translate(text: str) -> str:
    if re.search(r"%|//|\*\*", text):  # operators of Python alone
        raise Unknown(f"{shown(text)} is no expression of RAPID")
    text = re.sub(r"\\(\w+)\s*:=", r",\1=", text)
    text = re.sub(r"(?<=[\w\]}])\.\s*([a-z]\w*)", lambda m: f"[{_FIELDS[m[1]]}]", text)
    text = re.sub(r"\{([^{}]*)\}", lambda m: "".join(f"[({i})-1]" for i in split(m[1])), text)
    return text.replace(" mod ", " % ").replace(" div ", " // ")


def _offs(target: list[Any], x: float, y: float, z: float) -> list[Any]:
    return [[a + b for a, b in zip(target[0], (x, y, z), strict=True)], *target[1:]]


def _rel_tool(
    target: list[Any], x: float, y: float, z: float, rx: float = 0, ry: float = 0, rz: float = 0
) -> list[Any]:
    w, *v = zyx_quaternion(-rz, -ry, -rx)  # of the inverse of R_x R_y R_z
    moved = pose_of(target[0], target[1]) @ pose_of((x, y, z), (w, *(-a for a in v)))
    return [(1e3 * moved.translation()).tolist(), moved.rotation().wxyz.tolist(), *target[2:]]


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "offs": _offs, "reltool": _rel_tool, "orientzyx": zyx_quaternion, **IN_DEGREES,
}  # fmt: skip

_ZONE = re.compile(r"z(0|1|5|10|15|20|30|40|50|60|80|100|150|200)", re.IGNORECASE | re.ASCII)
"""Predefined zone data, mm; others are data of other modules."""


class RapidData(Program):
    """A program with the data of its moves."""

    def __init__(self, moves: Moves) -> None:
        values = Values(str.lower, _translate, _FUNCTIONS, list_literal, _COMPARISON)
        super().__init__(values, moves)
        values.adds_vectors = True
        values.names |= {"true": True, "false": False}
        self._turns: Turning = "path"
        self._singular = ""

    def _zone(self, line: int, name: str, radius: str | None) -> Zone | None:
        r"""How the point is rounded, by zone data, their predefined name, or ``\Z`` (mm)."""
        try:
            if radius is not None:
                size = turning = float(self.values.value(radius))
            elif (own := _ZONE.fullmatch(name)) and not self._states(name):
                size, turning = float(own[1]) or Z0, _TURNING * (float(own[1]) or Z0)
            elif name.lower() == "fine" and not self._states(name):
                return None
            else:
                fine, size, turning, *_ = self.values.value(name)
                if fine is True:
                    return None
                turning = max(size, turning) if size >= 0.0 else size
            mark = name if radius is None else f"{name}\\Z:={radius}"
            return Zone(line, mark, 1e-3 * size, 1e-3 * turning)
        except (Unknown, TypeError, ValueError):
            return Zone(line, name)

    def _states(self, name: str) -> bool:
        """Whether the file has data of this name, which then hide those that every system has."""
        return self.values.base(name) in self.values.names

    def _is_held(self, name: str) -> bool | None:
        """Whether the robot holds a tool or work object; ``None`` if the file does not say so."""
        if self.moves.strict:
            return None
        try:
            held = self.values.value(name)[0]
        except (Unknown, TypeError, LookupError):
            return None
        return held if isinstance(held, bool) else None

    def _jointtarget(self, line: int, text: str) -> tuple[list[float], list[float]]:
        """Angles and external axes."""
        found = self.values.value(text)
        try:
            angles, external = ([float(x) for x in part] for part in found)
        except (TypeError, ValueError):
            raise refuse(line, text, "expected a jointtarget, [[6 angles],[6 axes]].") from None
        if len(external) != 6:
            raise refuse(line, text, f"expected 6 external axes, got {len(external)}.")
        return angles, external

    def _refuse_lost(self, name: str) -> None:
        """Refuse data of the file, or of a program of this package, that state no pose."""
        own = self._states(name) or name.lower() in ("task_tool", WOBJ)
        if self.moves.strict and own:
            raise InvalidInput(f"the file does not state the pose of {name}; a line was changed.")

    def _tool(self, line: int, name: str) -> ProgramFrame:
        """A tool; its pose in the flange if the file states it."""
        if name.lower() == TOOL and not self._states(name):
            return ProgramFrame(name, mink.SE3.identity())
        try:
            held, pose, _ = self.values.value(name)
            place = pose_of(*pose)
        except (Unknown, TypeError, ValueError):
            self._refuse_lost(name)
            return ProgramFrame(name)
        if held is not True:
            raise InvalidInput(CARRIES, line=line)
        return ProgramFrame(name, place)

    def _tool_speed(self, speed: str, options: Mapping[str, str]) -> Speed | None:
        """Of speed data, or of its predefined name, which turns by 500 degrees/s."""
        linear = self._feed(speed, options)
        named = self._named_speed(speed)
        angular = 500.0 if named else float(self.values.value(speed)[1])
        return None if math.isnan(linear) else Speed(linear, math.radians(angular))

    def _target(self, line: int, move: str, text: str, tool: str, wobj: str) -> Target:
        """The robtarget of a move in the work object in force, with its configuration."""
        found, pose = self.values.value(text), self._pose(line, text)
        data = tuple(map(int, found[2]))
        if list(data) != found[2]:
            raise refuse(line, move, "expected whole numbers cf1, cf4, cf6, cfx.")
        frame = ProgramFrame(*self.moves.frame, self._moved_by(wobj))
        return Target(pose, self._tool(line, tool), frame, data, line)

    def _pose(self, line: int, text: str) -> mink.SE3:
        target = self.values.value(text)
        if not isinstance(target, list) or len(target) != 4:
            raise Unknown(f"expected a robtarget, [[x,y,z],[q1,q2,q3,q4],[…],[…]], got {text}")
        given = zip(EXTERNAL, target[3], strict=False)
        self.moves.external(line, {axis: (value, "") for axis, value in given if value < 8e9})
        return pose_of(target[0], target[1])

    def _feed(self, speed: str, options: Mapping[str, str]) -> float:
        """m/s: of the option V, of speed data, or of its predefined name (v100, mm/s)."""
        try:
            if "t" in options:  # a time, so that the length would have to be known
                return math.nan
            name = self._named_speed(speed)
            found = self.values.value(options["v"]) if "v" in options else None
            found = found or (float(name[1]) if name else self.values.value(speed)[0])
            return 1e-3 * float(found)
        except (Unknown, TypeError):
            return math.nan

    def _named_speed(self, name: str) -> re.Match[str] | None:
        """The name of predefined speed data, with its number."""
        found = re.fullmatch(r"v(\d+)", name, re.IGNORECASE | re.ASCII)
        return None if self._states(name) else found

    def _moved_by(self, name: str) -> str | None:
        """What moves a work object; ``None`` if the file does not say so."""
        if name.lower() == "wobj0" and not self._states(name):
            return ""
        try:
            held, fixed, *_ = self.values.value(name)
        except (Unknown, TypeError, ValueError):
            return None
        return "hand" if held else "" if fixed else "positioner"

    def _frame(self, name: str) -> tuple[str, mink.SE3 | None]:
        """A work object; its pose if the file states it, and no axis moves it."""
        if name.lower() == "wobj0" and not self._states(name):
            return _WORLD
        try:
            held, fixed, unit, user, own = self.values.value(name)
            known = not held and fixed and not unit
            pose = pose_of(*user) @ pose_of(*own) if known else None
        except (Unknown, TypeError, ValueError):
            self._refuse_lost(name)
            return name, None
        return name, pose
