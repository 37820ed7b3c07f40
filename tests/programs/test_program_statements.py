"""Any statement at any line of a program: refused, or read as the controller executes it, or noted.

The controllers are small interpreters in ``oracles/controllers.py``. The statements are inserted
into programs of export, with and without their header, and into programs with constants and
procedures, as people write them.
"""

from __future__ import annotations

import random
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from oracles import controllers
from oracles.controllers import STEP, Array, Motion, Unknown

import qp_twist as qt
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories import TimedPath, read_trajectory, write_trajectory

NAMES = tuple(f"j{k}" for k in range(1, 7))
SUFFIX = {"urscript": ".script", "rapid": ".mod", "krl": ".src", "ls": ".ls"}
NONE = "[9E9,9E9,9E9,9E9,9E9,9E9]"
ZERO = {
    "urscript": "[0, 0, 0, 0, 0, 0]",
    "rapid": f"[[0,0,0,0,0,0],{NONE}]",
    "krl": "{A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}",
}
STATEMENTS = {
    "urscript": """
        movej([0, 0, 0, 0, 0, 0])
        movej([0, 0, 0, 0, 0, 0], t=1)
        movej(p1)
        movej(q=p1, a=1, v=1, t=0.5)
        movel([0, 0, 0, 0, 0, 0])
        movej(get_actual_joint_positions())
        servoj([0, 0, 0, 0, 0, 0], t=0.1)
        x = movej([0, 0, 0, 0, 0, 0])
        textmsg(movej([0, 0, 0, 0, 0, 0]))
        textmsg("#"); movej([0, 0, 0, 0, 0, 0])
        textmsg("a", '"'); movej([0, 0, 0, 0, 0, 0])  # '
        set_digital_out(0, True); movej([0, 0, 0, 0, 0, 0])
        set_digital_out(0, True)
        set_tcp(p[0, 0, 0.1, 0, 0, 0])
        textmsg("moves")
        p1 = [0, 0, 0, 0, 0, 0]
        p1 = p2
        p1[0] = 1
        global p1 = [0, 0, 0, 0, 0, 0]
        p1 = p1 + [1, 0, 0, 0, 0, 0]
        p1 = get_actual_joint_positions()
        x = 3
        x = first()
        late = 3.0
        at_q = [0, 0, 0, 0, 0, 0]
        at_w = [9, 9, 9, 9, 9, 9]
        t = 0.5
        q = [0, 0, 0, 0, 0, 0]
        cubic([0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0], 0.1)
        line([0, 0, 0, 0, 0, 0], 0.1)
        start([0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0])
        finish()
        x = finish()
        first()
        second()
        motion()
        halt
        halt()
        return
        end
        def first():
        def movej(q):
        def d2r(x):
        while True:
        if True:
        thread other():
        sleep(1)
        sync()
        stopj(2)
        run first()
        get_steptime = 3
        movej = 3
        d2r = 3
    """,
    "rapid": """
        MoveAbsJ [[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;
        MoveAbsJ [[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs,v100\\T:=1,z0,tool0;
        MoveAbsJ [[0,0,0,0,0,0],[7,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;
        MoveAbsJ p1,v100,z10,tool0;
        MoveAbsJ Offs(p1),v100,z10,tool0;
        MoveL [[0,0,0],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,z10,tool0;
        p1 := p2;
        p1 := [[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
        p1.robax.rax_1 := 60;
        p1 := CJointT();
        VAR jointtarget p1 := [[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
        reg1 := 5;
        reg1 := moveaway();
        first;
        FIRST;
        RETURN;
        Stop;
        SetDO do1,1;
        TPWrite "p1 := p2;";
        TPWrite "a"";MoveAbsJ [[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v1000,z0,tool0;!";
        TPWrite "x!"; MoveAbsJ [[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,z0,tool0;
        WaitTime 1;
        WaitUntil moveaway();
        VelSet 50,500;
        IF TRUE THEN
        PROC third()
        ENDPROC
        ERROR
        DeactUnit ROB_1;
        PDispSet pose1;
        %"first"%;
    """,
    "krl": """
        PTP {A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}
        PTP {E6AXIS: A1 0,A2 0,A3 0,A4 0,A5 0,A6 0,E1 0}
        PTP {A1 0,A2 0,A3 0,A4 0,A5 0,A6 0,E1 5}
        PTP XP1 C_PTP
        PTP $AXIS_ACT
        LIN {X 0,Y 0,Z 0}
        PTP_REL {A1 10}
        XP1 = XP2
        XP1 = {A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}
        xp1.a1 = 0
        XP1 = $AXIS_ACT
        XP1 = AWAY()
        X = 5
        DECL E6AXIS XP1={A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}
        FIRST()
        AWAY()
        motion()
        $OUT[1]=TRUE
        $VEL_AXIS[1]=20
        $TOOL=TOOL_DATA[1]
        $AXIS_ACT.A1=5
        WAIT SEC 1
        WAIT FOR AWAY()
        HALT
        RETURN
        ENDSPLINE
        TIME_BLOCK START
        TIME_BLOCK END = 1
        TRIGGER WHEN DISTANCE=0 DELAY=0 DO AWAY() PRIO=-1
        INTERRUPT DECL 4 WHEN TRUE DO AWAY()
        IF TRUE THEN
        GOTO M
        DEF THIRD()
        MSG[]="; PTP {A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}"
        ;PTP {A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}
    """,
    "ls": """
        J P[1] 100% FINE ;
        J P[1] 20% FINE ACC50 ;
        J P[1] 20% FINE Offset,PR[1] ;
        J PR[1] 20% FINE ;
        L P[1] 100mm/sec FINE ;
        P[1]=P[2] ;
        PR[1]=JPOS ;
        DO[1]=ON ;
        UTOOL[1]=PR[1] ;
        $MCR.$GENOVERRIDE=1 ;
        WAIT 1.00(sec) ;
        WAIT DI[1]=ON TIMEOUT,LBL[1] ;
        CALL PART ;
        CALL AWAY ;
        JMP LBL[1] ;
        IF R[1]=1,CALL PART ;
        PAUSE ;
        END ;
        MESSAGE[J P] ;
        !/POS /END ;
        !x ; J P[1] 100% FINE ;
        //J P[1] 100% FINE ;
    """,
}
LISTED = {program: [s.strip() for s in text.split("\n") if s.strip()]
          for program, text in STATEMENTS.items()}  # fmt: skip


