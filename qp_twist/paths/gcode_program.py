"""Blocks of a G-code program in the order in which they run: branches, loops, subprograms."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.gcode_expressions import LOCALS, Variables

MOST_BLOCKS = 100_000
"""Of blocks that run; beyond it, a loop does not end."""
_DEEPEST = 50
"""Of calls within calls."""
_O_WORD = re.compile(
    r"O\s*(<[^<>]*>|[0-9]+)\s*(SUB|ENDSUB|CALL|RETURN|IF|ELSEIF|ELSE|ENDIF|WHILE|ENDWHILE|DO|"
    r"REPEAT|ENDREPEAT|BREAK|CONTINUE)\b(.*)"
)
"""LinuxCNC's branches, *O Codes*."""
_WHILE = re.compile(r"(WHILE|DO|END)\s*(\[.*\])?\s*(?:DO)?\s*([0-9]+)\s*$")
_IF = re.compile(r"IF\s*(\[.*\])\s*(?:THEN\s*(.+)|GOTO\s*([0-9]+))$|GOTO\s*([0-9]+)$")
_CALL = re.compile(r"(?:M98|M97|G65)(?![0-9.]).*")
"""FANUC's branches and calls, *Custom Macro*; M97 of Haas calls a block of the same program."""
_NUMBER = re.compile(r"N\s*0*([0-9]+)")
_PROGRAM = re.compile(r"[O:]\s*0*([0-9]+)(?!\s*(?:SUB|CALL|IF|WHILE|REPEAT|DO)\b)")
_SIMPLE = re.compile(r"[#\[]|^\s*(?:N[0-9]+\s*)?(?:O|IF|WHILE|GOTO|DO|END)|M9[789]|G65", re.I)
"""What a line has that needs more than to be read where it stands."""
_ARGUMENTS = "ABCIJKDEF H M   QRSTUVWXYZ"
"""FANUC: the variable #n of a macro has the n-th letter as its argument."""
_COMMENT = re.compile(r"\([^)]*\)|;.*")


@dataclass
class _Frame:
    """A call that is running: where it goes on, how often it repeats, and its variables."""

    back: int
    begin: int
    repeats: int = 1
    variables: dict[str, float] = field(default_factory=dict)


