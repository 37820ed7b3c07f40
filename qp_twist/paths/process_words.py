"""Words of a toolpath that switch the process on and off, and where on the path they stand."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.errors import InvalidInput
from qp_twist.paths.toolpath import SAME_POINT, Curve, Lines, ProcessWord

PROCESS = re.compile(
    r"(?:SPINDL|COOLNT|M0*[345789](?![0-9])|SetDO|SetAO|SetGO|PulseDO|Set|Reset|[DARG]O\b|\$(?:AN)?OUT"
    r"|PULSE|set_(?:\w+_)?(?:digital|analog)_out)",
    re.IGNORECASE | re.ASCII,
)
"""How words begin that switch spindle, coolant or an output."""
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_LONGEST = 24
"""Characters of a procedure's name, KRL's: the shortest."""


def placed_words(
    words: Sequence[ProcessWord], pieces: Sequence[Curve]
) -> tuple[tuple[int, str], ...]:
    """The words with the waypoint, from 0, at which each stands, in the order of the file.

    A word stands where the motion before it ends: on a curve at that point, between curves at the
    last waypoint before the next curve and its approach, in front of all motions at the first
    waypoint. Curves that are taken in another order than the file has them have no words.

    Args:
        words: With positions in the frame of the waypoints.
        pieces: The parts of the path, one after the other.
    """
    lines = np.concatenate([piece.lines for piece in pieces])
    if (np.diff(lines) < 0).any():
        return ()
    positions = np.concatenate([piece.positions for piece in pieces])
    leads = np.concatenate([np.full(len(p), p.role in ("approach", "retreat")) for p in pieces])
    found, least = list[tuple[int, str]](), 0
    for word in words:
        here = np.flatnonzero(~leads & _ends_there(positions, lines, word))
        at = here[-1] if len(here) else np.searchsorted(lines, word.line, side="right") - 1
        least = max(int(at), least)
        found.append((least, word.text))
    return tuple(found)


def stood_at(curve: Curve, words: Sequence[ProcessWord]) -> Mask:
    """Which points of a curve (N,) have a word: they stay where others are left out."""
    stays = np.zeros(len(curve), dtype=bool)
    for word in words:
        stays |= _ends_there(curve.positions, curve.lines, word)
    return stays


def _ends_there(positions: Array, lines: Lines, word: ProcessWord) -> Mask:
    """At which points (N,) the motion before a word may end; a repeated one has an older line."""
    if not word.position:
        return np.zeros(len(lines), dtype=bool)
    apart = np.linalg.norm(positions - np.array(word.position), axis=1)
    return np.asarray((apart < SAME_POINT) & (lines <= word.after))


def check_calls(calls: Mapping[str, str]) -> None:
    """Refuse a mapping of words to procedures that a controller cannot call.

    Raises:
        InvalidInput: If a word is empty, or a name is not a letter, then letters, digits and _.
    """
    for word, name in calls.items():
        if not _parts(word) or not _NAME.fullmatch(name) or len(name) > _LONGEST:
            raise InvalidInput(
                f"program.calls: {word!r} = {name!r}; expected a word of the toolpath and the name "
                f"of a procedure: a letter, then letters, digits and _, at most {_LONGEST}.",
                key="program.calls",
            )


def call_of(text: str, calls: Mapping[str, str]) -> str | None:
    """The procedure of a word: that of the longest entry whose parts it has, in their order.

    ``SPINDL ON`` fits ``SPINDL/ON,RPM,3000``.
    """
    given = _parts(text)

    def fits(word: str) -> bool:
        left = iter(given)
        return given[:1] == _parts(word)[:1] and all(part in left for part in _parts(word))

    found = max(filter(fits, calls), key=len, default=None)
    return None if found is None else calls[found]


def _parts(text: str) -> list[str]:
    return [part for part in re.split(r"[\s/,=]+", text.upper()) if part]
