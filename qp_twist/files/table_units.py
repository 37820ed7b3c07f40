"""Units in headers, and their size in SI units."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Mapping, Sequence
from typing import Any, Literal

LengthUnit = Literal["mm", "m", "inch"]
AngleUnit = Literal["deg", "rad"]
FeedUnit = Literal["mm/min", "mm/s", "m/min", "m/s", "inch/min"]

LENGTHS: dict[LengthUnit, float] = {"mm": 1e-3, "m": 1.0, "inch": 0.0254}
"""Metres in a unit."""
ANGLES: dict[AngleUnit, float] = {"deg": math.radians(1.0), "rad": 1.0}
"""Radians in a unit."""
FEEDS: dict[FeedUnit, float] = {
    "mm/min": 1e-3 / 60.0, "mm/s": 1e-3, "m/min": 1.0 / 60.0, "m/s": 1.0,
    "inch/min": 0.0254 / 60.0,
}  # fmt: skip
"""Metres per second in a unit."""
TIMES = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "ns": 1e-9}
"""Seconds in a unit."""

_SPELLINGS = {
    "m": "m meter meters metre metres", "inch": "in inch inches",
    "mm": "mm millimeter millimeters millimetre millimetres",
    "deg": "deg degs degree degrees °", "rad": "rad rads radian radians",
    "s": "s sec second seconds", "ms": "ms", "µs": "us µs μs", "ns": "ns",
    "cm": "cm", "µm": "um µm μm", "ft": "ft feet", "grad": "grad",
}  # fmt: skip
_UNITS = {word: unit for unit, words in _SPELLINGS.items() for word in words.split()}
"""Units that are in none of the tables above; these are refused by name."""
_RATES = {"mmpm": "mm/min", "ipm": "inch/min"}
_PER = {"s": "s", "sec": "s", "s²": "s²", "s^2": "s²", "s2": "s²", "s**2": "s²", "min": "min"}
_SECONDS = {"": 1.0, "s": 1.0, "s²": 1.0, "min": 60.0}

_BRACKETS = re.compile(r"(.*?)(?:\s+|_?)[\[({]\s*([^\[\](){}]*?)\s*[\])}]\s*")
_ENDING = re.compile(
    rf"(.*?)\s*[\s_./-]\s*((?:{'|'.join(_UNITS)})(?:/(?:sec|s|min)|(?:_per_|_| per )s)?|mmpm|ipm)",
    re.IGNORECASE,
)
ENDINGS = frozenset(_UNITS.values()) - TIMES.keys() | FEEDS.keys()


def split_unit(name: str, endings: Container[str] = ENDINGS) -> tuple[str, str | None]:
    """A column's name, and the unit after it: ``x [mm]``, ``x_mm``, ``x/mm``; ``None`` without one.

    Units are spelled as in the tables of this module, or as in the header if they are not known;
    without brackets only those among ``endings`` count. ``nx [-]`` has no unit.
    """
    bracket = _BRACKETS.fullmatch(name)
    if bracket and bracket[1]:
        return bracket[1], _unit(bracket[2])
    ending = _ENDING.fullmatch(name.strip())
    if ending and ending[1]:
        unit = _unit(re.sub(r"[_ ](?:per[_ ])?s$", "/s", ending[2].lower()))
        if unit in endings:
            return ending[1], unit
    return name.strip(), None


def _unit(written: str) -> str | None:
    text = written.strip().lower()
    above, _, below = (part.strip() for part in text.partition("/"))
    if below in _PER:
        return f"{_UNITS.get(above, above)}/{_PER[below]}"
    return _UNITS.get(text) or _RATES.get(text) or (text if text.isalpha() else None)


def factor(unit: str, *tables: Mapping[Any, float]) -> float | None:
    """Size in SI units of a unit of the tables, or of one per time; ``None`` for others."""
    above, _, below = unit.partition("/")
    return next((table[above] / _SECONDS[below] for table in tables if above in table), None)


def is_unit_row(fields: Sequence[str], width: int) -> bool:
    """Whether a line below the header contains the columns' units, in brackets or not."""
    bare = [field.strip("[](){} ").lower() for field in fields]
    return (
        len(fields) <= width
        and any(bare)
        and all(
            field in ("", "-", "1") or field in _RATES or field.partition("/")[0].strip() in _UNITS
            for field in bare
        )
    )
