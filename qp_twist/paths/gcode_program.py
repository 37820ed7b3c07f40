"""Branches, loops, subprograms and variables of a G-code program."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import cached_property

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.program_course import Course
from qp_twist.paths.program_values import FUNCTIONS

_WORDS = (
    "SUB|ENDSUB|CALL|RETURN|IF|ELSEIF|ELSE|ENDIF|WHILE|ENDWHILE|DO|REPEAT|ENDREPEAT|BREAK|CONTINUE"
)
_O_WORD = re.compile(rf"O\s*(<[^<>]*>|[0-9]+)\s*({_WORDS})\b(.*)")
"""LinuxCNC's branches, *O Codes*."""
_WHILE = re.compile(r"(WHILE|DO|END)\s*(\[.*\])?\s*(?:DO)?\s*([0-9]+)\s*$")
_IF = re.compile(r"IF\s*(\[.*\])\s*(?:THEN\s*(.+)|GOTO\s*([0-9]+))$|GOTO\s*([0-9]+)$")
_CALL = re.compile(r"(M98|M97|G65)(?![0-9.]).*")
"""FANUC's branches and calls, *Custom Macro*; M97 of Haas calls a block of the same program."""
_NUMBER = re.compile(r"\s*N\s*0*([0-9]+)", re.IGNORECASE)
_PROGRAM = re.compile(r"\s*[O:]\s*0*([0-9]+)(?!\s*(?:SUB|CALL|IF|WHILE|REPEAT|DO)\b)", re.I)
_SIMPLE = re.compile(
    r"[#\[]|^\s*(?:N[0-9]+\s*)?(?:O|IF|WHILE|GOTO|DO|END)|M9[789]|G65"
    r"|(?<![A-Z0-9_])R[0-9]+\s*=|=[^;\"]*(?<![A-Z0-9_])R[0-9]"
    r"|=\s*[-+]?\s*(?:[0-9.]+\s*(?:[-+*/]|DIV|MOD)|[A-Z0-9]*\()", re.IGNORECASE,
)  # fmt: skip
"""What a line has that needs more than to be read where it stands."""
_ARGUMENTS = "ABCIJKDEF H M   QRSTUVWXYZ"
"""FANUC: the variable #n of a macro has the n-th letter as its argument."""
_COMMENT = re.compile(
    rf"(?<![-+*/=(])(?<!AC|IC|DC){''.join(f'(?<!{name})' for name in FUNCTIONS)}"
    r"\((?:[^()]|\([^()]*\))*\)|;.*",
    re.IGNORECASE,
)
"""A comment; brackets behind an operator or a function are those of a formula of SINUMERIK."""
_OPENS = ("SUB", "IF", "WHILE", "DO", "REPEAT")
_CLOSES = ("ENDSUB", "ENDIF", "ENDWHILE", "ENDREPEAT")


