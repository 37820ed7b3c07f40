"""A plan keeps its constraints also between waypoints, where its joints are on the path."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import qp_twist as qt
from qp_twist.following import with_options
from qp_twist.planning.on_the_path import OnThePath
from qp_twist.planning.problem import block_diagonal
from qp_twist.trajectories.task_run import run_task

Array = np.ndarray


class Turned(qt.Constraint):
    """A joint of the planar arm turns no further back than an angle, rad."""

    kind, names, units = "turn", ("turn",), ("rad",)

    def __init__(self, joint: int, least: float) -> None:
        self.joint, self.lower = joint, least

    def margins(self, q: Array) -> Array:
        return q[:, [self.joint]] - self.lower

    def gradients(self, q: Array) -> Array:
        return np.broadcast_to(np.eye(3)[self.joint], (len(q), 1, 3))

    def change(self, q: Array, travel: Array) -> Array:
        return travel[:, [self.joint]]


LINKS = np.array([2.0, 1.5, 1.0])


def tip(q: Array) -> Array:
    """End point of three links in the plane."""
    angles = np.cumsum(q)
    return np.array([LINKS @ np.cos(angles), LINKS @ np.sin(angles)])


def onto(q: Array, point: Array, moving: Sequence[int] = (0, 1, 2)) -> Array:
    """Newton steps of least norm, by some joints."""
    for _ in range(12):
        angles = np.cumsum(q)
        along = LINKS * np.array([-np.sin(angles), np.cos(angles)])
        J = along[:, ::-1].cumsum(axis=1)[:, ::-1]
        step = np.linalg.pinv(J[:, moving]) @ (point - tip(q))
        q = q + np.eye(3)[:, moving] @ step
    return q


def middles(begin: Array, end: Array, left: Array, right: Array, depth: int) -> list[Array]:
    """Of a motion and of its halves, brought onto the line between two points."""
    if not depth:
        return []
    q, point = onto(0.5 * (begin + end), 0.5 * (left + right)), 0.5 * (left + right)
    before = middles(begin, q, left, point, depth - 1)
    return [q, *before, *middles(q, end, point, right, depth - 1)]


def stays(
    begin: Array, end: Array, left: Array, right: Array, joint: int, least: float, depth: int
) -> bool:
    """Whether middles, with a joint at the end of its range if it would leave it, are near."""
    if not depth:
        return True
    straight, point = 0.5 * (begin + end), 0.5 * (left + right)
    q = onto(straight, point)
    if q[joint] < least:
        q[joint] = least
        q = onto(q, point, [k for k in range(3) if k != joint])
    near = np.abs(q - straight).max() < 0.2 * np.abs(end - begin).max()
    return bool(
        near
        and stays(begin, q, left, point, joint, least, depth - 1)
        and stays(q, end, point, right, joint, least, depth - 1)
    )


def test_violations_on_the_path_are_those_of_middles_brought_onto_it() -> None:
    """Random motions of up to 60° a joint from one waypoint to another 0.1 m away.

    A joint that goes straight stays within its ends.
    """
    task = qt.load_task("planar_line").part([0, 5])
    model = copy.copy(task.model)
    model.jnt_range[:] = -7.0, 7.0
    task = dataclasses.replace(task, model=model)
    (left, right), rng, found = task.positions[:, :2], np.random.default_rng(4), []
    for _ in range(30):
        begin = onto(task.start + rng.uniform(-0.5, 0.5, 3), left)
        end = onto(begin + rng.uniform(-1.0, 1.0, 3), right)
        ends = np.minimum(begin, end)
        beyond = ends - np.min(middles(begin, end, left, right, 7), axis=0)
        joint = int(np.argmax(beyond))
        least, expected = ends[joint], max(beyond[joint], 0.0)
        kept = dataclasses.replace(task, constraints=(Turned(joint, least),))
        [[violation, jump]], _ = OnThePath(kept).violations(np.array([begin, end]))
        if not jump:
            # What is straight to 1e-4 rad is not halved again.
            assert violation == pytest.approx(expected, rel=0.1, abs=3e-4)
            found.append(violation)
    assert len(found) > 15 and max(found) > 0.01


def test_a_motion_along_the_end_of_a_range_is_run_along_it() -> None:
    """Corrections of least norm would lead out of the range; the other two joints can do it alone.

    It was taken for a jump, and the whole path was searched again: minutes for an arm on a lift.
    """
    task = qt.load_task("planar_line").part([0, 5])
    (left, right), rng, along = task.positions[:, :2], np.random.default_rng(8), 0
    for _ in range(400):
        begin = onto(task.start + rng.uniform(-2.0, 2.0, 3), left)
        end = onto(begin + rng.uniform(-0.4, 0.4, 3), right)
        ends = np.minimum(begin, end)
        beyond = ends - onto(0.5 * (begin + end), 0.5 * (left + right))
        joint = int(np.argmax(beyond))
        if beyond[joint] < 3e-4 or not stays(begin, end, left, right, joint, ends[joint], 7):
            continue
        model = copy.copy(task.model)
        model.jnt_range[:] = -20.0, 20.0
        model.jnt_range[joint, 0] = ends[joint]
        kept = dataclasses.replace(task, model=model, constraints=(Turned(joint, -30.0),))
        assert not OnThePath(kept).violations(np.array([begin, end]))[0].any()
        along += 1
    assert along > 3


def test_a_plan_of_a_shipped_task_is_run_on_the_path(tmp_path: Path) -> None:
    """Its straight motions alone kept the band of rolls, up to 34 mm off the path."""
    done = run_task(qt.load_task("deburring_bands"), "qp_planned", tmp_path / "motion.csv")
    assert done.passes, done.check


def test_a_path_of_few_waypoints_is_planned_and_run_without_a_jump(tmp_path: Path) -> None:
    """Within 0.2 s its wrist could go to another branch, 84 mm off the path in between."""
    shipped = qt.load_task("deburring")
    assert shipped.source is not None
    text = shipped.source.read_text().replace("steps_per_edge = 100", "steps_per_edge = 25")
    coarse = tmp_path / "coarse.toml"
    coarse.write_text(text.replace("../scenes/m16ib_deburring.xml", str(shipped.scene)))
    done = run_task(qt.load_task(coarse), "qp_planned", tmp_path / "motion.csv")
    assert done.passes, done.check


def test_a_run_in_least_time_is_no_slower_than_one_along_another_plan(tmp_path: Path) -> None:
    """Between waypoints 37 mm apart a plan in time counts corners that a run passes faster."""
    shipped = qt.load_task("deburring")
    few = tuple(shipped.waypoints[i] for i in range(0, 121, 15))
    task = dataclasses.replace(
        shipped, waypoints=few, flipped_waypoints=None, lines=None, best_start=True,
        durations=np.append(0.0, np.full(len(few) - 1, 0.1)),
    )  # fmt: skip
    seconds = {}
    for objective in ("time", "centering"):
        asked = with_options(task, ["qp_planned"], {"objective": objective}, "")
        done = run_task(asked, "qp_planned", tmp_path / f"{objective}.csv")
        assert done.passes and done.timed is not None
        seconds[objective] = done.timed.motion.times[-1]
        assert bool(done.remark) == (objective == "time")
    assert seconds["time"] <= seconds["centering"] + 1e-9
    # What is written is what is said to be the fastest.
    written = qt.read_trajectory(tmp_path / "time.csv")
    asked = with_options(task, ["qp_planned"], {"objective": "time"}, "")
    assert qt.check_trajectory(written, asked).passes
    assert written.motion.times[-1] == pytest.approx(seconds["time"], abs=1e-6)
    # Ctrl-C while the others are planned keeps the run that there is.
    begun, motions = [False], list[str]()

    def planning(what: str, share: float) -> None:
        motions.extend([what] * begun[0])
        if begun[0] and "off the grid" in what:
            begun[0] = False
            raise KeyboardInterrupt

    done = run_task(
        asked, "qp_planned", tmp_path / "kept.csv", planning=planning,
        timing=lambda: begun.__setitem__(0, True),
    )  # fmt: skip
    assert motions and done.passes
    assert done.remark.count(" s") == 1  # the time of one motion alone


def test_no_place_to_be_looked_at_makes_a_program_without_rows() -> None:
    """Where no middle is corrected, as on a short stretch beside an obstacle."""
    assert block_diagonal(np.zeros((0, 2, 3))).shape == (0, 0)
    blocks = np.arange(12.0).reshape(2, 2, 3)
    expected = np.zeros((4, 6))
    expected[:2, :3], expected[2:, 3:] = blocks
    assert (block_diagonal(blocks).toarray() == expected).all()
