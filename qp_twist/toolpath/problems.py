"""What is wrong with a toolpath file, collected so that one reading says all of it."""

from __future__ import annotations

from qp_twist.errors import InvalidInput

SHOWN = 20
"""Problems that are listed one by one; the others are counted."""


class Problems:
    """Problems of a file, in the order of its lines.

    Attributes:
        file: Name of the file, for messages.
    """

    def __init__(self, file: str) -> None:
        self.file = file
        self._found: list[tuple[int, str]] = []

    def __len__(self) -> int:
        return len(self._found)

    def add(self, line: int, what: str, place: str = "") -> None:
        """Note a problem.

        Args:
            line: Of the file, from 1.
            what: What was read and what was expected, without a full stop.
            place: Column or word in the line, if there is one to name.
        """
        self._found.append((line, f"line {line}{place and f', {place}'}: {what}."))

    def refuse(self) -> None:
        """Raise if there is a problem.

        Raises:
            InvalidInput: With every problem, or the first :data:`SHOWN` and the number of others.
        """
        if not self._found:
            return
        sentences = [sentence for _, sentence in sorted(self._found, key=lambda item: item[0])]
        if len(sentences) == 1:
            raise InvalidInput(f"{self.file}, {sentences[0]}")
        lines = [f"{self.file}: {len(sentences)} problems:", *sentences[:SHOWN]]
        if len(sentences) > SHOWN:
            lines.append(f"and {len(sentences) - SHOWN} more.")
        raise InvalidInput("\n  ".join(lines))