PLACES = 8
"""Lines before which each statement is inserted."""


def waypoints() -> Array:
    rng = np.random.default_rng(7)
    return 0.2 + np.cumsum(rng.uniform(0.01, 0.03, (6, 6)), axis=0)


def joints(program: str) -> ControllerJoints:
    """Axes as they are; a robot without coupling for LS, where the model's are refused."""
    return ControllerJoints(NAMES, np.ones(6), np.zeros(6), robot="own", program=program)


def exported(program: str, folder: Path, header: bool) -> tuple[str, dict[str, str]]:
    q = waypoints()
    rows = TimedPath(NAMES, q, 0.0137 * np.arange(len(q)), np.gradient(q, 0.0137, axis=0))
    path = write_trajectory(rows, folder / f"motion{SUFFIX[program]}", joints(program))
    lines = path.read_text().split("\n")
    if not header:
        comment = re.compile(r"\s*(# (qp|rob|unit|poi|sec|ord|No|\w+ = j)|! |; |\d+:  !)")
        lines = [line for line in lines if not comment.match(line)]
        lines = numbered(lines) if program == "ls" else lines
    return "\n".join(lines), {}


def written(program: str) -> tuple[str, dict[str, str]]:
    """A program with constants, and two procedures that are called in turn."""
    q = waypoints()
    deg = np.degrees(q)
    if program == "urscript":
        lines = [f"p{k} = [{', '.join(f'{x:.8f}' for x in row)}]" for k, row in enumerate(q)]
        for name, part in (("first", range(3)), ("second", range(3, 6))):
            lines += [f"def {name}():", *(f"  movej(p{k}, t=0.5)" for k in part), "end"]
        return "\n".join(
            [*lines, "def motion():", "  first()", "  second()", "end", "motion()"]
        ), {}
    if program == "rapid":
        lines = ["MODULE motion"]
        for k, row in enumerate(deg):
            lines.append(f"VAR jointtarget p{k}:=[[{','.join(f'{x:.6f}' for x in row)}],{NONE}];")
        for name, part in (("first", range(3)), ("second", range(3, 6))):
            moves = [f"  MoveAbsJ p{k},v100,z1,tool0;" for k in part]
            lines += [f"PROC {name}()", *moves, "ENDPROC"]
        return "\n".join(
            [*lines, "PROC main()", "  first;", "  second;", "ENDPROC", "ENDMODULE"]
        ), {}
    if program == "krl":
        lines = ["&ACCESS RVP", "DEF motion( )", "BAS (#INITMOV,0)"]
        for k, row in enumerate(deg):
            axes = ",".join(f"A{i} {x:.6f}" for i, x in enumerate(row, start=1))
            lines.append(f"DECL E6AXIS XP{k}={{{axes}}}")
        lines += ["FIRST( )", "SECOND( )", "END"]
        for name, part in (("FIRST", range(3)), ("SECOND", range(3, 6))):
            lines += [f"DEF {name}( )", *(f"PTP XP{k} C_PTP" for k in part), "END"]
        return "\n".join(lines), {}
    head = "/PROG {}\n/ATTR\n/MN\n{}\n/POS\n{}/END\n"

    def text(name: str, statements: list[str], part: range) -> str:
        points = "".join(
            f"P[{i}]{{\n GP1:\n UF : 0, UT : 1,\n "
            + ", ".join(f"J{a}= {x:.6f} deg" for a, x in enumerate(deg[k], start=1)) + "\n};\n"
            for i, k in enumerate(part, start=1)
        )  # fmt: skip
        return head.format(name, "\n".join(numbered(["0:" + s for s in statements])), points)

    part = [f"J P[{k}] 20% CNT50 ;" for k in (1, 2, 3)]
    main = [*part, "CALL PART ;"]
    return text("MOTION", main, range(3)), {"PART": text("PART", part, range(3, 6))}