class Program:
    """Runs through the blocks of a program.

    Attributes:
        variables: Their values so far.
    """

    def __init__(self, lines: Sequence[str]) -> None:
        self.variables = Variables()
        self._lines = lines
        self._plain = [_SIMPLE.search(line) is None for line in lines]
        self._calls: list[_Frame] = []
        self._repeats: dict[int, int] = {}
        self._taken: set[str] = set()
        self._codes: dict[int, str] = {}
        self._partners: dict[tuple[int, str, tuple[str, ...], int], int] = {}

    def plain(self, number: int) -> bool:
        """Whether the line of this number, from 1, has no variables, branches or calls."""
        return self._plain[number - 1]

    def run(self) -> Iterator[tuple[int, str]]:
        """Line numbers, from 1, and blocks without variables, in the order in which they run.

        Raises:
            InvalidInput: If a branch or an expression has no value, with its line.
        """
        at, count = 0, 0
        while at < len(self._lines):
            if self._plain[at]:
                yield at + 1, self._lines[at]
                at += 1
                continue
            count += 1
            try:
                if count > MOST_BLOCKS:
                    raise InvalidInput(f"more than {MOST_BLOCKS} blocks run; a loop does not end")
                text, following = self._block(at)
            except InvalidInput as error:
                error.line = at + 1
                raise
            if text:
                yield at + 1, text
            if following < 0:
                return
            at = following

    def _code(self, at: int) -> str:
        """A line without comments and its number, in capitals."""
        if at in self._codes:
            return self._codes[at]
        text = _COMMENT.sub("", self._lines[at]).upper().strip()
        number = _NUMBER.match(text)
        self._codes[at] = text[number.end() :].strip() if number else text
        return self._codes[at]

    def _word(self, at: int) -> tuple[str, str, str] | None:
        """Label, word and rest of a branch or a loop; FANUC's loops are those of LinuxCNC."""
        if self._plain[at]:
            return None
        if (found := _O_WORD.fullmatch(self._code(at))) is not None:
            return found[1], found[2], found[3]
        if (found := _WHILE.fullmatch(self._code(at))) is None:
            return None
        word = "ENDWHILE" if found[1] == "END" else "WHILE"
        return f"DO{found[3]}", word, found[2] or "[1]"

    def _block(self, at: int) -> tuple[str, int]:
        """The block of a line without variables, and the line that follows it."""
        code = self._code(at)
        if (word := self._word(at)) is not None:
            return "", self._branch(at, *word)
        if (jump := _IF.fullmatch(code)) is not None:
            condition, then, *targets = jump.groups()
            if condition and not self.variables.value(condition):
                return "", at + 1
            if then is None:
                return "", self._find(_NUMBER, next(filter(None, targets)), "GOTO")
            return self.variables.resolved(then), at + 1
        if (call := _CALL.search(code)) is not None:
            return "", self._call(at, self.variables.resolved(call[0]))
        if re.search(r"M99(?![0-9])", code):
            return ("", self._return()) if self._calls else ("M30", -1)
        computed = "#" in code or "[" in code
        return self.variables.resolved(code) if computed else self._lines[at], at + 1

    def _find(self, pattern: re.Pattern[str], number: str, what: str) -> int:
        """The line with a number."""
        wanted = int(number)
        for k, line in enumerate(self._lines):
            found = pattern.match(_COMMENT.sub("", line).upper().strip())
            if found is not None and int(found[1]) == wanted:
                return k
        raise InvalidInput(
            f"{what} {wanted} is not in this file, and what it moves is not known; have the CAM "
            "system write one program"
        )

    def _partner(self, at: int, label: str, words: tuple[str, ...], *, step: int = 1) -> int:
        """The next line with one of some words of a label."""
        key = (at, label, words, step)
        if key not in self._partners:
            k = at + step
            while 0 <= k < len(self._lines):
                found = self._word(k)
                if found is not None and found[0] == label and found[1] in words:
                    break
                k += step
            self._partners[key] = k if k < len(self._lines) else -1
        if self._partners[key] < 0:
            title = label if label.startswith("DO") else f"O{label}"
            raise InvalidInput(f"{title} has no {' or '.join(words)}")
        return self._partners[key]

    def _branch(self, at: int, label: str, word: str, rest: str) -> int:
        """The line that follows an O word."""
        key = f"{label} {len(self._calls)}"
        match word:
            case "SUB":
                return self._partner(at, label, ("ENDSUB",)) + 1
            case "CALL":
                try:
                    begin = self._partner(-1, label, ("SUB",))
                except InvalidInput:
                    raise InvalidInput(
                        f"O{label.lower()} calls a subprogram that is not in this file; what it "
                        "moves is not known"
                    ) from None
                values = self.variables.brackets(rest)
                given = dict.fromkeys(map(str, range(1, LOCALS + 1)), 0.0)
                given |= {str(k): value for k, value in enumerate(values, start=1)}
                return self._enter(_Frame(at + 1, begin + 1, 1, given))
            case "ENDSUB" | "RETURN":
                return self._return() if self._calls else -1
            case "IF" | "ELSEIF":
                if word == "IF":
                    self._taken.discard(key)
                elif key in self._taken:
                    return self._partner(at, label, ("ENDIF",)) + 1
                if self.variables.value(rest):
                    self._taken.add(key)
                    return at + 1
                other = self._partner(at, label, ("ELSEIF", "ELSE", "ENDIF"))
                return other if "ELSEIF" in self._code(other) else other + 1
            case "ELSE":
                return self._partner(at, label, ("ENDIF",)) + 1
            case "DO" | "ENDIF":
                return at + 1
            case _:
                return self._loop_word(at, label, word, rest)

    def _loop_word(self, at: int, label: str, word: str, rest: str) -> int:
        """The line that follows WHILE, REPEAT, their ends, BREAK or CONTINUE."""
        if word == "WHILE":
            holds = self.variables.value(rest)
            if self._has_do(at, label):
                return self._partner(at, label, ("DO",), step=-1) if holds else at + 1
            return at + 1 if holds else self._partner(at, label, ("ENDWHILE",)) + 1
        if word == "REPEAT":
            left = self._repeats.pop(at, None)
            left = round(self.variables.value(rest)) if left is None else left - 1
            if left <= 0:
                return self._partner(at, label, ("ENDREPEAT",)) + 1
            self._repeats[at] = left
            return at + 1
        if word in ("ENDWHILE", "ENDREPEAT"):
            return self._partner(at, label, (word.removeprefix("END"),), step=-1)
        end = self._partner(at, label, ("ENDWHILE", "ENDREPEAT", "WHILE"))
        if word == "CONTINUE":
            return end
        if "ENDREPEAT" in self._code(end):
            self._repeats.pop(self._partner(end, label, ("REPEAT",), step=-1), None)
        return end + 1

    def _has_do(self, at: int, label: str) -> bool:
        """Whether the condition of a loop stands at its end: ``do … while``."""
        try:
            begin = self._partner(at, label, ("DO", "ENDWHILE", "WHILE"), step=-1)
        except InvalidInput:
            return False
        return (self._word(begin) or ("", "", ""))[1] == "DO"

    def _call(self, at: int, text: str) -> int:
        """The line that follows M98, M97 or G65."""
        words = dict(re.findall(r"([A-Z])\s*([+-]?[0-9]*\.?[0-9]+)", text))
        if "P" not in words:
            raise InvalidInput(f"{shortened(text)!r} calls a program without P")
        number, repeats = words["P"], float(words.get("L", 1))
        if text.startswith("M98") and "L" not in words and len(number) > 4:
            # FANUC: P0031000 calls program 1000 three times.
            number, repeats = number[-4:], float(number[:-4])
        if text.startswith("M97"):
            begin = self._find(_NUMBER, number, "M97: block N")
        else:
            begin = 1 + self._find(_PROGRAM, number, f"{text[:3]}: program O")
        given = dict[str, float]()
        if text.startswith("G65"):
            given = {str(_ARGUMENTS.index(k) + 1): float(v) for k, v in words.items()
                     if k in _ARGUMENTS and k not in "GPL"}  # fmt: skip
        else:
            given = self.variables.local  # M98 has the variables of its caller
        return self._enter(_Frame(at + 1, begin, int(repeats), given))

    def _enter(self, frame: _Frame) -> int:
        if len(self._calls) >= _DEEPEST:
            raise InvalidInput(f"more than {_DEEPEST} calls within calls")
        frame.variables, self.variables.local = self.variables.local, frame.variables
        self._calls.append(frame)
        return frame.begin if frame.repeats > 0 else self._return()

    def _return(self) -> int:
        frame = self._calls[-1]
        frame.repeats -= 1
        if frame.repeats > 0:
            return frame.begin
        self._calls.pop()
        self.variables.local = frame.variables
        return frame.back
