"""A robot program, executed as far as it states what runs.

What it does goes to a :class:`~qp_twist.programs.moves.Moves`. If that is strict, a statement that
is not known is refused wherever it stands, as are branches, loops and variables that change;
otherwise a statement without coordinates is passed over and listed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import nullcontext
from itertools import zip_longest

from qp_twist.errors import InvalidInput
from qp_twist.files import of_lines
from qp_twist.programs.acts import Acts
from qp_twist.programs.listing import Procedure
from qp_twist.programs.loops import rounds
from qp_twist.programs.moves import Moves
from qp_twist.programs.statements import Statements, refuse, shown, split
from qp_twist.programs.values import Undecided, Values

_MOST = 200_000
"""Statements that a program may execute."""
_DEEPEST = 30
"""Calls inside each other."""


class Program(Acts):
    """A program while it is executed. A language is a subclass: patterns of its statements."""

    def __init__(self, values: Values, moves: Moves) -> None:
        super().__init__(values, moves)
        self._called: set[str] = set()
        self._running: list[str] = []
        self._threads: dict[str, Statements] = {}
        self._count = 0
        self._unknown: dict[str, list[int]] = {}

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
        procedures = self.listing.procedures
        first = self.first(self.listing.uncalled())
        if len(first) > 1:
            self._say_order(first)
        for name in first:
            self._call(procedures[name].line, name, [])
        left = [
            name for name, each in procedures.items()
            if name not in self._called and self.listing.moving(each.body)
        ]  # fmt: skip
        for name, (line, *_) in self._unknown.items():
            if left:
                raise refuse(line, name, f"is not known here, and {left[0]} is never called.")
        if self._unknown:
            listed = ", ".join(f"{n} ({of_lines(at)})" for n, at in self._unknown.items())
            self.moves.note(f"not known here, and taken to move nothing: {listed}")
        for name in left:
            self.moves.note(f"{name} (line {procedures[name].line}) is never called, and left out")

    def first(self, uncalled: list[str]) -> list[str]:
        """The procedures that run first, of those that no other calls."""
        if "main" in self.listing.procedures:
            return ["main"]
        return [] if self._called else uncalled

    def _say_order(self, names: Sequence[str]) -> None:
        order, unsaid = ", ".join(names), "nothing says which of these runs"
        if self.moves.strict:
            expected = "expected one main, or one that calls the others."
            raise InvalidInput(f"{unsaid}: {order}; {expected}")
        self.moves.note(f"{unsaid} first; they are read in this order: {order}")

    def check(self, statements: Statements) -> None:
        """Refuse what is not known."""
        self.listing.vouch(statements)

    def run(self, statements: Statements) -> str:
        """Execute statements; the signal of the one that leaves them, if any."""
        k = 0
        while k < len(statements):
            line, text = statements[k]
            k, self._count = k + 1, self._count + 1
            if self._count > _MOST:
                raise InvalidInput(f"the program executes more than {_MOST:,} statements.")
            opened = self.listing.opened(text)
            try:
                if opened is None:
                    act, match, _ = self.listing.act(text)
                    self.before(line, text)
                    signal = act if isinstance(act, str) else act(line, match) or ""
                else:
                    role, match, close = opened
                    end, closing = self.listing.end(statements, k, close)
                    signal = self._block(line, role, match, statements[k:end], closing)
                    k = end + 1
            except InvalidInput as error:
                error.line = line if error.line is None else error.line
                raise
            if signal.startswith("to "):  # a label among these statements, or outside of them
                at = [k for k, (_, label) in enumerate(statements) if signal == f"to {label}"]
                signal, k = ("", at[0]) if at else (signal, k)
            if signal:
                return signal
        return ""

    def before(self, line: int, text: str) -> None:
        """What a controller does before it executes a statement, whatever that is."""

    def call(self, line: int, match: re.Match[str]) -> str | None:
        """A call: groups ``called`` and ``arguments``."""
        name, arguments = match["called"], (match.groupdict().get("arguments") or "").strip()
        self.listing.refuse_calls(line, arguments)
        key = self.values.key(name)
        if key in self.listing.procedures:
            return self._call(line, key, split(arguments) if arguments else [])
        if self.moves.called(line, name) and not arguments:
            return None
        if self.moves.strict:
            raise refuse(
                line, match[0],
                f"calls {name}, which the file does not have; if it switches the process, state it "
                "in [program] calls (--calls).",
            )  # fmt: skip
        if self.listing.has_coordinates(match[0]):
            raise refuse(line, match[0], "is not known here, and has coordinates.")
        for word in re.findall(r"[\w$]+", arguments):  # which it may set
            if self.values.key(word) in self.values.names:
                self.values.forget(word, f"{name} of line {line} may have changed {word}")
        self._unknown.setdefault(name, []).append(line)
        return None

    # ------------------------------------------------------------ blocks

    def _block(
        self, line: int, role: str, match: re.Match[str], body: Statements, closing: re.Match[str]
    ) -> str:
        """Execute a block; its signal."""
        if role == "procedure":
            name = self.values.key(match["name"])
            taken = self.listing.procedures.keys() | self.values.functions.keys()
            if self.moves.strict and name in taken:
                raise refuse(line, match[0], "this name has a meaning already.")
            parameters = [re.findall(r"\w+", part) for part in match["arguments"].split(",")]
            names = [self.parameter(words) for words in parameters if words]
            self.listing.procedures[name] = Procedure(line, names, body)
            return ""
        if role == "once":
            return self.run(body)
        if role == "never":
            self.moves.noted(line, match[0], "passed")
            self._threads[self.values.key(match.groupdict().get("name") or "")] = body
            self.values.shared |= {*map(self.values.base, self.listing.assigning(body))}
            return ""
        if role == "for ever" and not any(
            effect == "leaves"
            for *_, effect in self.listing.reached(body, (*self.listing.procedures,))
        ):
            self.moves.note(f"{shown(match[0])} (line {line}) is for ever: read once")
            return self.run(body) or ("end" if self.listing.moving(body) else "")
        try:
            if role == "if":
                for condition, branch in self.listing.branches(match["condition"], body):
                    if condition is None or self.values.condition(condition):
                        return self.run(branch)
                return ""
            own = role == "for" and self.language.own_counter
            with self.values.scope(match["name"]) if own else nullcontext():
                for _ in rounds(self.values, line, role, match, closing, counts_down=own):
                    signal = self.run(body)
                    if signal not in ("", "continue"):
                        return "" if signal == "break" else signal
        except Undecided:
            word = match[0].split(maxsplit=1)[0]
            why = "which is not decided in the file"
            self._pass_over(line, match[0], body, f"{word} is not read" if role == "open" else why)
        return ""

    def _pass_over(self, line: int, begin: str, body: Statements, why: str) -> None:
        """Pass over what runs or not; then it may not move, nor say where anything is."""
        if moving := self.listing.moving(body):
            raise InvalidInput(
                f"{shown(moving[1])} runs or not by {shown(begin)} of line {line}, {why}; write a "
                "program without it.",
                line=moving[0],
            )
        for name, number in self.listing.assigning(body).items():
            self.values.forget(name, f"{name} (line {number}) depends on {shown(begin)}")
        for number, text, match, effect in self.listing.reached(body):
            if effect in ("setting", "speed"):
                self.unsettle(number, text, match, f"depends on {shown(begin)} of line {line}")
        self.moves.noted(line, begin.split(maxsplit=1)[0], "passed")

    def beside(self, line: int, match: re.Match[str]) -> None:
        """What may run beside the program, or interrupt it: group ``beside``."""
        name = self.values.key(match["beside"])
        own = self.listing.procedures.get(name)
        body = own.body if own else self._threads.get(name, [])
        if moving := self.listing.moving(body, ("joint", "path")):
            raise refuse(
                line, match[0],
                f"runs {shown(moving[1])} of line {moving[0]} beside the program; threads and "
                "interrupts that move are not read.",
            )  # fmt: skip
        self.skip(line, match)

    def parameter(self, words: Sequence[str]) -> str:
        """The name of a parameter, before its kind or default value."""
        return words[0]

    def _call(self, line: int, name: str, arguments: Sequence[str]) -> str | None:
        _, parameters, body = self.listing.procedures[name]
        chain = [*self._running, name]
        if name in self._running or len(chain) > _DEEPEST:
            raise refuse(
                line, " calls ".join(chain),
                f"calls in a circle, or more than {_DEEPEST} inside each other, are not read.",
            )  # fmt: skip
        if len(parameters) < len(arguments):
            raise InvalidInput(f"{name} takes {len(parameters)} arguments, got {len(arguments)}.")
        self._called.add(name)
        given = [(p, a, self.values.base(p)) for p, a in zip_longest(parameters, arguments)]
        with self.values.scope(*parameters):
            for parameter, argument, _ in given:
                self.values.assign(line, parameter, argument or "")
            self._running = chain
            signal = self.run(body)
            self._running = chain[:-1]
        if signal.startswith("to "):
            raise refuse(line, signal, "its label is not among the statements around it.")
        changed = {*map(self.values.base, self.listing.assigning(body))}
        for parameter, argument, key in given:
            if argument and key in changed and argument.strip().isidentifier():
                why = f"{name} of line {line} may have changed {argument} by {parameter}"
                self.values.forget(argument, why)
        return "end" if signal == "end" else None