def numbered(lines: list[str]) -> list[str]:
    """The lines of a TP program, counted anew."""
    count, found = 0, []
    for line in lines:
        count += bool(re.match(r"\s*\d+:", line))
        found.append(re.sub(r"^LINE_COUNT.*", "", re.sub(r"^\s*\d+:", f"{count:4d}:", line)))
    return found


def inserted(program: str, text: str, statement: str, place: int) -> str | None:
    """The program with a statement before a line; ``None`` where no statement can stand."""
    lines = text.split("\n")
    if program != "ls":
        return "\n".join([*lines[:place], statement, *lines[place:]])
    if not lines[place].strip() or not re.match(r"\s*\d+:|/POS", lines[place]):
        return None
    return "\n".join(numbered([*lines[:place], f" 0:{statement}", *lines[place:]]))


def executed(program: str, text: str, beside: dict[str, str]) -> Motion:
    if program == "ls":
        return controllers.tp(text, beside)
    interpreter = {"urscript": controllers.urscript, "rapid": controllers.rapid,
                   "krl": controllers.krl}[program]  # fmt: skip
    return interpreter(text)


def moved(points: Array) -> Array:
    """Points without repetitions: waits."""
    stays = np.zeros(len(points), bool)
    stays[1:] = (np.abs(np.diff(points, axis=0)) < 1e-12).all(axis=1)
    return points[~stays]


def assert_same(rows: TimedPath, motion: Motion, program: str, what: str) -> None:
    """The motion that is read is the one that is executed."""
    if rows.velocities is None:
        scale = 1.0 if program == "urscript" else np.degrees(1.0)
        q = rows.q if rows.points is None else rows.q[rows.points]
        read, sent = moved(scale * q), moved(motion.points)
        assert len(read) == len(sent), what
        assert read == pytest.approx(sent, abs=1e-9), what
        return
    assert rows.times is not None
    start, *streamed, last = motion.points
    times = STEP * np.arange(len(streamed))
    assert abs(times[-1] + STEP - rows.times[-1]) <= STEP + 1e-9, what
    assert start == pytest.approx(rows.q[0], abs=1e-9), what
    assert np.array(streamed) == pytest.approx(rows.motion.at(times).q, abs=1e-8), what
    assert last == pytest.approx(rows.q[-1], abs=1e-9), what


