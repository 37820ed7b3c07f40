"""Decode text files and split their lines: encoding, delimiter, decimal mark."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from qp_twist.errors import InvalidInput, QpTwistError

_POINT = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
_COMMA = re.compile(r"[+-]?(?:[0-9]+(?:,[0-9]+)?|,[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
_GROUPED = re.compile(
    r"[+-]?[1-9][0-9]{0,2}([.,'\u2019\u00a0\u202f])[0-9]{3}(?:\1[0-9]{3})*(?!\1)([.,])[0-9]+"
)
"""A number with thousands apart and a decimal mark, which shows what either mark means."""
_NOT_FINITE = re.compile(r"[+-]?(?:1\.#)?(?:nan|inf|infinity|ind|qnan)(?:\(\w*\))?", re.IGNORECASE)


@contextmanager
def of_file(name: object) -> Iterator[None]:
    """The boundary of a reader: what it raises about a file's content names the file.

    What no reader foresees (a library's exceptions, numbers beyond a float) is refused as well.
    """
    try:
        yield
    except InvalidInput as error:
        if error.file:  # which this one names
            error.sentence, error.line, error.column, error.key = str(error), None, "", ""
        error.file = str(name)
        raise
    except Exception:
        with own_exceptions(name):
            raise


@contextmanager
def own_exceptions(name: object) -> Iterator[None]:
    """The same boundary for a reader whose messages name the file already."""
    try:
        yield
    except (QpTwistError, Warning):
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        raise InvalidInput(
            f"{name}: its content cannot be read ({type(error).__name__}: {reason}); the file is "
            "damaged, or not of this format."
        ) from error


def text_lines(content: bytes) -> list[str]:
    """The lines of a text, without their ends; UTF-8, UTF-16 with its mark, or Latin-1.

    Raises:
        InvalidInput: If it is empty, or not text.
    """
    marked = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ["utf-16"] if marked else ["utf-8-sig", "latin-1"]:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        # Text may contain form feeds, but no other control characters.
        if any(ord(c) < 32 and c not in "\t\n\r\f\x1a" for c in set(text)):
            break
        if not text.strip():
            raise InvalidInput("the file is empty.")
        text = re.sub("\r+\n", "\n", text.replace("\x1a", ""))
        # Beside ends of other kinds, a carriage return alone is a slip inside a line.
        lone = " " if text.count("\n") > text.count("\r") else "\n"
        return text.replace("\r", lone).split("\n")
    raise InvalidInput("this is no text file: no text in UTF-8, UTF-16 or Latin-1.")


def shortened(text: str, most: int = 90) -> str:
    """A text of a file for a message: its begin and its end, if it is longer than ``most``."""
    if len(text) <= most:
        return text
    return f"{text[: most // 2]} … {text[len(text) - most // 2 :]}"


@dataclass(frozen=True)
class Dialect:
    """Syntax of a line.

    Attributes:
        delimiter: Between the fields; empty for any blanks, ``";,"`` for both of these.
        decimal: The decimal mark, ``"."`` or ``","``.
    """

    delimiter: str
    decimal: str

    @classmethod
    def detected(cls, lines: Sequence[str], least: int, expected: str) -> Dialect:
        """The dialect in which some lines, without comments, have the most numbers.

        Raises:
            InvalidInput: If no line has ``least`` numbers in any dialect.
        """
        marks = [mark for mark in ";\t" if any(mark in line for line in lines)]
        dialects = [cls(delimiter, decimal) for delimiter in marks for decimal in ".,"]
        dialects += [cls(",", "."), cls("", "."), cls("", ",")]
        # "t;x,y,z;q": two commas in a field are no decimal marks.
        if ";" in marks and any(f.count(",") > 1 for line in lines for f in line.split(";")):
            dialects.append(cls(";,", "."))
        scores = [dialect._score(lines, least) for dialect in dialects]
        best = dialects[scores.index(max(scores))]
        if max(scores)[0] == 0:
            count = {1: "a number", 3: "three numbers"}.get(least, f"{least} numbers")
            raise InvalidInput(
                f"no line has {count}; {expected}, separated by commas, semicolons, tabs or blanks."
            )
        return best

    def _score(self, lines: Iterable[str], least: int) -> tuple[int, int]:
        """Count of numbers in the lines with at least that many, minus the other fields in them."""
        numbers = others = 0
        for line in lines:
            fields = [field for field in self.split(line) if field]
            found = sum(self.number(field) is not None for field in fields)
            if found >= least:
                numbers, others = numbers + found, others + len(fields) - found
        return numbers, -others

    def split(self, line: str) -> list[str]:
        """The fields of a line, stripped of blanks and quotes."""
        if self.delimiter == ";,":
            return [field.strip() for field in line.replace(";", ",").split(",")]
        if self.delimiter and '"' in line:
            try:
                found = next(
                    csv.reader([line], delimiter=self.delimiter, skipinitialspace=True), []
                )
                return [field.strip() for field in found]
            except csv.Error:  # a field longer than any number; reported when it is read
                pass
        fields = line.split(self.delimiter) if self.delimiter else line.split()
        return [field.strip().strip('"').strip() for field in fields]

    def names(self, line: str) -> list[str]:
        """The fields of a header line: a unit in brackets belongs to the name before it."""
        if self.delimiter:
            return self.split(line)
        found: list[str] = []
        for field in self.split(line):
            if found and field.startswith(("[", "(")):
                found[-1] += f" {field}"
            else:
                found.append(field)
        return found

    def number(self, field: str) -> float | None:
        """The number in a field, NaN and infinity included; ``None`` for text."""
        field, plain = field.replace("\u2212", "-"), _POINT if self.decimal == "." else _COMMA
        if not plain.fullmatch(field):
            grouped = _GROUPED.fullmatch(field)
            if not grouped or grouped[2] != self.decimal:
                return float("nan") if _NOT_FINITE.fullmatch(field) else None
            field = field.replace(grouped[1], "")
        return float(field.replace(",", ".").replace("d", "e").replace("D", "e"))


def of_lines(numbers: Sequence[int]) -> str:
    """Lines of a file for a message: the first one, and how many more there are."""
    more = f" and {len(numbers) - 1} more" if len(numbers) > 1 else ""
    return f"line {numbers[0]}{more}"
