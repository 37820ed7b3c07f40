"""The text of a robot program: its blocks and procedures, and what its statements may do."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from qp_twist.programs.statements import Statements, refuse
from qp_twist.programs.syntax import MOVING, Act, Effect, Language, Rule
from qp_twist.programs.values import Values


class Procedure(NamedTuple):
    """A procedure: its first line, its parameters and its statements."""

    line: int
    parameters: list[str]
    body: Statements


class Listing:
    """A program's text in the patterns of its language.

    If it is ``strict``, as when ``check`` reads it, what is not known is refused.

    Attributes:
        procedures: By their names.
        assigned: The lines where each variable is assigned; only if strict.
    """

    def __init__(
        self, language: Language, rules: Sequence[Rule], values: Values, *, strict: bool
    ) -> None:
        self._values, self._strict = values, strict
        self._language, flags = language, language.flags
        self._opens = [(re.compile(begin, flags), end, role) for begin, end, role in language.opens]
        self._begins = self._any([begin for begin, *_ in language.opens])
        self._closes = self._any([end for _, end, _ in language.opens])
        self._rules = [(re.compile(p, flags), act, effect) for p, act, effect in rules]
        self._acts: dict[str, tuple[Act | str, re.Match[str], Effect]] = {}
        self.procedures: dict[str, Procedure] = {}
        self.assigned: dict[str, list[str]] = {}

    def _any(self, patterns: Sequence[str]) -> re.Pattern[str]:
        """One pattern of several, whose groups have no names."""
        unnamed = (re.sub(r"\(\?P<\w+>", "(", pattern) for pattern in patterns)
        return re.compile("|".join(unnamed) or r"(?!)", self._language.flags)

    def opened(self, text: str) -> tuple[str, re.Match[str], str] | None:
        """Role, match and pattern of the end of the block that a statement opens, if it does.

        The roles are those of ``Language.opens``.
        """
        if not self._begins.fullmatch(text):
            return None
        fits = ((role, pattern.fullmatch(text), end) for pattern, end, role in self._opens)
        return next((role, match, end) for role, match, end in fits if match)

    def closes(self, text: str) -> bool:
        """Whether a statement ends a block."""
        return self._closes.fullmatch(text) is not None

    def end(self, statements: Statements, begin: int, end: str) -> tuple[int, re.Match[str]]:
        """Index and match of the statement that ends the block whose content begins at ``begin``.

        Raises:
            InvalidInput: If nothing ends it.
        """
        ends = [end]
        for k in range(begin, len(statements)):
            text = statements[k][1]
            opened = self.opened(text)
            if opened is not None:
                ends.append(opened[2])
            elif self.closes(text):
                closing = re.fullmatch(ends.pop(), text, self._language.flags)
                if not closing:
                    break
                if not ends:
                    return k, closing
        raise refuse(*statements[begin - 1], "has no end; a line was lost.")

    def act(self, text: str) -> tuple[Act | str, re.Match[str], Effect]:
        """What a statement does, its match, and its effect."""
        if text not in self._acts:
            fits = ((act, pattern.fullmatch(text), effect) for pattern, act, effect in self._rules)
            self._acts[text] = next((act, match, e) for act, match, e in fits if match)
        return self._acts[text]

    def branches(self, condition: str, body: Statements) -> list[tuple[str | None, Statements]]:
        """The branches of an ``if`` with their conditions; ``None`` for that of all others."""
        found: list[tuple[str | None, Statements]] = [(condition, [])]
        depth = 0
        for statement in body:
            other = re.fullmatch(self._language.otherwise, statement[1], self._language.flags)
            depth += self.opened(statement[1]) is not None
            depth -= self.closes(statement[1])
            if other and not depth:
                found.append((other["condition"], []))
            else:
                found[-1][1].append(statement)
        return found

    def uncalled(self) -> list[str]:
        """The procedures that no other one mentions."""
        words = {
            name: set(re.findall(r"\w+", self._values.key(" ".join(t for _, t in each.body))))
            for name, each in self.procedures.items()
        }
        return [n for n in words if not any(n in words[other] for other in words if other != n)]

    def reached(
        self, body: Statements, inside: tuple[str, ...] = ()
    ) -> Iterator[tuple[int, str, re.Match[str], Effect]]:
        """Line, text, match and effect of the statements of ``body`` and of procedures it calls.

        ``inside`` has the names of the procedures around it, which are not entered again.
        """
        for number, text in body:
            if not self.opened(text) and not self.closes(text):
                _, match, effect = self.act(text)
                yield number, text, match, effect
                called = self._values.key(match.groupdict().get("called") or "")
                if called in self.procedures and called not in inside:
                    yield from self.reached(self.procedures[called].body, (*inside, called))

    def moving(
        self, body: Statements, effects: Sequence[Effect] = MOVING
    ) -> tuple[int, str] | None:
        """The first statement that moves, or may."""
        for number, text, _, effect in self.reached(body):
            if effect in effects or (effect == "call" and self.has_coordinates(text)):
                return number, text
        return None

    def assigning(self, body: Statements) -> dict[str, int]:
        """Variables that may be assigned, each with a line."""
        return {m["name"]: k for k, _, m, effect in self.reached(body) if effect == "assigns"}

    def has_coordinates(self, text: str) -> bool:
        """Whether a position, or a variable that is one, stands in a statement."""
        language, names = self._language, self._values.names
        return bool(re.search(language.coordinates, text, language.flags)) or any(
            isinstance(names.get(self._values.key(word)), list | dict)
            for word in re.findall(r"[\w$]+", text)
        )

    def refuse_calls(self, line: int, expression: str) -> None:
        """Refuse calls of procedures with moves; if strict, of all but the language's functions.

        Raises:
            InvalidInput: If it has such a call.
        """
        for word in re.findall(r"(\w+)\s*\(", expression):
            key = self._values.key(word)
            if key in self._values.functions:
                continue
            own = self.procedures.get(key)
            moves = own is not None and self.moving(own.body, ("joint", "path"))
            if self._strict or moves or self.act(f"{word}()")[2] == "joint":
                raise refuse(
                    line, expression,
                    f"calls {word}, which moves, inside an expression; that is not read. Write the "
                    "call as a statement."
                    if moves
                    else f"a call in an expression is not read ({word}).",
                )  # fmt: skip

    def changes(self, name: str) -> bool:
        """Whether a variable is assigned more than once; then ``check`` knows no value of it."""
        return self._strict and len(self.assigned.get(name, ())) > 1

    def vouch(self, statements: Statements) -> None:
        """Refuse what is not known; make values unknown of variables that are assigned repeatedly.

        Raises:
            InvalidInput: At the first statement that is not read, or not where it stands.
        """
        language, inside = self._language, list[str]()
        for line, text in statements:
            opened, effect = self.opened(text), "silent"
            if opened is not None:
                role, match, _ = opened
                inside.append(role)
                if role == "procedure" and match["arguments"].strip():
                    raise refuse(line, text, "procedures with arguments are not read.")
                known = role in ("procedure", "once")
            elif self.closes(text):
                known = bool(inside) and bool(inside.pop())
            else:
                _, match, effect = self.act(text)
                known = effect not in ("path", "skip")
                fits = re.fullmatch(language.outside, text, language.flags)
                if "procedure" not in inside and (not fits or (language.enclosed and not inside)):
                    raise refuse(line, text, "stands outside all procedures; expected it in one.")
            if not known:
                word = re.match(r"[\w$/]+", text, re.ASCII)
                what = f"{word[0]} is not read" if word else "is not understood"
                raise refuse(line, text, f"{what}; only {language.reads} can be checked.")
            if effect == "assigns" and (match["value"] or match.groupdict().get("kind")):
                self.assigned.setdefault(self._values.base(match["name"]), []).append(str(line))
        for name, places in self.assigned.items():
            if self.changes(name):
                self._values.forget(
                    name,
                    f"{name} is assigned in lines {', '.join(places)}; only what is assigned once "
                    "can be checked",
                )
