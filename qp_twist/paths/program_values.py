"""Variables and expressions of programs: FANUC, LinuxCNC, SINUMERIK, Klartext."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from types import CodeType

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened

LOCALS = 33
"""FANUC and LinuxCNC: #1 to #33 belong to a subprogram."""
NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)"
_NAME = r"#\s*(?:<[^<>]*>|[0-9]+)|(?<![A-Z0-9_.])(?:R|Q[LR]?)[0-9]+"
_TERM = re.compile(rf"({_NAME})|(?<![A-Z0-9_.])(?:[0-9]+\.?[0-9]*|\.[0-9]+)")
_PLACED = re.compile(rf"({_NAME})|\$([0-9]+)")
"""A variable, or the place of a number."""
_OPERATORS = {
    "MOD": "%", "DIV": "//", "EQ": "==", "NE": "!=", "GT": ">", "GE": ">=", "LT": "<", "LE": "<=",
    "AND": " and ", "OR": " or ",
}  # fmt: skip
_OPERATOR = re.compile(rf"(?<![A-Z_])({'|'.join(_OPERATORS)})(?![A-Z_])")
FUNCTIONS: dict[str, Callable[..., float]] = {
    "SIN": lambda a: math.sin(math.radians(a)), "COS": lambda a: math.cos(math.radians(a)),
    "TAN": lambda a: math.tan(math.radians(a)), "ASIN": lambda v: math.degrees(math.asin(v)),
    "ACOS": lambda v: math.degrees(math.acos(v)),
    "ATAN": lambda y, x=1.0: math.degrees(math.atan2(y, x)),
    "ATAN2": lambda y, x: math.degrees(math.atan2(y, x)),
    "SQRT": math.sqrt, "SQ": lambda v: v * v, "POT": lambda v: v * v, "ABS": abs, "EXP": math.exp,
    "LN": math.log, "FIX": math.floor, "FUP": math.ceil, "INT": math.trunc, "TRUNC": math.trunc,
    "ROUND": lambda v: math.floor(abs(v) + 0.5) * math.copysign(1.0, v),
}  # fmt: skip
_BARE = re.compile(rf"\b(?!ATAN2\s*\()({'|'.join(FUNCTIONS)})\s*([+-]?\s*(?:{_NAME}|\$[0-9]+))")
"""Klartext: a function of a term without brackets."""
_QUOTIENT = re.compile(r"ATAN\s*(\((?:[^()]|\([^()]*\))*\))\s*/\s*(\((?:[^()]|\([^()]*\))*\))")
"""FANUC and LinuxCNC: ATAN[y]/[x]."""
_NODES = (
    ast.Expression, ast.Constant, ast.UnaryOp, ast.BinOp, ast.BoolOp, ast.Compare, ast.Call,
    ast.Name, ast.Load, ast.operator, ast.unaryop, ast.boolop, ast.cmpop,
)  # fmt: skip
_SET = re.compile(r"(#\s*(?:\[[^=]*\]|<[^<>]*>|[0-9]+))\s*=(?!=)")
_NEXT_WORD = re.compile(r"<[^<>]*>|(?<![A-Z_])([A-Z@^])(?=\s*[-+]?\s*[#\[0-9.])")
"""Names, and words behind a value that is set."""
_INDEXED = re.compile(r"(?<![A-Z0-9_])R\[\s*([0-9]+)\s*\]")
"""SINUMERIK: R[1] is R1."""
_COMPUTED = re.compile(r"[-+]?\s*(?:#\s*(?:<[^<>]*>|[0-9]+|(?=\[))|(?=\[))")
_FACTOR = rf"[-+]?\s*(?:R[0-9]+|{NUMBER}|(?:{'|'.join(FUNCTIONS)})?\s*\((?:[^()]|\([^()]*\))*\))"
_FORMULA = re.compile(
    rf"(?:(?<![A-Z0-9_])(R[0-9]+)\s*=|(=|[ID]C\s*\(|AC\s*\())\s*({_FACTOR}(?:\s*(?:\*\*|[-+*/]|DIV(?![A-Z])|MOD(?![A-Z]))\s*{_FACTOR})*)"
)
"""SINUMERIK: a parameter that is set, or a word that has a formula."""


