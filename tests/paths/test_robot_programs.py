"""What of a robot program is read, assumed and refused; true paths are in the corpus."""

import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from qp_twist.errors import InvalidInput
from qp_twist.paths import Toolpath, read_toolpath

TAIL = "[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"


def rapid(body: str, data: str = "") -> str:
    targets = "".join(
        f"CONST robtarget p{k}:=[[{500 + 10 * k},{k * k},300],[0,1,0,0],{TAIL};\n" for k in range(4)
    )
    return f"MODULE M\n{targets}{data}PROC main()\n{body}\nENDPROC\nENDMODULE\n"


def move(number: int, word: str = "MoveL", wobj: str = "") -> str:
    return f"{word} p{number},v100,z1,tool0{wobj};\n"


def krl(body: str) -> str:
    return f"DEF path( )\n$VEL.CP=0.1\n{body}\nEND\n"


LIN = "LIN {{X {},Y 0,Z 300,A 0,B 0,C 180}}\n"


def fanuc(
    lines: str, point: str = "X = 1.0 mm, Y = 2.0 mm, Z = 3.0 mm, W = 0 deg, P = 0 deg, R = 0 deg"
) -> str:
    other = point.replace("1.0 mm", "9.0 mm")
    return (
        f"/PROG A\n/ATTR\n/MN\n{lines}\n/POS\nP[1]{{\n GP1:\n UF : 1, UT : 1,\n {point}\n}};\n"
        f"P[2]{{\n GP1:\n UF : 1, UT : 1,\n {other}\n}};\n/END\n"
    )


def jbi(moves: str) -> str:
    return (
        "/JOB\n//NAME A\n//POS\n///POSTYPE BASE\nC00001=1,2,3,180,0,0\nP00001=1,2,9,180,0,0\n"
        f"///POSTYPE PULSE\nC00002=1,2,3,4,5,6\n//INST\n{moves}END\n"
    )


