"""What statements of a robot program do that neither move the robot nor lead elsewhere."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NoReturn

from qp_twist.programs.listing import Listing
from qp_twist.programs.moves import Kind, Moves
from qp_twist.programs.statements import refuse, shown
from qp_twist.programs.syntax import Language, Rule
from qp_twist.programs.values import Values

_COMPONENTS = re.compile(r"\.\s*(?:trans|rot|[xyzabc])\b", re.IGNORECASE | re.ASCII)
"""Components of positions."""


class Acts:
    """A program's assignments, settings and waits, and what is passed over or refused.

    Attributes:
        values: Variables and expressions.
        moves: Takes what a program does.
        listing: Its text.
    """

    language = Language()

    def __init__(self, values: Values, moves: Moves) -> None:
        self.values, self.moves = values, moves
        self.listing = Listing(self.language, self.grammar(), values, strict=moves.strict)

    def grammar(self) -> Sequence[Rule]:
        """Statements; the first rule that fits counts, and the last one fits all."""
        raise NotImplementedError

    def noting(self, patterns: Mapping[Kind, Sequence[str]]) -> list[Rule]:
        """Rules of statements that do not move the robot: their word, and their expressions."""
        return [(p, partial(self._note, kind), kind) for kind, ps in patterns.items() for p in ps]

    def assign(self, line: int, match: re.Match[str]) -> None:
        """An assignment or declaration: groups ``name``, ``part``, ``value``, ``kind``."""
        groups = match.groupdict(default="")
        name, kind, value = groups["name"], groups.get("kind", ""), groups["value"]
        part, key = "" if kind else groups.get("part", ""), self.values.base(name)
        if part and _COMPONENTS.search(part) and key not in self.values.names:
            raise refuse(line, match[0], "is a coordinate of what is not in the file.")
        self.listing.refuse_calls(line, part + value)
        if kind:
            self.values.local(key)
        if value and not self.listing.changes(key):
            self.values.assign(line, name + part, value)
        elif kind and not value:
            self.values.forget(name, f"{name} is declared in line {line} without a value")
        if self.moves.strict:
            known = self.listing.act(f"{name}()")[2] not in ("call", "path")
            if known or key in self.values.functions:
                raise refuse(line, match[0], "this name has a meaning already.")
            if part or not isinstance(self.values.names[key], int | float | list | dict):
                self.moves.noted(line, kind or name, "passed")

    def _note(self, kind: Kind, line: int, match: re.Match[str]) -> None:
        groups = match.groups(default="")
        self.listing.refuse_calls(line, groups[1] if len(groups) > 1 else "")
        self.moves.noted(line, groups[0] or match[0], kind)

    def skip(self, line: int, match: re.Match[str]) -> None:
        """A statement that moves nothing."""
        word = re.match(r"[^\s(=]+", match[0])
        self.moves.noted(line, word[0] if word else match[0], "passed")

    def wait(self, line: int, match: re.Match[str]) -> None:
        """A wait: its word, and its seconds."""
        seconds = self.values.number(match[2])
        if not math.isnan(seconds):
            self.moves.wait(line, match[1], seconds)
        elif self.moves.strict:
            raise refuse(line, match[0], "expected a number of seconds.")

    def stop(self, line: int, match: re.Match[str]) -> None:
        """A wait, its word, until the robot is at rest, or of a step of the controller."""
        self.moves.wait(line, match[1], 0.0)

    def refuse(self, line: int, match: re.Match[str]) -> NoReturn:
        """A statement after which the path is not known."""
        why = "is not read, and may move the robot or lead it elsewhere"
        raise refuse(line, match[0], f"{why}; write a program without it.")

    def undecided(self, line: int, match: re.Match[str]) -> NoReturn:
        """A statement that decides what runs, by what the program does not state."""
        why = "decides by what is not in the file which lines run; write a program without it."
        raise refuse(line, match[0], why)

    def unsettle(self, line: int, text: str, match: re.Match[str], why: str) -> None:
        """A setting runs or not: the frame or the speed that it would set is not known."""
        act, moves = self.listing.act(text)[0], self.moves
        frame, feed = moves.frame, moves.feed
        if not isinstance(act, str):
            act(line, match)
        if moves.frame is not frame:
            moves.frame = f"a frame that {why} (line {line})", None
        elif moves.feed != feed:
            moves.feed = math.nan
        moves.note(f"{shown(text)} (line {line}) {why}, which is not decided in the file")
