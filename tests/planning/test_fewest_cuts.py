"""Paths that no single motion follows: the tool lifts off, as rarely as possible."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.joint_paths import joint_path

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.paths import LiftOffs, shipped_folder
from qp_twist.planning.graph import Edges, interrupted_path
from qp_twist.trajectories import run_task

Array = np.ndarray

# ---------------------------------------------------------------- the search, by brute force


def best_by_trying_all(
    nodes: list[Array], edges: dict[tuple[int, int, int], float], barred: Array, alone: Array
) -> float:
    """Least cost of all sequences of nodes, 100 for each interruption; by enumeration."""
    best = np.inf
    for way in itertools.product(*(range(len(of)) for of in nodes)):
        for cut in itertools.product((False, True), repeat=len(nodes) - 1):
            ends = (True, *cut, True)
            cost = sum(of[i] for of, i in zip(nodes, way, strict=True)) + 100.0 * sum(cut)
            if any(c and b for c, b in zip(cut, barred, strict=True)) or any(
                ends[k] and ends[k + 1] and not alone[k] for k in range(len(nodes))
            ):
                continue
            for k, (pair, c) in enumerate(zip(itertools.pairwise(way), cut, strict=True)):
                cost += 0.0 if c else edges.get((k, *pair), np.inf)
            best = min(best, cost)
    return best


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_no_other_path_through_a_small_lattice_has_fewer_cuts_or_costs_less(seed: int) -> None:
    rng = np.random.default_rng(seed)
    nodes = [rng.uniform(size=rng.integers(1, 4)) for _ in range(rng.integers(2, 7))]
    edges = {
        (k, i, j): rng.uniform()
        for k, (a, b) in enumerate(itertools.pairwise(nodes))
        for i in range(len(a))
        for j in range(len(b))
        if rng.uniform() < 0.4
    }
    barred, alone = rng.uniform(size=len(nodes) - 1) < 0.2, rng.uniform(size=len(nodes)) < 0.3

    def connections(layer: int, alive: Array) -> Edges:
        ends = [(i, j) for k, i, j in edges if k == layer and i in alive]
        return Edges(*np.array(ends, dtype=np.intp).reshape(-1, 2).T)

    way = interrupted_path(
        nodes, connections,
        lambda k, e: np.array([edges[k, i, j] for i, j in zip(e.start, e.end, strict=True)]),
        np.where(barred, np.inf, 100.0), alone,
    )  # fmt: skip
    expected = best_by_trying_all(nodes, edges, barred, alone)
    assert way.value == pytest.approx(expected)
    if np.isfinite(expected):
        steps = enumerate(itertools.pairwise(way.nodes))
        walked = sum(of[i] for of, i in zip(nodes, way.nodes, strict=True))
        walked += sum(100.0 if k + 1 in way.cuts else edges[k, i, j] for k, (i, j) in steps)
        assert walked == pytest.approx(expected)


# ---------------------------------------------------------------- plans, by construction


def hinge(reach: float = 205.0) -> mujoco.MjModel:
    """A tool at 1 m from an axis, about which it turns to ``reach`` degrees either way."""
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><joint name="turn" type="hinge" axis="0 0 1"
        range="{-reach} {reach}"/><geom size="0.1" mass="1"/><site name="tool" pos="1 0 0"/></body>
        </worldbody></mujoco>"""
    )


def turning(last: float) -> qt.PathTask:
    """A path from −200° to ``last``, in steps of 10°."""
    angles = np.radians(np.arange(-200.0, last + 1.0, 10.0))[:, None]
    return joint_path(hinge(), angles, None).path_task


@pytest.mark.parametrize(("last", "count"), [(200, 0), (210, 1), (560, 1), (570, 2)])
def test_a_hinge_that_turns_by_410_degrees_is_interrupted_as_rarely(
    last: float, count: int
) -> None:
    """Range ±205°. Beyond 200° it can only go on 360° further back, from −150° to 200° again."""
    task = turning(last)
    plan = qt.plan(task, cuts="fewest")
    assert len(plan.cuts) == count
    assert ("no motion lifts it off less often" in str(plan.certificate)) == (count > 0)
    q = np.degrees(plan.at_waypoints[:, 0])
    assert np.abs(q).max() <= 205.0
    off = q - 10.0 * np.arange(len(q)) + 200.0
    assert np.abs(off - 360.0 * np.round(off / 360.0)).max() < 1e-6
    jumps = np.flatnonzero(np.abs(np.diff(q) - 10.0) > 1e-6) + 1
    assert tuple(jumps.tolist()) == plan.cuts
    assert plan.path_task.joint_moves == plan.cuts
    assert (qt.plan(task).q is None) == (count > 0)


