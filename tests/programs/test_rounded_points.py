"""Points that a controller rounds: judged by a bound, against roundings simulated here."""

from __future__ import annotations

import dataclasses
import re
from functools import cache
from pathlib import Path

import mink
import mujoco
import numpy as np
import pytest
from oracles.mounted_robots import FULL, mounted
from oracles.pose_programs import corrected, site_of
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

import qp_twist as qt
from qp_twist.programs import Zone
from qp_twist.programs.krl_values import pose_text
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories import Check, check_trajectory, joints_of, read_trajectory
from qp_twist.trajectories.corners import Corners

Array = np.ndarray
POSTURES = {
    "ABB IRB 120": (10.0, 20.0, 10.0, 5.0, 50.0, 20.0),
    "KUKA KR 16-2": (10.0, -70.0, 95.0, 5.0, 50.0, 200.0),
    "Fanuc LR Mate 200iD": (10.0, 10.0, -20.0, 20.0, -60.0, 20.0),
    "Universal Robots UR5e": (10.0, -80.0, 100.0, -110.0, -80.0, 20.0),
}
LEG = 0.02


@cache
def cell(name: str) -> tuple[qt.PathTask, ControllerJoints, Array]:
    """Two legs at right angles, and what the controller shows at their three points."""
    arm = mounted(name, POSTURES[name])
    places = np.array([[0.0, 0.0, 0.0], [LEG, 0.0, 0.0], [LEG, LEG, 0.0]])
    way = np.vstack([np.linspace(a, b, 10, endpoint=False) for a, b in (places[:2], places[1:])])
    poses = [arm.start @ mink.SE3.from_translation(p) for p in (*way, places[2])]
    task = arm.task("corner", poses, np.append(0.0, np.full(20, 0.04)), projector=FULL)
    joints = joints_of(task, tuple(f"joint_{k}" for k in range(1, 7)), robot=name)
    data = mujoco.MjData(arm.model)
    data.qpos[:], rows = arm.q, []
    for pose in poses:
        mujoco.mj_forward(arm.model, data)
        corrected(arm.model, data, pose.translation(), pose.rotation().as_matrix())
        rows.append(data.qpos.copy())
    return task, joints, joints.shown(np.array(rows)[[0, 10, 20]])


def text_of(name: str, zone: str, before: str = "") -> tuple[str, str]:
    """A program of the two legs, whose corner has a zone; its suffix."""
    _, _, theta = cell(name)
    if name.startswith("ABB"):
        at = [
            f"[[{','.join(f'{x:.8f}' for x in np.degrees(row))}],[9E9,9E9,9E9,9E9,9E9,9E9]]"
            for row in theta
        ]
        lines = [
            f"MoveL CalcRobT({p},gun),v50,{z},gun;" for p, z in ((at[1], zone), (at[2], "fine"))
        ]
        return "\n".join([
            "MODULE other", before, "PROC main()", f"MoveAbsJ {at[0]}\\NoEOffs,v50,fine,tool0;",
            *lines, "ENDPROC", "ENDMODULE\n",
        ]), ".mod"  # fmt: skip
    if name.startswith("Fanuc"):
        shown = np.degrees(theta)
        points = "".join(
            f"P[{k}]{{\n GP1:\n UF : 0, UT : 1,\n"
            + ",\n".join(f" J{j}= {x:.8f} deg" for j, x in enumerate(row, start=1)) + "\n};\n"
            for k, row in enumerate(shown, start=1)
        )  # fmt: skip
        return (
            "/PROG OTHER\n/ATTR\n/MN\n   1:J P[1] 10% FINE ;\n"
            f"   2:L P[2] 50mm/sec {zone} ;\n   3:L P[3] 50mm/sec FINE ;\n/POS\n{points}/END\n"
        ), ".ls"
    at = ["[" + ", ".join(f"{x:.10f}" for x in row) + "]" for row in theta]
    return (
        f"def other():\n  movej({at[0]}, a=1, v=1)\n  movel({at[1]}, a=1.2, v=0.05, {zone})\n"
        f"  movel({at[2]}, a=1.2, v=0.05)\nend\n"
    ), ".script"


def krl_text(zone: str, before: str) -> str:
    """Likewise to positions, in the flange and the world of the robot's model."""
    task, joints, theta = cell("KUKA KR 16-2")
    assert joints.arm is not None
    tool, base = joints.arm.tool_in_flange, joints.arm.base.inverse()

    axes = ",".join(f"A{k} {x:.8f}" for k, x in enumerate(np.degrees(theta[0]), start=1))
    corner, end = (pose_text(task.waypoints[k]) for k in (10, 20))
    return (
        f"DEF other( )\n{before}\n$TOOL={pose_text(tool)}\n$BASE={pose_text(base)}\n"
        f"$VEL.CP=0.05\nPTP {{{axes}}}\nLIN {corner} {zone}\nLIN {end}\nEND\n"
    )


