"""Files of TP programs: sections, numbered lines, remarks, and the programs that they call."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet

from qp_twist.errors import InvalidInput
from qp_twist.files import of_file, text_lines
from qp_twist.programs.joint_moves import Beside
from qp_twist.programs.listing import Procedure
from qp_twist.programs.moves import Moves
from qp_twist.programs.program import Program
from qp_twist.programs.statements import Statements, refuse, split
from qp_twist.programs.values import Values

MORE = ".."
"""Mark of a remark that continues the one above."""
_SECTION = re.compile(r"/(PROG\b.*|ATTR|APPL|MN|POS|END)\s*", re.ASCII)
_ATTRIBUTES = frozenset(
    ("OWNER", "COMMENT", "PROG_SIZE", "CREATE", "MODIFIED", "FILE_NAME", "VERSION", "LINE_COUNT",
     "MEMORY_SIZE", "PROTECT", "STORAGE", "STACK_SIZE", "TASK_PRIORITY", "TIME_SLICE",
     "BUSY_LAMP_OFF", "ABORT_REQUEST", "PAUSE_REQUEST", "DEFAULT_GROUP", "CONTROL_CODE",
     "LOCAL_REGISTERS")
)  # fmt: skip
"""Keys under /ATTR."""
_ATTRIBUTE = re.compile(r'\s*(?:TCD\s*:)?\s*(\w+)\s*=\s*(?:"[^"]*"|[^";{}=]*)\s*[;,]?\s*', re.ASCII)
_STATEMENT = re.compile(r"\s*\d*\s*:|\s*[JLCA]\s+PR?\[", re.ASCII)
"""A line of the program, or of what it moves to."""
_POINT = re.compile(r"P\[\s*(\d+)\s*(?::[^\]]*)?\]\s*\{(.*?)\}\s*;", re.DOTALL | re.ASCII)


class TpFiles(Program):
    """A program with its files: that of its own, and those of the programs that it calls.

    Attributes:
        comments: Remarks.
    """

    def __init__(self, values: Values, moves: Moves, beside: Beside) -> None:
        super().__init__(values, moves)
        self.comments: list[str] = []
        self._beside = beside
        self._points: dict[str, dict[int, str]] = {}
        self._labels: set[str] = set()

    def read(self, lines: Sequence[str], key: str = "") -> Statements:
        """The statements of a program; its points are kept."""
        strict = self.moves.strict
        name, parts = _parts(lines)
        texts = {part: "\n".join(text for _, text in each) for part, each in parts.items()}
        order = [part for part in parts if part != "APPL"]
        sections = ["", "PROG", "ATTR", "MN", "POS", "END"]
        beside = (texts[""] + texts.get("END", "")).strip()
        if "MN" not in parts or (strict and (order != sections or beside)):
            raise InvalidInput("this is no TP program: expected /PROG, /ATTR, /MN, /POS and /END.")
        found = _statements(parts["MN"], strict=strict)
        tail = texts.get("POS", "")
        points = self._points[key] = dict[int, str]()
        for match in _POINT.finditer(tail):
            if int(match[1]) in points and strict:
                at, _ = parts["POS"][tail.count("\n", 0, match.start())]
                raise InvalidInput(f"P[{match[1]}] stands twice.", line=at)
            points[int(match[1])] = match[2]
        self._labels |= {text for _, text in found if text.startswith("LBL")}
        if strict:
            self._check_attributes(parts)
            self._check_file(name, texts, found, points.keys())
        return found

    def _check_attributes(self, parts: Mapping[str, Sequence[tuple[int, str]]]) -> None:
        """Refuse lines above the program that are not of there, and so would not run."""
        for part in ("PROG", "ATTR", "APPL"):
            for number, line in parts.get(part, ()):
                attribute = _ATTRIBUTE.fullmatch(line)
                if line.strip() and not (attribute if part == "ATTR" else part == "APPL"):
                    raise refuse(number, line, f"is no attribute, but stands under /{part}.")
                if _STATEMENT.match(line):
                    raise refuse(number, line, f"stands under /{part}, where nothing is executed.")
                if attribute and part == "ATTR" and attribute[1] not in _ATTRIBUTES:
                    self.moves.note(f"{attribute[1]} under /ATTR, line {number}, is not known")

    def _check_file(
        self, name: str, texts: Mapping[str, str], found: Statements, points: AbstractSet[int]
    ) -> None:
        """Refuse a program of which a line was lost or added."""
        for number, text in found:
            self._remark(number, text)
        count = re.search(r"LINE_COUNT\s*=\s*(\d+)", texts["ATTR"], re.ASCII)
        if count and int(count[1]) != len(found):
            raise InvalidInput(
                f"{name}: LINE_COUNT is {count[1]}, but there are {len(found)} lines; a line was "
                "lost or added."
            )
        mask = re.search(r"DEFAULT_GROUP\s*=\s*([^;\n]*)", texts["ATTR"], re.ASCII)
        groups = {1, *map(int, re.findall(r"\bGP(\d)\s*:", texts["POS"]))}
        stated = {k for k, x in enumerate(split(mask[1] if mask else ""), 1) if x == "1"}
        if mask and points and stated != groups:
            raise InvalidInput(
                f"{name}: DEFAULT_GROUP is {mask[1]}, but its points are of motion group "
                f"{' and '.join(map(str, sorted(groups)))}; the controller would move others."
            )
        if left := _POINT.sub("", texts["POS"]).strip():
            raise InvalidInput(f"under /POS, something is left that is no point: {left[:60]!r}.")
        used = {int(n) for _, text in found for n in re.findall(r"\bP\[\s*(\d+)", text)}
        if unused := sorted(points - used):
            raise InvalidInput(
                f"{name}: no line moves to P[{unused[0]}]; a line was lost, or the point is left "
                "over."
            )

    def _remark(self, number: int, statement: str) -> None:
        """Collect a remark; one that continues the remark above is joined with it."""
        if re.match("!|//|--", statement):
            text = statement.lstrip("!/-")
            if text.startswith(MORE) and self.comments:
                self.comments[-1] += " " + text.removeprefix(MORE)
            else:
                self.comments.append(text)
        elif not statement.isascii():
            raise refuse(number, statement, "expected ASCII characters outside remarks.")

    def _load(self, name: str) -> bool:
        """Read a program beside this one, if it is there."""
        key = name.lower()
        if key not in self.listing.procedures:
            content = self._beside(f"{name}.ls")
            if content is None:
                return False
            with of_file(f"{name}.ls"):
                statements = self.read(text_lines(content), key)
                if self.moves.strict:
                    self.check(statements)
            self.listing.procedures[key] = Procedure(1, [], statements)
            self.load_called(statements)
        return True

    def load_called(self, statements: Statements) -> None:
        """Read the programs that statements call, as far as they are beside this one."""
        for _, text in statements:
            if called := re.search(r"\b(?:CALL|RUN)\s+(\w+)", text, re.IGNORECASE):
                self._load(called[1])


def label_of(text: str) -> str:
    """A label without its comment: LBL[1:next] is LBL[1]."""
    return re.sub(r"\s*\[\s*(\d+)[^\]]*\].*", r"[\1]", text.upper())


def _parts(lines: Sequence[str]) -> tuple[str, dict[str, list[tuple[int, str]]]]:
    """The program's name, and the numbered lines of its sections."""
    parts: dict[str, list[tuple[int, str]]] = {"": []}
    section, name = "", ""
    for number, line in enumerate(lines, start=1):
        if match := _SECTION.fullmatch(line):
            section, _, title = match[1].partition(" ")
            name = title.strip() or name
            parts[section] = []
        else:
            parts[section].append((number, line))
    return name, parts


