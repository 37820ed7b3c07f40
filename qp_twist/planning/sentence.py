"""Words about waypoints of a path that may be a part of another one."""

from __future__ import annotations


class Sentence(str):
    """Words about waypoints: its parts are words and, as numbers, waypoints counted from 1.

    The waypoints of a part of a path are then counted from the whole path's first one, too.
    """

    parts: tuple[str | int, ...]

    def __new__(cls, *parts: str | int) -> Sentence:
        """Join the parts."""
        found = super().__new__(cls, "".join(map(str, parts)))
        found.parts = tuple(part if isinstance(part, str) else int(part) for part in parts)
        return found

    def later(self, by: int) -> Sentence:
        """The same on a path with so many waypoints before."""
        return Sentence(*(part if isinstance(part, str) else part + by for part in self.parts))


UNSAID = Sentence()
"""No words."""
