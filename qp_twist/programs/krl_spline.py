"""Splines in the axes of KRL, and the times of their segments."""

from __future__ import annotations

import re

from qp_twist.errors import InvalidInput
from qp_twist.programs.moves import JointMove, Moves
from qp_twist.programs.statements import refuse


class Spline:
    """The splines of a program, each perhaps with a time block.

    Attributes:
        open: Whether it has begun, and not ended.
        segments: The moves of an open time block, without times.
        shares: Whether the parts of the time block are shares, not seconds.
    """

    def __init__(self, moves: Moves) -> None:
        self._moves = moves
        self.open = self.shares = self._timed = False
        self.segments: list[JointMove] | None = None
        self._parts: list[float] = []

    def begin(self) -> None:
        """``PTP_SPLINE``."""
        self.open, self._timed, self._parts = True, False, []

    def end(self, line: int, match: re.Match[str]) -> None:
        """``ENDSPLINE``."""
        if (self._moves.strict and not self.open) or self.segments is not None:
            raise refuse(
                line, match[0],
                "expected a spline before it, and the end of its time block (TIME_BLOCK END = …).",
            )  # fmt: skip
        self.open = False

    def begin_block(self, line: int, match: re.Match[str]) -> None:
        """``TIME_BLOCK START``."""
        if self._timed or not self.open:
            raise refuse(line, match[0], "expected one time block in a spline of axis moves.")
        self._timed, self.segments = True, []

    def part(self, line: int, match: re.Match[str]) -> None:
        """``TIME_BLOCK PART = …`` behind each segment."""
        self._parts.append(float(match[1]))
        if self.segments is None or len(self._parts) != len(self.segments):
            raise refuse(
                line, match[0],
                "expected TIME_BLOCK START, then one segment before each part; a line was lost or "
                "added.",
            )  # fmt: skip

    def end_block(self, line: int, match: re.Match[str]) -> None:
        """``TIME_BLOCK END = …``: each segment takes its part's share of the whole time."""
        segments, self.segments = self.segments or [], None
        parts, whole = self._parts, float(match[1])
        if not segments or len(parts) != len(segments):
            raise InvalidInput(
                f"the time block has {len(segments)} segments and {len(parts)} parts; a line "
                "was lost or added."
            )
        total = sum(parts)
        self.shares |= abs(total - whole) > 0.6e-5
        if not (total > 0.0 and whole > 0.0 and min(parts) > 0.0):
            raise InvalidInput("a time of the time block is not positive.")
        last = len(segments) - 1
        for k, (segment, part) in enumerate(zip(segments, parts, strict=True)):
            self._moves.joint(segment._replace(seconds=part * whole / total, passes=k < last))
