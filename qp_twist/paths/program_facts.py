"""What a whole program of a machine tool says about its numbers, before it is read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qp_twist.files import LENGTHS, LengthUnit
from qp_twist.paths.program_values import NUMBER
from qp_twist.paths.toolpath_builder import in_inches
from qp_twist.paths.toolpath_points import LONGEST_REACH

COMMENT = re.compile(r"\([^)\n]*\)?|;[^\n]*|\"[^\"\n]*\"")
_NO_MOTION = re.compile(
    r"^[^\n]*(?<![A-Z])(?:M(?:73|8[2-7]|92|[1-9][0-9]{2,3})|G0*(?:4|10|28|30|52|53|92))(?![0-9])"
    r"[^\n]*|^[^\n]*SUPA[^\n]*|^[^\n]*=\s*[\[#][^\n]*", re.MULTILINE,
)  # fmt: skip
_PACKED = re.compile(r"(?<![A-Z0-9_#<.])(?:[A-Z]=?[-+]?[0-9.]+){2,}(?![A-Z_=#\[])")
"""Words without blanks between them."""
_COORDINATE = re.compile(rf"(?<![A-Z0-9_#<])([ABCEIJKRXYZ])\s*=?\s*({NUMBER})")
_POINTLESS = re.compile(r"(?<![A-Z0-9_#<])[XYZIJK]\s*=?\s*[+-]?0*[1-9][0-9]*(?![0-9.])")
_TIP = re.compile(r"(?<![A-Z])(?:G43\.[45]|G234|TRAORI|M428)(?![0-9])")
_TRUNNION = re.compile(r"XYZ[AB]C\b|(?<![A-Z])M428(?![0-9])")
_EXTRUDES = re.compile(rf"^[^\n]*G0*[123](?![0-9.])[^\n]*(?<![A-Z])E\s*{NUMBER}", re.MULTILINE)
_INCH = re.compile(r"\bINCH(?:ES)?\b|\bIMPERIAL\b|\bIN/MIN\b")
_METRIC = re.compile(r"\bMM\b|\bMILLIM|\bMETRIC\b")
_INCHES = re.compile(r"(?<![A-Z])G(?:20|70|700)(?![0-9.])")
_MILLIMETRES = re.compile(r"(?<![A-Z])G(?:21|71|710)(?![0-9.])")
_MANY_TIMES = 30.0
"""Numbers without a decimal point this much larger than those with one count thousandths."""


@dataclass(frozen=True)
class Facts:
    """Facts of a program.

    Attributes:
        stated: Letters of coordinates that occur.
        rotary: Letters of rotary axes that are not 0 throughout.
        extrudes: Whether cuts have E, a 3-D printer's filament.
        tip: Whether the program switches control of the tool's tip on.
        trunnion: Whether it names LinuxCNC's table xyzac or xyzbc, or its switch M428.
        pointless: The first X, Y, Z, I, J, K without a decimal point, and its line; if any.
        points: Whether ``none`` of these has one, ``some`` have, or those without are ``larger`` as
            if they counted thousandths.
        unit: The unit that is likely if the program states none, and why; ``None`` if it is open.
    """

    stated: frozenset[str]
    rotary: str
    extrudes: bool
    tip: bool
    trunnion: bool
    pointless: tuple[str, int] | None
    points: str
    unit: tuple[LengthUnit, str] | None

    @classmethod
    def of(cls, lines: Sequence[str]) -> Facts:
        """Facts of the lines of a program."""
        text = "\n".join(lines).upper()
        plain = COMMENT.sub("", text)
        code = _PACKED.sub(
            lambda found: re.sub("(?<=[0-9.])(?=[A-Z])", " ", found[0]), _NO_MOTION.sub("", plain)
        )
        found: dict[str, list[str]] = {}
        for letter, number in _COORDINATE.findall(code):
            found.setdefault(letter, []).append(number)
        numbers = {k: np.array(v, dtype=np.float64) for k, v in found.items()}
        extent = max((float(np.ptp(numbers[k])) for k in "XYZ" if k in numbers), default=0.0)
        extrudes = _EXTRUDES.search(text) is not None
        points = "" if extrudes else _points(found, code, extent)
        pointless = _POINTLESS.search(code)
        return cls(
            frozenset(found), "".join(k for k in "ABC" if k in numbers and numbers[k].any()),
            extrudes, _TIP.search(plain) is not None, _TRUNNION.search(text) is not None,
            pointless and (pointless[0], code.count("\n", 0, pointless.start()) + 1), points,
            _unit(text, plain, extent * (1e-3 if points == "none" else 1.0), extrudes=extrudes),
        )  # fmt: skip

    @property
    def lathe(self) -> bool:
        """Whether it moves in X and Z alone."""
        return {"X", "Z"} <= self.stated and "Y" not in self.stated


def _points(found: dict[str, list[str]], code: str, extent: float) -> str:
    """How decimal points are used; empty where nothing is to be said of it."""
    written = [number for letter in "XYZIJK" for number in found.get(letter, ())]
    whole = max((abs(float(number)) for number in written if "." not in number), default=0.0)
    pointed = max((abs(float(number)) for number in written if "." in number), default=0.0)
    if not pointed:
        return "none" if extent * LENGTHS["mm"] > 2.0 * LONGEST_REACH else ""
    if re.search(r"[XYZ][-+ ]*[0-9]*\.[0-9]{5}", code) is not None:
        return ""  # finer than a control that counts thousandths takes
    return "larger" if whole >= 1000.0 and whole > _MANY_TIMES * pointed else "some"


def _unit(text: str, plain: str, extent: float, *, extrudes: bool) -> tuple[LengthUnit, str] | None:
    """The likely unit of a program of an extent, in that unit."""
    inches, metres = (pattern.search(plain) is not None for pattern in (_INCHES, _MILLIMETRES))
    if inches != metres:
        return "inch" if inches else "mm", "a word after the first motion says so"
    inch, metric = (pattern.search(text) is not None for pattern in (_INCH, _METRIC))
    if inch and not metric:
        return "inch", "its comments say so, and no G20 or G21 does"
    if extrudes:
        return "mm", "nothing states it, and 3-D printers count in mm"
    if (inch and metric) or extent * LENGTHS["mm"] > 2.0 * LONGEST_REACH:
        return None
    return "mm", f"nothing states it; {in_inches(extent)}" if extent else "nothing states it"
