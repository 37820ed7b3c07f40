"""Robot programs, executed as far as they state what runs, for the path of their moves.

Unlike in :mod:`~qp_twist.programs.reading`, for what ``check`` vouches for, a statement that moves
nothing need not be known here: it is passed over and listed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal

from qp_twist.errors import InvalidInput
from qp_twist.paths.robot_path import REFUSED, RobotPath, SeveralFrames
from qp_twist.paths.robot_values import Values
from qp_twist.paths.toolpath import Toolpath
from qp_twist.paths.toolpath_builder import ProgramWords, ToolpathFormat
from qp_twist.paths.toolpath_options import ReadingOptions
from qp_twist.programs.reading import Statements, refuse, shown, split

Effect = Literal["moves", "assigns", "nothing", "unknown"]
Rule = tuple[str, Callable[[int, "re.Match[str]"], object], Effect]
"""Pattern of a statement, what it does (``True``: leave the procedure), and its effect."""
_MOST = 200_000
"""Statements that a program may execute."""
_DEEPEST = 30
"""Calls inside each other."""


class RobotProgram:
    """A program while it is executed. A language is a subclass: patterns of its statements.

    Attributes:
        values: Variables and expressions.
        path: The moves so far.
        passed: Words that move nothing, with their lines.
    """

    flags = re.IGNORECASE | re.ASCII | re.DOTALL
    opens: Sequence[tuple[str, str, str]] = ()
    """Begins of blocks, their ends, and what becomes of each: ``procedure`` (groups ``name``,
    ``arguments``), ``once`` (it runs where it stands), ``for`` (groups ``name``, ``first``,
    ``last``, ``step``), ``for ever``, ``never``; ``open`` if nothing says whether it runs."""
    coordinates = r"\["
    """What stands in statements with a position, or with a frame by its number."""
    components = r"\.\s*(?:trans|rot|[xyzabc])\b"
    """Components of positions."""

    def __init__(self, values: Values, path: RobotPath) -> None:
        self.values, self.path = values, path
        self.passed: list[tuple[int, str]] = []
        self._procedures: dict[str, tuple[int, list[str], Statements]] = {}
        self._called: list[str] = []
        self._depth = self._count = 0
        self._acts: dict[str, tuple[Any, re.Match[str], Effect]] = {}
        self._opens = [
            (re.compile(begin, self.flags), end, role) for begin, end, role in self.opens
        ]
        begins = (re.sub(r"\(\?P<\w+>", "(", pattern) for pattern, *_ in self.opens)
        self._begins = re.compile("|".join(begins) or r"(?!)", self.flags)
        ends = "|".join(end for _, end, _ in self.opens)
        self._closes = re.compile(ends or r"(?!)", self.flags)
        self._rules = [
            (re.compile(p, self.flags), act, effect) for p, act, effect in self.grammar()
        ]

    def grammar(self) -> Sequence[Rule]:
        """Statements; the last rule fits all."""
        raise NotImplementedError

    def execute(self, statements: Statements) -> None:
        """Execute a program: its statements, then main, else what nothing in it calls."""
        self.run(statements)
        texts = {n: " ".join(t for _, t in body) for n, (_, _, body) in self._procedures.items()}
        words = {n: set(re.findall(r"\w+", self.values.key(t))) for n, t in texts.items()}
        tops = [n for n in words if not any(n in words[other] for other in words if other != n)]
        tops = ["main"] if "main" in words else [] if self._called else tops
        if len(tops) > 1:
            self.path.assumed["nothing says which of these runs first; they are read in this order:"
                              f" {', '.join(tops)}."] = None  # fmt: skip
        for name in tops:
            self._call(self._procedures[name][0], name, [])
        left = [n for n in words if n not in self._called and self._moving(self._procedures[n][2])]
        for name, (line, *_) in self.path.unknown.items():
            if left:
                raise refuse(line, name, f"is not known here, and {left[0]} is never called.")
        for name in left:
            self.path.assumed[f"{name} is never called, and left out."] = None

    def run(self, statements: Statements) -> bool:
        """Execute statements; whether one leaves the procedure."""
        k = 0
        while k < len(statements):
            line, text = statements[k]
            k, self._count = k + 1, self._count + 1
            if self._count > _MOST:
                raise InvalidInput(f"the program executes more than {_MOST:,} statements.")
            opened = self._opened(text)
            if opened is None:
                act, match, _ = self._act(text)
                try:
                    left = act(line, match) is True
                except InvalidInput as error:
                    error.line = line if error.line is None else error.line
                    raise
            else:
                role, match, close = opened
                end = self._end(statements, k, close)
                left, k = self._block(line, role, match, statements[k:end]), end + 1
            if left:
                return True
        return False

    # ------------------------------------------------------------ what statements do

    def assign(self, line: int, match: re.Match[str]) -> None:
        """An assignment or declaration: groups ``name``, ``part``, ``value``, ``kind``."""
        groups = match.groupdict(default="")
        part = "" if groups.get("kind") else groups.get("part", "")
        name = self.values.key(groups["name"])
        if part and re.search(self.components, part, self.flags) and name not in self.values.names:
            raise refuse(line, match[0], "is a coordinate of what is not in the file.")
        self._refuse_moving(line, groups["value"] or "")
        if groups["value"]:
            self.values.assign(line, groups["name"] + part, groups["value"])
        elif groups.get("kind"):
            name = f"{groups['name']} is declared in line {line} without a value"
            self.values.forget(groups["name"], name)

    def skip(self, line: int, match: re.Match[str]) -> None:
        """A statement that moves nothing."""
        self.passed.append((line, match[0].split("(")[0].split()[0].split("=")[0]))

    def leave(self, line: int, match: re.Match[str]) -> bool:
        """A statement that leaves its procedure."""
        return True

    def refuse(self, line: int, match: re.Match[str]) -> None:
        """A statement after which the path is not known."""
        raise refuse(line, match[0], "is not read, and may move the robot or lead it elsewhere; "
                     "write a program without it.")  # fmt: skip

    def call(self, line: int, match: re.Match[str]) -> None:
        """A call: groups ``called`` and ``arguments``."""
        name, arguments = match["called"], (match.groupdict()["arguments"] or "").strip()
        self._refuse_moving(line, arguments)
        if self.values.key(name) in self._procedures:
            self._call(line, self.values.key(name), split(arguments) if arguments else [])
            return
        if self._has_coordinates(match[0]):
            raise refuse(line, match[0], "is not known here, and has coordinates.")
        self.path.unknown.setdefault(name, []).append(line)

    def _refuse_moving(self, line: int, expression: str) -> None:
        """A function that moves has its moves where an expression calls it, which is not read."""
        for word in re.findall(r"\w+", expression):
            procedure = self._procedures.get(self.values.key(word))
            if procedure is not None and self._moving(procedure[2]):
                raise refuse(line, expression, f"calls {word}, which moves, inside an expression; "
                             "that is not read. Write the call as a statement.")  # fmt: skip

    def _has_coordinates(self, text: str) -> bool:
        names = (
            self.values.names.get(self.values.key(word)) for word in re.findall(r"[\w$]+", text)
        )
        return bool(re.search(self.coordinates, text, self.flags)) or any(
            isinstance(value, list | dict) for value in names
        )

    # ------------------------------------------------------------ blocks

    def _opened(self, text: str) -> tuple[str, re.Match[str], str] | None:
        """What becomes of the block that a statement begins, and the pattern of its end."""
        if not self._begins.fullmatch(text):
            return None
        fits = ((role, pattern.fullmatch(text), end) for pattern, end, role in self._opens)
        return next((role, match, end) for role, match, end in fits if match)

    def _end(self, statements: Statements, begin: int, end: str) -> int:
        """Where the block ends whose first statement is ``begin``."""
        ends = [end]
        for k in range(begin, len(statements)):
            text = statements[k][1]
            opened = self._opened(text)
            if opened is not None:
                ends.append(opened[2])
            elif self._closes.fullmatch(text):
                if not re.fullmatch(ends.pop(), text, self.flags):
                    break
                if not ends:
                    return k
        raise refuse(*statements[begin - 1], "has no end; a line was lost.")

    def _act(self, text: str) -> tuple[Any, re.Match[str], Effect]:
        if text not in self._acts:
            fits = ((act, pattern.fullmatch(text), effect) for pattern, act, effect in self._rules)
            self._acts[text] = next((a, match, e) for a, match, e in fits if match)
        return self._acts[text]

    def _block(self, line: int, role: str, match: re.Match[str], body: Statements) -> bool:
        """Execute a block; whether it leaves the procedure."""
        if role == "procedure":
            parameters = [re.findall(r"\w+", part) for part in match["arguments"].split(",")]
            names = [self.parameter(words) for words in parameters if words]
            self._procedures[self.values.key(match["name"])] = line, names, body
        elif role == "for":
            first, last = (self.values.value(match[key]) for key in ("first", "last"))
            step = self.values.value(match["step"] or "1")
            for k in range(int((last - first) // step) + 1 if step else 0):
                self.values.names[self.values.key(match["name"])] = first + k * step
                if self.run(body):
                    return True
        elif role == "once":
            return self.run(body)
        elif role == "for ever":
            self.path.assumed[f"{shown(match[0])} (line {line}) is for ever: read once."] = None
            return self.run(body) or self._moving(body) is not None
        elif role == "never":
            self.passed.append((line, match[0]))
        elif role == "open":
            self._pass_over(line, match[0], body)
        return False

    def _pass_over(self, line: int, begin: str, body: Statements) -> None:
        """Pass over what runs or not; then it may not move, nor say where anything is."""
        if moving := self._moving(body):
            raise InvalidInput(
                f"{shown(moving[1])} runs or not by {shown(begin)} of line {line}, which is not "
                "decided in the file; write a program without it.",
                line=moving[0],
            )
        for number, _, match, effect in self._reached(body):
            if effect == "assigns":
                why = f"{match['name']} (line {number}) depends on {shown(begin)}"
                self.values.forget(match["name"], why)
        self.passed.append((line, begin.split(maxsplit=1)[0]))

    def _moving(self, body: Statements) -> tuple[int, str] | None:
        """The first statement that moves, or may."""
        for number, text, _, effect in self._reached(body):
            if effect == "moves" or (effect == "unknown" and self._has_coordinates(text)):
                return number, text
        return None

    def _reached(
        self, body: Statements, inside: tuple[str, ...] = ()
    ) -> Iterator[tuple[int, str, re.Match[str], Effect]]:
        """Statements that may run, those of called procedures too."""
        for number, text in body:
            if not self._opened(text) and not self._closes.fullmatch(text):
                _, match, effect = self._act(text)
                yield number, text, match, effect
                called = self.values.key(match.groupdict().get("called") or "")
                if called in self._procedures and called not in inside:
                    yield from self._reached(self._procedures[called][2], (*inside, called))

    def parameter(self, words: Sequence[str]) -> str:
        """The name of a parameter among the words of its declaration."""
        return words[-1]

    def _call(self, line: int, name: str, arguments: Sequence[str]) -> None:
        _, parameters, body = self._procedures[name]
        if self._depth >= _DEEPEST or len(parameters) < len(arguments):
            raise InvalidInput(f"{name} takes {len(parameters)} arguments, and at most {_DEEPEST} "
                               "calls inside each other are read.", line=line)  # fmt: skip
        self._called.append(name)
        for parameter, argument in zip_longest(parameters, arguments, fillvalue=""):
            self.values.assign(line, parameter, argument)
        self._depth += 1
        self.run(body)
        self._depth -= 1


Reader = Callable[[Path, Sequence[str], RobotPath], RobotProgram]
"""(file, its lines, path to fill) to the program that was executed."""
_BEGIN = 50
"""Number of lines in which one stands with which a program begins."""


def robot_format(begins: str, words: ProgramWords, execute: Reader) -> ToolpathFormat:
    """The format of a language.

    Args:
        begins: Pattern of the lines with which its programs begin.
        words: What messages call its parts.
        execute: Executes a program.
    """
    pattern = re.compile(rf"\s*(?:{begins})", re.IGNORECASE | re.ASCII)

    def read(file: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
        try:
            path = RobotPath(options, words, in_base=False)
            program = execute(file, lines, path)
        except SeveralFrames:
            path = RobotPath(options, words, in_base=True)
            program = execute(file, lines, path)
        return path.toolpath(file, program.passed)

    return ToolpathFormat(
        lambda suffix, lines: any(map(pattern.match, lines[:_BEGIN])), read, REFUSED
    )