def read(folder: Path, name: str, text: str, **options: object) -> Toolpath:
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return read_toolpath(file, **options)


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("a.mod", rapid(move(0) + "IF di1=1 THEN\n" + move(1) + "ENDIF\n" + move(2)),
         "line 9: 'MoveL p1,v100,z1,tool0' runs or not by 'IF di1=1 THEN' of line 8"),
        ("a.mod", rapid("IF di1=1 work;\n" + move(1), "PROC work()\n" + move(0) + "ENDPROC\n"),
         "'IF di1=1 work': is not read, and may move"),
        ("a.mod", rapid(move(0) + move(1, wobj="\\WObj:=w1")),
         "line 8: it moves in w1, before in wobj0"),
        ("a.mod", rapid(move(0) + "MoveL pick,v100,z1,tool0;"),
         "line 8: the file does not state pick"),
        ("a.mod", rapid("VAR robtarget q;\n" + move(0) + "MoveL q,v100,fine,tool0;"),
         "q is declared in line 7 without a value"),
        ("a.mod", rapid("IF di1=1 THEN\nshift;\nENDIF\n" + move(0) + move(1),
                        "PROC shift()\np1:=Offs(p1,0,0,9);\nENDPROC\n"),
         "p1 .line 7. depends on 'IF di1=1 THEN'"),
        ("a.mod", rapid("SearchL di1,q,p1,v20,tool0;\n" + move(1)), "line 7: 'SearchL"),
        ("a.mod", rapid("PDispOn p1,tool0;\n" + move(0) + move(1)), "line 7: 'PDispOn"),
        ("a.mod", rapid("DrillAt p1,v100;\n" + move(0) + move(1)),
         "line 7: 'DrillAt.*has coordinates"),
        ("a.mod", rapid("MoveAbsJ home,v100,fine,tool0;\n" + move(1, "MoveJ")),
         "only joint moves in it.*qp-twist check PROGRAM TASK"),
        ("a.mod", rapid(move(0) + f"MoveL [[1,2,3],[0,2,0,0],{TAIL},v100,fine,tool0;"),
         "line 8: its quaternion has the length 2"),
        ("a.mod", rapid(move(0) + "MoveC p0,p1,v100,fine,tool0;"), "line 8: two points of the arc"),
        ("a.mod", rapid("MoveC p1,p2,v100,fine,tool0;"), "line 7: where the arc begins"),
        ("a.mod", rapid("main;\n" + move(0)), "main calls main"),
        ("a.mod", rapid("FOR i FROM 1 TO 1e9 DO\nx:=1;\nENDFOR\n" + move(0)), "2,000 statements"),
        ("a.mod", rapid("FOR i FROM 1 TO 3 DO\n" + move(0)), "has no end; a line was lost"),
        ("a.src", krl(LIN.format(1) + "LIN XP1"), "line 4: the file does not state xp1"),
        ("a.src", krl("WHILE $IN[1]\n" + LIN.format(1) + "ENDWHILE"),
         "line 4: 'LIN .* runs or not by"),
        ("a.src", krl("LIN {X 1,Y 2,Z 3}"), "leaves out some of X, Y, Z, A, B, C"),
        ("a.src", krl("LIN {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}"), "expected a position"),
        ("a.src", krl("BAS(#BASE,1)\n" + LIN.format(1) + "BAS(#BASE,2)\n" + LIN.format(2)),
         "line 6: it moves in base 2, before in base 1"),
        ("a.src", krl(LIN.format(1) + "GOTO again"), "line 4: 'GOTO again'"),
        ("a.ls", fanuc("1:L P[1] 10mm/sec FINE ;\n2:L PR[3] 10mm/sec FINE ;"),
         "line 5: 'L PR.*a register"),
        ("a.ls", fanuc("1:L P[1] 10mm/sec FINE Offset,PR[1] ;"), "line 4: .*Offset,PR"),
        ("a.ls", fanuc("1:L P[1] 1mm/sec FINE ;\n2:IF DI[1]=ON,JMP LBL[2] ;\n3:L P[2] 1mm/sec;"),
         "line 5: .*decides by what is not in the file"),
        ("a.ls", fanuc("1:L P[1] 10mm/sec FINE ;", "J1 = 0 deg, J2 = 0 deg"), "joint angles"),
        ("a.ls", fanuc("1:L P[7] 10mm/sec FINE ;"), "line 4: there is no P.7. under /POS"),
        ("a.jbi", jbi("MOVL C00002 V=10.0\n"), "line 10: .*pulses or angles"),
        ("a.jbi", jbi("MOVL C00001\nMOVC C00001\nMOVL C00001\n"), "an arc is three MOVC"),
        ("a.jbi", jbi("JUMP *A IF IN#(1)=ON\n"), "line 10: .*JUMP decides here which lines run"),
        ("a.jbi", jbi("SET P001 P002\nMOVL P001 V=10.0\n"), "line 11: .*the job changes it"),
        ("a.script", "def a():\n  movel([0,-1,1,0,0,0], a=1)\nend\n", "line 2: expected a pose"),
        ("a.script", "def a():\n  movel(pose_trans(get_tcp_pose(), p[0,0,0,0,0,0]), v=1)\nend\n",
         "line 2: the file does not state get_tcp_pose"),
        ("a.script", "def a():\n  x = 0\n  while x < 3:\n  movel(p[0.1,0,0,0,0,0])\n  end\nend\n",
         "2,000 statements"),
        ("a.script", "def a():\n  speedl([0,0,0.1,0,0,0], 0.5, 1)\nend\n", "line 2: 'speedl"),
    ],
)  # fmt: skip
def test_what_the_file_does_not_decide_is_refused_with_its_line(
    tmp_path: Path, name: str, text: str, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("qp_twist.programs.program._MOST", 2000)  # a hundredth, which is quicker
    with pytest.raises(InvalidInput, match=sentence):
        read(tmp_path, name, text)


def test_what_is_assumed_and_passed_over_is_said(tmp_path: Path) -> None:
    """Words without coordinates do not stop the reading of a program; each is in a sentence."""
    body = 'WHILE TRUE DO\nSpindleOn 9000;\nIF di1=1 THEN\nTPWrite "on";\nENDIF\n'
    body += move(0) + move(1) + "ENDWHILE"
    toolpath = read(tmp_path, "a.mod", rapid(body))
    [curve] = toolpath.curves
    np.testing.assert_allclose(curve.positions, [[0.5, 0, 0.3], [0.51, 0.001, 0.3]])
    assumed = " ".join(toolpath.assumptions)
    for sentence in ("(line 7) is for ever: read once", "taken to move nothing: SpindleOn (line 8)",
                     "coordinates are in wobj0", "z is taken as the tool's axis"):  # fmt: skip
        assert sentence in assumed
    assert "IF" in toolpath.passed_over[0] and "z1 (2)" in toolpath.passed_over[0]


def test_a_call_that_is_not_known_is_refused_while_moves_of_the_file_are_never_called(
    tmp_path: Path,
) -> None:
    body = "Path_20;\n" + move(0) + move(1)
    with pytest.raises(InvalidInput, match=r"line 10: 'Path_20': .*path_10 is never called"):
        read(tmp_path, "a.mod", rapid(body, "PROC Path_10()\n" + move(2) + "ENDPROC\n"))


def test_a_joint_move_begins_another_curve(tmp_path: Path) -> None:
    """To a position it leads there; to joint angles, to where the file does not say."""
    body = move(0, "MoveJ") + move(1) + move(2, "MoveJ") + move(3) + "MoveAbsJ h,v100,fine,tool0;\n"
    toolpath = read(tmp_path, "a.mod", rapid(body + move(1) + move(0)))
    assert [len(curve) for curve in toolpath.curves] == [2, 2, 2]
    assert any(
        "where the file does not state the tool (line 11)" in a for a in toolpath.assumptions
    )


def test_points_of_the_data_file_beside_a_krl_program(tmp_path: Path) -> None:
    (tmp_path / "PART.DAT").write_text(
        "DEFDAT PART\nDECL E6POS XP1={X 1.0,Y 2.0,Z 3.0,A 0,B 0,C 180,S 2,T 35,E1 0}\n"
        "DECL E6POS XP2={X 1.0,Y 9.0,Z 3.0,A 0,B 0,C 180}\n"
        'DECL FDAT FP1={TOOL_NO 1,BASE_NO 4,IPO_FRAME #BASE,POINT2[] " "}\nENDDAT\n'
    )
    body = "FDAT_ACT=FP1\nBAS(#CP_PARAMS,0.5)\nLIN XP1 C_DIS\nLIN XP2"
    toolpath = read(tmp_path, "part.src", krl(body))
    [curve] = toolpath.curves
    np.testing.assert_allclose(curve.positions, [[1e-3, 2e-3, 3e-3], [1e-3, 9e-3, 3e-3]])
    assert curve.feeds is not None and curve.feeds[1] == 0.5
    assert "coordinates are in base 4." in toolpath.assumptions


@pytest.mark.parametrize("name", ["columns", "feed_unit", "rotary"])
def test_options_of_other_formats_are_refused(tmp_path: Path, name: str) -> None:
    value = {"columns": "position=1,2,3", "feed_unit": "mm/s", "rotary": "head-ac"}[name]
    with pytest.raises(InvalidInput, match=f"states it itself; leave {name} out"):
        read(tmp_path, "a.mod", rapid(move(0) + move(1)), **{name: value})


def test_a_zipped_program_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "a.urp").write_bytes(gzip.compress(b"<URProgram/>"))
    with pytest.raises(InvalidInput, match="this is no text file"):
        read_toolpath(tmp_path / "a.urp")


