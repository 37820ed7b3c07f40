"""What the readers of all formats share: options, rows, units, arcs, sizes, problems and notes."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array, Mask
from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS, LengthUnit, Problems
from qp_twist.paths.arcs import MOST_POINTS, Arc
from qp_twist.paths.toolpath import SAME_DIRECTION, SAME_POINT, Curve, Meaning, Toolpath
from qp_twist.paths.toolpath_columns import Orientation
from qp_twist.paths.toolpath_options import ReadingOptions
from qp_twist.paths.turning import angles_between, turns_between

LARGEST_COORDINATE = 100.0
"""Coordinates beyond it, m, indicate a wrong unit."""
LONGEST_REACH = 4.7
"""Of the arms on the market, m: FANUC's M-2000iA/1700L reaches 4.68 m."""
LARGEST_FEED = 100.0
"""Feeds above it, m/s, indicate a wrong unit."""


class ToolpathFormat(NamedTuple):
    """A format of toolpath files.

    Attributes:
        matches: Whether a file is of this format, by its suffix (lower case) and its lines.
        read: (file, lines, options) to the toolpath.
        refused: Why it has no use for some options, by their names.
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
    """A point of a file and the motion that leads to it.

    Attributes:
        position: m.
        direction: Three or four numbers, or none.
        line: Line of the file, from 1.
        feed: m/s; NaN without one.
        rapid: Whether the tool gets there in rapid motion.
        begins: Whether it is unknown where the tool comes from.
        name: Name of the part of the file.
    """

    position: tuple[float, ...]
    direction: tuple[float, ...]
    line: int
    feed: float = math.nan
    rapid: bool = False
    begins: bool = False
    name: str = ""


class RowsOfCurve(NamedTuple):
    """The rows of a curve, and those that lead to it, or away from it, in rapid motion."""

    rows: list[Row]
    before: list[Row]
    after: list[Row]


class TooManyPoints(InvalidInput):
    """The rest of a file is not read."""


def toolpath_of(
    path: Path,
    orientation: Orientation,
    curves: Sequence[RowsOfCurve],
    call: str,
    problems: Problems,
    *,
    assumptions: Iterable[str],
    passed_over: Iterable[str],
    unit: LengthUnit,
    unit_in_file: bool,
) -> Toolpath:
    """The toolpath of some curves, with the checks common to all formats.

    Args:
        path: The file.
        orientation: Meaning of the directions; angles in radians, a quaternion's w first.
        curves: Their rows.
        call: Name of the direction's columns in messages.
        problems: Those of the reader; raised here together with those of the rows.
        assumptions: What the reader assumed, a sentence each.
        passed_over: What it passed over, likewise.
        unit: Of the file's positions.
        unit_in_file: Whether the file states it.

    Raises:
        InvalidInput: If there is no row, a row is too far away or too fast, or a direction is zero.
    """
    if not curves:
        problems.refuse()
        raise InvalidInput("there is no point in it.")
    rows = [row for curve in curves for part in (curve.before, *curve[:1], curve.after)
            for row in part]  # fmt: skip
    _refuse_far(rows, problems, unit, unit_in_file=unit_in_file)
    found: list[Curve] = []
    repeated: list[int] = []
    for number, (main, *ways) in enumerate(curves, start=1):
        name = next((row.name for row in main if row.name), str(number))
        curve = _curve(orientation, main, name, call, problems, feeds=_feeds(main, problems))
        again = _repeats(curve)
        repeated += curve.lines[again].tolist()
        before, after = (
            _curve(orientation, way, "", call, problems) if way else None for way in ways
        )
        found.append(replace(curve.part(~again), before=before, after=after))
    problems.refuse()
    whole = orientation in ("quaternion", "rpy", "rotation_vector", "matrix")
    meaning: Meaning = "rotation" if whole else orientation  # type: ignore[assignment]
    dropped = []
    if len(repeated) == 1:
        dropped = [f"a point that repeats the one before was dropped (line {repeated[0]})."]
    elif repeated:
        dropped = [
            f"{len(repeated)} points that repeat the one before were dropped (the first in line "
            f"{repeated[0]})."
        ]
    return Toolpath(
        path, meaning, tuple(found), tuple(assumptions), (*passed_over, *dropped), unit,
        unit_in_file,
    )  # fmt: skip


class Feeds:
    """The feed in force of a program: a length per minute, per turn of the spindle, or by time.

    Attributes:
        per_turn: Whether it is per turn of the spindle.
        turns_per_minute: Of the spindle.
        by_time: Whether each motion states how many of its kind would take a minute.
        motions_per_minute: What the motion states that is read.
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


