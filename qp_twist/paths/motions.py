"""Motions of a program, point by point, and the curves that they make."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import MOST_POINTS
from qp_twist.paths.assemble import RawCurve


class TooManyPoints(InvalidInput):
    """The rest of a file is not read."""


@dataclass(frozen=True, slots=True)
class Motion:
    """A point and the motion that leads to it.

    Attributes:
        position: m.
        direction: Tool axis, from the tip to the holder.
        line: Line of the file, from 1.
        feed: m/s; NaN without one.
        rapid: Whether the tool gets there in rapid motion.
        breaks: Whether it is unknown where the tool comes from.
        name: Name of the part of the file.
    """

    position: tuple[float, ...]
    direction: tuple[float, ...]
    line: int
    feed: float
    rapid: bool
    breaks: bool
    name: str


@dataclass
class Motions:
    """Motions in the order of the file.

    Attributes:
        points: The motions.
        name: Name of the part of the file that is being read.
    """

    points: list[Motion] = field(default_factory=list)
    name: str = ""
    _breaks: bool = False

    def begin(self) -> None:
        """The next point begins another curve: the motion to it is not known."""
        self._breaks = bool(self.points)

    def add(
        self,
        position: Sequence[float],
        direction: Sequence[float],
        line: int,
        feed: float = math.nan,
        *,
        rapid: bool = False,
    ) -> None:
        """Add a point.

        Raises:
            TooManyPoints: If there are more than :data:`~qp_twist.paths.arcs.MOST_POINTS`.
        """
        if len(self.points) >= MOST_POINTS:
            raise TooManyPoints(
                f"the file has more than {MOST_POINTS} points, those of divided arcs and turns "
                "included; divide it into several files"
            )
        breaks, self._breaks = self._breaks, False
        self.points.append(
            Motion(tuple(position), tuple(direction), line, feed, rapid, breaks, self.name)
        )

    def curves(self) -> list[RawCurve]:
        """The curves: points with no rapid motion between them.

        A point to which only rapid motion leads, and which only rapid motion leaves, belongs to no
        curve: it is in ``before`` of the next one, or in ``after`` of the last.
        """
        runs: list[list[Motion]] = []
        for point in self.points:
            if not runs or point.rapid or point.breaks:
                runs.append([])
            runs[-1].append(point)
        found: list[RawCurve] = []
        waiting = RawCurve()
        for run in runs:
            if len(run) == 1:
                _append(waiting, run[0])
                continue
            curve = RawCurve(next((p.name for p in run if p.name), ""))
            for point in run:
                _append(curve, point)
                # The motion to the first point of a curve is not part of it.
                curve.feeds.append(math.nan if point is run[0] else point.feed)
            if waiting.positions:
                curve.before, waiting = waiting, RawCurve()
            found.append(curve)
        if found and waiting.positions:
            found[-1].after = waiting
        return found


def _append(rows: RawCurve, point: Motion) -> None:
    rows.positions.append(point.position)
    rows.directions.append(point.direction)
    rows.lines.append(point.line)


def times(count: int) -> str:
    """``once``, or for example ``3 times``."""
    return "once" if count == 1 else f"{count} times"


def of_lines(numbers: Sequence[int]) -> str:
    """Lines of a file for a message: the first one, and how many more there are."""
    more = f" and {len(numbers) - 1} more" if len(numbers) > 1 else ""
    return f"line {numbers[0]}{more}"


@dataclass
class PassedOver:
    """Words of a program that move nothing, with their lines."""

    lines: dict[str, list[int]] = field(default_factory=dict)

    def add(self, word: str, line: int) -> None:
        """Count one."""
        self.lines.setdefault(word, []).append(line)

    def notes(self) -> list[str]:
        """One sentence, or none."""
        if not self.lines:
            return []
        words = ", ".join(
            word if len(lines) == 1 else f"{word} ({len(lines)})"
            for word, lines in self.lines.items()
        )
        count = sum(map(len, self.lines.values()))
        return [f"passed over, since they move nothing ({times(count)}): {words}."]


def notes_on_rapid(curves: Sequence[RawCurve], rapids: int, word: str) -> list[str]:
    """Sentences on rapid motions: their speed, and the points between them."""
    notes = []
    alone = [way for rows in curves for way in (rows.before, rows.after) if way is not None]
    points = sum(len(way.positions) for way in alone)
    if points:
        notes.append(
            f"only {word} leads to {points} of the points and on: they are part of the path with "
            'rapids = "keep" in [path], and left out otherwise.'
        )
    if rapids:
        notes.append(
            f"{word} ({times(rapids)}): the tool gets there at the speed of [feed], as in the file "
            'with rapids = "keep", else by [path.approach], [path.retreat] and [path.transfer].'
        )
    return notes
