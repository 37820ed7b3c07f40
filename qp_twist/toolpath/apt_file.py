"""Toolpaths from APT-CL, the cutter location lines of CAM systems."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

from qp_twist.errors import InvalidInput
from qp_twist.toolpath.assemble import Rows, assembled
from qp_twist.toolpath.columns import LENGTHS, LengthUnit, Orientation
from qp_twist.toolpath.toolpath import Toolpath

_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
_COORDINATES = ("x", "y", "z", "i", "j", "k")

_TEXT = ("PARTNO", "PPRINT", "REMARK", "INSERT", "TPRINT", "MACHIN", "TITLES", "DISPLY", "PAINT")
"""Words whose rest is free text, or speaks to a person or a machine only."""

_IGNORED = frozenset({
    *_TEXT, "FEDRAT", "FEED", "SPINDL", "COOLNT", "LOAD", "SELCTL", "SELECT", "TOOLNO",
    "CUTTER", "TLDATA", "MSYS", "INTOL", "OUTTOL", "TOLER", "LINTOL", "MCHTOL",
    "MCHFIN", "AUXFUN", "PREFUN", "SEQNO", "OPSKIP", "LEADER", "DELAY", "DWELL", "STOP", "OPSTOP",
    "CLRSRF", "CLAMP", "HEAD", "MODE", "PROBE", "VERIFY", "TMARK", "CLDIST", "ARCSLP",
    "END-OF-PATH", "END", "FINI", "NOPOST", "CLPRNT", "PRINT", "AIR", "COUPLE",
})  # fmt: skip
"""Words that do not move the tool off the line between two points."""

_BREAKS = frozenset({"GOHOME", "HOME", "RETRCT", "RAPTO", "LOADTL", "UNLOAD", "TURRET"})
"""Words after which the tool is elsewhere."""

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
"""Words that change the path in a way that is not read."""


def read_apt(
    path: Path,
    lines: Sequence[str],
    *,
    orientation: Orientation | None,
    length_unit: LengthUnit | None,
) -> Toolpath:
    """The toolpath of an APT-CL file.

    ``RAPID`` begins another curve with the point that it leads to, since what follows begins there.
    A point between two ``RAPID`` is left out, as is that of ``FROM``. A tool axis holds until
    another one is stated; before the first, and after ``MULTAX/OFF``, it is (0, 0, 1).

    Raises:
        InvalidInput: If a line is broken, or changes the path in a way that is not read.
    """
    if orientation not in (None, "axis", "none"):
        raise InvalidInput(
            f"{path.name}: orientation is {orientation!r}, but an APT file has tool axes; leave it "
            'out or say "axis" or "none".'
        )
    reader = _Reader(path.name, length_unit)
    for line, text in _statements(lines):
        reader.statement(line, text)
    if reader.points == 0:
        raise InvalidInput(f"{path.name}: there is no GOTO in it.")
    notes = []
    if orientation is None and not reader.axis_stated:
        notes.append("no GOTO states a tool axis; (0, 0, 1) is taken, as APT has it.")
    cuts = reader.cuts()
    if not cuts:
        raise InvalidInput(f"{path.name}: no two GOTO without RAPID between them; nothing is cut.")
    passed = reader.points - sum(len(rows.positions) for rows in cuts)
    if passed:
        notes.append(f"left out, since only RAPID leads there and on: {passed} of the points.")
    return assembled(path, orientation or "axis", cuts, "i, j, k", notes)


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
    """What is known while the statements go by."""

    file: str
    stated_unit: LengthUnit | None
    unit: LengthUnit | None = None
    axis: tuple[float, ...] = (0.0, 0.0, 1.0)
    axis_stated: bool = False
    rapid: bool = False
    points: int = 0
    name: str = ""
    curves: list[Rows] = field(default_factory=lambda: [Rows()])

    def statement(self, line: int, text: str) -> None:
        """Take one statement."""
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
        elif word == "UNITS":
            self._units(line, upper)
        elif word == "MULTAX":
            if upper[:1] == ["OFF"]:
                self.axis = (0.0, 0.0, 1.0)
        elif word == "TOOL PATH":
            self._begin()
            self.name = arguments[0] if arguments else ""
        elif word in _CHANGES and not (word in ("CUTCOM", "CYCLE", "OFSTNO") and "OFF" in upper):
            self._refuse(line, f"{word} is {_CHANGES[word]}, which is not read; write the path as "
                         "GOTO lines (in the CAM system: linear output, no cycles)")  # fmt: skip
        elif word in _BREAKS or first in _BREAKS:
            self._begin()
        elif word not in _IGNORED and word not in _CHANGES and not first.startswith(_TEXT):
            self._refuse(line, f"{word[:40] or text[:40]!r} is not known, and whether it changes "
                         "the path neither; take the line out if it does not")  # fmt: skip

    def cuts(self) -> list[Rows]:
        """The curves along which the tool moves, and not only to their first point."""
        return [rows for rows in self.curves if len(rows.positions) > 1]

    def _goto(self, line: int, arguments: Sequence[str]) -> None:
        numbers = self._numbers(line, "GOTO", arguments)
        if len(numbers) == 6:
            self.axis, self.axis_stated = numbers[3:], True
        unit = self._unit(line)
        if self.rapid:
            self._begin()
        rows = self.curves[-1]
        rows.name = rows.name or self.name
        rows.positions.append(tuple(LENGTHS[unit] * v for v in numbers[:3]))
        rows.directions.append(self.axis)
        rows.lines.append(line)
        self.points += 1
        self.rapid = False

    def _begin(self) -> None:
        """Another curve from here on."""
        if self.curves[-1].positions:
            self.curves.append(Rows())

    def _numbers(self, line: int, word: str, arguments: Sequence[str]) -> tuple[float, ...]:
        found = []
        for name, argument in zip(_COORDINATES, arguments, strict=False):
            compact = argument.replace(" ", "")
            if not _NUMBER.fullmatch(compact):
                what = f"expected a number, got {argument!r}" if argument else "it is missing"
                self._refuse(line, f"{word}, {name}: {what}")
            value = float(compact.upper().replace("D", "E"))
            if not math.isfinite(value):
                self._refuse(line, f"{word}, {name}: {argument!r} is too large")
            found.append(value)
        # A seventh number is a feed rate in some systems.
        if len(found) not in (3, 6) or len(arguments) > 7:
            self._refuse(
                line, f"{word} takes x, y, z or x, y, z, i, j, k; got {len(arguments)} numbers"
            )
        return tuple(found)

    def _units(self, line: int, arguments: Sequence[str]) -> None:
        names: dict[str, LengthUnit] = {
            "MM": "mm", "MMS": "mm", "INCHES": "inch", "INCH": "inch", "IN": "inch", "M": "m",
            "METERS": "m",
        }  # fmt: skip
        if len(arguments) != 1 or arguments[0] not in names:
            self._refuse(line, f"UNITS/{','.join(arguments)}: expected MM or INCHES")
        unit = names[arguments[0]]
        if self.stated_unit not in (None, unit):
            self._refuse(
                line,
                f"the file is in {unit}, length_unit of the task file says {self.stated_unit}; "
                "correct one of them",
            )
        if self.points and unit != self.unit:
            self._refuse(line, "UNITS changes after the first GOTO")
        self.unit = unit

    def _unit(self, line: int) -> LengthUnit:
        unit = self.unit or self.stated_unit
        if unit is None:
            self._refuse(
                line,
                'no UNITS/ before the first GOTO; add UNITS/MM above it, or length_unit = "mm" '
                'or "inch" to [path] of the task file',
            )
        return unit

    def _refuse(self, line: int, what: str) -> NoReturn:
        raise InvalidInput(f"{self.file}, line {line}: {what}.")