def test_the_best_of_the_places_is_taken() -> None:
    """Mean z of both pieces, each turned as a whole as far as it may be, at all places."""
    plan = qt.plan(turning(250), cuts="fewest")
    angles = np.arange(-200.0, 251.0, 10.0)

    def least(k: int) -> float:
        found = 0.0
        for of in (angles[:k], angles[k:]):
            turned = [of + turn for turn in (-360.0, 0.0, 360.0)]
            found += min((float(x @ x) for x in turned if np.abs(x).max() <= 200.0), default=np.inf)
        return found

    best = min(map(least, range(2, len(angles) - 1)))
    assert least(plan.cuts[0]) == pytest.approx(best)
    assert plan.value == pytest.approx(best / 410.0**2 / 2.0 / len(angles))


def test_the_tool_lifts_off_where_the_feed_is_too_fast() -> None:
    task = turning(150)
    seconds = np.full(len(task.waypoints), 1.0)
    seconds[0], seconds[7] = 0.0, 0.1
    task = dataclasses.replace(task, durations=seconds, velocity_limits=np.array([0.2]))
    assert qt.plan(task).certificate.kind == "speed"
    assert qt.plan(task, cuts="fewest").cuts == (7,)


@pytest.mark.parametrize("centering", [0.0, 3.0])
def test_the_time_of_a_path_with_lift_offs_is_that_of_its_pieces_and_joint_moves(
    centering: float,
) -> None:
    """The joint keeps the feed, 10° in 1 s, and turns back by 350° at 1 rad/s."""
    task = turning(250)
    count = len(task.waypoints)
    task = dataclasses.replace(
        task, durations=np.append(0.0, np.ones(count - 1)), velocity_limits=np.array([1.0])
    )
    objective = "time" if centering == 0.0 else {"time": 1.0, "centering": centering}
    plan = qt.plan(task, objective, cuts="fewest")
    assert len(plan.cuts) == 1
    seconds = (count - 2) + np.radians(350.0)
    z = 0.5 * (np.degrees(plan.at_waypoints[:, 0]) / 410.0) ** 2
    assert plan.value == pytest.approx(seconds + centering * z.mean())
    assert plan.durations is not None
    assert plan.durations.sum() == pytest.approx(seconds)


def test_a_slower_plan_says_where_it_lifts_off_and_where_it_is_slower(tmp_path: Path) -> None:
    plan = qt.plan(qt.load_task(ring(tmp_path, '"fewest"')), "time")
    said, [k] = str(plan.certificate), plan.cuts
    assert f"lifts off after waypoint {k};" in said
    assert plan.durations is not None and plan.s is not None
    assert plan.path_task.durations is not None
    reached = np.append(0.0, np.cumsum(plan.durations))[plan.s == np.floor(plan.s)]
    along = np.delete(np.arange(len(reached) - 1), plan.path_task.joint_moves[0] - 1)
    factors = np.zeros(len(reached) - 1)
    factors[along] = np.diff(reached)[along] / plan.path_task.durations[1:][along]
    assert f"after waypoint {int(np.argmax(factors)) + 1} {factors.max():.3g} times" in said


def test_a_waypoint_out_of_reach_is_still_the_reason_for_no_plan() -> None:
    task = turning(500)
    far = task.waypoints[30].copy()
    far.wxyz_xyz[4] += 0.2
    waypoints = (*task.waypoints[:30], far, *task.waypoints[31:])
    plan = qt.plan(dataclasses.replace(task, waypoints=waypoints), cuts="fewest")
    assert plan.q is None
    assert plan.cuts == ()
    assert "does not reach waypoint 31" in str(plan.certificate)


