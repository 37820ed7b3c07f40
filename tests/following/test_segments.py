"""Projectors that change along the path: common rows, blends, and what a task file may say."""

import dataclasses
import functools
import shutil
from pathlib import Path

import mink
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import qp_twist as qt
from qp_twist.pages.roadmap import roadmap_figure
from qp_twist.paths import Segment, shipped_folder

pytestmark = pytest.mark.numerical
TASK = "approach_contact_retreat"
ROLL, FREED = 20, 161  # indices of the waypoints where the shipped task's projectors change
EDGE = 68  # of one on an edge
KINDS = ("full", "plane", "line", "none")
FRAMES = ("world", "body", "target")


def projector(kind: str, axis: object) -> qt.Projector:
    make = getattr(qt.Projector, kind)
    return make(axis) if kind in ("plane", "line") else make()


def twist(linear: str, angular: str, frame: str = "world", axis: object = (0, 0, 1)) -> object:
    return qt.TwistProjector(
        linear=projector(linear, axis), angular=projector(angular, axis), frame=frame
    )


# ---------------------------------------------------------------- common rows

AXES = st.tuples(*[st.integers(-2, 2)] * 3).filter(any)


@given(st.sampled_from(KINDS), AXES, st.sampled_from(KINDS), AXES)
def test_the_intersection_is_what_both_keep(kind: str, e: tuple, other: str, f: tuple) -> None:
    a, b = projector(kind, e), projector(other, f)
    found = a.intersection(b)
    # A vector that both keep is one that M₁ + M₂ doubles.
    values, vectors = np.linalg.eigh(a.matrix + b.matrix)
    kept = vectors[:, values > 2.0 - 1e-9]
    assert found.matrix == pytest.approx(kept @ kept.T, abs=1e-9)
    assert found.rank == kept.shape[1]
    assert b.intersection(a).matrix == pytest.approx(found.matrix, abs=1e-12)


def test_twist_projectors_meet_block_by_block_in_the_frame_that_matters() -> None:
    contact = twist("full", "plane", "body")
    for frame in FRAMES:
        common = contact.intersection(twist("plane", "full", "body"))
        assert (common.linear.rank, common.angular.rank, common.frame) == (2, 2, "body")
        # Full and none have no axis: it does not matter what they are fixed to.
        common = twist("full", "none", frame).intersection(contact)
        assert (common.linear.rank, common.angular.rank, common.frame) == (3, 0, "body")
    with pytest.raises(qt.InvalidInput, match=r"fixed to 'body'.*'target'; state both in one"):
        contact.intersection(twist("full", "line", "target"))


# ---------------------------------------------------------------- along the path


WAYS = {
    # The shipped task; the tool's axis is let go where the target turns; the way back, which takes
    # rows up after stretches so short that they have not strayed far.
    "shipped": ((6, 0), (5, ROLL), (3, FREED)),
    "on an edge": ((6, 0), (5, ROLL), (3, EDGE)),
    "back": ((3, 0), (5, 12), (6, 45)),
}


@functools.cache
def run(method: str, blend: int, way: str = "shipped") -> qt.Trajectory:
    """The shipped task's path, or its beginning taken back, with changes of projector on it."""
    task = qt.load_task(TASK)
    by_rank = {t.rank: t for t in task.projectors}
    (begin, _), *changes = WAYS[way]
    waypoints = task.waypoints[:-71:-1] if way == "back" else task.waypoints
    return qt.follow(
        dataclasses.replace(
            task,
            waypoints=waypoints[: EDGE + 15] if way == "on an edge" else waypoints,
            projector=by_rank[begin],
            segments=tuple(Segment(first, by_rank[rank], blend) for rank, first in changes),
        ),
        method,
    )


def second_differences(trajectory: qt.Trajectory) -> np.ndarray:
    """Largest change of a joint's step in degrees; entry i is of the step to waypoint i + 2."""
    return np.degrees(np.abs(np.diff(trajectory.q, 2, axis=0)).max(axis=1))