def checked(name: str, text: str, suffix: str, folder: Path) -> Check:
    task, joints, _ = cell(name)
    path = folder / f"other{suffix}"
    path.write_text(text)
    return check_trajectory(read_trajectory(path, None, joints), task)


def arc(distance: float) -> float:
    """How far an arc tangent to two legs at right angles passes their corner, by its points."""
    angles = np.linspace(0.0, 0.5 * np.pi, 9001)
    points = distance * np.column_stack([1.0 - np.sin(angles), 1.0 - np.cos(angles)])
    return float(np.linalg.norm(points, axis=1).min())


ZONES = [
    ("ABB IRB 120", "fine", "", 0.0),
    ("ABB IRB 120", "z0", "", 0.3e-3), ("ABB IRB 120", "z200", "", 0.5 * LEG),
    ("ABB IRB 120", r"z0\Z:=0.2", "", 0.2e-3), ("ABB IRB 120", "mine", "", 0.5 * LEG),
    ("ABB IRB 120", "mine", "CONST zonedata mine:=[FALSE,0.2,0.2,0.2,0.03,0.2,0.03];", 0.2e-3),
    ("ABB IRB 120", "[FALSE,4,6,6,0.6,6,0.6]", "", 4e-3),
    ("Fanuc LR Mate 200iD", "FINE", "", 0.0), ("Fanuc LR Mate 200iD", "CNT0", "", 0.0),
    ("Fanuc LR Mate 200iD", "CNT2", "", 0.01 * LEG),
    ("Fanuc LR Mate 200iD", "CNT100", "", 0.5 * LEG),
    ("Universal Robots UR5e", "r=0", "", 0.0), ("Universal Robots UR5e", "r=0.0002", "", 2e-4),
    ("Universal Robots UR5e", "r=0.005", "", 5e-3), ("Universal Robots UR5e", "r=0.015", "", 0.015),
    ("KUKA KR 16-2", "", "", 0.0), ("KUKA KR 16-2", "C_DIS", "$APO.CDIS=0.2", 2e-4),
    ("KUKA KR 16-2", "C_DIS", "$APO={CPTP 5,CDIS 0.3}", 3e-4),
    ("KUKA KR 16-2", "C_DIS", "", 0.5 * LEG), ("KUKA KR 16-2", "C_VEL", "", 0.5 * LEG),
    ("KUKA KR 16-2", "C_DIS", "$APO.CDIS=0.2\nBAS(#INITMOV,0)", 0.5 * LEG),
]  # fmt: skip


@pytest.mark.parametrize(("name", "zone", "before", "reach"), ZONES)
def test_a_corner_passes_where_its_arc_is_within_the_tolerance(
    name: str, zone: str, before: str, reach: float, tmp_path: Path
) -> None:
    if name.startswith("KUKA"):
        text, suffix = krl_text(zone, before), ".src"
    else:
        text, suffix = text_of(name, zone, before)
    check = checked(name, text, suffix, tmp_path)
    found = [each for each in check.findings if each.name == "position where points are rounded"]
    assert check.passes == (arc(reach) <= 1e-4), check.verdict
    assert len(found) == (reach > 0.0)
    if found:
        # The joints follow the moves in steps, by which the tool is off them by some µm.
        assert 0.0 <= found[0].value - 1e3 * arc(reach) <= 0.003
        moves = enumerate(text.split("\n"), start=1)
        line = next(k for k, each in moves if re.search("MoveL|:L|movel|LIN", each))
        assert f"the move of line {line}, {zone}, " in found[0].where


@pytest.mark.parametrize(
    ("name", "zone", "before"),
    [
        ("ABB IRB 120", "[FALSE,-5,-5,-5,-1,-5,-1]", ""),
        ("ABB IRB 120", r"z0\Z:=-0.2", ""),
        ("Universal Robots UR5e", "r=-1", ""),
        ("KUKA KR 16-2", "C_DIS", "$APO.CDIS=-0.2"),
    ],
)
def test_a_negative_distance_is_refused_with_its_line(
    name: str, zone: str, before: str, tmp_path: Path
) -> None:
    kuka = name.startswith("KUKA")
    text, suffix = (krl_text(zone, before), ".src") if kuka else text_of(name, zone, before)
    with pytest.raises(qt.InvalidInput, match=r"line \d+.*negative distance"):
        checked(name, text, suffix, tmp_path)