class ProgramBuilder:
    """A toolpath as it is read, line by line, from the program of a machine tool.

    Attributes:
        options: Of the reader.
        words: Of the format.
        problems: Those found so far.
        line: Line that is being read.
        unit: Unit of length that the file states.
        name: Name of the part of the file that is being read.
        rows: The points so far.
        feeds: The feed in force.
    """

    def __init__(self, options: ReadingOptions, words: ProgramWords) -> None:
        if options.orientation not in (None, words.direction, "none"):
            raise InvalidInput(
                f"orientation is {options.orientation!r}, but {words.title} has tool axes; leave it"
                f' out or say "{words.direction}" or "none".'
            )
        self.options, self.words = options, words
        self.problems, self.feeds = Problems(), Feeds()
        self.line = 0
        self.unit: LengthUnit | None = None
        self._likely: tuple[LengthUnit, str] | None = None
        self.name = ""
        self.rows: list[Row] = []
        self._begins = False
        self._frame: object = None
        self._passed: dict[str, list[int]] = {}
        self._notes: dict[tuple[str, bool], list[int]] = {}
        self._rapids = self._arcs = 0

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

    def pass_over(self, word: str) -> None:
        """Count a word that moves nothing."""
        self._passed.setdefault(word, []).append(self.line)

    def note(self, what: str, *, left_out: bool = False) -> None:
        """What was assumed in this line, or left out; ``{}`` in the text is replaced by lines."""
        self._notes.setdefault((what, left_out), []).append(self.line)

    def _noted(self, *, left_out: bool) -> list[str]:
        return [what.replace("{}", of_lines(lines)) if "{}" in what
                else f"{what} ({of_lines(lines)})."
                for (what, left), lines in self._notes.items() if left == left_out]  # fmt: skip

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
        inches = extent * LENGTHS["inch"]
        if self._likely is None and inches > 2.0 * LONGEST_REACH >= extent * LENGTHS["mm"]:
            self.assume_unit("mm", f"nothing states it; as inches it would be {inches:.3g} m long")

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

    def begin_curve(self) -> None:
        """The next point begins another curve: the motion to it is not known."""
        self._begins = bool(self.rows)

    def add(
        self, points: Sequence[Array], directions: Sequence[Sequence[float]], *, rapid: bool
    ) -> None:
        """Add the points of a motion, m, at the feed in force.

        Raises:
            TooManyPoints: If there are more than :data:`~qp_twist.paths.arcs.MOST_POINTS`.
        """
        feed = math.nan if rapid else self.feeds.now()
        self._rapids += rapid
        if len(self.rows) + len(points) > MOST_POINTS:
            raise TooManyPoints(
                f"the file has more than {MOST_POINTS} points, those of divided arcs and turns "
                "included; divide it into several files"
            )
        for point, direction in zip(points, directions, strict=True):
            begins = self._begins
            row = Row(tuple(point.tolist()), tuple(direction), self.line, feed, rapid, begins,
                      self.name)  # fmt: skip
            last = self.rows[-1] if self.rows else None
            if rapid and not begins and last and last.rapid and _same_place(row, last):
                continue  # the tool is there
            self._begins = False
            self.rows.append(row)

    def divide_arc(self, arc: Arc) -> tuple[Array, Array]:
        """The ends of an arc's chords, and their shares of its angle."""
        points = arc.points(self.options.arc_error)
        self._arcs += 1
        return points

    def _words(self, said: str, *, applied: bool) -> list[str]:
        """A note on words that move nothing, or that count for the motions behind them."""
        found = [(word, len(lines)) for word, lines in self._passed.items()
                 if bool(re.fullmatch(self.words.applied, word)) == applied]  # fmt: skip
        words = [word if count == 1 else f"{word} ({count})" for word, count in found]
        count = times(sum(count for _, count in found))
        return [f"{said} ({count}): {', '.join(words)}."] if words else []

    def _divided(self, sense: str) -> list[str]:
        """A note on the arcs, if there are any."""
        error = 1e3 * self.options.arc_error
        what = f"arcs ({times(self._arcs)}){sense}: chords within {error:g} mm of them (arc_error)."
        return [what] if self._arcs else []

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
        curves = self._curves()
        if not curves:
            self.problems.refuse()
            nothing = "there is no motion to a point with all coordinates in it."
            uncut = f"no two points without {self.words.rapid} between them; nothing is cut."
            raise InvalidInput(uncut if self.rows else nothing)
        orientation = self.options.orientation
        no_axis = "no tool axis is stated; (0, 0, 1) is taken, as on a machine of three axes."
        return toolpath_of(
            path,
            orientation or self.words.direction,
            curves,
            self.words.axis,
            self.problems,
            assumptions=[
                *self._unit_notes(),
                *([] if orientation or has_axis else [no_axis]),
                *self._rapid_notes(),
                *self._noted(left_out=False),
                *self._divided(sense),
                *self._words("words that change what follows are applied", applied=True),
                *assumptions,
            ],
            passed_over=[
                *self._words("passed over, since they move nothing", applied=False),
                *self._noted(left_out=True),
            ],
            unit=self.length_unit if self.rows else "m",
            unit_in_file=self.unit is not None,
        )

    def _curves(self) -> list[RowsOfCurve]:
        """The curves: points with no rapid motion between them.

        A point to which only rapid motion leads, and which only rapid motion leaves, belongs to no
        curve: it is in ``before`` of the next one, or in ``after`` of the last.
        """
        runs: list[list[Row]] = []
        for row in self.rows:
            if not runs or row.rapid or row.begins:
                runs.append([])
            runs[-1].append(row)
        found: list[RowsOfCurve] = []
        waiting: list[Row] = []
        for run in runs:
            if all(_same_place(row, run[0]) for row in run[1:]):
                waiting += run[:1] if not waiting or not _same_place(run[0], waiting[-1]) else []
            else:
                found.append(RowsOfCurve(run, waiting, []))
                waiting = []
        if found:
            found[-1].after.extend(waiting)
        return found

    def _unit_notes(self) -> Iterator[str]:
        """A note on a unit that nothing states."""
        if self._likely is not None and self.unit is None and self.options.length_unit is None:
            unit, why = self._likely
            other = "inch" if unit == "mm" else "mm"
            yield f"read as {unit}: {why}; {self.options.answer('length_unit', other)} reads it so."

    def _rapid_notes(self) -> Iterator[str]:
        """A note on rapid motions, if there are any."""
        if self._rapids:
            yield (
                f'{self.words.rapid} ({times(self._rapids)}): with rapids = "keep" in [path] the '
                "tool goes these ways at the speed of [feed]; otherwise [path.approach], "
                "[path.retreat] and [path.transfer] lead it from curve to curve."
            )


