"""Data of KRL: variables with their types, and the points of the file beside a program."""

from __future__ import annotations

import re
from collections.abc import Sequence

from qp_twist.programs.program import Program

NAME = r"[A-Za-z]\w*"
_TYPES = r"INT|REAL|BOOL|CHAR|FRAME|POS|E6POS|AXIS|E6AXIS|FDAT|PDAT|LDAT|LOAD"
DECLARED = [
    rf"(?:GLOBAL\s+)?{word}(?P<kind>{kinds})\s+(?P<name>{NAME})(?P<part>(?:\s*\[[\d\s,]*\])?"
    rf"(?:\s*,\s*{NAME}(?:\s*\[[\d\s,]*\])?)*)\s*(?:=(?!=)(?P<value>.*))?"
    for word, kinds in ((r"DECL\s+(?:GLOBAL\s+)?(?:CONST\s+)?", NAME), ("", _TYPES))
]
ASSIGNMENT = rf"(?P<name>{NAME})(?P<part>(?:\s*\[[^\]]*\]|\s*\.\s*\w+)*)\s*=(?!=)(?P<value>.*)"


class KrlData(Program):
    """A program with its data."""

    def read_data(self, file: str, lines: Sequence[str]) -> None:
        """The points of the data file beside a program; another run may have changed its values."""
        for number, line in enumerate(lines, start=1):
            code = line.partition(";")[0].strip()
            for pattern in (*DECLARED, ASSIGNMENT):
                match = re.fullmatch(pattern, code, self.language.flags)
                if match and match["value"]:
                    name = self.values.key(match["name"])
                    self.listing.assigned.setdefault(name, []).append(f"{number} of {file}")
                    if "kind" in match.groupdict():
                        self._declare(match)
                        self.values.assign(number, match["name"], match["value"])
                        self.values.kept.add(self.values.key(match["name"]))
                    break

    def _declare(self, match: re.Match[str]) -> None:
        """Remember the type of variables."""
        names = re.sub(r"\[[^\]]*\]", "", f"{match['name']}{match['part']}")
        kinds = self.values.kinds
        assert kinds is not None
        kinds |= {self.values.base(name): match["kind"].lower() for name in names.split(",")}

    def assign(self, line: int, match: re.Match[str]) -> None:
        """An assignment or declaration; a name that nothing declares may be an output's."""
        if "kind" in match.groupdict():
            self._declare(match)
        elif self.moves.strict and self.values.base(match["name"]) not in (self.values.kinds or ()):
            self.moves.wait(line, "", 0.0)
        super().assign(line, match)
