"""Variables and expressions of G-code."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable
from functools import lru_cache
from types import CodeType

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened

LOCALS = 30
"""LinuxCNC: #1 to #30 belong to a subprogram, and are 0 unless they are arguments."""
_SET = re.compile(r"\s*#\s*(\[[^=]*\]|<[^<>]*>|[0-9]+)\s*=\s*(.+)$")
_REFERENCE = re.compile(r"#\s*(<[^<>]*>|[0-9]+)")
_TERM = re.compile(r"#\s*(<[^<>]*>|[0-9]+)|(?<![A-Z0-9_.])(?:[0-9]+\.?[0-9]*|\.[0-9]+)")
_OPERATORS = {
    "MOD": "%", "EQ": "==", "NE": "!=", "GT": ">", "GE": ">=", "LT": "<", "LE": "<=",
    "AND": " and ", "OR": " or ",
}  # fmt: skip
_OPERATOR = re.compile(rf"(?<![A-Z_])({'|'.join(_OPERATORS)})(?![A-Z_])")


_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "SIN": lambda a: math.sin(math.radians(a)), "COS": lambda a: math.cos(math.radians(a)),
    "TAN": lambda a: math.tan(math.radians(a)), "ASIN": lambda v: math.degrees(math.asin(v)),
    "ACOS": lambda v: math.degrees(math.acos(v)), "SQRT": math.sqrt, "ABS": abs, "EXP": math.exp,
    "LN": math.log, "FIX": math.floor, "FUP": math.ceil,
    "ROUND": lambda v: math.floor(abs(v) + 0.5) * math.copysign(1.0, v),
}  # fmt: skip
_NODES = (
    ast.Expression, ast.Constant, ast.UnaryOp, ast.BinOp, ast.BoolOp, ast.Compare, ast.Call,
    ast.Name, ast.Load, ast.operator, ast.unaryop, ast.boolop, ast.cmpop,
)  # fmt: skip


class Variables:
    """Values of #1, #<name>.

    Attributes:
        local: Those of the subprogram that runs, by number or ``<name>``.
    """

    def __init__(self) -> None:
        self.local: dict[str, float] = {}
        self._global: dict[str, float] = {}

    def _home(self, name: str) -> dict[str, float]:
        """FANUC and LinuxCNC: below #31 and names without _ are local, others global."""
        if name.startswith("<"):
            return self._global if name.startswith("<_") else self.local
        return self.local if int(name) <= LOCALS + 3 else self._global

    def get(self, name: str) -> float:
        """The value of a variable.

        Raises:
            InvalidInput: If the file does not set it.
        """
        found = self._home(name).get(name)
        if found is None:
            raise InvalidInput(
                f"#{name.lower()} has no value in this file: it is one of the machine's, or of the "
                "program that calls this one"
            )
        return found

    def value(self, text: str) -> float:
        """The value of an expression.

        Raises:
            InvalidInput: If it has none.
        """
        try:
            known = {**_FUNCTIONS, "ATAN": _atan, "V": self.get, "I": self._indirect}
            found = float(eval(_compiled(text), {"__builtins__": {}}, known))
        except (SyntaxError, NameError, TypeError, RecursionError, MemoryError) as error:
            raise InvalidInput(f"{shortened(text)!r} is not computed") from error
        except (ArithmeticError, ValueError) as error:
            raise InvalidInput(f"{shortened(text)!r} has no value: {error}") from error
        if not math.isfinite(found):
            raise InvalidInput(f"{shortened(text)!r} has no finite value")
        return found

    def _indirect(self, number: float) -> float:
        """#[…]: the variable of a number that is computed."""
        return self.get(str(round(number)))

    def brackets(self, text: str) -> list[float]:
        """The values of ``[a] [b] …``."""
        found, at = [], 0
        while (start := text.find("[", at)) >= 0:
            at = _closing(text, start)
            found.append(self.value(text[start:at]))
        return found

    def resolved(self, text: str) -> str:
        """A block with numbers in place of variables and expressions; sets variables."""
        values = []
        while (found := _SET.match(text)) is not None:
            # Several of a line, FANUC's #1=0#2=5, get the values from before the line.
            rest = re.split(r"(?<=[0-9.\]>\s])(?=#\s*[0-9<]+[^#=\]]*=[^=])", found[2], maxsplit=1)
            name = found[1]
            if name.startswith("["):
                name = str(round(self.value(name)))
            values.append((_name(name), self.value(rest[0])))
            text = rest[1] if len(rest) > 1 else ""
        for name, value in values:
            self._home(name)[name] = value
        out, at = [], 0
        for start in range(len(text)):
            if start < at or text[start] not in "[#":
                continue
            end = start + 1 if text[start] == "#" else start
            if end < len(text) and text[end] == "[":
                end = _closing(text, end)
            elif (reference := _REFERENCE.match(text, start)) is not None:
                end = reference.end()
            else:
                raise InvalidInput(f"{shortened(text[start:])!r} is not computed")
            value = self.value(text[start:end])
            before = text[at:start]
            if re.search(r"[-+]\s*$", before):  # Y-#1
                sign, before = before.rstrip()[-1], before.rstrip()[:-1]
                value = -value if sign == "-" else value
            out += [before, f"{value:.9f}"]
            at = end
        return "".join([*out, text[at:]])


@lru_cache(maxsize=10_000)
def _compiled(text: str) -> CodeType:
    """An expression in Python, with V and I for the values of variables.

    Raises:
        SyntaxError: If it has something else than numbers, variables, operators and functions.
    """
    plain = re.sub(r"\s+(?![^<]*>)", "", text).replace("[", "(").replace("]", ")")
    plain = re.sub(r"ATAN(\((?:[^()]|\([^()]*\))*\))/(\((?:[^()]|\([^()]*\))*\))",
                   r"ATAN(\1,\2)", plain)  # fmt: skip
    plain = _OPERATOR.sub(lambda found: _OPERATORS[found[1]], plain.replace("#(", "I("))
    tree = ast.parse(_TERM.sub(_term, plain), mode="eval")
    if not all(isinstance(node, _NODES) for node in ast.walk(tree)):
        raise SyntaxError
    return compile(tree, "", "eval")


def _term(found: re.Match[str]) -> str:
    """A variable or a number as Python writes it."""
    return f"V({_name(found[1])!r})" if found[1] else repr(float(found[0]))


def _name(text: str) -> str:
    """A variable's name without blanks and leading zeros."""
    return re.sub(r"\s+", "", text).upper() if text.startswith("<") else str(int(text))


def _atan(y: float, x: float = 1.0) -> float:
    """FANUC and LinuxCNC: ATAN[y]/[x], degrees."""
    return math.degrees(math.atan2(y, x))


def _closing(text: str, start: int) -> int:
    """Where the bracket at ``start`` is closed: the place after it."""
    depth = 0
    for k in range(start, len(text)):
        depth += {"[": 1, "]": -1}.get(text[k], 0)
        if depth == 0:
            return k + 1
    raise InvalidInput(f"{shortened(text[start:])!r} has no closing bracket")