def _same_place(row: Row, other: Row) -> bool:
    """Whether the tool is where it is at another row."""
    return row.direction == other.direction and math.dist(row.position, other.position) < SAME_POINT


def times(count: int) -> str:
    """``once``, or for example ``3 times``."""
    return "once" if count == 1 else f"{count} times"


def of_lines(numbers: Sequence[int]) -> str:
    """Lines of a file for a message: the first one, and how many more there are."""
    more = f" and {len(numbers) - 1} more" if len(numbers) > 1 else ""
    return f"line {numbers[0]}{more}"


class UnitQuestion(NamedTuple):
    """Whether a file is in another unit, in words, and the options that say so.

    Attributes:
        text: For a message, without a full stop.
        likely: The unit in which it is small enough; ``None`` if there is none.
        options: Options of the toolpath; none if the unit is to be changed in the file.
    """

    text: str
    likely: LengthUnit | None
    options: dict[str, str | None]

    @classmethod
    def of(cls, unit: LengthUnit, size: float, most: float, *, unit_in_file: bool) -> UnitQuestion:
        """About a file of a size (m) above ``most`` (m)."""
        factors = {other: LENGTHS[other] / LENGTHS[unit] for other in LENGTHS}
        likely = next((u for u, f in factors.items() if f < 1.0 and f * size <= most), None)
        if likely is None:
            return cls("in no unit that is known would it be small enough", None, {})
        if unit_in_file:
            how = f"the file says {unit}, so write {likely} there"
            return cls(f"is the file in {likely}? {how}", likely, {})
        how = f'if it is, say length_unit = "{likely}"'
        return cls(f"is the file in {likely}? {how}", likely, {"length_unit": likely})