def test_a_function_that_moves_is_not_passed_over_inside_an_expression(tmp_path: Path) -> None:
    draws = "def f():\n movel(p[0.1,0,0,0,0,0])\n return 1\nend\n"
    moves = " movel(p[0,0,0,0,0,0])\n movel(p[0.2,0,0,0,0,0])\n"
    for used in ("x = f()", "g(f())"):
        text = f"{draws}def g(a):\nend\ndef main():\n{moves} {used}\nend\n"
        with pytest.raises(InvalidInput, match="f, which moves, inside an expression"):
            read(tmp_path, "a.script", text)


@pytest.mark.parametrize("number", ["1e308", "1e13", "-1e300"])
def test_numbers_beyond_arithmetic_are_no_pose(tmp_path: Path, number: str) -> None:
    text = f"movel(p[{number},0,0,0,0,0])\nmovel(p[0,0,0,0,0,0])\n"
    with pytest.raises(InvalidInput):
        read(tmp_path, "a.script", text)


def test_a_frame_that_is_moved_is_another_frame(tmp_path: Path) -> None:
    data = 'PERS wobjdata w1:=[FALSE,TRUE,"",[[100,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n'
    moves = move(0, wobj="\\WObj:=w1") + move(1, wobj="\\WObj:=w1")
    body = moves + "w1.uframe.trans.x:=300;\n" + move(1, wobj="\\WObj:=w1")
    (curve,) = read(tmp_path, "a.mod", rapid(body, data)).curves
    assert (1e3 * curve.positions[:, 0]) == pytest.approx([600, 610, 810])


