"""Toolpaths from URScript, of Universal Robots.

Source: Universal Robots, *The URScript Programming Language*, modules *motion* and *urmath*: poses
``p[x, y, z, rx, ry, rz]`` are m and a rotation vector, in the robot's base.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mink
import numpy as np

from qp_twist.paths.robot_path import RobotPath
from qp_twist.paths.robot_program import RobotProgram, Rule, robot_format
from qp_twist.paths.robot_values import Pose, Unknown, Values, list_literal
from qp_twist.paths.toolpath import LARGEST_NUMBER
from qp_twist.paths.toolpath_builder import ProgramWords, ToolpathFormat
from qp_twist.programs.reading import refuse, split, without_texts
from qp_twist.programs.urscript import ASSIGNMENT, CALLS

_WORDS = ProgramWords("a URScript program", "the tool's frame (TCP)", "movej", "m", "quaternion")
_BEGINS = r"(?:def|sec|thread)\s+\w+\s*\(.*\)\s*:|(?:move[ljpc]|set_tcp)\s*\("
"""Lines with which a script begins."""
_ARGUMENTS = {
    "movej": ("q", "a", "v", "t", "r"), "movel": ("pose", "a", "v", "t", "r"),
    "movep": ("pose", "a", "v", "r"), "movec": ("pose_via", "pose_to", "a", "v", "r", "mode"),
}  # fmt: skip


def _se3(pose: Any) -> mink.SE3:
    values = np.array(pose, dtype=np.float64)
    if (
        not isinstance(pose, Pose)
        or values.shape != (6,)
        or not (np.abs(values) <= LARGEST_NUMBER).all()
    ):
        raise Unknown(f"expected a pose, p[x, y, z, rx, ry, rz], got {pose}")
    return mink.SE3.from_rotation_and_translation(mink.SO3.exp(values[3:]), values[:3])


def _pose(se3: mink.SE3) -> Pose:
    return Pose([*se3.translation().tolist(), *se3.rotation().log().tolist()])


def _added(one: Any, other: Any) -> Pose:
    """``pose_add``: translations are added, and rotations composed."""
    a, b = _se3(one), _se3(other)
    turn = a.rotation() @ b.rotation()
    return _pose(mink.SE3.from_rotation_and_translation(turn, a.translation() + b.translation()))


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "pose_trans": lambda a, b: _pose(_se3(a) @ _se3(b)), "pose_add": _added,
    "pose_inv": lambda a: _pose(_se3(a).inverse()), "get_inverse_kin": lambda pose, *_, **__: pose,
    "d2r": math.radians, "r2d": math.degrees, "sin": math.sin, "cos": math.cos, "tan": math.tan,
    "sqrt": math.sqrt, "norm": abs,
}  # fmt: skip


class Script(RobotProgram):
    """A script."""

    flags = re.ASCII | re.DOTALL  # capitals count
    opens = (
        (r"def\s+(?P<name>\w+)\s*\((?P<arguments>.*)\)\s*:", "end", "procedure"),
        (r"(?:thread|sec)\b.*:", "end", "never"),
        (r"while\s*\(?\s*True\s*\)?\s*:", "end", "for ever"), (r"(?:if|while)\b.*:", "end", "open"),
    )  # fmt: skip

    def __init__(self, path: RobotPath) -> None:
        super().__init__(Values(str, str, _FUNCTIONS, list_literal), path)
        self.values.names |= {"True": True, "False": False, "pi": math.pi}
        path.frame = "the robot's base", mink.SE3.identity()

    def grammar(self) -> Sequence[Rule]:
        """Moves, words that move nothing, variables, calls."""
        return (
            (rf"(?P<word>{'|'.join(_ARGUMENTS)})\s*\((?P<arguments>.*)\)", self._move, "moves"),
            (r"(?:move|servo|speed|force_mode|freedrive|teach|conveyor|path_offset|track|screw)\w*"
             r"\s*\(.*", self.refuse, "moves"),
            (r"(?:return|break|halt)\b.*", self.leave, "moves"),
            (r"(?:else|elif)\b.*", self.skip, "nothing"),
            *((pattern, self.skip, "nothing") for kind in CALLS.values() for pattern in kind),
            (ASSIGNMENT, self.assign, "assigns"),
            (r"(?:(?:global|local|run|join|kill)\b|\$).*|\w+|(?:sleep|stopj|stopl|sync)\s*\(.*",
             self.skip, "nothing"),
            (r"(?P<called>\w+)\s*\((?P<arguments>.*)\)", self.call, "unknown"),
            (r".*", self.refuse, "moves"),
        )  # fmt: skip

    def parameter(self, words: Sequence[str]) -> str:
        """A parameter may have a default value."""
        return words[0]

    def _move(self, line: int, match: re.Match[str]) -> None:
        names, given = _ARGUMENTS[match["word"]], dict[str, str]()
        for place, argument in enumerate(split(match["arguments"])):
            named = re.fullmatch(r"(\w+)\s*=\s*(.+)", argument, re.ASCII)
            key = named[1] if named else (names[place] if place < len(names) else "")
            if key not in names or key in given:
                raise refuse(line, argument, f"expected the arguments {', '.join(names)}.")
            given[key] = named[2] if named else argument
        if match["word"] == "movej":
            try:
                self.path.joint(line, _se3(self.values.value(given.get("q", ""))))
            except Unknown:
                self.path.joint(line, None)
            return
        try:
            timed = "t" in given and self.values.value(given["t"]) > 0.0
            self.path.feed = math.nan if timed else float(self.values.value(given.get("v", "0.25")))
        except (Unknown, TypeError):
            self.path.feed = math.nan
        if given.get("r", "0") != "0":
            self.passed.append((line, "r"))
        poses = [_se3(self.values.value(text)) for key, text in given.items() if key[0] == "p"]
        if len(poses) != 1 + (match["word"] == "movec"):
            raise refuse(line, match[0], "expected poses, p[x, y, z, rx, ry, rz].")
        if len(poses) == 2:
            self.path.arc(line, poses[0], poses[1])
        else:
            self.path.line(line, poses[0])


def _execute(file: Path, lines: Sequence[str], path: RobotPath) -> RobotProgram:
    """Execute a script."""
    del file
    program = Script(path)
    codes = ((k, without_texts(k, line, "\"'", "#")[0]) for k, line in enumerate(lines, start=1))
    parts = ((k, part.strip()) for k, code in codes for part in code.split(";"))
    program.execute([(k, part) for k, part in parts if part])
    return program


URSCRIPT: ToolpathFormat = robot_format(_BEGINS, _WORDS, _execute)
"""URScript."""
