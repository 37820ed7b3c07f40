"""Robot programs: round trips, changed programs, programs of others, long ones."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.program_rows import DECIMALS, random_rows

import qp_twist as qt
from qp_twist.programs import DIALECTS, JointMoves, Speed, fanuc_ls
from qp_twist.programs.header import header_lines
from qp_twist.referee import EXCEEDED
from qp_twist.referee.joint_rates import largest_accelerations
from qp_twist.robots import ControllerJoints, named_robot
from qp_twist.shipped import shipped_folder
from qp_twist.trajectories import (
    TimedPath,
    check_trajectory,
    joints_of,
    read_trajectory,
    write_trajectory,
)

PROGRAMS = list(DIALECTS)
SEEDS = st.integers(0, 2**32 - 1)


def suffix(program: str) -> str:
    return {"urscript": ".script", "rapid": ".mod", "krl": ".src", "ls": ".ls"}[program]


@pytest.mark.parametrize("program", PROGRAMS)
@given(seed=SEEDS, cubic=st.booleans())
@settings(max_examples=25, deadline=None)
def test_a_program_gives_back_the_rows_to_the_printed_digit(
    tmp_path_factory: pytest.TempPathFactory, program: str, seed: int, cubic: bool
) -> None:
    rows, joints = random_rows(seed, program, velocities=cubic)
    path = tmp_path_factory.mktemp("program") / f"prog{suffix(program)}"
    write_trajectory(rows, path, joints)
    back = read_trajectory(path, rows.joint_names, joints)
    decimals, of_time = DECIMALS[program]
    unit = 1.0 if program == "urscript" else np.degrees(1.0)
    # What the controller shows is printed to the nearest digit.
    digit = 0.5 * 10.0**-decimals + 1e-12
    shown, given_ = unit * joints.shown(back.q), unit * joints.shown(rows.q)
    assert np.abs(shown - given_).max() <= digit
    assert np.abs(10.0**decimals * shown - np.round(10.0**decimals * shown)).max() < 1e-3
    assert back.times is not None
    assert rows.times is not None
    took = np.diff(back.times)
    meant = np.maximum(np.diff(rows.times), DIALECTS[program].period)
    tick = 10.0**-of_time
    if program == "urscript" and cubic:
        assert np.abs(took - meant).max() <= tick
        assert back.velocities == pytest.approx(rows.velocities, abs=1e-9)
    else:
        assert back.velocities is None
        # Rounded up; a joint is faster by what digits explain.
        assert (took >= meant - 1e-9).all() and (took <= meant + tick + 1e-9).all()
        fastest = (np.abs(np.diff(shown, axis=0)) / took[:, None]).max(axis=0)
        before = (np.abs(np.diff(given_, axis=0)) / meant[:, None]).max(axis=0)
        assert (fastest <= before + 2.0 * digit / meant.min() + 1e-9).all()
    assert back.metadata["task"] == f"task_{seed}"
    # Written again, it is the same text.
    again = path.with_name(f"again{suffix(program)}")
    write_trajectory(dataclasses.replace(back, metadata=rows.metadata), again, joints)
    name = re.compile(r"\b(prog|again|PROG|AGAIN)\b|run_(prog|again)")
    if DIALECTS[program].period <= np.diff(rows.times).min():  # else the header says what is longer
        assert name.sub("", again.read_text()) == name.sub("", path.read_text())


@pytest.mark.parametrize("seed", range(3))
def test_a_script_asks_for_no_more_acceleration_than_the_rows_in_nanoseconds(
    tmp_path: Path, seed: int
) -> None:
    """Bang-bang at a limit, times in whole ns as files state them; rows 0.2 to 1 ms apart."""
    rng = np.random.default_rng(seed)
    exact = np.append(0.0, np.cumsum(1e-3 * rng.uniform(0.2, 1.0, size=20000)))
    a = np.repeat(rng.choice([-3.0, 3.0], size=(200, 6)), 100, axis=0)
    took = np.diff(exact)[:, None]
    v = np.vstack([np.zeros(6), np.cumsum(a * took, axis=0)])
    q = np.vstack([np.zeros(6), np.cumsum(0.5 * took * (v[1:] + v[:-1]), axis=0)])
    names = tuple(f"joint_{k}" for k in range(1, 7))
    rows = TimedPath(names, q, np.round(exact, 9), v)
    joints = ControllerJoints.as_modelled(names)
    write_trajectory(rows, tmp_path / "way.script", joints)
    back = read_trajectory(tmp_path / "way.script", names, joints)
    for each in (rows, back):  # sums of 20,000 steps are themselves some 1e-14 off
        assert largest_accelerations(each.motion)[1].max() <= 3.0 * (1.0 + 10.0 * EXCEEDED)


@pytest.fixture(scope="module")
def deburring(tmp_path_factory: pytest.TempPathFactory) -> tuple[qt.PathTask, TimedPath]:
    """The shipped task with a fourth of its waypoints: a check of 401 takes half a second."""
    file = tmp_path_factory.mktemp("tasks") / "deburring.toml"
    text = (shipped_folder("tasks") / file.name).read_text("utf-8")
    text = text.replace("steps_per_edge = 100", "steps_per_edge = 25")
    file.write_text(text.replace("../scenes", shipped_folder("scenes").as_posix()), "utf-8")
    task = qt.load_task(file)
    assert len(task.waypoints) == 101
    trajectory = qt.refine_trajectory(qt.follow(task, "qp_gradient", slow_down=True))
    return task, TimedPath.of(qt.time_trajectory(trajectory))


@pytest.fixture
def written(
    deburring: tuple[qt.PathTask, TimedPath], tmp_path: Path
) -> Callable[[str], tuple[Path, ControllerJoints]]:
    """The task's trajectory as a program; in other languages than LS with the model's joints."""
    task, rows = deburring

    def write(program: str) -> tuple[Path, ControllerJoints]:
        joints = joints_of(task, rows.joint_names, as_modelled=program != "ls")
        return write_trajectory(rows, tmp_path / f"motion{suffix(program)}", joints), joints

    return write


@pytest.mark.parametrize("program", PROGRAMS)
def test_the_check_of_a_program(
    program: str, deburring: tuple[qt.PathTask, TimedPath],
    written: Callable[[str], tuple[Path, ControllerJoints]],
) -> None:  # fmt: skip
    path, joints = written(program)
    found = check_trajectory(read_trajectory(path, None, joints), deburring[0])
    assert found.passes, found.verdict
    robot = "the Fanuc M-16iB/20 counts them" if program == "ls" else "the model counts them"
    assert robot in found.verdict


POINT = {"urscript": r"  line\(", "rapid": "    MoveAbsJ", "krl": "SPTP", "ls": r"\tJ1="}


def outcome(path: Path, text: str, joints: ControllerJoints, task: qt.PathTask) -> tuple[str, str]:
    """``("refused", why)``, ``("fails", why)`` or ``("passes", verdict)`` of a changed program."""
    path.write_text(text, "utf-8")
    try:
        rows = read_trajectory(path, None, joints)
    except qt.InvalidInput as error:
        return "refused", str(error)
    found = check_trajectory(rows, task)
    return ("passes" if found.passes else "fails"), found.verdict


@pytest.mark.parametrize("program", PROGRAMS)
def test_changed_programs_are_refused_or_fail(
    program: str, deburring: tuple[qt.PathTask, TimedPath],
    written: Callable[[str], tuple[Path, ControllerJoints]],
) -> None:  # fmt: skip
    task = deburring[0]
    path, joints = written(program)
    text = path.read_text("utf-8")
    lines = text.split("\n")
    places = [k for k, line in enumerate(lines) if re.match(POINT[program], line)]
    number = re.compile(r"(?<![\w.])-?\d+\.\d{3,}")
    for place in places[30], places[len(places) // 2], places[-2]:
        line = lines[place]
        values = list(number.finditer(line))[: 3 if place == places[30] else 1]
        for value in values:
            old = value[0]
            flipped = old[1:] if old[0] == "-" else f"-{old}"
            digit = old.index(".") + 1
            other = str((int(old[digit]) + 4) % 10)
            if program == "urscript":  # rad: a tenth is 6°, a thousandth 0.06°
                digit += 1
                other = str((int(old[digit]) + 4) % 10)
            changed = old[:digit] + other + old[digit + 1 :]
            for new in (flipped, changed):
                mutant = [*lines]
                mutant[place] = line[: value.start()] + new + line[value.end() :]
                what, why = outcome(path, "\n".join(mutant), joints, task)
                assert what in ("fails", "refused"), (old, new, why)
        for mutant in (lines[:place] + lines[place + 1 :], lines[:place] + lines[place:place + 1]
                       + lines[place:]):  # fmt: skip
            assert outcome(path, "\n".join(mutant), joints, task)[0] == "refused"
    # Every angle in another unit.
    scale = np.degrees(1.0) if program == "urscript" else np.radians(1.0)

    def converted(match: re.Match[str]) -> str:
        return f"{scale * float(match[0]):.10f}"

    begin = places[0]
    other_unit = lines[:begin] + [number.sub(converted, line) for line in lines[begin:]]
    assert outcome(path, "\n".join(other_unit), joints, task)[0] in ("fails", "refused")
    for old, new, words in (
        ("unit: " + DIALECTS[program].unit, "unit: grad", "the header says unit: grad"),
        ("points: ", "points: 1", "the header says points"),
        ("seconds: ", "seconds: 1", "the header says seconds"),
        (" = joint_1", " = -joint_1", "the header says .* = -joint_1"),
        ("robot: ", "robot: another ", "the header says robot: another"),
        ("points: ", "pints: ", "the header has no line 'points'"),
        ("qp_twist ", "twist ", "lines of a header .* but not its first one"),
    ):
        what, why = outcome(path, text.replace(old, new, 1), joints, task)
        assert what == "refused"
        assert re.search(words, why), why
    path.write_text(text, "utf-8")
    assert check_trajectory(read_trajectory(path, None, joints), task).passes


def test_programs_written_as_modelled_say_so(
    written: Callable[[str], tuple[Path, ControllerJoints]],
    deburring: tuple[qt.PathTask, TimedPath],
) -> None:
    task, rows = deburring
    joints = joints_of(task, rows.joint_names)
    for program in ("rapid", "krl", "urscript"):
        path, _ = written(program)
        with pytest.raises(qt.InvalidInput, match=r"not in .*written as modelled: add") as refusal:
            read_trajectory(path, None, joints)
        assert str(refusal.value).startswith(f"{path}: the Fanuc M-16iB/20 is programmed in ls")
    path.write_text(path.read_text("utf-8").replace("robot: as modelled", "robot: UR5"), "utf-8")
    with pytest.raises(qt.InvalidInput, match="the program is for another robot, or say"):
        read_trajectory(path, None, joints)
    abb = ControllerJoints.of_robot(named_robot("ABB IRB 2400"), rows.joint_names)
    with pytest.raises(qt.InvalidInput, match=r"for another robot\.$"):
        read_trajectory(written("ls")[0], None, abb)
    with pytest.raises(qt.InvalidInput, match=r"but here it is ABB IRB 2400; .* as modelled: add"):
        read_trajectory(written("rapid")[0], None, abb)
    with pytest.raises(qt.InvalidInput, match=r"not in ls; choose a file that ends in \.mod\.$"):
        write_trajectory(rows, written("ls")[0], abb)


def test_programs_for_another_robot_are_refused(
    written: Callable[[str], tuple[Path, ControllerJoints]],
    deburring: tuple[qt.PathTask, TimedPath],
) -> None:
    task, rows = deburring
    path, _ = written("ls")
    other = ControllerJoints.of_robot(named_robot("Fanuc M-20iA"), rows.joint_names)
    with pytest.raises(qt.InvalidInput, match="robot: Fanuc M-16iB/20, but here it is Fanuc M"):
        read_trajectory(path, None, other)
    # J3 of a Fanuc is the forearm's angle to the floor, which no model counts.
    modelled = joints_of(task, rows.joint_names, as_modelled=True)
    with pytest.raises(qt.InvalidInput, match="J3 as the angle of the forearm to the floor"):
        read_trajectory(path, None, modelled)
    with pytest.raises(qt.InvalidInput, match="J3 as the angle of the forearm to the floor"):
        write_trajectory(rows, path.with_name("modelled.ls"), modelled)
    with pytest.raises(
        qt.InvalidInput, match=r"programmed in ls, not in krl; choose a file .* \.ls,"
    ):
        write_trajectory(rows, path.with_suffix(".src"), joints_of(task, rows.joint_names))
    with pytest.raises(qt.InvalidInput, match="not those of the KUKA KR 16-2"):
        joints_of(task, rows.joint_names, robot="KR 16-2")
    planar = qt.load_task("planar_line")
    with pytest.raises(qt.InvalidInput, match="not one of the known robots"):
        joints_of(planar, ("a", "b", "c"))
    path.write_text(path.read_text().replace("!J1 = joint_1 ;", "!another remark ;"))
    with pytest.raises(qt.InvalidInput, match="5 lines of axes, and there are 6 axes"):
        read_trajectory(path, None, joints_of(task, rows.joint_names))
    own = joints_of(planar, ("a", "b", "c"), as_modelled=True)
    short = TimedPath(("a", "b", "c"), np.zeros((2, 3)), np.array([0.0, 1.0]))
    with pytest.raises(qt.InvalidInput, match="moves 6 axes, and there are 3 joints"):
        write_trajectory(short, path.with_suffix(".src"), own)


J = [f"j{k}" for k in range(1, 7)]
FOREIGN = {
    ".src": """&ACCESS RVP
