"""Frames, positions and axes of KRL, and its expressions."""

from __future__ import annotations

import re
from typing import Any

import mink

from qp_twist.programs.statements import NUMBER, split
from qp_twist.programs.values import (
    IN_DEGREES,
    Unknown,
    Values,
    fixed,
    pose_of,
    zyx_angles,
    zyx_quaternion,
)

POSE = "xyzabc"
"""Components of a position: mm and degrees."""
_FIELD = rf"(\w+)\s+({NUMBER})"
_RECORD = re.compile(
    rf"\{{(?:\s*\w+\s*:)?\s*({_FIELD}(?:\s*,\s*{_FIELD})*)\s*\}}", re.ASCII | re.IGNORECASE
)


class Frame(dict[str, Any]):
    """Components of a frame, position or axes; ``@`` is KRL's geometric operator."""

    def __matmul__(self, other: Frame) -> Frame:
        pose = frame_pose(self) @ frame_pose(other)
        values = [*(1e3 * pose.translation()), *zyx_angles(pose.rotation())]
        return Frame(zip(POSE, map(float, values), strict=True))


def frame_pose(frame: Frame) -> mink.SE3:
    """The pose that a frame states; A, B, C are about z, y', x''."""
    x, y, z, a, b, c = (frame[key] for key in POSE)
    return pose_of((x, y, z), zyx_quaternion(a, b, c))


def pose_text(pose: mink.SE3, more: str = "") -> str:
    """A position with its components in mm and degrees, and what stands behind them."""
    position, angles = 1e3 * pose.translation(), zyx_angles(pose.rotation())
    values = (*(fixed(x, 4) for x in position), *(fixed(angle, 6) for angle in angles))
    fields = [f"{key.upper()} {value}" for key, value in zip(POSE, values, strict=True)]
    return f"{{{','.join([*fields, *filter(None, [more])])}}}"


def _literal(text: str) -> Frame | None:
    match = _RECORD.fullmatch(text)
    if match is None:
        return None
    fields = re.findall(_FIELD, match[1])
    found = Frame((key.lower(), float(value)) for key, value in fields)
    if len(found) < len(fields):
        raise Unknown(f"a component stands twice in {text}")
    return found


def _record(**fields: Any) -> Frame:
    return Frame({k: float(v) if type(v) is int else v for k, v in fields.items()})


def _key(name: str) -> str:
    return name.lower().replace("$", "_")


def _translate(text: str) -> str:
    def record(match: re.Match[str]) -> str:
        parts = [part.split(None, 1) for part in split(match[1]) if part]
        return f"_f({', '.join(f'{part[0]}={part[1]}' for part in parts)})"

    text = re.sub(r"\[\s*\]", "", text)
    text = re.sub(r"#(\w+)", r'"\1"', text)
    text = re.sub(r"\{(?:\s*\w+\s*:)?([^{}]*)\}", record, text).replace(":", "@")
    text = re.sub(r"\[([^\[\]]*)\]", lambda m: "".join(f"[({i})-1]" for i in split(m[1])), text)
    return re.sub(r"(?<=[\w\])])\.\s*([a-z]\w*)", r'["\1"]', text)


def krl_values() -> Values:
    """Variables of KRL, with those that each program has."""
    values = Values(_key, _translate, {**IN_DEGREES, "_f": _record}, _literal, [("<>", "!=")])
    values.kinds = {}
    nothing = Frame(dict.fromkeys(POSE, 0.0))
    values.names |= {"_nullframe": nothing, "_world": nothing, "true": True, "false": False}
    return values
