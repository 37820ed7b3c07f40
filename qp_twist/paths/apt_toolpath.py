"""Toolpaths from APT-CL, the cutter location lines of CAM systems."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS, LengthUnit, Problems
from qp_twist.paths.assemble import RawCurve, assembled
from qp_twist.paths.toolpath import Toolpath
from qp_twist.paths.toolpath_columns import Orientation

_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
_COORDINATES = ("x", "y", "z", "i", "j", "k")

_TEXT = ("PARTNO", "PPRINT", "REMARK", "INSERT", "TPRINT", "MACHIN", "TITLES", "DISPLY", "PAINT")
"""Words followed by free text, or that concern only the operator or the machine."""

_IGNORED = frozenset({
    *_TEXT, "COOLNT", "LOAD", "SELCTL", "SELECT", "TOOLNO",
    "CUTTER", "TLDATA", "MSYS", "INTOL", "OUTTOL", "TOLER", "LINTOL", "MCHTOL",
    "MCHFIN", "AUXFUN", "PREFUN", "SEQNO", "OPSKIP", "LEADER", "DELAY", "DWELL", "STOP", "OPSTOP",
    "CLRSRF", "CLAMP", "HEAD", "MODE", "PROBE", "VERIFY", "TMARK", "CLDIST", "ARCSLP",
    "END-OF-PATH", "END", "FINI", "NOPOST", "CLPRNT", "PRINT", "AIR", "COUPLE",
})  # fmt: skip
"""Words that do not change the path between two points."""

_BREAKS = frozenset({"GOHOME", "HOME", "RETRCT", "RAPTO", "LOADTL", "UNLOAD", "TURRET"})
"""Words after which the tool is at an unknown point."""

_CHANGES = {
    "CIRCLE": "a circular move", "ARC": "a circular move", "MOVARC": "a circular move",
    "INDIRV": "a move along a surface", "INDIRP": "a move along a surface",
    "TLLFT": "a move along a surface", "TLRGT": "a move along a surface",
    "TLON": "a move along a surface", "GOFWD": "a move along a surface",
    "GOBACK": "a move along a surface", "GOLFT": "a move along a surface",
    "GORGT": "a move along a surface", "GOUP": "a move along a surface",
    "GODOWN": "a move along a surface", "GODLTA": "a move from where the tool is",
    "GOCLER": "a move to a plane", "CYCLE": "a drilling cycle", "SPLINE": "a curved move",
    "NURBS": "a curved move", "TRACUT": "a change of coordinates",
    "ORIGIN": "a change of coordinates", "TRANS": "a change of coordinates",
    "ROTATE": "a turn of the part", "ROTABL": "a turn of the part", "CUTCOM": "a shifted path",
    "COPY": "a repetition", "INDEX": "a repetition", "MIRROR": "a mirrored path",
    "THREAD": "a thread", "OFSTNO": "a shifted path", "SET": "an offset or a tool axis",
    "TLAXIS": "a tool axis of its own",
}  # fmt: skip
"""Words that change the path in a way that this reader does not support."""

_PER_MINUTE: dict[str, LengthUnit | None] = {
    "MMPM": "mm", "MMPMIN": "mm", "IPM": "inch", "INPM": "inch", "MPM": "m",
    "UPM": None, "PERMIN": None,
}  # fmt: skip
"""Units of a feed per minute; ``None``: the file's own unit of length."""
_PER_TURN: dict[str, LengthUnit | None] = {
    "MMPR": "mm", "IPR": "inch", "UPR": None, "PERREV": None,
}  # fmt: skip
"""Units of a feed per turn of the spindle."""


def read_apt(
    path: Path,
    lines: Sequence[str],
    orientation: Orientation | None,
    length_unit: LengthUnit | None,
) -> Toolpath:
    """The toolpath of an APT-CL file.

    The point after ``RAPID`` begins another curve. A point between two ``RAPID`` is left out, as is
    that of ``FROM``. A tool axis holds until the next one; before the first, and after
    ``MULTAX/OFF``, it is (0, 0, 1). A feed of ``FEDRAT`` holds until the next one, except for
    motions by ``RAPID``.

    Raises:
        InvalidInput: If a line is invalid, or changes the path in a way that is not supported.
    """
    if orientation not in (None, "axis", "none"):
        raise InvalidInput(
            f"orientation is {orientation!r}, but an APT file has tool axes; leave it "
            'out or say "axis" or "none".'
        )
    reader = _Reader(Problems(), length_unit)
    for line, text in _statements(lines):
        reader.statement(line, text)
    if reader.points == 0:
        reader.problems.refuse()
        raise InvalidInput("there is no GOTO in it.")
    notes = []
    if orientation is None and not reader.has_axis:
        notes.append("no GOTO states a tool axis; (0, 0, 1) is taken, as APT has it.")
    cuts = reader.cuts()
    if not cuts:
        reader.problems.refuse()
        raise InvalidInput("no two GOTO without RAPID between them; nothing is cut.")
    passed = reader.points - sum(len(rows.positions) for rows in cuts)
    if passed:
        notes.append(f"left out, since only RAPID leads there and on: {passed} of the points.")
    notes += reader.notes()
    return assembled(
        path,
        orientation or "axis",
        cuts,
        "i, j, k",
        notes,
        reader.problems,
        unit=reader.unit or length_unit or "m",
        unit_in_file=reader.unit is not None,
    )


