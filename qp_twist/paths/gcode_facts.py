"""What a whole G-code program says about how its numbers are meant, before it is read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from qp_twist.files import LENGTHS, LengthUnit
from qp_twist.paths.gcode_words import NUMBER
from qp_twist.paths.toolpath_points import LONGEST_REACH

_COMMENT = re.compile(r"\([^)\n]*\)?|;[^\n]*|\"[^\"\n]*\"")
_NO_MOTION = re.compile(
    r"^[^\n]*(?<![A-Z])(?:M(?:73|8[2-7]|92|[1-9][0-9]{2,3})|G0*(?:4|10|28|30|52|53|92))(?![0-9])"
    r"[^\n]*|^[^\n]*SUPA[^\n]*|^[^\n]*=\s*[\[#][^\n]*", re.MULTILINE,
)  # fmt: skip
_COORDINATE = re.compile(rf"(?<![A-Z0-9_#<])([ABCEIJKRXYZ])\s*=?\s*({NUMBER})")
_TIP = re.compile(r"(?<![A-Z])(?:G43\.[45]|G234|TRAORI|M428)(?![0-9])")
_TRUNNION = re.compile(r"XYZ[AB]C\b|(?<![A-Z])M428(?![0-9])")
_EXTRUDES = re.compile(rf"^[^\n]*G0*[123](?![0-9.])[^\n]*(?<![A-Z])E\s*{NUMBER}", re.MULTILINE)
_INCH = re.compile(r"\bINCH(?:ES)?\b|\bIMPERIAL\b|\bIN/MIN\b")
_INCHES = re.compile(r"(?<![A-Z])G(?:20|70|700)(?![0-9.])")
_MILLIMETRES = re.compile(r"(?<![A-Z])G(?:21|71|710)(?![0-9.])")
_METRIC = re.compile(r"\bMM\b|\bMILLIM|\bMETRIC\b")
_GCODE = re.compile(rf"[%/:]|(?:[/N][0-9]*\s*)?(?:[A-Z]\s*=?\s*{NUMBER}\s*)+$|[(;]|$")
_CUT = re.compile(rf"(?<![A-Z])G0*[0-3](?![0-9.]).*[XYZ]\s*=?\s*{NUMBER}", re.IGNORECASE)
MANY_TIMES = 30.0
"""Numbers without a decimal point this much larger than those with one count thousandths."""


@dataclass(frozen=True)
class Facts:
    """Facts of a program.

    Attributes:
        extent: The largest difference of X, Y or Z words, in the unit of the file.
        stated: Letters of coordinates that occur.
        rotary: Letters of rotary axes that are not 0 throughout.
        whole: The largest number of X, Y, Z, I, J, K without a decimal point.
        pointed: The same of those with one.
        fine: Whether a number has more digits than a control that counts thousandths takes.
        extrudes: Whether cuts have E, a 3-D printer's filament.
        tip: Whether the program switches control of the tool's tip on.
        trunnion: Whether it names LinuxCNC's table xyzac or xyzbc, or its switch M428.
        later: The unit that a word names, perhaps after the first motion; ``None`` if none or both.
        unit: The unit that comments name; ``None`` if they name none or both.
        units: Whether comments name both.
    """

    extent: float
    stated: frozenset[str]
    rotary: str
    whole: float
    pointed: float
    fine: bool
    extrudes: bool
    tip: bool
    trunnion: bool
    later: LengthUnit | None
    unit: LengthUnit | None
    units: bool

    @classmethod
    def of(cls, lines: Sequence[str]) -> Facts:
        """Facts of the lines of a program."""
        text = "\n".join(lines).upper()
        plain = _COMMENT.sub("", text)
        code = _NO_MOTION.sub("", plain)
        inch, metric = _INCH.search(text) is not None, _METRIC.search(text) is not None
        found: dict[str, list[str]] = {}
        for letter, number in _COORDINATE.findall(code):
            found.setdefault(letter, []).append(number)
        numbers = {k: np.array(v, dtype=np.float64) for k, v in found.items()}
        kinds = {True: 0.0, False: 0.0}
        for letter in "XYZIJK":
            for number in found.get(letter, ()):
                point = "." in number
                kinds[point] = max(kinds[point], abs(float(number)))
        return cls(
            max((float(np.ptp(numbers[k])) for k in "XYZ" if k in numbers), default=0.0),
            frozenset(found),
            "".join(k for k in "ABC" if k in numbers and numbers[k].any()),
            kinds[False],
            kinds[True],
            re.search(r"[XYZ][-+ ]*[0-9]*\.[0-9]{5}", code) is not None,
            _EXTRUDES.search(text) is not None,
            _TIP.search(plain) is not None,
            _TRUNNION.search(text) is not None,
            _either(_INCHES.search(plain) is not None, _MILLIMETRES.search(plain) is not None),
            _either(inch, metric),
            inch and metric,
        )

    @property
    def lathe(self) -> bool:
        """Whether it moves in X and Z alone."""
        return {"X", "Z"} <= self.stated and "Y" not in self.stated

    @property
    def unlike(self) -> bool:
        """Whether numbers without a decimal point seem to count thousandths, others do not."""
        large = self.whole >= 1000.0 and self.whole > MANY_TIMES * self.pointed > 0.0
        return large and not self.fine

    @cached_property
    def in_thousandths(self) -> bool:
        """Whether no number has a decimal point, and as mm they would leave any arm's reach."""
        return (
            not self.pointed
            and not self.extrudes
            and self.extent * LENGTHS["mm"] > 2.0 * LONGEST_REACH
        )

    def likely_unit(self) -> tuple[LengthUnit, str] | None:
        """The unit that is assumed, if the program states none, and why; ``None`` if it is open."""
        if self.later is not None:
            return self.later, "a word after the first motion says so"
        if self.unit == "inch":
            return "inch", "its comments say so, and no G20 or G21 does"
        if self.extrudes:
            return "mm", "nothing states it, and 3-D printers count in mm"
        extent = self.extent * (1e-3 if self.in_thousandths else 1.0)
        if self.units or extent * LENGTHS["mm"] > 2.0 * LONGEST_REACH:
            return None
        inches = extent * LENGTHS["inch"]
        return "mm", f"nothing states it; as inches it would be {inches:.3g} m long"


def _either(inch: bool, metric: bool) -> LengthUnit | None:
    return None if inch == metric else "inch" if inch else "mm"


def is_gcode(lines: Sequence[str]) -> bool:
    """Whether lines are evidently blocks of G-code: nearly all of them, and a motion."""
    head = [_COMMENT.sub("", line).strip().upper() for line in lines[:400]]
    text = [line for line in head if line]
    fits = sum(_GCODE.match(line) is not None for line in text)
    return fits > 0.8 * len(text) and any(map(_CUT.search, text))