def test_a_joint_move_leads_around_what_is_between_two_waypoints() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom name="wall" type="box" pos="0.04 0.3 0" size="0.01 0.6 1"/>
        <body><joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
        <geom type="sphere" size="0.001" mass="1" contype="0" conaffinity="0"/>
        <body><joint name="y" type="slide" axis="0 1 0" range="-1 1"/>
        <geom name="ball" type="sphere" size="0.02" mass="1"/><site name="tool"/></body></body>
        </worldbody></mujoco>"""
    )
    rows = np.column_stack([np.arange(-0.5, 0.51, 0.1), np.zeros(11)])
    task = joint_path(model, rows, None).path_task
    assert qt.plan(task, "travel").q is None
    plan = qt.plan(task, "travel", cuts="fewest")
    assert plan.cuts == (6,)
    q = plan.motion()
    u = np.arange(20)[:, None, None] / 20.0
    points = (q[:-1] + u * np.diff(q, axis=0)).reshape(-1, 2)
    beside = np.maximum(np.abs(points - [0.04, 0.3]) - [0.01, 0.6], 0.0)
    assert np.linalg.norm(beside, axis=1).min() >= 0.02 - 1.1e-4
    assert "no proof" in str(plan.certificate)


# ---------------------------------------------------------------- from a task file to its check


def ring(folder: Path, cuts: str) -> Path:
    """400° of a circle about an arm whose first joint turns by 340°, feed, approach and retreat."""
    arm = shipped_folder("scenes") / "m16ib_deburring.xml"
    (folder / "ring.xml").write_text(
        f'<mujoco model="ring"><include file="{arm.resolve()}"/></mujoco>'
    )
    angles = np.radians(np.arange(-150.0, 251.0, 10.0))
    rows = [f"{np.cos(a):.9f},{np.sin(a):.9f},0.3,0,0,1" for a in angles]
    (folder / "ring.csv").write_text("\n".join(["x [m],y [m],z [m],i,j,k", *rows]))
    file = folder / "ring.toml"
    file.write_text(f"""start = "best"