def _statements(lines: Sequence[tuple[int, str]], *, strict: bool) -> Statements:
    """The statements of a program, each with its line in the file.

    A statement ends with a semicolon; a line without a number continues the one above.

    Raises:
        InvalidInput: If that is strict, and a number or a semicolon is missing.
    """
    found: Statements = []
    numbered, open_ = 0, False
    for number, line in lines:
        if not line.strip():
            continue
        match = re.fullmatch(r"\s*(\d*)\s*:([^;]*)(;?)\s*", line, re.ASCII)
        if strict:
            numbered += bool(match and match[1])
            wrong = "expected a line of a TP program, NUMBER: … ;, with one statement."
            if match and open_ and match[1]:
                wrong = "the line above has no semicolon at its end."
            elif match and match[1] and int(match[1]) != numbered:
                wrong = f"expected line number {numbered}; a line was lost or added."
            elif match and not match[3] and re.match(r"\s*(?:!|//|--)", match[2]):
                wrong = "a remark ends with a semicolon on its line."
            elif match:
                wrong = ""
            if wrong:
                raise refuse(number, line, wrong)
        for part in re.findall(r"[^;]+;?", re.sub(r"^\s*\d*\s*:", "", line)):
            code = part.rstrip("; \t").strip()
            if open_:
                found[-1] = found[-1][0], f"{found[-1][1]} {code}".strip()
            elif code or strict:
                found.append((number, code))
            open_ = bool(part.strip()) and not part.rstrip().endswith(";") and bool(found)
    if open_ and strict:
        raise refuse(found[-1][0], found[-1][1], "expected a semicolon at its end.")
    return [(k, label_of(text) if re.match("LBL", text, re.I) else text) for k, text in found]
