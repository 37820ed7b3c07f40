"""What controllers do with a program: small interpreters that share no code with the package.

A URScript is translated into Python and executed, so that whatever its functions do with their
variables happens. The other three are interpreted line by line with variables that can change.
What an interpreter does not know raises :class:`Unknown`.
"""

import contextlib
import math
import re

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
STEP = 0.002
"""Period of the controller of a UR, s."""


class Unknown(Exception):
    """A statement that the interpreter does not know; the controller may do anything."""


class _Halt(BaseException):
    """The program is over."""


class Motion:
    """Where a program sends the robot.

    Attributes:
        targets: Of its moves, and positions that it streams, one after the other.
    """

    def __init__(self) -> None:
        self.targets: list[list[float]] = []

    @property
    def points(self) -> Array:
        """The targets, (N, 6)."""
        return np.array(self.targets).reshape(-1, 6)


def urscript(text: str) -> Motion:
    """Execute a script; its only function, if nothing stands outside functions."""
    motion = Motion()

    def movej(q: object, a: float = 1.4, v: float = 1.05, t: float = 0.0, r: float = 0.0) -> None:
        del a, v, t, r
        motion.targets.append([float(x) for x in q])  # type: ignore[attr-defined]

    def servoj(q: object, *others: object, **named: object) -> None:
        del others, named
        motion.targets.append([float(x) for x in q])  # type: ignore[attr-defined]

    def halt() -> None:
        raise _Halt

    def nothing(*others: object, **named: object) -> None:
        del others, named

    names: dict[str, object] = {
        "movej": movej, "servoj": servoj, "halt": halt, "get_steptime": lambda: STEP,
        "d2r": math.radians, "True": True, "False": False, "__builtins__": {},
        "get_actual_joint_positions": lambda: [0.0] * 6,
        **dict.fromkeys(
            ("stopj", "textmsg", "sleep", "sync", "popup", "set_tcp", "set_payload",
             "set_digital_out", "set_standard_digital_out"), nothing),
    }  # fmt: skip
    try:
        exec(compile(_as_python(text), "<script>", "exec"), names)
    except _Halt:
        pass
    except (NameError, SyntaxError, TypeError, ValueError, IndexError, RecursionError) as error:
        raise Unknown(f"{error!r}") from error
    return motion


def _as_python(text: str) -> str:
    """A script in Python.

    Every name that is assigned is one variable of the whole script, as ``global`` makes it;
    arguments of functions are their own.
    """
    text = re.sub(r",\s*\n\s*", ", ", text)
    assigned = set(re.findall(r"^\s*(?:global\s+|local\s+)?(\w+)(?:\[\d+\])?\s*=(?!=)", text, re.M))
    lines, depth, defined, outside = [], 0, [], False
    for raw in text.split("\n"):
        code = raw.split("#")[0].strip() if '"' not in raw else raw.strip()
        if code == "end":
            depth -= 1
        if code in ("", "end"):
            continue
        code = re.sub(r"^(global|local)\s+", "", code)
        code = re.sub(r"\bp\[", "[", "halt()" if code == "halt" else code)
        outside |= depth == 0 and not code.startswith("def ")
        lines.append("    " * depth + code)
        if code.endswith(":"):
            depth += 1
            lines.append("    " * depth + "pass")
            if match := re.match(r"def\s+(\w+)\((.*)\)", code):
                defined += [match[1]] if depth == 1 else []
                own = assigned - {name.strip() for name in match[2].split(",")}
                lines[-1] = "    " * depth + (f"global {', '.join(sorted(own))}" if own else "pass")
    if not outside and len(defined) == 1:
        lines.append(f"{defined[0]}()")
    return "\n".join(lines)


def rapid(text: str) -> Motion:
    """Execute a module: main, or its only procedure."""
    text = re.sub(r'"(?:[^"]|"")*"', '""', text)
    text = re.sub(r"!.*", "", text)
    procedures = {
        name.lower(): [each.strip() for each in body.split(";") if each.strip()]
        for name, body in re.findall(r"(?is)\bPROC\s+(\w+)\s*\(\s*\)(.*?)\bENDPROC", text)
    }
    data = re.sub(r"(?is)\bPROC\b.*?\bENDPROC", "", text)
    data = re.sub(r"(?i)\b(END)?MODULE\b(\s+\w+)?", "", data)
    motion, values = Motion(), {}

    def literal(expression: str) -> list[float]:
        expression = expression.strip()
        if expression.lower() in values:
            return list(values[expression.lower()])
        match = re.fullmatch(r"\[\s*\[([^\[\]]*)\]\s*,\s*\[[^\[\]]*\]\s*\]", expression)
        if not match:
            raise Unknown(expression)
        return [float(x) for x in match[1].split(",")]

    def execute(statement: str) -> None:  # noqa: PLR0912
        if match := re.fullmatch(
            r"(?is)(?:CONST|PERS|VAR)\s+(\w+)\s+(\w+)\s*(?::=(.*))?", statement
        ):
            if match[1].lower() == "jointtarget" and match[3]:
                values[match[2].lower()] = literal(match[3])
        elif match := re.fullmatch(r"(?is)(\w+)\.robax\.rax_(\d)\s*:=(.*)", statement):
            if match[1].lower() not in values:
                raise Unknown(statement)
            values[match[1].lower()][int(match[2]) - 1] = float(match[3])
        elif match := re.fullmatch(r"(?is)(\w+)\s*:=(.*)", statement):
            try:
                values[match[1].lower()] = literal(match[2])
            except Unknown:
                if match[1].lower() in values or "(" in match[2]:
                    raise
        elif match := re.match(r"(?is)MoveAbsJ\s*(?:\\Conc\s*,)?\s*(\[.*?\]\s*\]|\w+)", statement):
            motion.targets.append(literal(match[1]))
        elif re.match(r"(?i)(EXIT)\b", statement):
            raise _Halt
        elif re.match(
            r"(?i)(SetDO|TPWrite|WaitTime|ConfJ|VelSet|Stop|WaitDI|GripLoad)\b", statement
        ):
            pass
        elif statement.lower() in procedures:
            for each in procedures[statement.lower()]:
                if each.upper() == "RETURN":
                    return
                execute(each)
        else:
            raise Unknown(statement)

    try:
        for statement in data.split(";"):
            if statement.strip():
                execute(statement.strip())
        execute("main" if "main" in procedures else next(iter(procedures)))
    except _Halt:
        pass
    return motion