@pytest.mark.parametrize(("method", "first"), [
    ("minimum_norm", EDGE), ("minimum_norm", FREED), ("gradient_projection", ROLL),
    ("gradient_projection", FREED), ("qp_gradient", ROLL), ("qp_gradient", FREED),
])  # fmt: skip
def test_a_blend_spreads_the_jump(method: str, first: int) -> None:
    blend = 10
    way = "on an edge" if first == EDGE else "shipped"
    at_once, blended = (second_differences(run(method, n, way)) for n in (0, blend))
    jump = at_once[first - 2]
    around = np.r_[at_once[first - 8 : first - 2], at_once[first - 1 : first + blend - 1]].max()
    assert jump > 4.0 * around
    # With d' and d'' the two methods' displacements, Δ²q = (1 − α)Δd' + αΔd'' + Δα(d'' − d').
    # Δα is 1.5/(n + 1) at most, and d'' − d' starts at the jump and changes by 2·around a waypoint.
    allowed = 1.5 / (blend + 1) * (jump + 2.0 * blend * around) + around
    largest = blended[first - 2 : first + blend - 1].max()
    assert largest <= allowed
    assert largest < 0.25 * jump


@pytest.mark.parametrize("method", ["minimum_norm", "qp_minimum_norm"])
def test_rows_that_are_acquired_come_in_at_rest(method: str) -> None:
    blend, first = 22, 5
    task = run("minimum_norm", 10, "back").path_task
    angles = {}
    for n in (0, blend):
        segment = Segment(first, task.segments[0].projector, n)
        short = dataclasses.replace(task, waypoints=task.waypoints[:30], segments=(segment,))
        trajectory = qt.follow(short, method)
        axes = np.array([pose(trajectory, i)[0][:, 2] for i in range(30)])
        wanted = [w.rotation().as_matrix()[:, 2] for w in short.waypoints]
        angles[n] = np.degrees(np.arcsin(np.linalg.norm(np.cross(axes, wanted), axis=1)))
    before, start = angles[0][:first], angles[0][first - 1]
    drift = np.abs(np.diff(before)).max()
    assert start > 10.0
    # At once: all of it in one waypoint.
    assert angles[0][first] < 1e-6
    error = angles[blend]
    assert error[:first] == pytest.approx(before, abs=1e-9)
    assert error[first + blend :].max() < 1e-6
    # The ramp's part, and the drift of the old method, which fades and is removed as well.
    allowed = 8.3 * start / (blend + 1) ** 2 + 3.0 * drift / (blend + 1)
    assert np.abs(np.diff(error, 2)).max() <= allowed
    assert allowed < 0.03 * start


def pose(trajectory: qt.Trajectory, index: int) -> tuple[np.ndarray, np.ndarray]:
    task = trajectory.path_task
    configuration = mink.Configuration(task.model, trajectory.q[index])
    return qt.kinematics.frame_pose(configuration, task.frame_name, task.frame_type)


@pytest.mark.parametrize(("method", "way"), [
    ("minimum_norm", "shipped"), ("minimum_norm", "back"), ("qp_gradient", "shipped"),
    ("qp_minimum_norm", "back"),
])  # fmt: skip
def test_the_rows_in_force_hold_at_every_waypoint(method: str, way: str) -> None:
    blend = 10
    trajectory = run(method, blend, way)
    task = trajectory.path_task
    first, second = (segment.first for segment in task.segments)
    count = len(task.waypoints)
    index = np.arange(count)
    # Which waypoints have to keep the tool's axis, and which its whole orientation.
    axis = index >= first + blend if way == "back" else index < second
    whole = index >= second + blend if way == "back" else index < first
    assert [t.rank for t in task.in_force] == (3 + 2 * axis + 1 * whole).tolist()
    for i, waypoint in enumerate(task.waypoints):
        rotation, position = pose(trajectory, i)
        wanted = waypoint.rotation().as_matrix()
        assert position == pytest.approx(waypoint.translation(), abs=1.1e-9)
        if axis[i]:
            assert rotation[:, 2] == pytest.approx(wanted[:, 2], abs=2e-9)
        if whole[i]:
            assert rotation == pytest.approx(wanted, abs=4e-9)
    assert trajectory.position_error.max() <= 1e-9
    assert trajectory.axis_error.max() <= np.radians(1e-7)
    # The freedom is used: elsewhere the orientation does not hold by itself.
    free = [np.abs(pose(trajectory, i)[0] - task.waypoints[i].rotation().as_matrix()).max()
            for i in np.flatnonzero(~axis)]  # fmt: skip
    assert max(free) > 1e-2