def test_zone_data_that_rapid_does_not_have_may_round_all_it_can(tmp_path: Path) -> None:
    check = checked("ABB IRB 120", *text_of("ABB IRB 120", "z17"), tmp_path)
    found = [each for each in check.findings if each.name == "position where points are rounded"]
    assert found[0].value == pytest.approx(1e3 * arc(0.5 * LEG), rel=1e-3)


@pytest.mark.parametrize(("aside", "passes"), [(0.0, True), (0.01e-3, True), (0.07e-3, False)])
def test_the_errors_of_moves_and_of_their_corner_add_up(
    aside: float, passes: bool, tmp_path: Path
) -> None:
    """A corner beside the path, across its plane, and rounded within it: each alone would pass."""
    text = krl_text("C_DIS", "$APO.CDIS=0.2")
    assert max(aside, arc(2e-4)) <= 1e-4 and (np.hypot(aside, arc(2e-4)) <= 1e-4) == passes
    corner = pose_text(cell("KUKA KR 16-2")[0].waypoints[10])
    move = mink.SE3.from_translation(np.array([0.0, 0.0, aside]))
    there = cell("KUKA KR 16-2")[0].waypoints[10] @ move
    assert text.count(corner) == 1
    check = checked("KUKA KR 16-2", text.replace(corner, pose_text(there)), ".src", tmp_path)
    assert check.passes == passes, check.verdict
    assert ("where points are rounded" in check.verdict) != passes


def test_a_blend_that_overlaps_leaves_its_point_out(tmp_path: Path) -> None:
    """Then the tool passes the corner on the line between its neighbours, or farther."""
    check = checked("Universal Robots UR5e", *text_of("Universal Robots UR5e", "r=0.5"), tmp_path)
    found = [each for each in check.findings if each.name == "position where points are rounded"]
    assert not check.passes and found[0].value >= 1e3 * LEG * np.sqrt(0.5)


STOPS = {
    "ABB IRB 120": ("z200", "WaitTime 0.5;", {"v50": r"v1000\T:=0.4"}),
    "Fanuc LR Mate 200iD": ("CNT100", "   3:WAIT .50(sec) ;", {"50mm/sec": "0.4sec"}),
    "Universal Robots UR5e": ("r=0.009", "sleep(0.5)", {"v=0.05": "t=0.4"}),
    "KUKA KR 16-2": ("C_DIS", "WAIT SEC 0.5", {}),
}
"""A zone, a wait, and how a straight move states its time instead, if it does."""


@pytest.mark.parametrize("waits", [False, True])
@pytest.mark.parametrize("name", STOPS)
def test_a_wait_behind_a_point_is_a_stop_and_moves_need_their_times(
    name: str, waits: bool, tmp_path: Path
) -> None:
    """From rest a joint needs 2 D/T², to rest 4 D/T²; D of the two legs, from its own poses."""
    zone, wait, timed = STOPS[name]
    kuka = name.startswith("KUKA")
    text, suffix = (krl_text(zone, ""), ".src") if kuka else text_of(name, zone)
    for speed, seconds in timed.items():
        text = text.replace(speed, seconds)
    lines = text.split("\n")
    corner = 1 + next(k for k, each in enumerate(lines) if re.search("MoveL|:L|movel|LIN", each))
    if waits:
        lines[corner] = lines[corner].replace("3:", "4:")  # of LS
        lines.insert(corner, wait)
    (path := tmp_path / f"other{suffix}").write_text("\n".join(lines))
    task, joints, theta = cell(name)
    limited = dataclasses.replace(task, acceleration_limits=np.full(6, 3.0))
    rows = read_trajectory(path, None, joints)
    assert rows.points is not None
    assert [*rows.points].index(rows.stops[1]) == (1 if waits else 2)
    found = [
        each for each in check_trajectory(rows, limited).findings
        if each.name == "accelerations at stops, at least"
    ]  # fmt: skip
    way = np.abs(np.diff(joints.positions(theta), axis=0)).max()  # of joints that do not turn back
    assert [each.value for each in found] == [
        pytest.approx(100.0 / 3.0 * (4.0 if waits else 2.0) * way / 0.4**2, rel=1e-6) for _ in timed
    ]


