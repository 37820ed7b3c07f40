"""A toolpath built from a program, block by block: units, feeds, arcs, problems and notes."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS, LengthUnit, Problems, of_lines
from qp_twist.paths.arcs import MOST_POINTS, Arc
from qp_twist.paths.process_words import PROCESS
from qp_twist.paths.toolpath import SAME_POINT, ProcessWord, Toolpath
from qp_twist.paths.toolpath_options import ReadingOptions
from qp_twist.paths.toolpath_points import (
    LONGEST_REACH,
    Points,
    PointsOfCurve,
    curves_between_rapids,
    toolpath_of,
)


class ToolpathFormat(NamedTuple):
    """A format of toolpath files: which it matches, how they are read, options it has no use for.

    Files are matched by suffix (lower case) and lines; each refused option has its reason.
    """

    matches: Callable[[str, Sequence[str]], bool]
    read: Callable[[Path, Sequence[str], ReadingOptions], Toolpath]
    refused: Mapping[tuple[str, ...], str]


STATED_BY_PROGRAMS: dict[tuple[str, ...], str] = {
    ("columns",): "an APT or G-code file has no columns; leave columns out.",
    ("feed_unit",): "an APT or G-code file states the unit of a feed itself; leave feed_unit out.",
}
"""Options that programs of machine tools have no use for, and why."""


class ProgramWords(NamedTuple):
    """What messages call a program, its tool axis, rapid motion and units; what its axes are.

    Attributes:
        tip: Words after which the coordinates are those of the tool's tip.
        applied: Pattern of words that move nothing themselves and count for motions behind them.
    """

    title: str
    axis: str
    rapid: str
    units: str
    direction: Literal["axis", "quaternion"] = "axis"
    tip: tuple[str, ...] = ()
    applied: str = ""


class Row(NamedTuple):
    """The points to which a motion leads, m, (N, 3), their directions, and its line, from 1.

    The feed is in m/s, NaN without one. Where it ``begins``, the motion to the first is not known.
    """

    positions: Array
    directions: Sequence[Sequence[float]]
    line: int
    feed: float = math.nan
    rapid: bool = False
    begins: bool = False
    name: str = ""


class TooManyPoints(InvalidInput):
    """The rest of a file is not read."""


class Feeds:
    """The feed in force of a program: a length per minute, per turn of the spindle, or by time.

    By time each motion states how many of its kind would take a minute.
    """

    def __init__(self) -> None:
        self._value, self.per_turn, self.turns_per_minute = math.nan, False, math.nan
        self.by_time = False
        self.motions_per_minute: float | None = None

    def take_motion(self, length: float) -> None:
        """A cut of a length, m: by time, it has a feed of its own.

        Raises:
            InvalidInput: If its time is not stated.
        """
        if not self.by_time:
            return
        if self.motions_per_minute is None:
            raise InvalidInput("G93: each block that cuts needs its own F")
        feed = self.motions_per_minute * length
        # A turn in place has a time, and no feed.
        self.set(feed if feed > 0.0 else math.nan, per_turn=False)

    def set(self, value: float, *, per_turn: bool) -> None:
        """A feed in m per minute, or m per turn."""
        self._value, self.per_turn = value, per_turn

    def state(self, word: str, value: float, unit: float, *, per_turn: bool = False) -> None:
        """A feed that a word states, and the length of its unit, m.

        Raises:
            InvalidInput: If it is not above 0.
        """
        if not value > 0.0:
            raise InvalidInput(f"{word}: expected a feed above 0, got {value:g}")
        if self.by_time:
            self.motions_per_minute = value
        else:
            self.set(unit * value, per_turn=per_turn)

    def now(self) -> float:
        """The feed in force, m/s; NaN without one.

        Raises:
            InvalidInput: If it is per turn, and no turns are stated.
        """
        if self.per_turn and math.isfinite(self._value) and not self.turns_per_minute > 0.0:
            raise InvalidInput(
                "the feed is per turn of the spindle, and nothing before it states turns per "
                "minute; state them, or the feed per minute"
            )
        return self._value * (self.turns_per_minute if self.per_turn else 1.0) / 60.0


class Rows(list[Row]):
    """The motions of a program in their order.

    Attributes:
        begins: Whether the next point begins another curve: the motion to it is not known.
        rapids: How many are rapid, those included that lead to where the tool is.
        arcs: How many arcs were divided into chords.
    """

    def __init__(self) -> None:
        super().__init__()
        self.begins = False
        self.rapids = self.arcs = self._points = 0

    def begin_curve(self) -> None:
        """The next point begins another curve."""
        self.begins = bool(self)

    def add(self, row: Row) -> None:
        """Add the points of a motion, unless it is rapid and the tool is there.

        Raises:
            TooManyPoints: If there are more than :data:`~qp_twist.paths.arcs.MOST_POINTS`.
        """
        self.rapids += row.rapid
        last = self[-1] if self else None
        if row.rapid and not self.begins and last and last.rapid and _same_place(row, last):
            return
        self._points += len(row.positions)
        if self._points > MOST_POINTS:
            raise TooManyPoints(
                f"the file has more than {MOST_POINTS} points, those of divided arcs and turns "
                "included; divide it into several files"
            )
        if len(row.positions):
            self.append(row)
            self.begins = False

    def curves(self) -> list[PointsOfCurve]:
        """The curves between rapid motions."""
        if not self:
            return []
        counts = [len(row.positions) for row in self]
        directions = chain.from_iterable(chain.from_iterable(row.directions for row in self))
        points = Points(
            np.concatenate([row.positions for row in self]),
            np.fromiter(directions, np.float64).reshape(sum(counts), -1),
            np.repeat([row.line for row in self], counts),
            np.repeat([row.feed for row in self], counts),
        )
        names = [row.name for row in self for _ in row.directions]
        begins = np.zeros(len(names), dtype=bool)
        begins[np.cumsum([0, *counts[:-1]])] = [row.begins for row in self]
        return curves_between_rapids(
            points, names, np.repeat([row.rapid for row in self], counts), begins
        )


class Remarks:
    """What a program says beside its motions, for the notes on the toolpath.

    Attributes:
        passed: How often each word that moves nothing is in it.
        process: The statements about the process.
        noted: Lines of each note, and whether it is on what was left out.
    """

    def __init__(self) -> None:
        self.passed = Counter[str]()
        self.process: list[ProcessWord] = []
        self.noted: dict[tuple[str, bool], list[int]] = {}

    def notes(self, *, left_out: bool) -> list[str]:
        """The notes on what was assumed, or on what was left out."""
        return [what.replace("{}", of_lines(lines)) if "{}" in what
                else f"{what} ({of_lines(lines)})."
                for (what, left), lines in self.noted.items() if left == left_out]  # fmt: skip

    def words(self, said: str, pattern: str, *, matching: bool) -> list[str]:
        """A note on the words that moved nothing, those that match a pattern or the others."""
        found = [(word, count) for word, count in self.passed.items()
                 if bool(re.fullmatch(pattern, word)) == matching]  # fmt: skip
        words = [word if count == 1 else f"{word} ({count})" for word, count in found]
        count = times(sum(count for _, count in found))
        return [f"{said} ({count}): {', '.join(words)}."] if words else []


class ProgramBuilder:
    """A toolpath as it is read, line by line, from the program of a machine tool.

    It has the problems found so far, and the line, the name of the part of the file, the stated
    unit of length and the feed that are in force.
    """

    def __init__(self, options: ReadingOptions, words: ProgramWords) -> None:
        if options.orientation not in (None, words.direction, "none"):
            raise InvalidInput(
                f"orientation is {options.orientation!r}, but {words.title} has tool axes; leave it"
                f' out or say "{words.direction}" or "none".'
            )
        self.options, self.words = options, words
        self.problems, self.feeds = Problems(), Feeds()
        self.rows, self.remarks = Rows(), Remarks()
        self.line = 0
        self.unit: LengthUnit | None = None
        self._likely: tuple[LengthUnit, str] | None = None
        self.name = ""
        self._frame: object = None

    @contextmanager
    def at(self, line: int) -> Iterator[None]:
        """Read a line: what is refused is a problem of it."""
        self.line = line
        try:
            yield
        except TooManyPoints as error:
            self.refuse(error)
            raise
        except InvalidInput as error:
            self.refuse(error)

    def problem(self, what: str, column: str = "", **options: str | None) -> None:
        """Add a problem of the current line; ``options`` settle it."""
        self.problems.add(self.line, what, column, options)

    def refuse(self, error: InvalidInput) -> None:
        """Add what is wrong with the current line."""
        self.problems.add(self.line, error.sentence, options=error.options)

    def pass_over(self, word: str, text: str = "") -> None:
        """Count a word that moves nothing; the statement is kept if it is about the process."""
        self.remarks.passed[word] += 1
        if PROCESS.match(word):
            last = self.rows[-1] if self.rows else None
            end = () if last is None else tuple(last.positions[-1].tolist())
            after = 0 if last is None else last.line
            self.remarks.process.append(ProcessWord(self.line, text or word, after, end))

    def note(self, what: str, *, left_out: bool = False) -> None:
        """What was assumed in this line, or left out; ``{}`` in the text is replaced by lines."""
        self.remarks.noted.setdefault((what, left_out), []).append(self.line)

    def set_frame(self, word: str, frame: object) -> None:
        """The file states the frame of the points that follow: its own, or a work offset."""
        self.pass_over(word)
        before, self._frame = self._frame, frame
        if before not in (None, frame) and self.rows:
            raise InvalidInput(
                f"{word} is another frame than before, and where it is, is not known; write each "
                "frame's paths into a file of their own"
            )

    def set_unit(self, unit: LengthUnit, *, moved: bool) -> None:
        """The file states its unit of length."""
        stated = self.options.length_unit
        if stated not in (None, unit):
            self.problem(
                f"the file is in {unit}, and length_unit "
                f"({self.options.option('length_unit')}) says {stated}; leave it out, or correct "
                "one of them"
            )
        if moved and unit != self.unit:
            self.problem("the unit changes after the first motion")
        self.unit = unit

    def assume_unit(self, unit: LengthUnit, why: str) -> None:
        """What speaks for a unit of length, if neither the file nor the options state one."""
        self._likely = unit, why

    def assume_unit_by_extent(self, extent: float) -> None:
        """Assume mm where a path of this extent, in its own unit, would leave any arm's reach."""
        far = extent * LENGTHS["inch"] > 2.0 * LONGEST_REACH >= extent * LENGTHS["mm"]
        if self._likely is None and far:
            self.assume_unit("mm", f"nothing states it; {in_inches(extent)}")

    @property
    def length_unit(self) -> LengthUnit:
        """That of the file, else the one asked for, else the likely one, else mm."""
        likely = None if self._likely is None else self._likely[0]
        return self.unit or self.options.length_unit or likely or "mm"

    def scale(self) -> float:
        """Metres in the unit of length; if there is none, the first line that needs it is wrong."""
        if self.unit is None and self.options.length_unit is None and self._likely is None:
            self.problem(
                f"no unit of length before the first point; add {self.words.units} above it, or "
                'length_unit = "mm" or "inch" to [path] of the task file',
                length_unit=None,
            )
            self.unit = "mm"
        return LENGTHS[self.length_unit]

    def add(
        self, points: Sequence[Array], directions: Sequence[Sequence[float]], *, rapid: bool
    ) -> None:
        """Add the points of a motion, m, at the feed in force.

        Raises:
            TooManyPoints: If there are more than :data:`~qp_twist.paths.arcs.MOST_POINTS`.
        """
        feed = math.nan if rapid else self.feeds.now()
        self.rows.add(
            Row(np.asarray(points), directions, self.line, feed, rapid, self.rows.begins, self.name)
        )

    def divide_arc(self, arc: Arc) -> tuple[Array, Array]:
        """The ends of an arc's chords, and their shares of its angle."""
        points = arc.points(self.options.arc_error)
        self.rows.arcs += 1
        return points

    def toolpath(
        self, path: Path, assumptions: Iterable[str] = (), *, has_axis: bool, sense: str = ""
    ) -> Toolpath:
        """The whole toolpath.

        Args:
            path: The file.
            assumptions: What the format assumed, a sentence each.
            has_axis: Whether the file states a tool axis.
            sense: How arcs turn, for the note on them.

        Raises:
            InvalidInput: If there are problems, or nothing is cut.
        """
        curves = self.rows.curves()
        if not curves:
            self.problems.refuse()
            nothing = "there is no motion to a point with all coordinates in it."
            uncut = f"no two points without {self.words.rapid} between them; nothing is cut."
            raise InvalidInput(uncut if self.rows else nothing)
        found = toolpath_of(
            path, self.options.orientation or self.words.direction, curves, self.words.axis,
            self.problems,
            assumptions=[*self._assumptions(has_axis=has_axis, sense=sense), *assumptions],
            passed_over=[
                *self.remarks.words(
                    "passed over, since they move nothing", self.words.applied, matching=False
                ),
                *self.remarks.notes(left_out=True),
            ],
            unit=self.length_unit if self.rows else "m", unit_in_file=self.unit is not None,
        )  # fmt: skip
        return replace(found, words=tuple(self.remarks.process))

    def _assumptions(self, *, has_axis: bool, sense: str) -> Iterator[str]:
        """What was assumed about units, axes, rapid motions, arcs and words."""
        options = self.options
        if self._likely is not None and self.unit is None and options.length_unit is None:
            unit, why = self._likely
            answer = options.answer("length_unit", "inch" if unit == "mm" else "mm")
            yield f"read as {unit}: {why}; {answer} reads it so."
        if options.axes_point == "into" and not has_axis:
            raise InvalidInput("the file states no tool axes; leave it out.", key="axes_point")
        if not options.orientation and not has_axis:
            yield "no tool axis is stated; (0, 0, 1) is taken, as on a machine of three axes."
        if self.rows.rapids:
            yield (
                f'{self.words.rapid} ({times(self.rows.rapids)}): with rapids = "keep" in [path] '
                "the tool goes these ways at the speed of [feed]; otherwise [path.approach], "
                "[path.retreat] and [path.transfer] lead it from curve to curve."
            )
        yield from self.remarks.notes(left_out=False)
        if self.rows.arcs:
            error = 1e3 * options.arc_error
            yield (
                f"arcs ({times(self.rows.arcs)}){sense}: chords within {error:g} mm of them "
                "(arc_error)."
            )
        said = "words that change what follows are applied"
        yield from self.remarks.words(said, self.words.applied, matching=True)


def _same_place(row: Row, last: Row) -> bool:
    """Whether a motion leads to where the tool is after the last one."""
    place, turned = last.positions[-1], last.directions[-1]
    return all(direction == turned for direction in row.directions) and all(
        math.dist(point, place) < SAME_POINT for point in row.positions
    )


def times(count: int) -> str:
    """``once``, or for example ``3 times``."""
    return "once" if count == 1 else f"{count} times"


def in_inches(extent: float) -> str:
    """How long a path would be as inches, for a message: in mm below 1 m."""
    metres = extent * LENGTHS["inch"]
    long = f"{metres:.3g} m" if metres >= 1.0 else f"{1e3 * metres:.3g} mm"
    return f"as inches it would be {long} long"