class Variables:
    """Values of ``#1``, ``#<name>``, ``R1`` (SINUMERIK) and ``Q1`` (Klartext).

    Attributes:
        local: Those of the subprogram that runs.
    """

    def __init__(self) -> None:
        self.local: dict[str, float] = {}
        self._shared: dict[str, float] = {}
        self._lacks: dict[str, str] = {}  # why a variable that is set has no value

    def _home(self, name: str) -> dict[str, float]:
        inner = name[1:].isdecimal() and int(name[1:]) <= LOCALS
        of_call = name[0] == "#" and (inner or re.match("#<[^_]", name) is not None)
        return self.local if of_call else self._shared

    def set(self, name: str, value: float) -> None:
        """Give a variable a value."""
        name = _name(name)
        self._home(name)[name] = value

    def forget(self, name: str, why: str) -> None:
        """A variable has a value that is not known here."""
        name = _name(name)
        self._home(name).pop(name, None)
        self._lacks[name] = why

    def get(self, name: str) -> float:
        """The value of a variable."""
        found = self._home(name).get(name)
        if found is None:
            why = self._lacks.get(name) or (
                "it is one of the machine's, of a measurement, or of the program that calls this "
                "one"
            )
            shown = name.lower() if name[0] == "#" else name
            raise InvalidInput(f"{shown} has no value in this file: {why}")
        return found

    def value(self, text: str) -> float:
        """The value of an expression."""
        numbers = list[float]()  # which differ where the formula does not: it is compiled once

        def taken(found: re.Match[str]) -> str:
            if found[1]:
                return found[0]
            numbers.append(float(found[0]))
            return f"${len(numbers) - 1}"

        known = {"V": self.get, "I": lambda number: self.get(f"#{round(number)}"),
                 "N": numbers.__getitem__}  # fmt: skip
        try:
            found = float(
                eval(
                    _compiled(_TERM.sub(taken, text)),
                    {"__builtins__": {}, **FUNCTIONS, "WHOLE": _whole},
                    known,
                )
            )
        except (SyntaxError, NameError, TypeError, RecursionError, MemoryError) as error:
            raise InvalidInput(f"{shortened(text)!r} is not computed") from error
        except (ArithmeticError, ValueError) as error:
            raise InvalidInput(f"{shortened(text)!r} has no value: {error}") from error
        if not math.isfinite(found):
            raise InvalidInput(f"{shortened(text)!r} has no finite value")
        return found

    def brackets(self, text: str) -> list[float]:
        """The values of ``[a] [b] …``."""
        found, at = [], 0
        while (start := text.find("[", at)) >= 0:
            at = _closing(text, start)
            found.append(self.value(text[start:at]))
        return found

    def resolved(self, text: str) -> str:
        """A block of G-code with numbers in place of variables and formulas; it sets variables.

        Its settings of ``#`` count behind it: its words have the values from before (LinuxCNC).
        """
        text, *parts = _SET.split(_INDEXED.sub(r"R\1", text))
        settings = {}
        for name, part in zip(parts[::2], parts[1::2], strict=True):
            inner = name.lstrip("# ")
            end = next((k.start() for k in _NEXT_WORD.finditer(part) if k[1]), len(part))
            to = f"#{round(self.value(inner))}" if inner[0] == "[" else name
            settings[to] = self.value(part[:end])
            text += f" {part[end:]}"
        if re.search(r"(?<![A-Z0-9_])R[0-9]+\s*=", text) and re.search(
            r"(?<![A-Z0-9_])[A-QS-Z][A-Z0-9]*\s*=[^=]*(?<![A-Z0-9_])R[0-9]+(?![0-9]|\s*=)", text
        ):
            raise InvalidInput(
                "an R parameter is set in a block whose words use one; write it in a block of its "
                "own"
            )
        text = _FORMULA.sub(self._formula, text)
        out, at = [], 0
        while (found := _COMPUTED.search(text, at)) is not None:
            end = _closing(text, found.end()) if text[found.end() :][:1] == "[" else found.end()
            out += [text[at : found.start()], f"{self.value(text[found.start() : end]):.9f}"]
            at = end
        for name, value in settings.items():
            self.set(name, value)
        return "".join([*out, text[at:]])

    def _formula(self, found: re.Match[str]) -> str:
        value = self.value(found[3])
        if found[1]:
            self.set(found[1], value)
            return ""
        return f"{found[2]}{value:.9f}"


