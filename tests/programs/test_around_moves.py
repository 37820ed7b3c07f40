"""What stands around the moves: parts of the path, words of the process, calls of procedures."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import qp_twist as qt
from qp_twist.errors import InvalidInput
from qp_twist.paths.process_words import call_of
from qp_twist.programs import DIALECTS, fanuc_ls
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories import joints_of, read_trajectory, run_task
from qp_twist.trajectories.trajectory_file import write_checked

WELD = """\
UNITS/MM
FEDRAT/600,MMPM
SPINDL/3000,RPM,CLW
RAPID
GOTO/0,0,0,0,0,1
COOLNT/ON
GOTO/10,0,0,0,0,1
GOTO/20,0,0,0,0,1
GOTO/60,0,0,0,0,1
COOLNT/OFF
RAPID
GOTO/60,0,50,0,0,1
RAPID
GOTO/60,80,0,0,0,1
COOLNT/ON
GOTO/30,80,0,0,0,1
COOLNT/OFF
GOTO/0,80,0,0,0,1
RAPID
GOTO/0,80,50,0,0,1
SPINDL/OFF
FINI
"""
CALLS = {"COOLNT ON": "ArcOn", "COOLNT OFF": "ArcOff"}
ORIGIN = np.array([0.0, 1.0, 0.65])
CALL = {
    "rapid": r"^ +(Arc\w+);$",
    "krl": r"^(?:TRIGGER WHEN PATH=0 ONSTART DELAY=0 DO )?(Arc\w+)\( \)",
    "ls": r"^ *\d+:CALL (Arc\w+) ;$",
}
MOVE = {"rapid": "MoveAbsJ", "krl": r"^S?PTP \{", "ls": r":J P\["}


@pytest.fixture(scope="module")
def weld(tmp_path_factory: pytest.TempPathFactory) -> qt.PathTask:
    folder = tmp_path_factory.mktemp("weld")
    seams = qt.load_task("dome_seams")
    text = Path(str(seams.source)).read_text()
    for old, new in (
        ("../scenes/m16ib_deburring.xml", seams.scene.as_posix()),
        ("dome_seams.csv", "weld.apt"),
        ("lead_deg = 5", ""),
        ("position = [0.0, 1.0, 0.3]", f"position = {ORIGIN.tolist()}"),
    ):
        assert old in text
        text = text.replace(old, new)
    (folder / "weld.apt").write_text(WELD)
    (folder / "weld.toml").write_text(text)
    return qt.load_task(folder / "weld.toml")


@pytest.fixture(scope="module")
def timed(weld: qt.PathTask, tmp_path_factory: pytest.TempPathFactory) -> qt.TimedPath:
    found = run_task(weld, "qp_gradient", tmp_path_factory.mktemp("run") / "run.csv").timed
    assert found is not None
    return found


def joints(task: qt.PathTask, dialect: str) -> ControllerJoints:
    names = qt.JointRanges.of(task.model).names
    return joints_of(task, names, as_modelled=dialect != "ls")


def test_a_word_stands_where_the_motion_before_it_ends(weld: qt.PathTask) -> None:
    """Also where points are left out within a chord error: (10, 0, 0) and (20, 0, 0) may go."""
    at = [(text, (1e3 * (weld.positions[k] - ORIGIN)).round(6)) for k, text in weld.process]
    assert [text for text, _ in at] == [
        "SPINDL/3000,RPM,CLW", "COOLNT/ON", "COOLNT/OFF", "COOLNT/ON", "COOLNT/OFF", "SPINDL/OFF",
    ]  # fmt: skip
    for (_, found), expected in zip(
        at,
        [(0, 0, 50), (0, 0, 0), (60, 0, 0), (60, 80, 0), (30, 80, 0), (0, 80, 50)],
        strict=True,
    ):
        assert found == pytest.approx(expected, abs=1e-6)
    part = weld.part(slice(weld.process[1][0], None))
    assert [k for k, _ in part.process][:3] == [0, 0, weld.process[2][0] - weld.process[1][0]]


def test_curves_in_another_order_than_the_file_have_no_words(weld: qt.PathTask) -> None:
    text = (
        Path(str(weld.source))
        .read_text()
        .replace('tool = "into"', 'curves = [2, 1]\ntool = "into"')
    )
    file = Path(str(weld.source)).with_name("other.toml")
    file.write_text(text)
    assert qt.load_task(file).process == ()


@pytest.mark.parametrize("dialect", ["rapid", "krl", "ls"])
def test_parts_and_calls_stand_behind_their_points(
    weld: qt.PathTask, timed: qt.TimedPath, dialect: str, tmp_path: Path
) -> None:
    task = dataclasses.replace(weld, calls=CALLS)
    how = joints(task, dialect)
    file = tmp_path / f"weld{DIALECTS[dialect].suffix}"
    check, written = write_checked(timed, file, task, how)
    assert written and check.passes
    lines = file.read_text().splitlines()
    names = [m[1] for line in lines if (m := re.search(r"> (\w+)", line)) and "=" not in line]
    assert names == [
        "approach", "SPINDL", "curve", "retreat", "transfer", "approach", "curve", "retreat",
        "end", "SPINDL",
    ]  # fmt: skip
    calls = [(k, m[1]) for k, line in enumerate(lines) if (m := re.search(CALL[dialect], line))]
    assert [name for _, name in calls] == ["ArcOn", "ArcOff"] * 2
    # The point before each call, by MuJoCo from the angles as they are read back.
    rows = read_trajectory(file, how.joint_names[:6], how, task.calls.values())
    data = mujoco.MjData(task.model)
    for (k, _), expected in zip(calls, [(0, 0), (60, 0), (60, 80), (30, 80)], strict=True):
        point = sum(bool(re.search(MOVE[dialect], line)) for line in lines[:k]) - 1
        data.qpos[:] = rows.of_joints(qt.JointRanges.of(task.model).names).q[point]
        mujoco.mj_kinematics(task.model, data)
        place = 1e3 * (data.site(task.frame_name).xpos - ORIGIN)
        assert place == pytest.approx((*expected, 0.0), abs=0.1)
        if dialect != "krl":
            last = next(x for x in reversed(lines[:k]) if re.search(MOVE[dialect], x))
            assert re.search(r"\bfine\b", last, re.IGNORECASE)
    assert any("ArcOn" in note and "must not move" in note for note in rows.notes)
    with pytest.raises(InvalidInput, match=r"ArcOn.*(?:--calls|beside the file)"):
        read_trajectory(file, None, how)


def test_a_script_calls_only_where_the_robot_rests(
    weld: qt.PathTask, timed: qt.TimedPath, tmp_path: Path
) -> None:
    how = joints(weld, "urscript")
    inner = dataclasses.replace(weld, calls=CALLS)
    with pytest.raises(InvalidInput, match="where the robot moves"):
        write_checked(timed, tmp_path / "weld.script", inner, how)
    ends = dataclasses.replace(weld, calls={"SPINDL": "Spin"})
    check, written = write_checked(timed, tmp_path / "weld.script", ends, how)
    text = (tmp_path / "weld.script").read_text()
    assert written and check.passes and text.count("  Spin()") == 2
    assert "# > COOLNT/ON" in text
    # What a person has filled in is read, too; a call of anything else is not.
    filled = text.replace("  start(", "  set_tcp(p[0, 0, 0.1, 0, 0, 0])\n  start(", 1)
    (tmp_path / "filled.script").write_text(filled)
    read_trajectory(tmp_path / "filled.script", None, how, ["Spin"])
    (tmp_path / "other.script").write_text(text.replace("Spin()", "Other()", 1))
    with pytest.raises(InvalidInput, match="Other"):
        read_trajectory(tmp_path / "other.script", None, how, ["Spin"])


def test_calls_and_comments_survive_where_a_program_is_divided(
    weld: qt.PathTask, timed: qt.TimedPath, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fanuc_ls, "LONGEST", 45)
    task = dataclasses.replace(weld, calls=CALLS)
    file = tmp_path / "weld.ls"
    check, written = write_checked(timed, file, task, joints(task, "ls"))
    assert written and check.passes
    parts = "".join(p.read_text() for p in sorted(tmp_path.glob("weld_*.ls")))
    assert len(list(tmp_path.glob("weld_*.ls"))) > 1
    assert re.findall(r"CALL (Arc\w+) ;", parts) == ["ArcOn", "ArcOff"] * 2
    assert parts.count("!> retreat") == 2


def test_nothing_of_tool_base_and_load_is_invented(
    weld: qt.PathTask, timed: qt.TimedPath, tmp_path: Path
) -> None:
    for name, dialect in DIALECTS.items():
        file = tmp_path / f"weld{dialect.suffix}"
        qt.write_trajectory(timed, file, joints(weld, name))
        text = file.read_text()
        gaps = (*dialect.frames_to_fill_in, *dialect.to_fill_in)
        assert text.count("fill in: ") == len(gaps) > 1
        for line in text.splitlines():
            if re.search(r"GripLoad|set_target_payload|LOAD_DATA|PAYLOAD", line):
                assert "..." in line


@pytest.mark.parametrize(("text", "name"), [
    ("COOLNT/ON", "A"), ("COOLNT/FLOOD,ON", "A"), ("COOLNT/OFF", "B"), ("COOLNT/MIST", None),
    ("SPINDL/ON,RPM,3000", "C"), ("M3 S500", "D"), ("M30", None), ("ON", None),
])  # fmt: skip
def test_the_longest_entry_that_fits_is_called(text: str, name: str | None) -> None:
    calls = {"coolnt on": "A", "COOLNT OFF": "B", "SPINDL": "C", "M3": "D"}
    assert call_of(text, calls) == name


@pytest.mark.parametrize("calls", [{"SPINDL": "Spin dle"}, {"": "A"}, {"SPINDL": "A" * 30}])
def test_a_name_that_no_controller_can_call_is_refused(
    weld: qt.PathTask, calls: dict[str, str]
) -> None:
    with pytest.raises(InvalidInput, match="calls"):
        dataclasses.replace(weld, calls=calls)