DEF other ( )
DECL E6AXIS XA
;FOLD INI
BAS(#INITMOV,0)
$VEL_AXIS[1]=20
E6AXIS XB={A1 10,A2 -90,A3 90,A4 0,A5 0,A6 0,E1 0}
PTP {A1 0,A2 -90.5,A3 90,A4 0,A5 45,A6 0}
ptp XB C_PTP
PTP {E6AXIS: A1 20,A2 -90,A3 90,A4 0,A5 0,A6 0} ; done
END
""",
    ".mod": """%%%
MODULE other
CONST jointtarget p10:=[[0,-90.5,90,0,45,0],[9E9,9E+09,9E9,9E9,9E9,9E9]];
PERS tooldata gun:=[TRUE,[[0,0,1],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
PROC main()
  ConfJ\\Off; TPWrite "go; MoveL!";
  MoveAbsJ p10,v100,fine,tool0;
  MoveAbsJ
    [[10,-90,90,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs,v100,z10,gun\\WObj:=wobj0;
  MoveAbsJ [[20,-90,90,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;
ENDPROC
ENDMODULE
""".removeprefix("%%%\n"),
    ".script": """def other():
  set_tcp(p[0,0,0.1,0,0,0])
  home = [0, d2r(-90.5), d2r(90), 0, d2r(45), 0]
  movej(home, a=1.4, v=1.05)
  movej([d2r(10), d2r(-90), d2r(90), 0, 0, 0], 1.4, 1.05, 0, 0.01)
  movej([d2r(20), d2r(-90), d2r(90), 0, 0, 0])  # done
end
other()
""",
    ".ls": """/PROG OTHER
/ATTR
/MN
   1:  UFRAME_NUM=0 ;
   2:J P[1:"home"] 20% FINE ;
   3:J P[2] 20% CNT50 ;
   4:J P[1] 20% FINE ;
   5:J P[3] 20%
    :  FINE ;
/POS
P[1:"home"]{ GP1: UF : 0, UT : 1,
 J1= 0 deg, J2= -90.5 deg, J3= 90 deg, J4= 0 deg, J5= 45 deg, J6= 0 deg };
P[2]{ GP1: UF : 0, UT : 1,
 J1= 10 deg, J2= -90 deg, J3= 90 deg, J4= 0 deg, J5= 0 deg, J6= 0 deg };
P[3]{ GP1: UF : 0, UT : 1,
 J1= 20 deg, J2= -90 deg, J3= 90 deg, J4= 0 deg, J5= 0 deg, J6= 0 deg };
/END
""",
}


def counted(ending: str) -> ControllerJoints:
    """Joints that a controller shows as they are; for LS those of a robot without coupling."""
    if ending != ".ls":
        return ControllerJoints.as_modelled(J)
    return ControllerJoints(tuple(J), np.ones(6), np.zeros(6), robot="own", program="ls")


@pytest.mark.parametrize("ending", FOREIGN)
def test_programs_of_others_are_read(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"other{ending}"
    path.write_text(FOREIGN[ending], "utf-8")
    rows = read_trajectory(path, None, counted(ending))
    expected = np.array([[0, -90.5, 90, 0, 45, 0], [10, -90, 90, 0, 0, 0], [20, -90, 90, 0, 0, 0]])
    if ending == ".ls":
        expected = expected[[0, 1, 0, 2]]
    assert np.degrees(rows.q) == pytest.approx(expected)
    assert rows.times is None
    notes = "; ".join(rows.notes)
    assert "depends on the controller" in notes
    assert sum(zone is not None for zone in rows.zones) >= 1
    assert "passed over" in notes
    assert "no header" in notes


@pytest.mark.parametrize(
    ("ending", "old", "new", "words"),
    [
        (".src", "PTP {A1 0", "LIN {X 0", "line 8: .*leaves out some of X, Y, Z"),
        (".src", "PTP {A1 0,A2 -90.5,", "PTP {X 0,", "line 8: .*leaves out some of X, Y, Z"),
        (".src", "A6 0} ; done", "A6 0,E1 3}", "external axes"),
        (".src", "$VEL_AXIS[1]=20", "LOOP", "LOOP is not read"),
        (".src", "$VEL_AXIS[1]=20", "another()", "does not have"),
        (".src", "ptp XB", "ptp XC", "the file does not state xc"),
        (".src", "A2 -90.5", "A2 minus", "does not state minus"),
        (".src", "ptp XB", "WAIT SEC 1e999\nptp XB", "a wait of inf s"),
        (".mod", "MoveAbsJ p10", "MoveL p10", "line 6: expected a robtarget"),
        (".mod", "MoveAbsJ p10", "MoveAbsJ p20", "does not state p20"),
        (".mod", "ConfJ\\Off;", "IF TRUE THEN", "IF is not read"),
        (".mod", "[10,-90,90,0,0,0],[9E9", "[10,-90,90,0,0,0],[5", "external axes"),
        (".mod", "fine,tool0;\nENDPROC", "fine,tool0\nENDPROC", "semicolon"),
        (".script", "movej(home", "movel(home", "line 4: expected a joint move first"),
        (".script", "movej(home", "movec(home, home", "line 4: expected a joint move first"),
        (".script", "movej(home", "movej(p[0,0,1,0,0,0]", "Cartesian"),
        (".script", "[0, d2r(-90.5)", "[0, -90.5", "URScript takes rad"),
        (".script", "  home", "  while True:\n  home", "while is not read"),
        (".script", "other()\n", "elsewhere()\n", "does not have"),
        (".ls", "J P[2] 20%", "L P[2] 20%", "L is not read"),
        (".ls", "J P[2] 20%", "L P[2] 20mm/sec", "with the task of the robot"),
        (".ls", "J P[2] 20%", "C P[2] P[3] 20mm/sec", "with the task of the robot"),
        (".ls", "J1= 10 deg", "J1= 10 mm", "unit is 'mm'"),
        (".ls", " J1= 10 deg,", "X = 10 mm,", "expected X, Y, Z in mm"),
        (".ls", "   3:", "   4:", "expected line number 3"),
        (".ls", "UFRAME_NUM=0", "JMP LBL[1]", "JMP is not read"),
        (".ls", "UFRAME_NUM=0", "CALL NEXT", "no NEXT.ls beside"),
        (".ls", "UFRAME_NUM=0", "CALL OTHER", "other calls other"),
        (".ls", "P[3] 20%", "P[2] 20%", "no line moves to"),
        (".ls", "FINE ;\n   3", "FINE Offset,PR[1] ;\n   3", "Offset.*is not read"),
    ],
)  # fmt: skip
def test_what_programs_of_others_may_not_have(
    ending: str, old: str, new: str, words: str, tmp_path: Path
) -> None:
    path = tmp_path / f"other{ending}"
    assert old in FOREIGN[ending]
    path.write_text(FOREIGN[ending].replace(old, new, 1), "utf-8")
    with pytest.raises(qt.InvalidInput, match=words) as refusal:
        read_trajectory(path, None, counted(ending))
    assert str(path) in str(refusal.value)


@given(st.binary(max_size=300), st.sampled_from([".src", ".mod", ".script", ".ls", ".mcap"]))
@settings(max_examples=60, deadline=None)
def test_garbage_ends_in_a_sentence(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, ending: str
) -> None:
    path = tmp_path_factory.mktemp("garbage") / f"garbage{ending}"
    path.write_bytes(content)
    with pytest.raises(qt.InvalidInput):
        read_trajectory(path, None, counted(ending))


def test_a_long_tp_program_is_divided(tmp_path: Path) -> None:
    count = fanuc_ls.LONGEST + 500
    rng = np.random.default_rng(0)
    q = np.cumsum(rng.normal(scale=1e-4, size=(count, 6)), axis=0)
    rows = TimedPath(tuple(J), q, 0.01 * np.arange(count), metadata={"task": "long"})
    joints = ControllerJoints.of_robot(named_robot("Fanuc M-20iA"), J)
    path = write_trajectory(rows, tmp_path / "long.ls", joints)
    files = sorted(file.name for file in tmp_path.iterdir())
    assert files == ["long.ls", "long_1.ls", "long_2.ls"]
    assert all(
        int(re.search(r"LINE_COUNT\s*= (\d+)", file.read_text())[1]) <= 9999  # type: ignore[index]
        for file in tmp_path.iterdir()
    )
    back = read_trajectory(path, None, joints)
    assert len(back.q) == count
    assert np.degrees(np.abs(back.q - q).max()) < 2e-4
    (tmp_path / "long_2.ls").unlink()
    with pytest.raises(qt.InvalidInput, match=r"no LONG_2.ls beside"):
        read_trajectory(path, None, joints)


def test_names_times_and_ranges_that_a_controller_does_not_take(tmp_path: Path) -> None:
    rows, joints = random_rows(3, "krl")
    for name in ("my-robot", "1st", "a" * 25, "é"):
        with pytest.raises(qt.InvalidInput, match="at most 24 characters"):
            write_trajectory(rows, tmp_path / f"{name}.src", joints)
    with pytest.raises(qt.InvalidInput, match="has no times"):
        write_trajectory(dataclasses.replace(rows, times=None), tmp_path / "a.src", joints)
    still = dataclasses.replace(rows, times=np.zeros(len(rows.q)))
    with pytest.raises(qt.InvalidInput, match="row 2 is not later than row 1"):
        write_trajectory(still, tmp_path / "a.src", joints)
    huge = dataclasses.replace(rows, q=rows.q + 1e300)
    with pytest.raises(qt.InvalidInput, match=r"would be at -?\d\.\d+e\+301°, outside"):
        write_trajectory(huge, tmp_path / "a.src", joints)
    far = dataclasses.replace(rows, q=rows.q + 7.0)
    with pytest.raises(qt.InvalidInput, match=r"outside .*° of the KUKA"):
        write_trajectory(far, tmp_path / "a.src", joints)
    assert not list(tmp_path.iterdir())
    with pytest.raises(qt.InvalidInput, match="say how it counts the joints"):
        read_trajectory(tmp_path / "a.src")


def test_the_sum_of_speeds_is_the_same_in_metres_and_millimetres() -> None:
    for k in range(1, 400):  # sums that end in half of the last digit
        moves = [
            JointMoves(np.zeros((2, 6)), np.ones(1), speeds=(Speed(speed),))
            for speed in (float(f"0.{k:03}1235"), 1e-3 * float(f"{k}.1235"))
        ]
        one, other = (header_lines(DIALECTS["rapid"], of, "", ()) for of in moves)
        assert one == other