SCRIPT = (
    "def a():\n  i = 0\n  {}\n    movel(p[0.01 * i, 0, 0.3, 3.1416, 0, 0])\n    i = i + 1\n{}"
    "  end\nend\n"
)
TARGET = "[[10*i,0,300],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.script", SCRIPT.format("while (i < 3):", "")),
        ("a.script", SCRIPT.format("while True:", "    if i == 3:\n      break\n    end\n")),
        ("a.mod", f"MODULE M\nPROC main()\nVAR num i;\nWHILE i < 3 DO\nMoveL {TARGET}\n"
                  "i := i + 1;\nENDWHILE\nIF i = 4 THEN\nStop;\nMoveL p9,v9,fine,tool0;\nENDIF\n"
                  "ENDPROC\nENDMODULE\n"),
        ("a.src", krl("INT i\ni = 0\nREPEAT\nLIN {X 10*i,Y 0,Z 300,A 0,B 0,C 180}\ni = i + 1\n"
                      "UNTIL i >= 3")),
        ("a.ls", fanuc("1:FOR R[1]=1 TO 3 ;\n2:L P[1] 1mm/sec FINE ;\n3:L P[2] 1mm/sec FINE ;\n"
                       "4:ENDFOR ;")),
        ("a.ls", fanuc("1:R[1:k]=0 ;\n2:LBL[1:go] ;\n3:L P[1] 1mm/sec FINE ;\n4:R[1]=R[1]+1 ;\n"
                       "5:L P[2] 1mm/sec FINE ;\n6:IF R[1]<3,JMP LBL[1] ;")),
    ],
)  # fmt: skip
def test_loops_by_numbers_of_the_program_are_counted(tmp_path: Path, name: str, text: str) -> None:
    [curve] = read(tmp_path, name, text).curves
    x = [1, 9] * 3 if name == "a.ls" else [0, 10, 20]
    assert 1e3 * curve.positions[:, 0] == pytest.approx(x)


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("a.mod", rapid("WHILE n < 3 DO\n" + move(0) + "n:=n+1;\nENDWHILE\n", "PERS num n:=0;\n"),
         "runs or not by 'WHILE n < 3 DO'"),
        ("a.ls", fanuc("1:R[1]=0 ;\n2:CALL PICK ;\n3:IF R[1]=1,JMP LBL[1] ;\n4:L P[1] 1mm/sec ;\n"
                       "5:LBL[1] ;\n6:L P[2] 1mm/sec FINE ;"),
         "line 6: .*decides by what is not in the file"),
        ("a.ls", fanuc("1:L P[1] 1mm/sec FINE ;\n2:P[2]=P[1] ;\n3:L P[2] 1mm/sec FINE ;"),
         "line 6: .*is not in the file"),
    ],
)  # fmt: skip
def test_what_others_may_have_changed_decides_nothing(
    tmp_path: Path, name: str, text: str, sentence: str
) -> None:
    with pytest.raises(InvalidInput, match=sentence):
        read(tmp_path, name, text)


def test_a_program_beside_a_tp_program_is_called(tmp_path: Path) -> None:
    (tmp_path / "part.ls").write_text(fanuc("1:L P[2] 1mm/sec FINE ;"))
    [curve] = read(tmp_path, "a.ls", fanuc("1:L P[1] 1mm/sec FINE ;\n2:CALL PART ;")).curves
    assert 1e3 * curve.positions[:, 0] == pytest.approx([1, 9])


