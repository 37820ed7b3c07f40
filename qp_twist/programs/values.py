"""Variables of a robot program, and its expressions as far as the program states their values."""

from __future__ import annotations

import ast
import json
import math
import operator
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from functools import lru_cache
from typing import Any

import mink
import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.programs.statements import NUMBER, shown

_ALONG = 1e-9
"""Cosine of an angle of ±90°, beside which two others turn about the same axis."""
LARGEST_NUMBER = 1e12
"""A coordinate beyond it is no pose."""
_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Mod: operator.mod,
    ast.Div: operator.truediv, ast.FloorDiv: operator.floordiv, ast.MatMult: operator.matmul,
    ast.USub: operator.neg, ast.UAdd: operator.pos, ast.Not: operator.not_,
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge,
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.And: all, ast.Or: any,
}  # fmt: skip
_WORD = re.compile(r"[\w$]+")
_NUMBER = re.compile(NUMBER, re.ASCII)
_OF_PYTHON = re.compile(r"'|(?<![\w$])\.?\d[\d.]*[$_xXoObBjJ]", re.ASCII)
"""Numbers of Python alone, 1_000, 0x10, 1j, and its texts."""


class Unknown(InvalidInput):
    """The program does not state a value: an input, a register, data of another file."""


class Undecided(Exception):
    """The program does not decide what runs."""


class Pose(list[Any]):
    """A pose of URScript, ``p[x, y, z, rx, ry, rz]``, which a list of joint positions is not."""


