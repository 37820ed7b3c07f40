"""Programs keep the joints' limits where straight moves lead past a nearly straight wrist."""

from __future__ import annotations

import dataclasses
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from oracles.joint_paths import joint_path
from oracles.program_cells import POSTURES, Job, job_of, measured
from oracles.program_simulator import Controller, Motion, read

import qp_twist as qt
from qp_twist.trajectories import TimedPath, joints_of, write_checked
from qp_twist.trajectories.linear_moves import LinearMotion

Array = np.ndarray
LIMIT = 10.0
"""rad/s²."""
LINEAR = LinearMotion()
CASES = {"ABB IRB 120": 2.0, "KUKA KR 16-2": 6.0, "Fanuc M-16iB/20": 2.0,
         "Universal Robots UR5e": 1.0}  # fmt: skip
"""Robots, and the angle of axis 5 where the path begins, degrees."""


def job_at(name: str, angle: float) -> Job:
    with pytest.MonkeyPatch.context() as patch:
        maker = name.split(maxsplit=1)[0]
        posture = [*POSTURES[maker]]
        posture[4] = angle
        patch.setitem(POSTURES, maker, tuple(posture))
        return job_of(name, length=0.1, count=51, acceleration=LIMIT)


@pytest.fixture(scope="module", params=CASES)
def job(request: pytest.FixtureRequest) -> Job:
    return job_at(request.param, CASES[request.param])


def accelerations(motion: Motion) -> float:
    """The largest of a joint: on moves over 8 ms, and of ramps over half of both moves."""
    found, slopes, spans = [0.0], [], []
    for first, last in pairwise(motion.corners):
        count = 1 + max(1, (last - first) // 8)
        times = np.linspace(motion.times[first], motion.times[last], count)
        columns = motion.q[first : last + 1].T
        q = np.array([np.interp(times, motion.times[first : last + 1], each) for each in columns])
        v = np.diff(q) / np.diff(times)
        slopes.append((v[:, 0], v[:, -1]))
        spans.append(times[-1] - times[0])
        if v.shape[1] > 1:
            found.append(float((np.abs(np.diff(v)) / (times[1] - times[0])).max()))
    for k, (one, other) in enumerate(pairwise(spans)):
        changed = np.abs(slopes[k + 1][0] - slopes[k][1])
        found.append(float(changed.max()) / (0.5 * (one + other)))
    return max(found)


@pytest.mark.parametrize("linear", [None, LINEAR])
def test_no_joint_exceeds_its_limits(job: Job, linear: LinearMotion | None, tmp_path: Path) -> None:
    path = tmp_path / f"wave{job.suffix}"
    check, written = write_checked(job.rows, path, job.task, job.joints, linear=linear)
    assert written and check.passes, check.verdict
    text = path.read_text()
    motion = Controller(job.cell, read(text, job.suffix)).run()
    rates = np.abs(np.diff(motion.q, axis=0)) / np.diff(motion.times)[:, None]
    assert (rates <= job.limits.velocity).all()
    assert accelerations(motion) <= 1.05 * LIMIT
    if linear and job.suffix == ".script":  # joint moves are from rest to rest
        moves = [line.strip()[:5] for line in text.splitlines() if "([" in line]
        begins = [k for k, word in enumerate(moves) if word == "movej" and k]
        assert begins and "servoj" not in text
        for first, last in (motion.corners[k - 1 : k + 1] for k in begins):
            assert rates[[first, last - 1]].max() <= 2e-3 * LIMIT
    if linear and job.suffix == ".ls":  # says how many of its moves are not straight, and why
        said = re.search(r"(\d+) joint moves where the joints", "; ".join(check.notes))
        assert said and int(said[1]) == len(re.findall(r":J P\[", text)) - 1


@pytest.mark.parametrize(("name", "angle"), [("ABB IRB 120", 0.2), ("Fanuc LR Mate 200iD", -0.5)])
def test_where_digits_of_poses_exceed_limits_joints_move(
    name: str, angle: float, tmp_path: Path
) -> None:
    """By straight moves alone they are exceeded by 160 %, or the wrist arrives turned over."""
    job = job_at(name, angle)
    path, linear = tmp_path / f"wave{job.suffix}", LinearMotion(points="poses")
    check, written = write_checked(job.rows, path, job.task, job.joints, linear=linear)
    assert written and check.passes, check.verdict
    motion = Controller(job.cell, read(path.read_text(), job.suffix)).run()
    assert accelerations(motion) <= 1.05 * LIMIT
    found = measured(job, motion)
    assert found.off_path <= 1e-4 and found.off_axis <= np.radians(0.05)


def test_where_printed_speeds_are_rounded_up_joints_keep_their_ramps(tmp_path: Path) -> None:
    """At the planned speeds alone ``a`` was 2.8e-6 above what a joint has left beside the wrist."""
    job = job_at("Universal Robots UR5e", 0.2)
    path = tmp_path / "wave.script"
    check, _ = write_checked(job.rows, path, job.task, job.joints, linear=LINEAR)
    (found,) = (each for each in check.findings if each.name == "accelerations stated (a)")
    assert found.passes and found.value > 99.9  # the limit is met


def test_a_point_that_is_rounded_by_less_than_is_printed_is_a_stop(tmp_path: Path) -> None:
    """Axis 6 turns there and back: of CNT, whole percents of half a move, 0.5 % is FINE."""
    job = job_of("Fanuc LR Mate 200iD", length=0.1, count=3)
    q = np.repeat(job.task.start[None], 3, axis=0)
    q[1, 5] += np.radians(10.0)
    turns = qt.TwistProjector(linear=qt.Projector.none(), angular=qt.Projector.full())
    path_task = joint_path(job.task.model, q, np.array([0.0, 1.0, 1.0]), projector=turns).path_task
    # A joint that goes D in T needs 2 D/T² from rest, 0.35 rad/s², and 4 D/T² from rest to rest.
    limited = dataclasses.replace(path_task, acceleration_limits=np.full(6, 0.5))
    rows = TimedPath(job.rows.joint_names, q, np.arange(3.0))
    joints = joints_of(limited, rows.joint_names, robot=job.cell.name)
    check, written = write_checked(rows, path := tmp_path / "turns.ls", limited, joints)
    assert written and check.passes, check.verdict
    text = path.read_text()
    times = [int(each) for each in re.findall(r"(\d+)msec", text)]
    assert text.count("FINE") == 3 and "CNT" not in text
    needed = 4.0 * np.radians(10.0) / (1e-3 * np.array(times)) ** 2
    assert 0.9 * 0.5 < needed.max() <= 0.5