def test_a_function_that_only_returns_may_stand_in_an_expression(tmp_path: Path) -> None:
    text = "def f():\n return 1\nend\ndef main():\n x = f()\n movel(p[0,0,0,0,0,0])\n"
    [curve] = read(tmp_path, "a.script", text + " movel(p[0.2,0,0,0,0,0])\nend\n").curves
    assert len(curve) == 2


def test_variables_of_a_procedure_are_its_own(tmp_path: Path) -> None:
    body = "VAR num x:=1;\nwork 7;\nMoveL Offs(p0,x,0,0),v100,fine,tool0;\n" + move(1)
    work = "PROC work(num x)\nVAR num y:=x;\nENDPROC\n"
    [curve] = read(tmp_path, "a.mod", rapid(body, work)).curves
    assert 1e3 * curve.positions[0, 0] == pytest.approx(501)


SCRIPT_MOVES = " movel(p[0,0,0,0,0,0])\n movel(p[0.2,0,0,0,0,0])\n"
TP_MOVES = "1:L P[1] 10mm/sec FINE ;\n{}\n3:L P[2] 10mm/sec FINE ;"
HELD = (
    'PERS wobjdata held:=[TRUE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n'
    "PERS tooldata fixed:=[FALSE,[[0,0,0],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
)


def between(line: str) -> str:
    return krl(f"{LIN.format(1)}{line}\n{LIN.format(2)}")


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        *(("a.jbi", jbi(f"MOVL C00001\n{line}\nMOVL P00001\n"), f"line 11: .*{sentence}")
          for line, sentence in (
            ("FOR I001=0 TO 3", "FOR decides here"), ("WHILEEXP B000<3", "WHILEEXP decides here"),
            ("IFTHENEXP B000=1", "IFTHENEXP decides"), ("SWITCH B000 CASE 1", "SWITCH decides"),
            ("MOVL P00001 V=5 UNTIL IN#(1)=ON", "MOVL decides here which lines run, or how far"),
            ("CALL JOB:OTHER", "the job OTHER is not read"), ("RET IF IN#(1)=ON", "RET decides"),
            ("PAUSE IF IN#(1)=ON", "PAUSE decides here"), ("TSYNC 1", "may move the robot"))),
        ("a.src", between("$ORI_TYPE=#CONSTANT"), "line 4: .*ORI_TYPE"),
        ("a.src", between("$CIRC_TYPE=#OTHER"), "line 4: .*CIRC_TYPE"),
        ("a.src", krl("S" + LIN.format(1).strip() + " WITH $ORI_TYPE=#JOINT\n"), "the tool turns"),
        ("a.src", between("LDAT_ACT={VEL 2.0,ORI_TYP #CONSTANT,CIRC_TYP #BASE}"),
         "line 4: 'LDAT_ACT"),
        ("a.src", between("FDAT_ACT={TOOL_NO 1,BASE_NO 1,IPO_FRAME #TCP}"),
         "line 4: .*the robot carries the part"),
        ("a.src", krl("INT n\nREAL x\nn=7\nx=n/2\nLIN {X x,Y 0,Z 0,A 0,B 0,C 0}"),
         "7/2 is no whole number.*INT"),
        ("a.src", krl("INT n\nn=2.7\nLIN {X n,Y 0,Z 0,A 0,B 0,C 0}"), "2.7 is no whole number"),
        ("a.src", krl("SWITCH 2\nCASE 2\n" + LIN.format(1) + "ENDSWITCH"), "SWITCH is not read"),
        ("a.mod", rapid("TEST 2\nCASE 2:\n" + move(0) + "ENDTEST\n"), "TEST is not read"),
        ("a.mod", rapid(move(0, wobj="\\WObj:=held") + move(1), HELD), "robot carries the part"),
        ("a.mod", rapid(move(0).replace("tool0", "fixed") + move(1), HELD),
         "line 9: .*the robot carries the part"),
        ("a.ls", fanuc(TP_MOVES.format("2:L P[2] 10mm/sec FINE RTCP ;")),
         "line 5: .*the robot carries the part"),
        ("a.ls", fanuc(TP_MOVES.format("2:IF DI[1]=ON,CALL FOO ;")),
         "line 5: .*decides by what is not in the file"),
        ("a.ls", fanuc(TP_MOVES.format("2:IF (DI[1]=ON) THEN ;\n CALL FOO ;\n ENDIF ;")),
         "line 5: .*a program runs that is not beside the file"),
        ("a.ls", fanuc(TP_MOVES.format("2:IF (DI[1]=ON) THEN ;\n CALL PART ;\n ENDIF ;")),
         "runs or not by 'IF"),
        ("a.src", between("IF $IN[1] THEN\n$BASE=BASE_DATA[2]\nENDIF"),
         "line 7: it moves in a frame that depends on 'IF .IN.1. THEN' of line 4"),
        ("a.src", "DEF path( )\nBASE_DATA[2]=$NULLFRAME\n$BASE=BASE_DATA[2]\n" + LIN.format(1)
         + "IF $IN[1] THEN\nBASE_DATA[2]={X 1,Y 0,Z 0,A 0,B 0,C 0}\nENDIF\n$BASE=BASE_DATA[2]\n"
         + LIN.format(2) + "END\n", "line 9: it moves in base 2 that depends on 'IF"),
        ("a.src", between("INTERRUPT DECL 5 WHEN $IN[1]==TRUE DO GO_OUT()").replace("DEF", (
            "DEF MAIN()\nPATH()\nEND\nDEF GO_OUT()\n" + LIN.format(9) + "END\nDEF"), 1),
         "line 10: .*interrupts that move are not read"),
        ("a.mod", rapid("CONNECT i WITH t;\n" + move(0) + move(1),
                        "TRAP t\n" + move(2) + "ENDTRAP\n"),
         "line 10: .*runs 'MoveL p2.*' of line 7 beside the program"),
        ("a.mod", rapid("n:=-7 DIV 2;\n" + move(0) + "MoveL Offs(p1,n,0,0),v1,fine,tool0;",
                        "VAR num n;\n"), "how the quotient of -7 and 2 is cut off"),
        ("a.script", f"def a():\n thread T():\n  movel(p[0.9,0,0,0,0,0])\n end\n{SCRIPT_MOVES}"
                     " t = run T()\nend\n", "line 7: .*beside the program; threads and"),
        ("a.script", f"def a():\n q=[0,0,0,0]+[1]\n{SCRIPT_MOVES} movel(p[q[4],0,0,0,0,0])\nend",
         "sums and products of lists are not read"),
    ],
)  # fmt: skip
def test_what_a_controller_does_otherwise_than_is_computed_is_refused(
    tmp_path: Path, name: str, text: str, sentence: str
) -> None:
    (tmp_path / "part.ls").write_text(fanuc("1:L P[2] 1mm/sec FINE ;"))
    with pytest.raises(InvalidInput, match=sentence):
        read(tmp_path, name, text)