@pytest.mark.parametrize("method", ["qp_gradient", "qp"])
def test_limits_hold_through_a_blend(method: str) -> None:
    task = qt.load_task(TASK)
    keep = slice(FREED - 12, FREED + 15)
    start = run("minimum_norm", 10).q[keep.start]
    # Ranges that end close to where the joints are, and a hundredth of the robot's speed.
    for joint in range(task.model.njnt):
        task.model.jnt_range[joint] = start[joint] + np.array([-0.15, 0.15])
    assert task.durations is not None
    durations = task.durations[keep]
    task = dataclasses.replace(
        task,
        waypoints=task.waypoints[keep],
        projector=task.segments[0].projector,
        segments=(Segment(12, task.segments[1].projector, 10),),
        durations=durations,
        velocity_limits=0.01 * task.velocity_limits,
        start=start,
    )
    trajectory = qt.follow(task, method, weight="paper", gain=0.3)
    ranges = qt.JointRanges.of(task.model)
    assert (trajectory.q >= ranges.lower - 1e-9).all()
    assert (trajectory.q <= ranges.upper + 1e-9).all()
    speed = np.abs(np.diff(trajectory.q, axis=0)) / durations[1:, None]
    share = speed / task.velocity_limits
    assert share.max() <= 1.0 + 1e-9
    assert share[11:21].max() > 0.99  # a limit is active in the blend


# ---------------------------------------------------------------- task files


TEXT = """\
title = "A short line, first with the orientation, then without it"
[robot]
scene = "arm.xml"
frame = "tip"
[operational]
linear = { plane = [0, 0, 1] }
angular = { line = [0, 0, 1] }
[projector]
linear = { plane = [0, 0, 1] }
angular = { line = [0, 0, 1] }
[[segments]]
first = 4
blend = 2
linear = { plane = [0, 0, 1] }
angular = "none"
[[segments]]
first = 8
linear = { plane = [0, 0, 1] }
angular = { line = [0, 0, 1] }
[path]
kind = "polyline"
points = [[-1, 2, 0], [-0.9, 2, 0]]
steps_per_segment = 9
[start]
q_deg = [70.7, 69.1, 99.2]
"""


def load(folder: Path, text: str) -> qt.PathTask:
    shutil.copy(shipped_folder("scenes") / "planar_3r.xml", folder / "arm.xml")
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return qt.load_task(path)


def test_waypoints_of_a_file_count_from_1(tmp_path: Path) -> None:
    task = load(tmp_path, TEXT)
    assert [t.rank for t in task.in_force] == [3, 3, 3, 2, 2, 2, 2, 3, 3, 3]
    assert [(s.first, s.blend) for s in task.segments] == [(3, 2), (7, 0)]
    with pytest.raises(qt.InvalidInput, match=r"roadmap: mine leaves 0, then 1 of 3 joints free"):
        roadmap_figure(task, {})
    for method in ("qp_gradient", "twa"):
        error = qt.follow(task, method, iterations=20, gain=0.1)
        assert error.position_error.max() < 2e-9