@pytest.mark.parametrize(
    ("statement", "stops"),
    [
        ("$OUT[1]=TRUE", True), ("$ANOUT[1]=0.5", True), ("PULSE($OUT[1],TRUE,0.2)", True),
        ("DECL BOOL SEEN=$IN[3]", True), ("GRIP=TRUE", True), ("$TIMER[1]=0", True),
        ("DECL INT N=3", False), ("FDAT_ACT=F1\nBAS(#CP_DAT)", False), ("$FLAG[1]=TRUE", False),
        ("TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE", False), ("$ADVANCE=0", False),
        ("SIGNAL GRIP $OUT[1]", False),
    ],
)  # fmt: skip
def test_a_krl_program_stops_where_it_reads_or_writes_the_outside(
    statement: str, stops: bool, tmp_path: Path
) -> None:
    """KUKA's stops of the advance run; a name that nothing declares may be an output's."""
    corner, behind = krl_text("C_DIS", "$APO.CDIS=0.2").split(" C_DIS\n")
    for text in (f"{corner} C_DIS\n{statement}\n{behind}", f"{statement}\n".join(
        [corner[: corner.index("PTP")], f"{corner[corner.index('PTP') :]} C_DIS\n{behind}"]
    )):  # fmt: skip
        (path := tmp_path / "other.src").write_text(text)
        rows = read_trajectory(path, None, cell("KUKA KR 16-2")[1])
        assert rows.points is not None
        before = text.index(statement) < text.index("PTP")
        stopped = "ADVANCE=0" in text if before else stops
        assert [*rows.points].index(rows.stops[1]) == (1 if stopped else 2)
        assert rows.zones[1] is not None  # judged as rounded, too


def test_the_controllers_own_settings_replace_what_a_program_states(tmp_path: Path) -> None:
    text = krl_text("C_DIS", "$APO.CDIS=0.2").replace("\nLIN", "\nBAS(#INITMOV,0)\nLIN", 1)
    with pytest.raises(qt.InvalidInput, match=r"line \d+.*expected \$TOOL and \$BASE"):
        checked("KUKA KR 16-2", text, ".src", tmp_path)
    tool, base, speed = re.findall(r"(?m)^\$(?:TOOL|BASE|VEL).*\n", text)
    for stated, timed in ((tool + base, False), (tool + base + speed, True)):
        (path := tmp_path / "other.src").write_text(text.replace("\nLIN", f"\n{stated}LIN", 1))
        rows = read_trajectory(path, None, cell("KUKA KR 16-2")[1])
        assert (rows.times is not None) == timed


@pytest.mark.parametrize("seed", range(12))
def test_joint_moves_that_overlap_are_within_the_bound(seed: int) -> None:
    """Of two joint moves at constant speed, one ends in a ramp while the next one begins."""
    rng = np.random.default_rng(seed)
    task, joints, _ = cell("ABB IRB 120")
    size, share = 10.0 ** rng.uniform(-3.0, -0.7), rng.uniform(0.2, 1.0)
    steps = size * rng.normal(size=(2, 6))
    steps[1] = steps[0] + 10.0 ** rng.uniform(-2.0, 0.0) * steps[1]
    q = task.start + np.vstack([np.zeros(6), np.cumsum(steps, axis=0)])
    assert joints.tool is not None
    corners = Corners.of(joints.tool, q, [None, None])
    zones = [None, Zone(1, "half", share=share), None]
    bound = corners.rounded(zones, np.arange(3), FULL)
    data = mujoco.MjData(task.model)

    def tool(at: Array) -> Array:
        data.qpos[:] = at
        mujoco.mj_kinematics(task.model, data)
        return site_of(data)

    # Of ways of different length the shorter one is left at its share of one half.
    ways = [np.linalg.norm(np.diff([tool(x)[:3, 3] for x in q[k : k + 2]], axis=0)) for k in (0, 1)]
    parts = 0.5 * share * min(ways) / np.array(ways)
    at = tool(q[1])

    def off(s: float) -> tuple[float, float]:
        ends, begins = -parts[0] * (1.0 - s) ** 2 / 4.0, parts[1] * (1.0 + s) ** 2 / 4.0
        pose = tool(q[1] + ends * steps[0] + begins * steps[1])
        turn = Rotation.from_matrix(at[:3, :3].T @ pose[:3, :3])
        return float(np.linalg.norm(pose[:3, 3] - at[:3, 3])), float(turn.magnitude())

    nearest, turned = (
        minimize_scalar(lambda s, k=k: off(s)[k], bounds=(-1.0, 1.0), method="bounded",
                        options={"xatol": 1e-9}).fun
        for k in (0, 1)
    )  # fmt: skip
    assert nearest <= bound.position[0] * 1.05 + 1e-9
    assert turned <= bound.axis[0] * 1.05 + 1e-7
    assert bound.position[0] <= 1.5 * nearest + 0.05 * share * min(ways)