def offset(x: str) -> str:
    return f"MoveL Offs(p0,{x},0,0),v100,fine,tool0;\n"


@pytest.mark.parametrize(
    ("name", "text", "x"),
    [
        ("a.mod", rapid(f"FOR i FROM 3 TO 1 DO\n{offset('i')}ENDFOR\n"), [503, 502, 501]),
        ("a.mod", rapid(f"FOR i FROM 1 TO 2 DO\n{offset('i')}ENDFOR\n{offset('i')}",
                        "VAR num i:=77;\n"), [501, 502, 577]),
        ("a.mod", rapid(f"VAR pos d;\nd:=[1,2,3]+[10,20,30];\n{offset('d.x')}{move(1)}"),
         [511, 510]),
        ("a.src", krl("INT n\nREAL x\nn=8\nx=7\n" + "".join(
            f"LIN {{X {each},Y 0,Z 300,A 0,B 0,C 180}}\n" for each in ("n/2", "x/2", "7/2.0*2"))),
         [4, 3.5, 7]),
        ("a.ls", fanuc("1:R[1]=2 ;\n2:L P[1] 10mm/sec FINE ;\n3:L P[R[1]] 10mm/sec FINE ;"),
         [1, 9]),
        ("a.jbi", jbi("SET B001 3\nMOVL C00001\nINC B001\nWVON WEV#(1)\nMOVL P00001\n"), [1, 1]),
    ],
)  # fmt: skip
def test_counters_vectors_and_integers_are_those_of_the_language(
    tmp_path: Path, name: str, text: str, x: list[float]
) -> None:
    [curve] = read(tmp_path, name, text).curves
    assert 1e3 * curve.positions[:, 0] == pytest.approx(x)


