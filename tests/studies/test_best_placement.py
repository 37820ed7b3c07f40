"""The best placement of a part or a base, against transformations and searches of the tests."""

import json
import re
from dataclasses import replace
from itertools import count, product
from pathlib import Path

import matplotlib.image
import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.cli import main
from qp_twist.paths import base_moved
from qp_twist.studies import best_placement as search

LOWER, UPPER = [-0.2, -0.1, 0.0], [0.2, 0.1, 0.0]


@pytest.fixture
def steady_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that advances by half a second whenever it is read, however fast the machine is."""
    ticks = count()
    module = "qp_twist.studies.placement_search.perf_counter"
    monkeypatch.setattr(module, lambda: 0.5 * next(ticks))


def planar() -> qt.PathTask:
    """Every tenth waypoint of the planar line."""
    return qt.load_task("planar_line").part(np.arange(0, 101, 10))


def frame_in_world(task: qt.PathTask, q: Array) -> Array:
    """Pose of the task's frame (4, 4) by MuJoCo."""
    data = mujoco.MjData(task.model)
    data.qpos[:] = q
    mujoco.mj_kinematics(task.model, data)
    site = data.site(task.frame_name)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = site.xmat.reshape(3, 3), site.xpos
    return pose


def transform(x: Array) -> Array:
    """The rotation of a rotation vector (by Rodrigues' formula), then the shift, (4, 4)."""
    angle = np.linalg.norm(x[3:])
    k = x[3:] / angle if angle else np.zeros(3)
    K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    pose = np.eye(4)
    pose[:3, :3] += np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
    pose[:3, 3] = x[:3]
    return pose


@settings(deadline=None, max_examples=10)
@given(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6))
def test_the_robot_moves_with_its_base(x: list[float]) -> None:
    task = qt.load_task("deburring")
    offset = np.array(x)
    moved = base_moved(task, mink.SO3.exp(offset[3:]), offset[:3])
    # The base of this scene is at the world's origin, in its axes.
    for q in np.random.default_rng(0).uniform(-1.0, 1.0, (3, 6)):
        there = transform(offset) @ frame_in_world(task, q)
        np.testing.assert_allclose(frame_in_world(moved, q), there, atol=1e-12)
    np.testing.assert_array_equal(moved.positions, task.positions)


def test_the_path_of_the_result_is_turned_about_the_point_and_shifted(steady_clock: None) -> None:
    task = qt.load_task("dome_seams").part(slice(0, 20))
    about = np.array([0.1, 0.9, 0.2])
    box = [0.0, 0.0, -0.02, 0.0, 0.0, 0.3], [0.0, 0.0, 0.02, 0.0, 0.0, 0.5]
    found = search(task, *box, "margin", about=about, seconds=4.0)
    assert found.offset is not None and found.plan is not None
    assert found.here is None  # the box does not contain it
    assert (found.offsets >= np.array(box[0]) - 1e-12).all()
    assert (found.offsets <= np.array(box[1]) + 1e-12).all()
    pose = transform(found.offset)
    expected = (task.positions - about) @ pose[:3, :3].T + about + pose[:3, 3]
    np.testing.assert_allclose(found.plan.path_task.positions, expected, atol=1e-12)


def test_a_base_and_a_part_that_move_the_other_way_are_the_same_for_a_planar_arm() -> None:
    task = planar()
    shift = np.array([0.1, -0.05, 0.0])
    of_base = qt.plan(base_moved(task, mink.SO3.identity(), shift))
    of_part = qt.plan(qt.paths.placed(task, mink.SO3.identity(), np.zeros(3), -shift))
    assert of_base.value == pytest.approx(of_part.value, abs=1e-6)


def test_no_placement_of_a_grid_is_better(steady_clock: None) -> None:
    task = planar()
    found = search(task, LOWER, UPPER, seconds=40.0)
    assert found.plan is not None and found.here is not None
    assert found.plan.value < found.here.value
    middle = 0.5 * (task.positions.min(axis=0) + task.positions.max(axis=0))
    grid = [
        qt.plan(
            qt.paths.placed(task, mink.SO3.identity(), middle, middle + np.array([x, y, 0.0]))
        ).value
        for x, y in product((-0.2, 0.0, 0.2), (-0.1, 0.0, 0.1))
    ]
    assert found.plan.value <= np.nanmin(grid) + 1e-4
    again = qt.plan(found.plan.path_task)
    assert again.value == pytest.approx(found.plan.value, rel=1e-6)