@lru_cache(maxsize=10_000)
def _compiled(text: str) -> CodeType:
    """An expression in Python, with V and I for the values of variables."""
    plain = text.replace("[", "(").replace("]", ")").replace("^", "**").replace("<>", "!=")
    plain = _BARE.sub(r"\1(\2)", _QUOTIENT.sub(r"ATAN(\1,\2)", plain))
    plain = _OPERATOR.sub(lambda found: _OPERATORS[found[1]], re.sub(r"#\s*\(", "I(", plain))
    tree = ast.parse(_PLACED.sub(_term, plain).strip(), mode="eval")
    if not all(isinstance(node, _NODES) for node in ast.walk(tree)):
        raise SyntaxError
    whole = ast.fix_missing_locations(_WholeQuotients().visit(tree))
    return compile(whole, "", "eval")


class _WholeQuotients(ast.NodeTransformer):
    """Writes DIV and MOD as a call that refuses what controls compute differently."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if not isinstance(node.op, ast.FloorDiv | ast.Mod):
            return node
        kind = ast.Constant(type(node.op).__name__)
        return ast.Call(ast.Name("WHOLE", ast.Load()), [kind, node.left, node.right], [])


def _whole(kind: str, one: float, other: float) -> float:
    """DIV or MOD of numbers that are not below 0, or whose quotient is whole."""
    quotient, rest = divmod(one, other)
    if rest and min(one, other) < 0.0:
        raise ValueError("controls differ in how a quotient below 0 is cut off")
    return rest if kind == "Mod" else quotient


def _term(found: re.Match[str]) -> str:
    """A variable or a number as Python gets it."""
    return f"V({_name(found[1])!r})" if found[1] else f"N({found[2]})"


def _name(text: str) -> str:
    """A variable's name without blanks and leading zeros."""
    text = re.sub(r"\s+", "", text).upper()
    return re.sub(r"^(#|R|Q[LR]?)0+(?=[0-9])", r"\1", text)


def _closing(text: str, start: int) -> int:
    """Where the bracket at ``start`` is closed: the place after it."""
    depth = 0
    for k in range(start, len(text)):
        depth += {"[": 1, "]": -1}.get(text[k], 0)
        if depth == 0:
            return k + 1
    raise InvalidInput(f"{shortened(text[start:])!r} has no closing bracket")


def numbers_of(call: str, texts: Sequence[int] = ()) -> list[float | None]:
    """The arguments of a call such as ``CYCLE81(5,0,1,-3)``; ``None`` where one is left out.

    Args:
        call: The call.
        texts: Indices of arguments that are texts, which are left out.
    """
    found: list[float | None] = []
    for k, text in enumerate(call.partition("(")[2].rstrip(") ").split(",")):
        bare = "" if k in texts else text.strip()
        if bare and not re.fullmatch(NUMBER, bare):
            raise InvalidInput(f"{call}: expected numbers, got {shortened(bare)!r}")
        found.append(float(bare) if bare else None)
    return found
