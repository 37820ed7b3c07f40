"""Tools, bases and speeds of KRL, as far as a program states them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import mink

from qp_twist.errors import InvalidInput
from qp_twist.programs.joint_moves import Turning
from qp_twist.programs.krl_data import KrlData
from qp_twist.programs.krl_values import Frame, frame_pose
from qp_twist.programs.moves import Kind, Moves
from qp_twist.programs.statements import CARRIES, refuse
from qp_twist.programs.values import Unknown, Values

CIRCLES: dict[str, Turning] = {"#BASE": "space", "#PATH": "path"}
"""Of ``$CIRC_TYPE``: how the tool turns."""
_Frame = tuple[str, mink.SE3 | None]
_COUPLED = re.compile(
    r"EK\(MACHINE_DEF\[(\d)\]\.ROOT,\s*MACHINE_DEF\[\1\]\.MECH_TYPE,\s*BASE_DATA\[\d+\]\)",
    re.IGNORECASE,
)
"""A base that an external kinematic moves: in the flange of a positioner (RoboDK's public post
processor for KUKA)."""


class KrlFrames(KrlData):
    """A program with its frames and speeds.

    Attributes:
        frames: Those of ``BASE_DATA`` and ``TOOL_DATA`` that the file assigns, by number.
        tool: Name of the tool in force, and its pose in the flange if the file states it.
        turns: ``$VEL.ORI1`` and ``$VEL.ORI2``, rad/s; nan where the file does not state them.
        circle: How the tool turns on circles (``$CIRC_TYPE``); ``None``: not stated.
        unread: By setting, the statement in force for which straight moves are not read.
        zone: ``$APO.CDIS``, m; ∞ where the file does not state it.
    """

    def __init__(self, values: Values, moves: Moves) -> None:
        super().__init__(values, moves)
        self.frames: dict[str, dict[int | str, _Frame]] = {"base": {}, "tool": {}}
        self.tool: _Frame = "", None
        self.turns = {"1": math.nan, "2": math.nan}
        self.circle: Turning | None = None
        self.unread: dict[str, str] = {}
        self.zone = self._inline_zone = math.inf

    def unsettle(self, line: int, text: str, match: re.Match[str], why: str) -> None:
        """A setting runs or not; a base that it would state has no pose."""
        before = {what: dict(each) for what, each in self.frames.items()}
        tool = self.tool
        super().unsettle(line, text, match, why)
        if self.tool is not tool:
            self.tool = f"a tool that {why} (line {line})", None
        for what, each in self.frames.items():
            changed = {key for key, value in each.items() if value is not before[what].get(key)}
            each |= {key: (f"{what} {key} that {why} (line {line})", None) for key in changed}

    def _stated(self, line: int, match: re.Match[str], kind: Kind = "setting") -> None:
        coupled = match["word"].upper() == "$BASE" and _COUPLED.fullmatch(match["value"].strip())
        self.listing.refuse_calls(line, "" if coupled else match["value"])
        if not (self.moves.strict and kind == "speed" and match["word"] != "LDAT_ACT"):
            self.moves.noted(line, match["word"], kind)

    def _begin(self, line: int, match: re.Match[str]) -> None:
        """What a program begins with, among it a controller's own settings in place of all."""
        if "INITMOV" in match[0].upper():
            self.zone, self.moves.feed, self.circle = math.inf, math.nan, None
            self.turns = dict.fromkeys(self.turns, math.nan)
            if self.moves.strict:
                self.tool = self.moves.frame = "", None

    def _rounding(self, line: int, match: re.Match[str]) -> None:
        """``$APO.CDIS``, from how far before a point on it is rounded, also in a record."""
        self.listing.refuse_calls(line, match["value"])
        self.moves.noted(line, match["word"], "passed")
        whole = match["word"].upper() == "$APO"
        found = self._data(match["value"]).get("cdis") if whole else match["value"]
        self.zone = self._distance(found)

    def _inline_rounding(self, line: int, match: re.Match[str]) -> None:
        """What inline forms state, takes effect."""
        self.moves.noted(line, match["word"], "speed")
        self.zone = self._inline_zone

    def _distance(self, millimetres: object) -> float:
        """In m; ∞ if it is not known."""
        found = self.values.number(str(millimetres))
        return math.inf if math.isnan(found) else 1e-3 * found

    def _speed(self, line: int, match: re.Match[str]) -> None:
        self._stated(line, match, "speed")
        if match["word"].upper() == "BAS" and "CP_PARAMS" in match[0].upper():
            self.zone = self._inline_zone
        self.values.names["_vel"] = {"cp": self.moves.feed}
        self.moves.feed = self.values.number(match["value"])

    def _turning(self, line: int, match: re.Match[str]) -> None:
        self._stated(line, match, "speed")
        self.turns[match["word"][-1]] = math.radians(self.values.number(match["value"]))

    def _speeds(self, line: int, match: re.Match[str]) -> None:
        """A record, {CP …,ORI1 …,ORI2 …}."""
        self._stated(line, match, "speed")
        data = self._data(match["value"])
        found = data.get("cp", math.nan)
        self.moves.feed = found if isinstance(found, float) else math.nan
        self.turns = {key: math.radians(data.get(f"ori{key}", math.nan)) for key in "12"}

    def _data(self, text: str) -> Mapping[str, Any]:
        """A record; empty if the file does not state it."""
        with suppress(Unknown):
            found = self.values.value(text)
            return found if isinstance(found, Frame) else {}
        return {}

    def _mode(self, line: int, match: re.Match[str]) -> None:
        """Moves of a tool on a part that stands still, whose orientation turns in proportion."""
        value = match[2].strip().upper()
        known = value in ("#BASE", "#VAR")
        if match[1].upper() == "$CIRC_TYPE":
            self.circle = CIRCLES.get(value)
            known = self.circle is not None
        if not (known or self.moves.strict):
            self.refuse(line, match)
        self._reads(match[1], match[0], known=known)
        self.moves.noted(line, match[1], "setting")

    def _reads(self, setting: str, statement: str, *, known: bool) -> None:
        """Remember whether straight moves are read with a setting."""
        self.unread.pop(setting.upper(), "")
        if not known and setting.upper() != "$CIRC_TYPE":
            self.unread[setting.upper()] = statement

    def _set_frame(self, line: int, match: re.Match[str]) -> None:
        """``$BASE``, ``$TOOL``, also by their numbers."""
        text, what = match["value"].strip(), match["what"].lower()
        self._stated(line, match)
        number = re.fullmatch(rf"{what}_DATA\s*\[(.*)\]", text, re.IGNORECASE)
        if what == "base" and _COUPLED.fullmatch(text):
            self.moves.frame = text.upper(), None
            return
        if match["word"].upper() == "BAS" or number:
            found = self._numbered(what, number[1] if number else text)
        else:
            found = self._frame(text, f"${what.upper()} = {text}")
        if what == "tool":
            self.tool = found
        else:
            self.moves.frame = found

    def _numbered(self, what: str, text: str) -> tuple[str, mink.SE3 | None]:
        """The base or tool whose number an expression states; that of number 0 is none."""
        found = self.values.number(text)
        number = text.strip() if math.isnan(found) else int(found)
        none = mink.SE3.identity() if number == 0 and self.moves.strict else None
        return self.frames[what].get(number, (f"{what} {number}", none))

    def _frame_data(self, line: int, match: re.Match[str]) -> None:
        what = match["what"].lower()
        self._stated(line, match)
        if what == "tool" and not self.moves.strict:
            return
        number = self.values.number(match["part"])
        if math.isnan(number) and self.moves.strict:
            self._reads(match["word"], match[0], known=False)
            return
        number = int(self.values.value(match["part"]))
        name = f"{what} {number} of line {line}"
        known = not match["field"].strip()
        self.frames[what][number] = self._frame(match["value"], name) if known else (name, None)

    def _frame(self, text: str, name: str) -> tuple[str, mink.SE3 | None]:
        try:
            return name, frame_pose(self.values.value(text))
        except (Unknown, KeyError, TypeError, ValueError):
            if self.moves.strict and text.strip().startswith("{"):
                raise InvalidInput(f"{name}: expected {{X …,Y …,Z …,A …,B …,C …}}.") from None
            return name, None

    def _inline_frame(self, line: int, match: re.Match[str]) -> None:
        """The base of the move that follows, by which inline forms state it."""
        self._stated(line, match)
        data = self._data(match["value"])
        known = data.get("ipo_frame", "base") == "base"
        if not (known or self.moves.strict):
            raise refuse(line, match[0], CARRIES)
        self._reads(match["word"], match[0], known=known)
        if "base_no" in data:
            self.moves.frame = self._numbered("base", str(data["base_no"]))
        if "tool_no" in data:
            self.tool = self._numbered("tool", str(data["tool_no"]))

    def _inline_line(self, line: int, match: re.Match[str]) -> None:
        """How the tool turns on the move that follows, by which inline forms state it."""
        self._stated(line, match, "speed")
        data = self._data(match["value"])
        self.circle = CIRCLES.get(f"#{data.get('circ_typ', 'base')}".upper())
        self._inline_zone = self._distance(data.get("apo_dist"))
        known = data.get("ori_typ", "var") == "var"
        if not self.moves.strict and not (known and self.circle):
            self.refuse(line, match)
        self._reads(match["word"], match[0], known=known)