@pytest.mark.parametrize("base", ["exported", "without_header", "written"])
@pytest.mark.parametrize("program", SUFFIX)
def test_any_statement_at_any_line(program: str, base: str, tmp_path: Path) -> None:
    if base == "written":
        text, beside = written(program)
    else:
        text, beside = exported(program, tmp_path, header=base == "exported")
    path = tmp_path / f"motion{SUFFIX[program]}"
    for name, content in beside.items():
        (tmp_path / f"{name}.ls").write_text(content)
    path.write_text(text)
    rows = read_trajectory(path, None, joints(program))
    assert_same(rows, executed(program, text, beside), program, "unchanged")
    seen: Counter[str] = Counter()
    rng = random.Random(0)
    lines = range(text.count("\n") + 1)
    for statement in LISTED[program]:
        for place in rng.sample(lines, min(PLACES, len(lines))):
            changed = inserted(program, text, statement, place)
            if changed is None:
                continue
            what = f"{statement!r} before line {place + 1}"
            path.write_text(changed)
            try:
                rows = read_trajectory(path, None, joints(program))
            except qt.InvalidInput:
                seen["refused"] += 1
                continue
            try:
                motion = executed(program, changed, beside)
            except Unknown:
                word = re.match(r"[\w$]+", statement)
                assert word, what
                assert any(word[0] in note for note in rows.notes), what
                seen["noted"] += 1
            else:
                assert_same(rows, motion, program, what)
                seen["executed"] += 1
    assert min(seen["refused"], seen["executed"]) > 0, seen


CALLS = {
    "urscript": ("def p{}():\n{}\nend", "p{}()"),
    "rapid": ("PROC p{}()\n{}\nENDPROC", "p{};"),
    "krl": ("DEF p{}( )\n{}\nEND", "p{}( )"),
}