@pytest.mark.parametrize(
    ("name", "text", "feeds"),
    [
        ("a.src", between("$VEL.CP=$VEL.CP*2"), [0.2]),
        ("a.src", between("IF $IN[1] THEN\n$VEL.CP=0.3\nENDIF"), [math.nan]),
        ("a.src", between("$VEL={CP 0.05,ORI1 200,ORI2 200}"), [0.05]),
        ("a.src", krl(LIN.format(1) + f"SPLINE WITH $VEL.CP=0.3\nS{LIN.format(2)}ENDSPLINE\n"
                      + LIN.format(3)), [0.3, 0.1]),
        ("a.src", between(f"REAL v\nv=0.2\nS{LIN.format(3).strip()} WITH $VEL.CP=v\nv=1"),
         [0.2, 0.1]),
        ("a.ls", fanuc("1:R[1]=5 ;\n2:L P[1] 10mm/sec FINE ;\n3:L P[2] R[1]mm/sec FINE ;"),
         [0.005]),
    ],
)  # fmt: skip
def test_speeds_of_records_splines_and_registers_count(
    tmp_path: Path, name: str, text: str, feeds: list[float]
) -> None:
    [curve] = read(tmp_path, name, text).curves
    found = np.full(len(curve), np.nan) if curve.feeds is None else curve.feeds
    assert found[1:] == pytest.approx(feeds, nan_ok=True)


@pytest.mark.parametrize(("second", "moves"), [(0, False), (30, True)])
def test_external_axes_that_move_are_said(tmp_path: Path, second: int, moves: bool) -> None:
    """Those that stand still are not, whatever the name of the axis."""
    target = "[[{},0,300],[0,1,0,0],[0,0,0,0],[{},9E9,9E9,9E9,9E9,9E9]]"
    lines = [f"MoveL {target.format(k, axis)},v1,fine,tool0;" for k, axis in ((1, 0), (2, second))]
    group = "GP2:\n UF : 2, UT : 1,\n J1 = {} deg\n}};\nP[{}"
    text = fanuc("1:L P[1] 1mm/sec FINE COORD ;\n2:L P[2] 1mm/sec FINE COORD ;")
    text = text.replace("};\nP[2", group.format(0, 2)).replace("};\n/END", (
        group.format(second, 3).partition("P[3")[0] + "/END"))  # fmt: skip
    for name, program, axis in (
        ("a.mod", rapid("\n".join(lines)), "eax_a"),
        ("a.src", krl("".join(
            f"LIN {{X {e},Y 0,Z 300,A 0,B 0,C 180,E1 {e}}}\n" for e in (0, second or "0.0")
        ) + LIN.format(9)), "E1"),
        ("a.ls", text, "GP2_J1"),
    ):  # fmt: skip
        assumed = read(tmp_path, name, program).assumptions
        assert any(f"the external axis {axis} moves" in each for each in assumed) == moves, name


def test_a_tool_that_is_set_or_not_is_said(tmp_path: Path) -> None:
    tool = "IF $IN[1] THEN\n$TOOL=TOOL_DATA[2]\nENDIF"
    assumed = read(tmp_path, "a.src", between(tool)).assumptions
    assert any("(line 5) depends on 'IF $IN[1] THEN' of line 4" in each for each in assumed)


def test_a_wait_that_may_jump_is_taken_to_be_met(tmp_path: Path) -> None:
    lines = TP_MOVES.format("2:WAIT DI[1]=ON TIMEOUT,LBL[9] ;") + "\n4:LBL[9] ;"
    toolpath = read(tmp_path, "a.ls", fanuc(lines))
    assert any("LBL[9]' (line 5) is taken to be met" in each for each in toolpath.assumptions)