class Program:
    """The blocks of a program: each may set variables, and where the program goes on.

    Attributes:
        course: Where it goes on.
    """

    def __init__(self, lines: Sequence[str]) -> None:
        self.course = Course()
        self._lines = lines
        self._codes = {at: _code(line) for at, line in enumerate(lines) if _SIMPLE.search(line)}
        self._words: dict[int, tuple[str, str, str]] = {}
        self._groups: dict[int, list[int]] = {}
        self._open: dict[str, list[int]] = {}
        self._subprograms: dict[str, int] = {}
        for at, code in self._codes.items():
            self._pair(at, code)

    def plain(self, at: int) -> bool:
        """Whether a line has no variables, branches or calls."""
        return at not in self._codes

    def block(self, at: int) -> str:
        """The block of a line without variables; empty if it is a branch, a loop or a call."""
        if at not in self._codes:
            return self._lines[at]
        try:
            return self._resolved(at, self._codes[at])
        except InvalidInput:
            self.course.next = -1
            raise

    def _resolved(self, at: int, code: str) -> str:
        values = self.course.variables
        label, word, rest = self._words.get(at, ("", "", ""))
        if word in ("ENDSUB", "RETURN") or re.search(r"M99(?![0-9])", code):
            return "" if self.course.back() else "M30"
        if word:
            self._branch(at, label, word, rest)
            return ""
        if (jump := _IF.fullmatch(code)) is not None:
            condition, then, *targets = jump.groups()
            if condition and not values.value(condition):
                return ""
            if then is not None:
                return values.resolved(then)
            number = int(next(filter(None, targets)))
            self.course.next = self._found(self._numbers, number, "GOTO")
            return ""
        if (call := _CALL.search(code)) is not None:
            self._call(call[1], values.resolved(call[0]))
            return ""
        return values.resolved(code)

    # ------------------------------------------------------------ branches and loops

    def _pair(self, at: int, code: str) -> None:
        """Add a branch or a loop to the words that belong together: FANUC's are LinuxCNC's."""
        if (found := _O_WORD.fullmatch(code)) is not None:
            label, word, rest = found[1], found[2], found[3]
        elif (found := _WHILE.fullmatch(code)) is not None:
            label, rest = f"DO{found[3]}", found[2] or "[1]"
            word = "ENDWHILE" if found[1] == "END" else "WHILE"
        elif re.match(rf"O.*\b(?:{_WORDS})\b", code):
            raise InvalidInput(f"{shortened(code)!r} is no branch or loop", line=at + 1)
        else:
            return
        self._words[at] = label, word, rest
        if word == "SUB":
            self._subprograms.setdefault(label, at)
        if word in ("CALL", "RETURN"):
            return
        open_ = self._open.get(label)
        begins = open_ is None or (word in _OPENS and self._words[open_[0]][1] != "DO")
        group = [] if open_ is None or begins else open_
        group.append(at)
        self._groups[at] = self._open[label] = group
        if word in _CLOSES or (word == "WHILE" and len(group) > 1):
            del self._open[label]

    def _end(self, at: int) -> int:
        """Where the branch or loop of a line ends."""
        end = self._groups[at][-1]
        if end == self._groups[at][0] or self._words[end][1] not in (*_CLOSES, "WHILE"):
            raise InvalidInput(f"{self._words[at][0]} has no end")
        return end

    def _branch(self, at: int, label: str, word: str, rest: str) -> None:
        """Go on behind a branch or the word of a loop."""
        course, value = self.course, self.course.variables.value
        match word:
            case "CALL":
                if label not in self._subprograms:
                    raise InvalidInput(
                        f"O{label.lower()} calls a subprogram that is not in this file; what it "
                        "moves is not known"
                    )
                values = dict.fromkeys((f"#{k}" for k in range(1, 31)), 0.0)
                values |= {f"#{k}": v for k, v in enumerate(course.variables.brackets(rest), 1)}
                course.call(self._subprograms[label] + 1, local=values)
            case "IF":
                while word in ("IF", "ELSEIF") and not value(rest):
                    self._end(at)  # there is one
                    at = next(k for k in self._groups[at] if k > at)
                    word, rest = self._words[at][1:]
                course.next = at + 1
            case "SUB" | "ELSEIF" | "ELSE":  # behind a branch that was run
                course.next = self._end(at) + 1
            case "WHILE" if self._groups[at][0] != at:  # do … while
                course.next = self._groups[at][0] + 1 if value(rest) else at + 1
            case "WHILE" | "REPEAT":
                end = self._end(at)
                more = value(rest) if word == "WHILE" else course.counted(at, round(value(rest)))
                course.next = at + 1 if more else end + 1
            case "ENDWHILE" | "ENDREPEAT":
                course.next = self._groups[at][0]
            case "BREAK":
                course.forget(self._groups[at][0])
                course.next = self._end(at) + 1
            case "CONTINUE":
                course.next = self._end(at)

    # ------------------------------------------------------------ subprograms

    @cached_property
    def _numbers(self) -> dict[int, int]:
        """Where each block N is."""
        return dict(self._found_all(_NUMBER))

    @cached_property
    def _programs(self) -> dict[int, int]:
        """Where each program O is."""
        return dict(self._found_all(_PROGRAM))

    def _found_all(self, pattern: re.Pattern[str]) -> Iterator[tuple[int, int]]:
        for at in reversed(range(len(self._lines))):
            if (found := pattern.match(self._lines[at])) is not None:
                yield int(found[1]), at

    def _found(self, places: dict[int, int], number: int, what: str) -> int:
        if number not in places:
            raise InvalidInput(
                f"{what} {number} is not in this file, and what it moves is not known; have the "
                "CAM system write one program"
            )
        return places[number]

    def _call(self, word: str, text: str) -> None:
        """M98, M97 or G65."""
        words = dict(re.findall(r"([A-Z])\s*([+-]?[0-9]*\.?[0-9]+)", text))
        if "P" not in words:
            raise InvalidInput(f"{shortened(text)!r} calls a program without P")
        number, times = words["P"].partition(".")[0] or "0", float(words.get("L", 1))
        if word == "M98" and "L" not in words and len(number) > 4:
            # FANUC: P0031000 calls program 1000 three times.
            number, times = number[-4:], float(number[:-4])
        if word == "M97":
            begin = self._found(self._numbers, int(number), "M97: block N")
        else:
            begin = 1 + self._found(self._programs, int(number), f"{word}: program O")
        given = {f"#{_ARGUMENTS.index(k) + 1}": float(v) for k, v in words.items()
                 if k in _ARGUMENTS and k not in "GPL"}  # fmt: skip
        self.course.call(begin, times, given if word == "G65" else None)


def _code(line: str) -> str:
    """A line without comments and its number, in capitals."""
    text = _COMMENT.sub("", line).upper().strip()
    number = _NUMBER.match(text)
    return text[number.end() :].strip() if number else text