def _statements(lines: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Statements with the line that each begins in; ``$`` continues one, ``$$`` ends the line."""
    begun, text = 0, ""
    for number, line in enumerate(lines, start=1):
        code = line.partition("$$")[0]
        begun = begun or number
        before, dollar, _ = code.partition("$")
        text += before
        if dollar:
            continue
        if text.strip():
            yield begun, text.strip()
        begun, text = 0, ""
    if text.strip():
        yield begun, text.strip()


@dataclass
class _Reader:
    """State of the reader while it processes the statements."""

    problems: Problems
    length_unit: LengthUnit | None
    unit: LengthUnit | None = None
    axis: tuple[float, ...] = (0.0, 0.0, 1.0)
    has_axis: bool = False
    feed: tuple[float, LengthUnit | None] = (math.nan, "m")  # per second; None: the file's unit
    turns_per_second: float | None = None
    rapid: bool = False
    rapids: int = 0
    points: int = 0
    name: str = ""
    curves: list[RawCurve] = field(default_factory=lambda: [RawCurve()])
    without_unit: list[int] = field(default_factory=list)
    seventh: list[int] = field(default_factory=list)

    def statement(self, line: int, text: str) -> None:
        """Process one statement."""
        word, _, rest = text.partition("/")
        word = word.strip().upper()
        first = re.split(r"[\s,]", word, maxsplit=1)[0]
        arguments = [argument.strip() for argument in rest.split(",")] if rest.strip() else []
        upper = [argument.upper() for argument in arguments]
        if word == "GOTO":
            self._goto(line, arguments)
        elif word == "FROM":
            self._numbers(line, "FROM", arguments)
            self._begin()
        elif word == "RAPID":
            self.rapid = True
        elif word in ("FEDRAT", "FEED"):
            self._fedrat(line, word, upper)
        elif word == "SPINDL":
            self._spindle(upper)
        elif word == "UNITS":
            self._units(line, upper)
        elif word == "MULTAX":
            if upper[:1] == ["OFF"]:
                self.axis = (0.0, 0.0, 1.0)
        elif word == "TOOL PATH":
            self._begin()
            self.name = arguments[0] if arguments else ""
        elif word in _CHANGES and not (word in ("CUTCOM", "CYCLE", "OFSTNO") and "OFF" in upper):
            self.problems.add(
                line,
                f"{word} is {_CHANGES[word]}, which is not read; write the path as GOTO lines (in "
                "the CAM system: linear output, no cycles)",
            )
        elif word in _BREAKS or first in _BREAKS:
            self._begin()
        elif word not in _IGNORED and word not in _CHANGES and not first.startswith(_TEXT):
            self.problems.add(
                line,
                f"{word[:40] or text[:40]!r} is not known, and whether it changes the path neither;"
                " take the line out if it does not",
            )

    def cuts(self) -> list[RawCurve]:
        """The curves with more than one point."""
        return [rows for rows in self.curves if len(rows.positions) > 1]

    def notes(self) -> list[str]:
        """Notes on what was assumed about feeds, and what was ignored."""
        found = []
        if self.rapids:
            found.append(
                f"RAPID ({_times(self.rapids)}): the tool gets there by [path.approach], "
                "[path.retreat] and [path.transfer], at the speed of [feed]."
            )
        if self.without_unit:
            found.append(
                f"FEDRAT without a unit ({_lines(self.without_unit)}) is read as {self._length()} "
                "per minute."
            )
        if self.seventh:
            found.append(
                f"a seventh number of GOTO ({_lines(self.seventh)}) is not used; a feed is stated "
                "by FEDRAT."
            )
        return found

    def _goto(self, line: int, arguments: Sequence[str]) -> None:
        numbers = self._numbers(line, "GOTO", arguments)
        if self.rapid:
            self._begin()
            self.rapids += 1
        scale = LENGTHS[self._unit(line)]
        rapid, self.rapid = self.rapid, False
        self.points += 1
        if numbers is None:
            return
        if len(numbers) == 6 and not any(numbers[3:]):
            # Report it once: the points for which it would hold keep the previous axis.
            self.problems.add(line, "the axis is zero and has no direction", "i, j, k")
        elif len(numbers) == 6:
            self.axis, self.has_axis = numbers[3:], True
        if len(arguments) == 7:
            self.seventh.append(line)
        rows = self.curves[-1]
        rows.name = rows.name or self.name
        rows.positions.append(tuple(scale * v for v in numbers[:3]))
        rows.directions.append(self.axis)
        rows.lines.append(line)
        feed, unit = self.feed
        rows.feeds.append(math.nan if rapid else feed * (LENGTHS[unit] if unit else scale))

    def _begin(self) -> None:
        """Begin another curve."""
        if self.curves[-1].positions:
            self.curves.append(RawCurve())

    def _numbers(self, line: int, word: str, arguments: Sequence[str]) -> tuple[float, ...] | None:
        """Coordinates, or ``None`` if they are invalid."""
        # A seventh number is a feed rate in some systems.
        if len(arguments) not in (3, 6, 7):
            self.problems.add(
                line, f"{word} takes x, y, z or x, y, z, i, j, k; got {len(arguments)} numbers"
            )
            return None
        found = [
            self._number(line, f"{word}, {name}", argument)
            for name, argument in zip(_COORDINATES, arguments, strict=False)
        ]
        return None if None in found else tuple(v for v in found if v is not None)

    def _number(self, line: int, place: str, argument: str) -> float | None:
        """A number, or ``None`` if it is not one."""
        compact = argument.replace(" ", "")
        if not _NUMBER.fullmatch(compact):
            what = f"expected a number, got {argument[:40]!r}" if argument else "it is missing"
            self.problems.add(line, f"{place}: {what}")
            return None
        value = float(compact.upper().replace("D", "E"))
        if not math.isfinite(value):
            self.problems.add(line, f"{place}: {argument[:40]!r} is too large")
            return None
        return value

    def _fedrat(self, line: int, word: str, arguments: Sequence[str]) -> None:
        """A feed: a number and its unit, in either order."""
        words = [argument for argument in arguments if argument[:1].isalpha()]
        numbers = [argument for argument in arguments if not argument[:1].isalpha()]
        known = {**_PER_MINUTE, **_PER_TURN}
        if len(numbers) != 1 or len(words) > 1 or not set(words) <= known.keys():
            self.problems.add(
                line,
                f"{word}/{','.join(arguments)[:40]}: expected a number and its unit, one of "
                f"{', '.join(known)}",
            )
            return
        value = self._number(line, word, numbers[0])
        if value is None:
            return
        if value <= 0.0:
            self.problems.add(line, f"{word}: expected a feed above 0, got {value:g}")
            return
        if not words:
            self.without_unit.append(line)
        unit = known[words[0]] if words else None
        if not words or words[0] in _PER_MINUTE:
            self.feed = (value / 60.0, unit)
        elif self.turns_per_second:
            self.feed = (value * self.turns_per_second, unit)
        else:
            self.problems.add(
                line,
                f"{word}: {words[0]} is a feed per turn of the spindle, and no SPINDL before it "
                "states turns per minute; write SPINDL/…,RPM above it, or the feed per minute",
            )

    def _spindle(self, arguments: Sequence[str]) -> None:
        """Read turns per second, if the statement has them."""
        numbers = [argument for argument in arguments if _NUMBER.fullmatch(argument)]
        if "OFF" in arguments or {"SFM", "SMM"} & set(arguments):
            self.turns_per_second = None  # a speed of the surface depends on the tool
        elif len(numbers) == 1:
            value = float(numbers[0].replace("D", "E"))
            self.turns_per_second = value / 60.0 if math.isfinite(value) else None

    def _units(self, line: int, arguments: Sequence[str]) -> None:
        names: dict[str, LengthUnit] = {
            "MM": "mm", "MMS": "mm", "INCHES": "inch", "INCH": "inch", "IN": "inch", "M": "m",
            "METERS": "m",
        }  # fmt: skip
        if len(arguments) != 1 or arguments[0] not in names:
            self.problems.add(line, f"UNITS/{','.join(arguments)[:40]}: expected MM or INCHES")
            # The unit of the points is then unknown; a missing unit would be the same problem.
            self.unit = self.unit or self.length_unit or "mm"
            return
        unit = names[arguments[0]]
        if self.length_unit not in (None, unit):
            self.problems.add(
                line,
                f"the file is in {unit}, length_unit of the task file says {self.length_unit}; "
                "correct one of them",
            )
        if self.points and unit != self.unit:
            self.problems.add(line, "UNITS changes after the first GOTO")
        self.unit = unit

    def _length(self) -> LengthUnit:
        return self.unit or self.length_unit or "mm"

    def _unit(self, line: int) -> LengthUnit:
        """The unit of length; if there is none, the first line that needs it is a problem."""
        if self.unit is None and self.length_unit is None:
            self.problems.add(
                line,
                'no UNITS/ before the first GOTO; add UNITS/MM above it, or length_unit = "mm" '
                'or "inch" to [path] of the task file',
            )
            self.unit = "mm"
        return self._length()


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _lines(numbers: Sequence[int]) -> str:
    """Lines of a file for a message: the first one, and how many more there are."""
    more = f" and {len(numbers) - 1} more" if len(numbers) > 1 else ""
    return f"line {numbers[0]}{more}"
