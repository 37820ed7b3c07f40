"""A robot program, executed as far as it states what runs.

What it does goes to a :class:`~qp_twist.programs.moves.Moves`. If that is strict, a statement that
is not known is refused wherever it stands, as are branches, loops and variables that change;
otherwise a statement without coordinates is passed over and listed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import count, zip_longest
from typing import Any, NamedTuple

from qp_twist.errors import InvalidInput
from qp_twist.programs.moves import Kind, Moves
from qp_twist.programs.statements import Statements, refuse, shown, split
from qp_twist.programs.syntax import MOVING, Effect, Rule, Syntax
from qp_twist.programs.values import Unknown, Values

_MOST = 200_000
"""Statements that a program may execute."""
_DEEPEST = 30
"""Calls inside each other."""


class Procedure(NamedTuple):
    """Its first line, its parameters and its statements."""

    line: int
    parameters: list[str]
    body: Statements


class Program:
    """A program while it is executed. A language is a subclass: patterns of its statements.

    Attributes:
        values: Variables and expressions.
        moves: Takes what it does.
        procedures: By their names.
        assigned: The lines where each variable is assigned, if that is strict.
    """

    flags = re.IGNORECASE | re.ASCII | re.DOTALL
    opens: Sequence[tuple[str, str, str]] = ()
    """Begins of blocks, their ends, and what becomes of each: ``procedure`` (groups ``name``,
    ``arguments``), ``once`` (it runs where it stands), ``for`` (groups ``name``, ``first``,
    ``last``, ``step``), ``if`` and ``while`` (group ``condition``), ``until`` (this group is in the
    end), ``for ever``, ``never``; ``open`` if nothing says whether it runs."""
    otherwise = r"(?!)"
    """Other branches of an ``if``, with their ``condition``."""
    coordinates = r"\["
    """What stands in statements with a position, or with a frame by its number."""
    components = r"\.\s*(?:trans|rot|[xyzabc])\b"
    """Components of positions."""
    outside, enclosed = r".*", False
    """What may stand outside procedures, if that is strict, and whether only in another block."""
    reads = ""
    """What ``check`` reads, for messages."""
    main = "main"
    """The procedure that runs first."""

    def __init__(self, values: Values, moves: Moves) -> None:
        self.values, self.moves = values, moves
        self.procedures: dict[str, Procedure] = {}
        self._called: set[str] = set()
        self._running: list[str] = []
        self._count = 0
        self._locals: dict[str, Any] = {}
        self.assigned: dict[str, list[str]] = {}
        self._changing: set[str] = set()
        self._unknown: dict[str, list[int]] = {}
        self._syntax = Syntax(self.opens, self.grammar(), self.flags)

    def grammar(self) -> Sequence[Rule]:
        """Statements; the first rule that fits counts, and the last one fits all."""
        raise NotImplementedError

    def noting(self, patterns: Mapping[Kind, Sequence[str]]) -> list[Rule]:
        """Rules of statements that do not move the robot: their word, and their expressions."""
        return [(p, partial(self._note, kind), kind) for kind, ps in patterns.items() for p in ps]

    # ------------------------------------------------------------ what runs

    def execute(self, statements: Statements) -> None:
        """Execute a program: its statements, then what runs first of its procedures."""
        if self.moves.strict:
            self.check(statements)
        signal = self.run(statements)
        if signal.startswith("to "):
            raise InvalidInput(f"a jump {signal}, which is not among the statements around it.")
        if signal == "end":
            return
        words = {
            name: set(re.findall(r"\w+", self.values.key(" ".join(t for _, t in each.body))))
            for name, each in self.procedures.items()
        }
        uncalled = [n for n in words if not any(n in words[other] for other in words if other != n)]
        first = self.first(uncalled, statements)
        if len(first) > 1:
            self._say_order(first)
        for name in first:
            self._call(self.procedures[name].line, name, [])
        left = [n for n in words if n not in self._called and self._moving(self.procedures[n].body)]
        for name, (line, *_) in self._unknown.items():
            if left:
                raise refuse(line, name, f"is not known here, and {left[0]} is never called.")
        if self._unknown:
            listed = ", ".join(f"{n} ({_of_lines(at)})" for n, at in self._unknown.items())
            self.moves.note(f"not known here, and taken to move nothing: {listed}")
        for name in left:
            line = self.procedures[name].line
            self.moves.note(f"{name} (line {line}) is never called, and left out")

    def first(self, uncalled: list[str], statements: Statements) -> list[str]:
        """The procedures that run first, of those that no other calls."""
        return [self.main] if self.main in self.procedures else [] if self._called else uncalled

    def _say_order(self, names: Sequence[str]) -> None:
        order = ", ".join(names)
        if self.moves.strict:
            raise InvalidInput(
                f"nothing says which of these runs: {order}; expected one {self.main or 'call'}, "
                "or one that calls the others."
            )
        self.moves.note(
            f"nothing says which of these runs first; they are read in this order: {order}"
        )

    def check(self, statements: Statements) -> None:
        """Refuse what is not known, and find the lines where variables are assigned."""
        inside: list[str] = []
        for line, text in statements:
            opened, effect = self._syntax.opened(text), "silent"
            if opened is not None:
                role, match, _ = opened
                inside.append(role)
                if role == "procedure" and match["arguments"].strip():
                    raise refuse(line, text, "procedures with arguments are not read.")
                known = role in ("procedure", "once")
            elif self._syntax.closes(text):
                known = bool(inside) and bool(inside.pop())
            else:
                _, match, effect = self._syntax.act(text)
                known = effect not in ("path", "skip")
                fits = re.fullmatch(self.outside, text, self.flags)
                if "procedure" not in inside and (not fits or (self.enclosed and not inside)):
                    raise refuse(line, text, "stands outside all procedures; expected it in one.")
            if not known:
                word = re.match(r"[\w$/]+", text, re.ASCII)
                what = f"{word[0]} is not read" if word else "is not understood"
                raise refuse(line, text, f"{what}; only {self.reads} can be checked.")
            if effect == "assigns" and (match["value"] or match.groupdict().get("kind")):
                self.assigned.setdefault(self.values.base(match["name"]), []).append(str(line))
        for name, places in self.assigned.items():
            if len(places) > 1:
                why = (
                    f"{name} is assigned in lines {', '.join(places)}; only what is assigned once "
                )
                self.values.forget(name, f"{why}can be checked")
                self._changing.add(name)

    def run(self, statements: Statements) -> str:
        """Execute statements; the signal of the one that leaves them, if any."""
        k = 0
        while k < len(statements):
            line, text = statements[k]
            k, self._count = k + 1, self._count + 1
            if self._count > _MOST:
                raise InvalidInput(f"the program executes more than {_MOST:,} statements.")
            opened = self._syntax.opened(text)
            try:
                if opened is None:
                    act, match, _ = self._syntax.act(text)
                    signal = act(line, match) or ""
                else:
                    role, match, close = opened
                    end = self._syntax.end(statements, k, close)
                    signal = self._block(line, role, match, statements[k:end], statements[end][1])
                    k = end + 1
            except InvalidInput as error:
                error.line = line if error.line is None else error.line
                raise
            if signal.startswith("to "):
                signal, k = self._jump(signal, statements, k)
            if signal:
                return signal
        return ""

    def _jump(self, signal: str, statements: Statements, k: int) -> tuple[str, int]:
        """Where execution goes on at a label among some statements, or outside of them."""
        label = signal.removeprefix("to ")
        return next(
            (("", at) for at, each in enumerate(statements) if each[1] == label), (signal, k)
        )

    # ------------------------------------------------------------ what statements do

    def assign(self, line: int, match: re.Match[str]) -> None:
        """An assignment or declaration: groups ``name``, ``part``, ``value``, ``kind``."""
        groups = match.groupdict(default="")
        name, kind, value = groups["name"], groups.get("kind", ""), groups["value"]
        part, key = "" if kind else groups.get("part", ""), self.values.base(name)
        if part and re.search(self.components, part, self.flags) and key not in self.values.names:
            raise refuse(line, match[0], "is a coordinate of what is not in the file.")
        self.refuse_calls(line, part + value)
        if kind and self._running:
            self._locals.setdefault(key, self.values.names.get(key))
        if value and key not in self._changing:
            self.values.assign(line, name + part, value)
        elif kind and not value:
            self.values.forget(name, f"{name} is declared in line {line} without a value")
        if self.moves.strict:
            if (
                self._syntax.act(f"{name}()")[2] not in ("call", "path")
                or key in self.values.functions
            ):
                raise refuse(line, match[0], "this name has a meaning already.")
            if part or not isinstance(self.values.names[key], bool | float | list | dict):
                self.moves.noted(line, kind or name, "passed")

    def _note(self, kind: Kind, line: int, match: re.Match[str]) -> None:
        groups = match.groups(default="")
        self.refuse_calls(line, groups[1] if len(groups) > 1 else "")
        self.moves.noted(line, groups[0] or match[0], kind)

    def skip(self, line: int, match: re.Match[str]) -> None:
        """A statement that moves nothing."""
        word = re.match(r"[^\s(=]+", match[0])
        self.moves.noted(line, word[0] if word else match[0], "passed")

    def nothing(self, line: int, match: re.Match[str]) -> None:
        """A statement that does nothing worth a note."""

    def leave(self, line: int, match: re.Match[str]) -> str:
        """A statement that leaves its procedure."""
        return "return"

    def end(self, line: int, match: re.Match[str]) -> str:
        """A statement that ends the program."""
        return "end"

    def go_on(self, line: int, match: re.Match[str]) -> str:
        """``break`` or ``continue``."""
        return match[0].lower()

    def wait(self, line: int, match: re.Match[str]) -> None:
        """A wait: its word, and its seconds."""
        try:
            self.moves.wait(line, match[1], float(self.values.value(match[2])))
        except (Unknown, TypeError):
            if self.moves.strict:
                raise refuse(line, match[0], "expected a number of seconds.") from None

    def refuse(self, line: int, match: re.Match[str]) -> None:
        """A statement after which the path is not known."""
        raise refuse(
            line, match[0],
            "is not read, and may move the robot or lead it elsewhere; write a program without it.",
        )  # fmt: skip

    def call(self, line: int, match: re.Match[str]) -> str | None:
        """A call: groups ``called`` and ``arguments``."""
        name, arguments = match["called"], (match.groupdict().get("arguments") or "").strip()
        self.refuse_calls(line, arguments)
        key = self.values.key(name)
        if key in self.procedures:
            return self._call(line, key, split(arguments) if arguments else [])
        if self.moves.strict:
            raise refuse(line, match[0], f"calls {name}, which the file does not have.")
        if self._has_coordinates(match[0]):
            raise refuse(line, match[0], "is not known here, and has coordinates.")
        for word in re.findall(r"[\w$]+", arguments):  # which it may set
            if self.values.key(word) in self.values.names:
                self.values.forget(word, f"{name} of line {line} may have changed {word}")
        self._unknown.setdefault(name, []).append(line)
        return None

    def refuse_calls(self, line: int, expression: str) -> None:
        """A function that moves has its moves where an expression calls it, which is not read."""
        if "(" not in expression:
            return
        for word in re.findall(r"(\w+)\s*\(", expression):
            key = self.values.key(word)
            if key in self.values.functions:
                continue
            own = self.procedures.get(key)
            moves = own is not None and self._moving(own.body, ("joint", "path"))
            if self.moves.strict or moves or self._syntax.act(f"{word}()")[2] == "joint":
                raise refuse(
                    line, expression,
                    f"calls {word}, which moves, inside an expression; that is not read. Write the "
                    "call as a statement."
                    if moves
                    else f"a call in an expression is not read ({word}).",
                )  # fmt: skip

    def _has_coordinates(self, text: str) -> bool:
        names = (
            self.values.names.get(self.values.key(word)) for word in re.findall(r"[\w$]+", text)
        )
        return bool(re.search(self.coordinates, text, self.flags)) or any(
            isinstance(value, list | dict) for value in names
        )

    # ------------------------------------------------------------ blocks

    def _block(self, line: int, role: str, match: re.Match[str], body: Statements, end: str) -> str:
        """Execute a block; its signal."""
        if role == "procedure":
            name = self.values.key(match["name"])
            if self.moves.strict and (name in self.procedures or name in self.values.functions):
                raise refuse(line, match[0], "this name has a meaning already.")
            parameters = [re.findall(r"\w+", part) for part in match["arguments"].split(",")]
            names = [self.parameter(words) for words in parameters if words]
            self.procedures[name] = Procedure(line, names, body)
            return ""
        if role == "once":
            return self.run(body)
        if role == "never":
            self.moves.noted(line, match[0], "passed")
            self.values.shared |= {
                self.values.base(found["name"])
                for *_, found, effect in self._reached(body)
                if effect == "assigns"
            }
            return ""
        if role == "for ever" and not any(
            effect == "leaves" for *_, effect in self._reached(body, (*self.procedures,))
        ):
            self.moves.note(f"{shown(match[0])} (line {line}) is for ever: read once")
            return self.run(body) or ("end" if self._moving(body) else "")
        try:
            if role == "if":
                return self._branch(match["condition"], body)
            for _ in self._rounds(line, role, match, end):
                signal = self.run(body)
                if signal not in ("", "continue"):
                    return "" if signal == "break" else signal
        except _Open:
            self._pass_over(line, match[0], body)
        return ""

    def _rounds(self, line: int, role: str, match: re.Match[str], end: str) -> Iterator[object]:
        """The rounds of a loop.

        Raises:
            _Open: If the program does not state whether there is another one.
        """
        if role == "for":
            try:
                first, last = (self.values.value(match[key]) for key in ("first", "last"))
                groups = match.groupdict()
                step = -1 if groups.get("down") else self.values.value(groups.get("step") or "1")
                rounds = int((last - first) // step) + 1 if step else 0
            except (Unknown, TypeError) as error:
                raise _Open from error
            for k in range(rounds):
                self.values.assign(line, match["name"], repr(first + k * step))
                yield k
        elif role == "until":
            yield 0
            closing = next(re.fullmatch(e, end, self.flags) for _, e, r in self.opens if r == role)
            while closing and not self._holds(closing["condition"]):
                yield 0
        elif role == "for ever":
            yield from count()
        elif role == "while":
            while self._holds(match["condition"]):
                yield 0
        else:
            raise _Open

    def _holds(self, condition: str) -> bool:
        try:
            return self.values.condition(condition)
        except Unknown as error:
            raise _Open from error

    def _branch(self, condition: str | None, body: Statements) -> str:
        """Execute the branch of an ``if`` whose condition holds."""
        branches: list[tuple[str | None, Statements]] = [(condition, [])]
        depth = 0
        for statement in body:
            other = re.fullmatch(self.otherwise, statement[1], self.flags)
            depth += self._syntax.opened(statement[1]) is not None
            depth -= self._syntax.closes(statement[1])
            if other and not depth:
                branches.append((other["condition"], []))
            else:
                branches[-1][1].append(statement)
        for holds, branch in branches:
            if holds is None or self._holds(holds):
                return self.run(branch)
        return ""

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
        self.moves.noted(line, begin.split(maxsplit=1)[0], "passed")

    def _moving(
        self, body: Statements, effects: Sequence[Effect] = MOVING
    ) -> tuple[int, str] | None:
        """The first statement that moves, or may."""
        for number, text, _, effect in self._reached(body):
            if effect in effects or (effect == "call" and self._has_coordinates(text)):
                return number, text
        return None

    def _reached(
        self, body: Statements, inside: tuple[str, ...] = ()
    ) -> Iterator[tuple[int, str, re.Match[str], Effect]]:
        """Statements that may run, those of called procedures too."""
        for number, text in body:
            if not self._syntax.opened(text) and not self._syntax.closes(text):
                _, match, effect = self._syntax.act(text)
                yield number, text, match, effect
                called = self.values.key(match.groupdict().get("called") or "")
                if called in self.procedures and called not in inside:
                    yield from self._reached(self.procedures[called].body, (*inside, called))

    def parameter(self, words: Sequence[str]) -> str:
        """The name of a parameter among the words of its declaration."""
        return words[-1]

    def _call(self, line: int, name: str, arguments: Sequence[str]) -> str | None:
        _, parameters, body = self.procedures[name]
        chain = [*self._running, name]
        if name in self._running or len(chain) > _DEEPEST:
            raise refuse(
                line, " calls ".join(chain),
                f"calls in a circle, or more than {_DEEPEST} inside each other, are not read.",
            )  # fmt: skip
        if len(parameters) < len(arguments):
            raise InvalidInput(
                f"{name} takes {len(parameters)} arguments, got {len(arguments)}.", line=line
            )
        self._called.add(name)
        before, self._locals = self._locals, {}
        given = [(p, a, self.values.base(p)) for p, a in zip_longest(parameters, arguments)]
        for parameter, argument, key in given:
            own = self.values.names.get(key)
            self.values.assign(line, parameter, argument or "")
            self._locals.setdefault(key, own)
        self._running = chain
        signal = self.run(body)
        self._running = chain[:-1]
        if signal.startswith("to "):
            raise refuse(line, signal, "its label is not among the statements around it.")
        for key, value in self._locals.items():  # variables of the caller with these names
            if value is None:
                self.values.names.pop(key, None)
            else:
                self.values.names[key] = value
        self._locals = before
        changed = {
            self.values.base(m["name"]) for *_, m, e in self._reached(body) if e == "assigns"
        }
        for parameter, argument, key in given:
            if argument and key in changed and argument.strip().isidentifier():
                why = f"{name} of line {line} may have changed {argument} by {parameter}"
                self.values.forget(argument, why)
        return "end" if signal == "end" else None


class _Open(Exception):
    """The program does not decide what runs."""


def _of_lines(numbers: Sequence[int]) -> str:
    more = f" and {len(numbers) - 1} more" if len(numbers) > 1 else ""
    return f"line {numbers[0]}{more}"