def _refuse_far(
    rows: Sequence[Row], problems: Problems, unit: LengthUnit, *, unit_in_file: bool
) -> None:
    """Report all points that are too far away as one problem: a wrong unit."""
    apart = np.abs([row.position for row in rows]).max(axis=1)
    far = np.flatnonzero(apart > LARGEST_COORDINATE)
    if len(far):
        more = f", and {len(far) - 1} points more are as far" if len(far) > 1 else ""
        question = UnitQuestion.of(
            unit, float(apart.max()), LARGEST_COORDINATE, unit_in_file=unit_in_file
        )
        problems.add(
            rows[far[0]].line,
            f"the point is {apart[far[0]]:.4g} m from the origin of its file, more than "
            f"{LARGEST_COORDINATE:g} m{more}; {question.text}",
            options=question.options,
        )


def _feeds(rows: Sequence[Row], problems: Problems) -> Array | None:
    """Feeds of the motions to the points, NaN for the first one of a curve."""
    feeds = np.array([row.feed for row in rows])
    feeds[0] = np.nan
    fast = np.flatnonzero(feeds > LARGEST_FEED)
    if len(fast):
        many = f" (and to {len(fast) - 1} points more)" if len(fast) > 1 else ""
        problems.add(
            rows[fast[0]].line,
            f"the feed to this point{many} is {feeds[fast[0]]:.4g} m/s, more than "
            f"{LARGEST_FEED:g} m/s; check its unit",
        )
    return feeds if np.isfinite(feeds).any() else None


def _curve(
    orientation: Orientation,
    rows: Sequence[Row],
    name: str,
    call: str,
    problems: Problems,
    feeds: Array | None = None,
) -> Curve:
    lines = np.array([row.line for row in rows], dtype=np.int64)
    vectors = rotations = None
    values = np.array([row.direction for row in rows], dtype=np.float64)
    if orientation == "rpy":
        rotations = Rotation.from_euler("xyz", values).as_matrix()
    elif orientation == "rotation_vector":
        rotations = Rotation.from_rotvec(values).as_matrix()
    elif orientation == "matrix":
        rotations = np.clip(values.reshape(-1, 3, 3), -2.0, 2.0)
        turned = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        wrong = (turned > 0.01) | (np.linalg.det(rotations) < 0.0)
        for k in np.flatnonzero(wrong):
            problems.add(lines[k], "the matrix is no rotation; check which columns it is in", call)
        rotations = np.where(wrong[:, None, None], np.eye(3), rotations)
        rotations = Rotation.from_matrix(rotations).as_matrix()
    elif orientation != "none":
        vectors = _unit_vectors(orientation, values, lines.tolist(), call, problems)
    if vectors is not None and orientation == "quaternion":
        rotations, vectors = Rotation.from_quat(vectors, scalar_first=True).as_matrix(), None
    positions = np.array([row.position for row in rows], dtype=np.float64)
    return Curve(name, positions, vectors, rotations, lines, feeds)


def _unit_vectors(
    orientation: Orientation, values: Array, lines: list[int], call: str, problems: Problems
) -> Array:
    """The directions, normalised; those of length zero are problems."""
    largest = np.abs(values).max(axis=1, keepdims=True)
    nothing = largest[:, 0] < 1e-12
    for k in np.flatnonzero(nothing):
        problems.add(lines[k], f"the {orientation} is zero and has no direction", call)
    units: Array = np.where(nothing[:, None], 1.0, values / np.where(nothing[:, None], 1, largest))
    lengths = np.linalg.norm(units, axis=1)
    units /= lengths[:, None]
    if orientation == "quaternion":
        lengths *= largest[:, 0]
        for k in np.flatnonzero((np.abs(lengths - 1.0) > 0.01) & ~nothing):
            problems.add(
                lines[k],
                f"the quaternion has the length {lengths[k]:.4g} instead of 1; check which columns "
                "it is in",
                call,
            )
    return units


def _repeats(curve: Curve) -> Mask:
    """Which points repeat the one before, (N,)."""
    same = np.linalg.norm(np.diff(curve.positions, axis=0), axis=1) < SAME_POINT
    if curve.vectors is not None:
        same &= angles_between(curve.vectors[:-1], curve.vectors[1:]) < SAME_DIRECTION
    if curve.rotations is not None:
        same &= turns_between(curve.rotations[:-1], curve.rotations[1:]) < SAME_DIRECTION
    return np.concatenate([[False], same])