title = "A ring"
[robot]
scene = "ring.xml"
frame = "tool"
[projector]
linear = "full"
angular = {{ plane = [0, 0, 1] }}
frame = "body"
[path]
kind = "file"
file = "ring.csv"
max_spacing = 0.5
max_turn_deg = 90
[path.approach]
distance = 0.05
steps = 2
[path.retreat]
distance = 0.07
steps = 3
[feed]
speed = 0.2
[plan]
cuts = {cuts}
""")
    return file


def test_a_run_lifts_off_as_the_path_retreats_and_its_file_passes_the_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    task = qt.load_task(ring(tmp_path, '"fewest"'))
    run = run_task(task, "qp_planned", tmp_path / "run.csv")
    assert run.check is not None
    assert run.check.passes, run.check.problems
    lifted = run.trajectory.path_task
    assert isinstance(lifted.cuts, tuple)
    [k] = lifted.cuts
    assert len(lifted.waypoints) == len(task.waypoints) + 5
    # The tool points down: it lifts off upwards, and comes back from above.
    before, after = task.positions[[k - 1, k]]
    up = np.array([0.0, 0.0, 1.0])
    expected = [before + h * up for h in (0.07 / 3, 0.14 / 3, 0.07)] + [
        after + h * up for h in (0.05, 0.025)
    ]
    assert lifted.positions[k : k + 5] == pytest.approx(np.array(expected), abs=1e-9)
    assert lifted.parts[k : k + 5] == ("retreat",) * 3 + ("approach",) * 2
    assert lifted.joint_moves == (k + 3,)
    assert lifted.feed_time == pytest.approx(
        task.feed_time + (0.07 + 0.05) / 0.2 - np.linalg.norm(after - before) / 0.2
    )
    rows = qt.read_trajectory(tmp_path / "run.csv")
    assert rows.metadata["cuts"] == [k]
    passed = qt.check_trajectory(rows, task)
    assert passed.passes
    said = f"passes; lifts off after waypoints {k}, as it states itself"
    assert passed.verdict.startswith(said)
    # A program of the file lifts off where the file does.
    for program in ("urscript", "rapid"):
        main(["export", str(tmp_path / "run.csv"), str(tmp_path / "ring.toml"), "--to", program,
              "--as-modelled"])  # fmt: skip
        assert said in capsys.readouterr().out
    # Where the task does not let the tool lift off, or states other places, it does not pass.
    for cuts in ("[]", f"[{k - 3}]"):
        assert not qt.check_trajectory(rows, qt.load_task(ring(tmp_path, cuts))).passes
    silent = dataclasses.replace(rows, metadata={})
    found = qt.check_trajectory(silent, task)
    assert not found.passes
    assert any("cuts = [WAYPOINT" in note for note in found.notes)
    stated = qt.load_task(ring(tmp_path, f"[{k}]"))
    assert stated.cuts == (k,)
    assert stated.positions == pytest.approx(lifted.positions, abs=1e-9)
    passed = qt.check_trajectory(silent, stated)
    assert passed.passes
    assert "lifts off" not in passed.verdict
    with pytest.raises(qt.InvalidInput, match=f"already lifts the tool off after waypoints {k}"):
        qt.plan(stated, cuts="fewest")


@pytest.mark.parametrize(
    ("cuts", "message"),
    [
        ("[400]", r"plan\.cuts.*cannot lift off after waypoint 400; expected one from 2 to 44 "),
        ("[1]", r"plan\.cuts: .*after \[1\] waypoint 1 is .*; expected pieces of two waypoints"),
        ("[45]", r"plan\.cuts: .*after \[45\] waypoint 46 is .*; expected pieces of two"),
        ("[9, 10]", r"plan\.cuts: .*after \[9, 10\] waypoint 10 is .*; expected pieces of two"),
        ("[10, 5]", r"order from 1, .*got \[10, 5\]"),
        ('"few"', r'plan\.cuts: expected "fewest", or .*; got "few"\.$'),
        ("[1.5]", r"plan\.cuts: expected .*; got \[1\.5\]\.$"),
    ],
)
def test_cuts_that_a_path_cannot_have_are_refused(tmp_path: Path, cuts: str, message: str) -> None:
    with pytest.raises(qt.TaskFileError, match=message):
        qt.load_task(ring(tmp_path, cuts))


def test_a_piece_of_two_waypoints_is_planned(tmp_path: Path) -> None:
    task = qt.load_task(ring(tmp_path, "[2, 20, 22, 44]"))
    assert qt.plan(task).q is not None


def test_the_preference_of_a_lifted_path_is_counted_once(tmp_path: Path) -> None:
    """Rolls by MuJoCo: the frame's pose at each waypoint is turned about its z from the task's."""
    file = ring(tmp_path, '"fewest"')
    file.write_text(f"{file.read_text()}[preference]\nroll_deg = 40\nweight = 10\nwithin_deg = 2\n")
    plan = qt.plan(qt.load_task(file), {"centering": 1.0, "time": 0.01})
    assert len(plan.cuts) == 1
    task, model = plan.path_task, plan.path_task.model
    data, cost, z = mujoco.MjData(model), 0.0, 0.0
    half = 0.5 * (model.jnt_range[:, 1] - model.jnt_range[:, 0])
    middle = model.jnt_range.mean(axis=1)
    for q, waypoint, part in zip(plan.at_waypoints, task.waypoints, task.parts, strict=True):
        z += 0.5 * (((q - middle) / (2.0 * half)) ** 2).sum()
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        frame = data.site("tool").xmat.reshape(3, 3)
        turn = waypoint.rotation().as_matrix().T @ frame
        away = np.angle(np.exp(1j * (np.arctan2(turn[1, 0], turn[0, 0]) - np.radians(40.0))))
        if part == "contact":
            cost += 5.0 * max(abs(away) - np.radians(2.0), 0.0) ** 2
    count = len(task.waypoints)
    assert cost / count > 1e-3
    assert plan.durations is not None
    expected = (z + cost) / count + 0.01 * plan.durations.sum()
    assert plan.value == pytest.approx(expected, abs=1e-7)


def test_a_projector_of_the_retreat_holds_on_lift_offs_too(tmp_path: Path) -> None:
    file = ring(tmp_path, "[]")
    text = file.read_text().replace(
        "steps = 3", 'steps = 3\nlinear = "full"\nangular = "none"\nblend = 1'
    )
    file.write_text(text)
    task = qt.load_task(file)
    lifted = LiftOffs.of(task, (10,)).task
    own = [k for k, part in enumerate(task.parts) if part == "retreat"]
    assert [of.rank for of in lifted.in_force[10:15]] == [
        *(task.in_force[k].rank for k in own), 5, 5
    ]  # fmt: skip
    assert [of.rank for of in lifted.in_force[-3:]] == [task.in_force[k].rank for k in own]