class Values:
    """Variables, and expressions of a language, evaluated as Python's after a translation.

    Attributes:
        key: A variable's name as a name of Python.
        functions: By name.
        names: Values of variables; :class:`Unknown` where the program does not state one.
        kept: Variables whose value another run or program may have changed: it decides nothing.
        shared: Variables that something beside the program assigns, likewise, at any time.
        adds_vectors: Whether sums of three numbers are those of vectors; other lists have none.
        kinds: The declared types, if the language has integers (``int``, ``real``, …).
    """

    def __init__(
        self,
        key: Callable[[str], str],
        translate: Callable[[str], str],
        functions: Mapping[str, Callable[..., Any]],
        literal: Callable[[str], Any],
        comparison: Sequence[tuple[str, str]] = (),
    ) -> None:
        """``literal``: what only numbers are, else ``None``; ``comparison``: in Python's words."""
        self.key, self.functions = key, functions
        self._translate = lru_cache(maxsize=4096)(translate)
        self._literal, self._comparison = literal, comparison
        self.names: dict[str, Any] = {}
        self.kept: set[str] = set()
        self.shared: set[str] = set()
        self._local: dict[str, Any] = {}
        self.adds_vectors = False
        self.kinds: dict[str, str] | None = None

    def value(self, text: str) -> Any:
        """The value of an expression.

        Raises:
            Unknown: If something in it has no value, or it is not understood.
        """
        text = text.strip()
        if _NUMBER.fullmatch(text):
            return self._number(int(text) if text.lstrip("+-").isdecimal() else float(text))
        literal = self._literal(text)
        return self._evaluated(text) if literal is None else literal

    def number(self, text: str) -> float:
        """The number that an expression is; nan if the program does not state it."""
        try:
            return float(self.value(text))
        except (Unknown, TypeError, ValueError):
            return math.nan

    def condition(self, text: str) -> bool:
        """Whether a condition holds.

        Raises:
            Undecided: If the program does not state that.
        """
        for pattern, replacement in self._comparison:
            text = re.sub(pattern, replacement, text)
        words = set(map(self.key, _WORD.findall(text)))
        try:
            found = self._evaluated(text.strip())
        except Unknown as error:
            raise Undecided from error
        if words & (self.kept | self.shared) or not isinstance(found, bool):
            raise Undecided
        return found

    def _evaluated(self, text: str) -> Any:
        if _OF_PYTHON.search(text):
            raise Unknown(f"{shown(text)} has no number as the language writes it")
        try:
            return self._of(_parsed(self._translate(self.key(text))))
        except InvalidInput:
            raise
        except Exception as error:  # of Python's parser and operators
            raise Unknown(f"the file does not state {shown(text)}") from error

    def assign(self, line: int, target: str, text: str) -> None:
        """Assign to a variable or a component; what has no value is remembered as such."""
        try:
            value, name = self._typed(target, self.value(text)), self.key(target.strip())
            if isinstance(value, list | dict) and self._literal(text.strip()) is None:
                value = deepcopy(value)  # it may be another variable's
            node = None if name.isidentifier() else _parsed(self._translate(name))
            if node is None:
                self.names[name] = value
            elif isinstance(node, ast.Subscript):
                if isinstance(node.value, ast.Name) and isinstance(
                    self.names.get(node.value.id), Unknown | None
                ):
                    self.names[node.value.id] = {}  # an array that is only declared
                self._of(node.value)[self._place(node)] = value
            else:
                raise Unknown(f"{shown(target)} is not understood")
        except Exception as error:  # a component that the variable does not have is one, too
            why = error.sentence if isinstance(error, Unknown) else "it is not understood"
            self.forget(target, f"{target} of line {line}: {why}")
        self.kept.discard(self.base(target))

    def forget(self, target: str, why: str) -> None:
        """A variable has no value any more that the file states."""
        self.names[self.base(target)] = Unknown(why)

    @contextmanager
    def scope(self, *targets: str) -> Iterator[None]:
        """Behind it, these variables and all that was :meth:`local` have their values of before."""
        outer, self._local = self._local, {}
        for target in targets:
            self.local(self.base(target))
        try:
            yield
        finally:
            for name, value in self._local.items():
                if value is None:
                    self.names.pop(name, None)
                else:
                    self.names[name] = value
            self._local = outer

    def local(self, name: str) -> None:
        """A variable is one of this scope."""
        self._local.setdefault(name, self.names.get(name))

    def base(self, target: str) -> str:
        """The variable of which a target is a part."""
        match = _WORD.search(self.key(target))
        return match[0] if match else ""

    def _of(self, node: ast.AST) -> Any:
        match node:
            case ast.Constant(value):
                return self._number(value)
            case ast.Name(name):
                found = self.names.get(name, Unknown(f"the file does not state {name}"))
                if isinstance(found, Unknown):
                    raise found
                return found
            case ast.List(elements) | ast.Tuple(elements):
                return [self._of(element) for element in elements]
            case ast.UnaryOp(sign, operand):
                return _OPERATORS[type(sign)](self._of(operand))
            case ast.BinOp(left, sign, right):
                return self._combined(type(sign), self._of(left), self._of(right))
            case ast.Compare(left, [sign], [right]):
                return _OPERATORS[type(sign)](self._of(left), self._of(right))
            case ast.BoolOp(sign, operands):
                return _OPERATORS[type(sign)]([self._of(operand) for operand in operands])
            case ast.Subscript(ast.Name("p"), ast.Tuple(elements)):
                return Pose(self._of(element) for element in elements)
            case ast.Subscript(array):
                return self._of(array)[self._place(node)]
            case ast.Call(ast.Name(name), arguments, keywords) if name in self.functions:
                words = {str(word.arg): self._of(word.value) for word in keywords}
                return self.functions[name](*map(self._of, arguments), **words)
        raise Unknown(f"the file does not state {ast.unparse(node)}")

    def _number(self, value: Any) -> Any:
        """A constant; whole ones are integers only where the language has such."""
        return float(value) if type(value) is int and self.kinds is None else value

    def _combined(self, sign: type, one: Any, other: Any) -> Any:
        if isinstance(one, list) or isinstance(other, list):
            both = isinstance(one, list) and isinstance(other, list) and len(one) == len(other) == 3
            if not (self.adds_vectors and both and sign in (ast.Add, ast.Sub)):
                raise Unknown("sums and products of lists are not read")
            return [self._combined(sign, a, b) for a, b in zip(one, other, strict=True)]
        if sign is ast.Div and type(one) is type(other) is int:
            if one % other:
                raise Unknown(
                    f"{one}/{other} is no whole number, and quotients of INT, which are cut off, "
                    f"are not read; write {one}/{other}.0 if both may be REAL"
                )
            return one // other
        if sign in (ast.FloorDiv, ast.Mod) and one % other and min(one, other) < 0:
            raise Unknown(
                f"languages differ in how the quotient of {one:g} and {other:g} is cut off"
            )
        return _OPERATORS[sign](one, other)

    def _typed(self, target: str, value: Any) -> Any:
        """A value as the declared type of a variable has it."""
        kind = (self.kinds or {}).get(self.base(target))
        if kind == "int" and isinstance(value, float):
            if value != int(value):
                raise Unknown(f"{value:g} is no whole number, and it is INT")
            return int(value)
        return float(value) if type(value) is int and (kind == "real" or "." in target) else value

    def _place(self, node: ast.Subscript) -> Any:
        place = self._of(node.slice)
        return int(place) if isinstance(place, float) else place


