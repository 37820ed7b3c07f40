"""Speeds and accelerations that programs state: exchanged ones, and what joints need for them."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import mink
import mujoco
import numpy as np
import pytest
from oracles.mounted_robots import mounted
from oracles.program_cells import POSTURES, Job, job_of

import qp_twist as qt
from qp_twist.robots import ControllerJoints
from qp_twist.robots.tool_chain import Poses
from qp_twist.trajectories import check_trajectory, joints_of, read_trajectory, write_checked
from qp_twist.trajectories.linear_moves import LinearMotion

JOINTS, POSES = LinearMotion(points="joints", circles=False), LinearMotion(points="poses")
STATED = [
    ("ABB IRB 120", None, r"\\T:=[\d.]+"), ("ABB IRB 120", JOINTS, r"\\T:=[\d.]+"),
    ("ABB IRB 120", POSES, r"(?<=\],\[)[\d.]+(?=,[\d.]+,5000)"),
    ("KUKA KR 16-2", None, r"PART = [\d.]+"), ("KUKA KR 16-2", POSES, r"VEL\.CP=[\d.]+"),
    ("Fanuc LR Mate 200iD", None, r"\d+msec"),
    ("Fanuc LR Mate 200iD", JOINTS, r"[\d.]+(?:mm/sec|cm/min)"),
    ("Universal Robots UR5e", None, r"(?<=\], )[\d.]+(?=\)\n)"),
    ("Universal Robots UR5e", None, r"(?<=\], \[)[-\d.]+"),
    ("Universal Robots UR5e", JOINTS, r"(?<=, )v=[\d.]+(?=, r)"),
    ("Universal Robots UR5e", JOINTS, r"(?<=, )a=[\d.]+(?=, v=[\d.]+, r)"),
]  # fmt: skip
"""Of each language and motion what states the time, the speed or the acceleration of a move."""


@cache
def job(name: str) -> Job:
    return job_of(name, length=0.03, count=16)


@pytest.mark.parametrize(("name", "linear", "pattern"), STATED)
def test_exchanged_speeds_are_refused(
    name: str, linear: LinearMotion | None, pattern: str, tmp_path: Path
) -> None:
    """Sums are the same, and the path, too."""
    of = job(name)
    path = tmp_path / f"wave{of.suffix}"
    assert write_checked(of.rows, path, of.task, of.joints, linear=linear).written
    text = path.read_text()
    found = list(re.finditer(pattern, text))
    one, other = found[0], next(each for each in found if each[0] != found[0][0])
    path.write_text(
        text[: one.start()] + other[0] + text[one.end() : other.start()] + one[0]
        + text[other.end() :]
    )  # fmt: skip
    with pytest.raises(qt.InvalidInput, match=r"order: .*were exchanged"):
        read_trajectory(path, None, of.joints)


@pytest.mark.parametrize(
    ("a", "word"), [(1.2, "movel"), (40.0, "movel"), (9.0, "movej"), (13.0, "movej")]
)
def test_joints_keep_their_limits_on_ramps_of_scripts(a: float, word: str, tmp_path: Path) -> None:
    """At the acceleration a of the tool those of the joints are a J⁻¹ u; of a joint move, a."""
    name = "Universal Robots UR5e"
    arm = mounted(name, POSTURES["Universal"])
    data = mujoco.MjData(arm.model)
    data.qpos[:] = arm.q
    mujoco.mj_forward(arm.model, data)
    J, site = np.zeros((6, 6)), data.site("tool").id
    mujoco.mj_jacSite(arm.model, data, J[:3], J[3:], site)
    rates = np.linalg.solve(J, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    task = arm.task("short", [arm.start, arm.start], np.array([0.0, 1.0]))
    joints = joints_of(task, tuple(f"joint_{k}" for k in range(1, 7)), robot=name)
    shown = joints.shown(np.array([arm.q, arm.q + 1e-3 * rates]))
    begin, end = (f"[{', '.join(f'{x:.9f}' for x in row)}]" for row in shown)
    path = tmp_path / "other.script"
    path.write_text(
        f"def other():\n  movej({begin}, a=1, v=1)\n  {word}({end}, a={a}, v=0.001)\nend\n"
    )
    check = check_trajectory(read_trajectory(path, None, joints), task)
    found = next(each for each in check.findings if each.name == "accelerations stated (a)")
    most = a * (float(np.abs(rates).max()) if word == "movel" else 1.0)
    limit = np.pi / 0.25  # the data sheet's speeds, π rad/s, within 0.25 s
    assert found.value == pytest.approx(100.0 * most / limit, rel=0.02)
    assert found.passes == (most <= limit)
    assert "(a) checked against the default" in check.verdict


@pytest.mark.parametrize(("v", "short"), [(0.02, False), (0.05, True)])
def test_a_move_that_is_too_short_for_its_speed_is_named(
    v: float, short: bool, tmp_path: Path
) -> None:
    """On 1 mm at 1.2 m/s² a tool comes to √(1.2 · 0.001) m/s = 0.035 m/s, and to rest."""
    name = "Universal Robots UR5e"
    arm = mounted(name, POSTURES["Universal"])
    end = arm.start @ mink.SE3.from_translation(np.array([0.001, 0.0, 0.0]))
    task = arm.task("short", [arm.start, end], np.array([0.0, 1.0]))
    joints = joints_of(task, tuple(f"joint_{k}" for k in range(1, 7)), robot=name)
    chain = joints.tool
    assert chain is not None
    q = chain.beside(arm.q[None], Poses(end.rotation().as_matrix()[None], end.translation()[None]))
    assert q is not None
    shown = joints.shown(np.vstack([arm.q, q]))
    points = [f"[{', '.join(f'{x:.9f}' for x in row)}]" for row in shown]
    path = tmp_path / "other.script"
    path.write_text(f"def other():\n  movej({points[0]})\n  movel({points[1]}, v={v})\nend\n")
    back = read_trajectory(path, None, joints)
    assert bool(re.search(r"1 moves are too short .*line 3", "; ".join(back.unjudged))) == short


def script_of(moves: list[tuple[float, str]], folder: Path) -> Path:
    """Joint moves of the first axis, and of the last one half as far, with their arguments."""
    path, lines, at = folder / "joints.script", ["def joints():"], 0.0
    for way, how in [(0.0, ""), *moves]:
        at += way
        lines.append(f"  movej([{at}, 0, 0, 0, 0, {0.5 * at}]{how})")
    path.write_text("\n".join([*lines, "end", ""]))
    return path


@pytest.mark.parametrize(("way", "v", "a"), [(1.0, 0.5, 2.0), (0.1, 1.0, 2.0), (-0.3, 0.3, 1.0)])
def test_a_joint_move_takes_the_time_of_its_ramps(
    way: float, v: float, a: float, tmp_path: Path
) -> None:
    """Beside a robot that speeds up, holds v, and slows down in time, step by step."""
    step, at, rate, places = 1e-4, 0.0, 0.0, [0.0]
    while at < abs(way) - 1e-6 and len(places) < 100_000:
        slows = rate**2 / (2.0 * a) >= abs(way) - at
        then = max(rate - a * step, 1e-4) if slows else min(rate + a * step, v)
        at, rate = at + 0.5 * (rate + then) * step, then
        places.append(at)
    joints = ControllerJoints.as_modelled([f"joint_{k}" for k in range(1, 7)])
    path = script_of([(way, f", a={a}, v={v}"), (0.2, ", t=1.5")], tmp_path)
    back = read_trajectory(path, None, joints)
    assert back.times is not None and back.points is not None and len(back.stops) == 3
    seconds = float(back.times[back.points[1]])
    assert seconds == pytest.approx(step * (len(places) - 1), rel=0.03)
    assert back.times[-1] == pytest.approx(seconds + 1.5)
    times = np.linspace(0.0, seconds, 50)
    found = back.motion.at(times).q
    expected = np.sign(way) * np.interp(times, step * np.arange(len(places)), places)
    assert found[:, 0] == pytest.approx(expected, abs=0.01 * abs(way))
    assert found[:, 5] == pytest.approx(0.5 * found[:, 0])


def test_a_joint_move_that_is_rounded_has_no_time(tmp_path: Path) -> None:
    joints = ControllerJoints.as_modelled([f"joint_{k}" for k in range(1, 7)])
    path = script_of([(0.1, ", a=1, v=1, r=0.01"), (0.1, ", a=1, v=1")], tmp_path)
    back = read_trajectory(path, None, joints)
    assert back.times is None and "does not begin and end at rest" in "; ".join(back.notes)


@pytest.mark.parametrize(("v", "passes"), [(3.1, True), (3.2, False)])
def test_the_speed_of_a_joint_move_is_judged(v: float, passes: bool, tmp_path: Path) -> None:
    """The data sheet has 180 °/s; on 2 rad at 12 rad/s² a joint comes to √24 rad/s."""
    name = "Universal Robots UR5e"
    arm = mounted(name, POSTURES["Universal"])
    task = arm.task("short", [arm.start, arm.start], np.array([0.0, 1.0]))
    joints = joints_of(task, tuple(f"joint_{k}" for k in range(1, 7)), robot=name)
    there = arm.q + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    begin, end = (
        f"[{', '.join(f'{x:.9f}' for x in row)}]" for row in joints.shown(np.array([arm.q, there]))
    )
    path = tmp_path / "other.script"
    path.write_text(f"def other():\n  movej({begin})\n  movej({end}, a=12, v={v})\nend\n")
    check = check_trajectory(read_trajectory(path, None, joints), task)
    found = next(each for each in check.findings if each.name == "velocity limits")
    assert found.passes == passes
    assert found.value == pytest.approx(100.0 * v / np.pi, rel=1e-3)


def test_streamed_positions_end_at_rest_where_another_move_follows(tmp_path: Path) -> None:
    joints = ControllerJoints.as_modelled([f"joint_{k}" for k in range(1, 7)])
    path = script_of([(0.1, ", t=1"), (0.1, ", t=1"), (0.1, ", t=1")], tmp_path)
    text = path.read_text().split("\n")
    text[2:4] = [line.replace("movej", "servoj") for line in text[2:4]]
    path.write_text("\n".join(text))
    assert read_trajectory(path, None, joints).stops == (0, 2, 3)