def krl(text: str) -> Motion:
    """Execute the first program of a file."""
    motion, values = Motion(), {}
    procedures: dict[str, list[str]] = {}
    name = ""
    for raw in text.split("\n"):
        code = raw.split(";")[0].strip()
        if match := re.fullmatch(r"(?i)(?:GLOBAL\s+)?DEF\s+(\w+)\s*\(\s*\)", code):
            name = match[1].upper()
            procedures[name] = []
        elif code.upper() == "END":
            name = ""
        elif code and name:
            procedures[name].append(code)
        elif code and not code.startswith("&"):
            raise Unknown(code)
    here = [0.0] * 6

    def literal(expression: str) -> list[float]:
        expression = expression.strip()
        if expression.upper() in ("$AXIS_ACT", "$POS_ACT"):
            return list(motion.targets[-1] if motion.targets else here)
        if expression.upper() in values:
            return list(values[expression.upper()])
        if not expression.startswith("{"):
            raise Unknown(expression)
        found = dict(re.findall(r"A([1-6])\s+(-?[\d.]+)", expression))
        return [float(found[str(axis)]) for axis in range(1, 7)]

    def execute(code: str) -> None:  # noqa: PLR0912
        if match := re.fullmatch(r"(?i)S?PTP\s*(\{.*?\}|(?<=\s)[$\w]+)(\s+C_\w+)*", code):
            if not match[1].startswith("$"):
                motion.targets.append(literal(match[1]))
        elif match := re.fullmatch(r"(?i)(?:DECL\s+)?E6AXIS\s+(\w+)\s*(?:=(.*))?", code):
            if match[2]:
                values[match[1].upper()] = literal(match[2])
        elif match := re.fullmatch(r"(?i)(\w+)\.A([1-6])\s*=(.*)", code):
            if match[1].upper() not in values:
                raise Unknown(code)
            values[match[1].upper()][int(match[2]) - 1] = float(match[3])
        elif match := re.fullmatch(r"(?i)(\w+)\s*=(?!=)(.*)", code):
            if match[1].upper() in values or "(" in match[2] or "{" in match[2]:
                values[match[1].upper()] = literal(match[2])
        elif match := re.fullmatch(r"(?i)(\w+)\s*\(\s*\)", code):
            if match[1].upper() not in procedures:
                raise Unknown(code)
            for each in procedures[match[1].upper()]:
                if each.upper() == "RETURN":
                    return
                execute(each)
        elif not re.match(
            r"(?i)(PTP_SPLINE$|TIME_BLOCK|ENDSPLINE|GLOBAL INTERRUPT DECL 3|INTERRUPT ON 3|BAS"
            r"|\$OUT|\$VEL|\$ADVANCE|WAIT|HALT|\$OV_PRO|\$TOOL)", code,
        ):  # fmt: skip
            raise Unknown(code)

    for code in procedures[next(iter(procedures))]:
        if code.upper() == "RETURN":
            break
        execute(code)
    return motion


def tp(text: str, beside: dict[str, str]) -> Motion:
    """Execute a TP program, with those beside it by their names in capitals."""
    motion = Motion()

    def run(text: str, depth: int) -> None:
        body = re.search(r"(?ms)^/MN\s*$(.*?)^/POS\s*$(.*?)^/END", text)
        if not body or depth > 30:
            raise Unknown("no TP program")
        points = {}
        for number, inside in re.findall(r"(?s)P\[(\d+)[^\]]*\]\s*\{(.*?)\}", body[2]):
            found = dict(re.findall(r"J([1-6])\s*=\s*(-?[\d.]+)", inside))
            points[number] = [float(found[str(axis)]) for axis in range(1, 7)]
        for line in body[1].split("\n"):
            for part in line.split(";"):
                code = re.sub(r"^\s*\d*\s*:", "", part).strip()
                if not code or code.startswith(("!", "//")):
                    continue
                if match := re.match(r"J\s+P\[(\d+)", code):
                    motion.targets.append(list(points[match[1]]))
                elif match := re.fullmatch(r"P\[(\d+)\]=P\[(\d+)\]", code):
                    points[match[1]] = list(points[match[2]])
                elif match := re.fullmatch(r"CALL\s+(\w+)", code):
                    if match[1].upper() not in beside:
                        raise Unknown(code)
                    run(beside[match[1].upper()], depth + 1)
                elif code == "ABORT":
                    raise _Halt
                elif code == "END":
                    return
                elif not re.match(r"(DO\[|R\[|WAIT|UTOOL_NUM|OVERRIDE|PAUSE|MESSAGE)", code):
                    raise Unknown(code)

    with contextlib.suppress(_Halt):
        run(text, 0)
    return motion