@lru_cache(maxsize=4096)
def _parsed(text: str) -> ast.AST:
    with warnings.catch_warnings():  # of numbers that run into words, which no language has
        warnings.simplefilter("error")
        return ast.parse(text.strip(), mode="eval").body


IN_DEGREES: dict[str, Callable[..., Any]] = {
    "sin": lambda a: math.sin(math.radians(a)), "cos": lambda a: math.cos(math.radians(a)),
    "tan": lambda a: math.tan(math.radians(a)), "sqrt": math.sqrt, "abs": abs,
}  # fmt: skip
"""Functions of languages whose angles are degrees."""


def pose_of(position: Sequence[float], wxyz: Sequence[float], scale: float = 1e-3) -> mink.SE3:
    """A pose from a position, in units of ``scale`` m, and a quaternion.

    Raises:
        Unknown: If they are no three and four finite numbers.
        InvalidInput: If the quaternion's length is not 1 within 1 %.
    """
    numbers = [*map(float, wxyz), *map(float, position)]
    if len(numbers) != 7 or not all(abs(x) <= LARGEST_NUMBER for x in numbers):
        raise Unknown(f"{numbers} is no pose")
    length = math.hypot(*numbers[:4])
    if abs(length - 1.0) > 0.01:
        raise InvalidInput(f"its quaternion has the length {length:.4g} instead of 1")
    return mink.SE3(
        np.array([*(q / length for q in numbers[:4]), *(scale * x for x in numbers[4:])])
    )


def zyx_quaternion(*angles_deg: float) -> tuple[float, float, float, float]:
    """The quaternion (w, x, y, z) of R_z(a) R_y(b) R_x(c), as half the angles make it."""
    (cz, sz), (cy, sy), (cx, sx) = (
        (math.cos(half), math.sin(half)) for half in (math.radians(a) / 2.0 for a in angles_deg)
    )
    return (
        cz * cy * cx + sz * sy * sx, cz * cy * sx - sz * sy * cx,
        cz * sy * cx + sz * cy * sx, sz * cy * cx - cz * sy * sx,
    )  # fmt: skip


def zyx_angles(rotation: mink.SO3) -> tuple[float, float, float]:
    """The angles a, b, c of R = R_z(a) R_y(b) R_x(c), degrees; c = 0 where b is ±90°."""
    R = rotation.as_matrix()
    level = math.hypot(R[0, 0], R[1, 0])
    b = math.atan2(-R[2, 0], level)
    if level < _ALONG:
        return math.degrees(math.atan2(-R[0, 1], R[1, 1])), math.degrees(b), 0.0
    found = math.atan2(R[1, 0], R[0, 0]), b, math.atan2(R[2, 1], R[2, 2])
    return tuple(map(math.degrees, found))  # type: ignore[return-value]


def fixed(value: float, decimals: int) -> str:
    """A number with so many decimals; 0 without a sign."""
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


_JSON = json.JSONDecoder(parse_int=float)


def list_literal(text: str) -> Any:
    """A list of numbers and lists; of URScript also a pose; ``None`` if it is none."""
    is_pose = text[:2] == "p["
    if not (is_pose or text[:1] == "["):
        return None
    try:
        found = _JSON.decode(text[is_pose:])
    except (ValueError, RecursionError):  # .5 and 5. are no numbers of JSON
        return None
    return (Pose(found) if is_pose else found) if isinstance(found, list) else None