def test_the_largest_clearance_is_the_least_distance_on_the_way_of_the_plan(
    steady_clock: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("qp_twist.studies.placement_search._SHARP", 4.0)  # fewer plans
    task = qt.load_task("deburring_cell").part(np.arange(4))
    box = [0.0, 0.0, 0.0], [0.0, 0.0, 0.1]
    found = search(task, *box, "clearance", body="part", seconds=3.0)
    assert found.plan is not None and found.here is not None
    assert found.value >= found.value_here
    assert found.value > 2.0 * task.clearances[0].distance  # not only what the task asks for
    (clearance,) = found.plan.path_task.clearances
    model = found.plan.path_task.model
    data, least = mujoco.MjData(model), np.inf
    for a, b in zip(found.plan.motion()[:-1], found.plan.motion()[1:], strict=True):
        for share in np.linspace(0.0, 1.0, 21):
            data.qpos[:] = a + share * (b - a)
            mujoco.mj_forward(model, data)
            distances = [
                mujoco.mj_geomDistance(model, data, one, other, 0.2, None)
                for one, other in clearance.pairs
            ]
            least = min(least, *distances)
    assert found.value == pytest.approx(least, abs=1e-4)
    found.figure()


def test_the_least_time_of_a_path_without_a_feed(steady_clock: None) -> None:
    task = replace(qt.load_task("deburring").part(np.arange(0, 20, 2)), durations=None)
    found = search(task, LOWER, UPPER, "time", seconds=3.0)
    assert found.plan is not None and found.here is not None
    assert found.value == found.plan.value <= found.value_here
    steps = np.abs(np.diff(found.plan.motion(), axis=0))
    assert found.value > (steps / task.velocity_limits).max(axis=1).sum()


def test_processes_find_the_same_values(steady_clock: None) -> None:
    task = planar()
    alone = search(task, LOWER, UPPER, seconds=0.1)
    several = search(task, LOWER, UPPER, seconds=0.1, jobs=2)
    places = {tuple(x): value for x, value in zip(alone.offsets, alone.values, strict=True)}
    common = [
        (places[tuple(x)], value)
        for x, value in zip(several.offsets, several.values, strict=True)
        if tuple(x) in places
    ]
    assert len(common) >= 8
    np.testing.assert_allclose(*np.transpose(common), rtol=1e-9)


def test_ctrl_c_returns_the_best_plan_by_then(steady_clock: None) -> None:
    task = planar()

    def press(what: str, share: float) -> None:
        if what == "descents":
            raise KeyboardInterrupt

    found = search(task, LOWER, UPPER, seconds=20.0, progress=press)
    assert found.interrupted and found.plan is found.here
    box = [0.05, 0.0, 0.0], [0.2, 0.1, 0.0]  # without a plan where the part is
    with pytest.raises(KeyboardInterrupt):
        search(task, *box, seconds=20.0, progress=press)


def test_a_box_out_of_reach_has_none_and_a_reason(steady_clock: None) -> None:
    task = qt.load_task("deburring").part(np.arange(2))
    found = search(task, [5.0, 5.0, 0.0], [6.0, 6.0, 0.0], seconds=0.2)
    assert found.plan is None and found.offset is None and found.reachable == 0.0
    assert "reach" in found.reason
    assert np.isnan(found.values).all()
    found.figure()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"lower": [0, 0, 1]}, "entry 3 of lower, 1, is above that of upper, 0."),
        ({"lower": UPPER}, "lower equals upper"),
        ({"lower": [0.0] * 4}, "expected three numbers, m, or six"),
        ({"lower": [np.nan, 0, 0]}, "lower"),
        ({"moves": "robot"}, "expected 'part' or 'base', got 'robot'"),
        ({"body": "no such body"}, "has no such body 'no such body'"),
        ({"moves": "base", "about": [0, 0, 0]}, "body and about are of the part"),
        ({"seconds": 0.0}, "seconds"),
        ({"objective": "speed"}, "objective"),
        ({"objective": "clearance"}, "planar_line: has no [clearance]"),
    ],
)
def test_wrong_arguments_are_refused(options: dict[str, object], says: str) -> None:
    arguments = {"lower": LOWER, "upper": UPPER, "seconds": 0.1} | options
    with pytest.raises(qt.InvalidInput, match=re.escape(says)):
        search(qt.load_task("planar_line"), **arguments)  # type: ignore[arg-type]


def test_what_is_printed_places_the_part_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], steady_clock: None
) -> None:
    shipped = qt.load_task("dome_seams")
    assert shipped.source is not None
    text = shipped.source.read_text("utf-8").replace("../scenes/", "")
    task, out = tmp_path / "own.toml", tmp_path / "found"
    task.write_text(text, encoding="utf-8")
    seams = shipped.source.with_suffix(".csv").read_text("utf-8").splitlines(keepends=True)
    (tmp_path / "dome_seams.csv").write_text("".join(seams[:15]))  # twelve points of the first seam
    box = ["--lower=-0.1,-0.1,0,0,0,-60", "--upper", "0.1,0.1,0.1,0,0,60"]
    main(["place", str(task), *box, "--objective", "margin", "--seconds", "6",
          "--out", str(out)])  # fmt: skip
    printed = capsys.readouterr().out
    keys = dict(re.findall(r"^(position|rpy_deg) = (\[.*\])$", printed, re.MULTILINE))
    for key, value in keys.items():
        text = re.sub(rf"(?m)^{key} = \[.*?\]", f"{key} = {value}", text, count=1)
    moved = tmp_path / "moved.toml"
    moved.write_text(text, encoding="utf-8")
    facts = json.loads((out / "placement.json").read_text("utf-8"))
    assert facts["value"] > facts["value_here"]
    assert qt.plan(qt.load_task(moved), "margin").value == pytest.approx(facts["value"], abs=1e-2)
    assert len(facts["tried_offsets_and_values"]) == facts["tried"]
    height, width, _ = matplotlib.image.imread(out / "map.png").shape
    assert width > height > 100


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--lower", "0,0,0"], "give both --lower and --upper"),
        (["--lower", "a,b", "--upper", "1,1,1"], "--lower 'a,b': expected three numbers in metres"),
    ],
)
def test_the_command_refuses_a_box_that_is_none(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["place", "planar_line", *words])
    assert end.value.code == 2
    assert says in capsys.readouterr().err