@pytest.mark.parametrize(("old", "new", "sentence"), [
    ("first = 4", "first = 1", r"line 12: segments\[0\]\.first: .*greater than or equal to 2"),
    ("first = 8", "first = 4", r"line 17: segments\[1\]\.first: .* after 4, .* to 10, .*got 4"),
    ("first = 8", "first = 11", r"line 17: segments\[1\]\.first: .* up to 10, the last .*got 11"),
    ("blend = 2", "blend = 4", r"line 13: segments\[0\]\.blend: .* waypoints 4 to 7.*over 4"),
    ("first = 8", "first = 8\nblend = 3", r"line 18: segments\[1\]\.blend: .* 8 to 10.*over 3"),
    ("first = 8", "first = 8\nblend = 1.5", r"line 18: segments\[1\]\.blend: .*integer"),
    ("first = 8", "frist = 8", r"line 17: segments\[1\]\.frist: unknown key; did you mean 'first'"),
    ("first = 8\n", "", r"line 16: segments\[1\]\.first: missing"),
    ("blend = 2\nlinear = { plane", "blend = 2\nlinear = { line", r"line 11: segments\[0\]: .*ide"),
    ("angular = \"none\"", "angular = { line = [0, 0, 1] }\nframe = \"body\"",
     r"line 11: segments\[0\]: .*fixed to 'world'.*'body'"),
    ("blend = 2\nlinear = { plane = [0, 0, 1] }", "blend = 2\nlinear = \"none\"",
     r"line 13: segments\[0\]\.blend: .*no row in common"),
])  # fmt: skip
def test_a_segment_that_does_not_fit_is_named_with_its_place(
    tmp_path: Path, old: str, new: str, sentence: str
) -> None:
    assert TEXT.count(old) == 1
    with pytest.raises(qt.TaskFileError, match=r"mine\.toml, " + sentence):
        load(tmp_path, TEXT.replace(old, new))


def test_segments_of_ones_own_are_checked() -> None:
    task = qt.load_task(TASK)
    short = task.waypoints[:100]
    with pytest.raises(qt.InvalidInput, match=r"segments\[1\]\.first: .* up to 100"):
        dataclasses.replace(task, waypoints=short)
    with pytest.raises(qt.InvalidInput, match=r"Segment\(first=…\): expected a int"):
        Segment(1.5, task.projector)  # type: ignore[arg-type]
    with pytest.raises(qt.InvalidInput, match=r"segments\[0\]: expected a Segment"):
        dataclasses.replace(task, segments=(3,))


# ---------------------------------------------------------------- the path at its parameter


@given(st.floats(0.0, 180.0), st.booleans())
def test_a_path_between_two_waypoints_is_their_line_and_shortest_rotation(
    s: float, whole: bool
) -> None:
    task = qt.load_task(TASK)
    s = float(round(s)) if whole else s
    k = min(int(s), len(task.waypoints) - 2)
    before, after = task.waypoints[k : k + 2]
    path = task.at(np.array([s]))
    if s in (k, k + 1):
        exact = task.waypoints[int(s)]
        assert (path.positions[0] == exact.translation()).all()
        assert (path.rotations[0] == exact.rotation().as_matrix()).all()
        assert path.projectors[0] is task.in_force[int(s)]
        return
    way = before.interpolate(after, alpha=s - k)
    line = before.translation() + (s - k) * (after.translation() - before.translation())
    assert path.positions[0] == pytest.approx(line, abs=1e-12)
    assert path.rotations[0] == pytest.approx(way.rotation().as_matrix(), abs=1e-9)
    assert path.projectors[0].rank == min(t.rank for t in task.in_force[k : k + 2])
    assert task.at(np.array([s])).feed_times == pytest.approx(
        task.durations[: k + 1].sum() + (s - k) * task.durations[k + 1]
    )


@pytest.mark.parametrize("s", [[-0.5], [181.0], [3.0, 2.0], [np.nan], ["a"], [[1.0]]])
def test_a_parameter_off_the_path_is_refused(s: object) -> None:
    with pytest.raises(qt.InvalidInput, match="s: "):
        qt.load_task("approach_contact_retreat").at(s)  # type: ignore[arg-type]