@pytest.mark.parametrize(
    ("program", "count", "words"),
    [("krl", 28, "more than 20,000"), ("ls", 60, "inside each other")],
)
def test_calls_are_bounded(
    program: str, count: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Programs of which each calls the next one twice would move 2^27 times; or go too deep."""
    monkeypatch.setattr("qp_twist.programs.program._MOST", 20_000)  # quicker than 200,000
    times = 2 if count < 30 else 1
    path = tmp_path / f"p0{SUFFIX[program]}"
    if program == "ls":
        point = "P[1]{\n GP1:\n UF : 0, UT : 1,\n J1= 0 deg, J2= 0 deg, J3= 0 deg, J4= 0 deg, " \
                "J5= 0 deg, J6= 0 deg\n};\n"  # fmt: skip
        for k in range(count):
            lines = [f"0:CALL P{k + 1} ;"] * times if k < count - 1 else ["0:J P[1] 20% FINE ;"] * 2
            body = "\n".join(numbered(lines))
            points = "" if k < count - 1 else point
            name = path.with_name(f"p{k}.ls")
            name.write_text(f"/PROG P{k}\n/ATTR\n/MN\n{body}\n/POS\n{points}/END\n")
    else:
        frame, call = CALLS[program]
        move = {
            "urscript": f"movej({ZERO['urscript']})",
            "rapid": f"MoveAbsJ {ZERO['rapid']},v100,fine,tool0;",
            "krl": f"PTP {ZERO['krl']}",
        }[program]
        bodies = ["\n".join([call.format(k + 1)] * times) for k in range(count - 1)] + [move]
        text = "\n".join(frame.format(k, body) for k, body in enumerate(bodies))
        if program == "rapid":
            text = f"MODULE p0\n{text}\nENDMODULE"
        path.write_text(text + ("\np0()" if program == "urscript" else ""))
    with pytest.raises(qt.InvalidInput, match=words):
        read_trajectory(path, None, joints(program))


@pytest.mark.parametrize(
    ("program", "change", "words"),
    [
        ("urscript", ("  second()\n", ""), "second .* never called"),
        (
            "rapid",
            ("MODULE motion", "%%%\n  VERSION:1\n  LANGUAGE:ENGLISH\n%%%\n\nMODULE motion"),
            "",
        ),
        ("rapid", (NONE, "[0,9E9,9E9,9E9,9E9,9E9]"), "external axes stand still, eax_a at 0"),
        ("rapid", (NONE, "[350.5,0,0,0,0,0]"), "eax_a at 350.5"),
        ("rapid", ("  first;", '  ConfJ \\Off; first; TPWrite "!";'), "ConfJ .*TPWrite"),
        ("krl", ("FIRST( )\nS", "PTP $POS_ACT\nPTP $AXIS_ACT\nFIRST( )\nS"), "where the robot is"),
        ("krl", ("XP0 C_PTP", "XP0 C_PTP\nBAS(#TOOL,1)\nBAS(#BASE,0)"), "task's tool.*BAS"),
        (
            "krl",
            ("PTP XP0 C_PTP", "SPTP XP0 WITH $VEL_AXIS[1]=SVEL_JOINT(100.0), $TOOL=STOOL2(FP0)"),
            r"\$VEL_AXIS",
        ),
        ("ls", ("/POS", "   5:  UFRAME_NUM=0 ;\n/POS"), "UFRAME_NUM"),
        ("ls", ("J1=", "E1= 0.000 mm, J1="), "external axes stand still, E1 at 0"),
    ],
)
def test_ordinary_programs_are_read(
    program: str, change: tuple[str, str], words: str, tmp_path: Path
) -> None:
    text, beside = written(program)
    assert change[0] in text
    changed = text.replace(*change)
    for name, content in beside.items():
        (tmp_path / f"{name}.ls").write_text(content)
    path = tmp_path / f"motion{SUFFIX[program]}"
    path.write_text(changed)
    rows = read_trajectory(path, None, joints(program))
    assert re.search(words, "; ".join(rows.notes)), rows.notes
    assert len(rows.q) == (3 if "never" in words else 6)
    assert rows.q[:3] == pytest.approx(waypoints()[:3], abs=1e-7)


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [(2, "[5,0,0,0,0,0]", "external axis eax_a to 5, from 0"), (0, "[5,0,0,0,0,0]", "from 5")],
)
def test_moving_external_axes_are_refused(
    place: int, value: str, words: str, tmp_path: Path
) -> None:
    text, _ = written("rapid")
    lines = text.replace(NONE, "[0,0,0,0,0,0]").split("\n")
    lines[place + 1] = lines[place + 1].replace("[0,0,0,0,0,0]", value)
    path = tmp_path / "motion.mod"
    path.write_text("\n".join(lines))
    with pytest.raises(qt.InvalidInput, match=words):
        read_trajectory(path, None, joints("rapid"))


def test_targets_of_a_data_file_are_constants(tmp_path: Path) -> None:
    """A .dat file declares targets; the program may not change them, whole or in part."""
    text, _ = written("krl")
    data = [line for line in text.split("\n") if line.startswith("DECL")]
    program = "\n".join(line for line in text.split("\n") if not line.startswith("DECL"))
    dat = tmp_path / "MOTION.dat"
    dat.write_text("\n".join(["DEFDAT motion PUBLIC", *data, "ENDDAT"]))
    path = tmp_path / "motion.src"
    path.write_text(program)
    assert read_trajectory(path, None, joints("krl")).q == pytest.approx(waypoints(), abs=1e-7)
    for line in (
        "XP1 = XP2",
        "XP1.A1 = 0",
        f"XP1 = {ZERO['krl']}",
        f"DECL E6AXIS XP1={ZERO['krl']}",
    ):
        path.write_text(program.replace("FIRST( )", f"{line}\nFIRST( )", 1))
        with pytest.raises(qt.InvalidInput, match=r"xp1 is assigned in lines"):
            read_trajectory(path, None, joints("krl"))
    path.write_text(program)
    dat.write_text("\n".join(["DEFDAT motion PUBLIC", *data, "XP1.A1=5", "ENDDAT"]))
    with pytest.raises(qt.InvalidInput, match=r"xp1 is assigned in lines"):
        read_trajectory(path, None, joints("krl"))


@pytest.mark.parametrize("ending", ["\r", "\x1a"])
def test_hidden_line_ends_are_refused(ending: str, tmp_path: Path) -> None:
    """A carriage return or an end of file within a line: controllers differ in what follows."""
    text, _ = written("urscript")
    path = tmp_path / "motion.script"
    path.write_bytes(text.replace("  second()", f"  # x{ending}  second()").encode())
    with pytest.raises(qt.InvalidInput, match="carriage return or an end-of-file mark"):
        read_trajectory(path, None, joints("urscript"))
