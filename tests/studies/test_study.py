"""Studies: what is drawn, what is judged, what is stored, and what happens when processes die."""

import contextlib
import dataclasses
import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.dying_jobs import Dying
from oracles.mutations import mutated

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.paths import leaned
from qp_twist.studies import draw_sample
from qp_twist.studies.judge import Judge
from qp_twist.studies.rows import Job
from qp_twist.studies.sample import section_of
from qp_twist.studies.store import BASE, Store
from qp_twist.studies.workers import each

pytest.importorskip("joblib", reason="the extra `study`")

ROOT = Path(__file__).parents[2]
DEBURRING = qt.load_task("deburring")
LINE = (ROOT / "tasks" / "planar_line.toml").read_text("utf-8")
METHODS = ["minimum_norm", "qp_gradient"]


def line_task(folder: Path, **replaced: str) -> Path:
    """The planar line in eight steps, with another text in some places."""
    text = LINE.replace("steps_per_segment = 100", "steps_per_segment = 8")
    text = text.replace("../scenes/", "")
    for old, new in replaced.items():
        assert old in text
        text = text.replace(old, new)
    file = folder / "line.toml"
    file.write_text(text, "utf-8")
    return file


def content(study: qt.Study) -> list[dict[str, Any]]:
    """Its rows, but for what a clock says."""
    table = study.table()
    del table["seconds"]
    return [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]


@pytest.fixture(scope="module")
def twelve(tmp_path_factory: pytest.TempPathFactory) -> qt.Study:
    """Twelve samples, done at once by two processes; later studies use the same two."""
    folder = tmp_path_factory.mktemp("twelve")
    task = line_task(folder)
    return qt.study(task, ["placement"], 12, METHODS, out=folder / "out", jobs=2, certify=False)


# ---------------------------------------------------------------- what is drawn


@given(st.integers(0, 2**31), st.integers(0, 10**6))
@settings(max_examples=10)
def test_a_sample_is_its_number(seed: int, index: int) -> None:
    alone = draw_sample(DEBURRING, ["placement"], index, seed=seed, start="task")
    again = draw_sample(DEBURRING, ["placement"], index, seed=seed, start="task")
    among = draw_sample(DEBURRING, ["placement", "gain", "solver"], index, seed=seed, start="task")
    other = draw_sample(DEBURRING, ["placement"], index + 1, seed=seed, start="task")
    assert alone.drawn == again.drawn
    assert alone.drawn.items() <= among.drawn.items()
    np.testing.assert_array_equal(alone.path_task.positions, among.path_task.positions)
    assert alone.drawn != other.drawn
    assert section_of(DEBURRING).placement is not None


def test_placements_are_those_of_the_example() -> None:
    import placements  # the example has its own code for them

    for index in range(5):
        expected = placements.placed(DEBURRING, *placements.placement(0, index))
        found = draw_sample(DEBURRING, ["placement"], index, start="task").path_task
        for a, b in zip(expected.waypoints, found.waypoints, strict=True):
            np.testing.assert_allclose(a.as_matrix(), b.as_matrix(), atol=1e-12)
        assert expected.flipped_waypoints is not None
        assert found.flipped_waypoints is not None
        for a, b in zip(expected.flipped_waypoints, found.flipped_waypoints, strict=True):
            np.testing.assert_allclose(a.as_matrix(), b.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(found.velocity_limits, np.radians(15.0))


def test_the_workpiece_moves_along() -> None:
    sample = draw_sample(DEBURRING, ["placement"], 2, start="task")
    part = sample.path_task.model.body("part")
    np.testing.assert_allclose(part.pos, [sample.drawn[axis] for axis in "xyz"], atol=1e-12)
    distances = np.linalg.norm(sample.path_task.positions - part.pos, axis=1)
    np.testing.assert_allclose(distances, 0.3, atol=1e-12)  # still on the sphere
    np.testing.assert_allclose(DEBURRING.model.body("part").pos, [0.0, 1.0, 0.3])


def test_draws_stay_in_their_ranges_and_fill_them() -> None:
    drawn = [
        draw_sample(DEBURRING, ["placement", "tool", "gain", "solver"], i, start="task").drawn
        for i in range(60)
    ]
    section = section_of(DEBURRING)
    assert section.placement is not None
    ranges = dict(zip("xyz", zip(section.placement.lower, section.placement.upper, strict=True),
                      strict=True))  # fmt: skip
    ranges |= {"yaw_deg": (-180.0, 180.0), "tilt_deg": (0.0, 45.0), "tool_lead_deg": (-5.0, 5.0)}
    for name, (low, high) in ranges.items():
        values = np.array([d[name] for d in drawn])
        assert low <= values.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < values.max() <= high
    assert {d["solver"] for d in drawn} == {"daqp", "proxqp", "osqp"}
    gains = np.log([d["gain_qp_gradient"] for d in drawn])
    assert np.log(0.005) <= gains.min() < gains.max() <= 0.0


@pytest.mark.parametrize(("lead", "tilt"), [(0.1, 0.0), (0.0, 0.1), (-0.07, 0.12)])
def test_the_tool_leans_against_the_path(lead: float, tilt: float) -> None:
    found = leaned(DEBURRING, lead, tilt)
    before = np.array([w.rotation().as_matrix()[:, 2] for w in DEBURRING.waypoints])
    after = np.array([w.rotation().as_matrix()[:, 2] for w in found.waypoints])
    np.testing.assert_array_equal(found.positions, DEBURRING.positions)
    turned = np.arccos(np.clip((before * after).sum(axis=1), -1.0, 1.0))
    np.testing.assert_allclose(turned, np.hypot(lead, tilt), atol=1e-7)
    way = DEBURRING.positions[60] - DEBURRING.positions[40]  # along the first edge, about 50
    left = np.cross(way, before[50])  # z points down into the part: seen from above, left of way
    assert np.sign(after[50] @ way) == np.sign(lead)
    if tilt:
        assert np.sign(after[50] @ left) == np.sign(tilt)


def test_robots_are_drawn_and_refused(tmp_path: Path) -> None:
    scene = (ROOT / "scenes" / "planar_3r.xml").read_text("utf-8")
    (tmp_path / "other.xml").write_text(scene.replace('model="', 'model="other_'), "utf-8")
    (tmp_path / "six.xml").write_text((ROOT / "scenes" / "m16ib_deburring.xml").read_text())
    robots = '[study.robot]\nscenes = ["planar_3r.xml", "{}"]\n\n[iteration]'
    file = line_task(tmp_path, **{"[iteration]": robots.format("other.xml")})
    drawn = {
        draw_sample(qt.load_task(file), ["robot"], i, start="task").drawn["scene"]
        for i in range(12)
    }
    assert drawn == {"planar_3r.xml", "other.xml"}
    file = line_task(tmp_path, **{"[iteration]": robots.format("six.xml")})
    with pytest.raises(qt.InvalidInput, match=r"six\.xml has the joints joint_1, joint_2"):
        qt.study(file, ["robot"], 2, METHODS, out=tmp_path / "out")


# ---------------------------------------------------------------- what is judged


@pytest.fixture(scope="module")
def good(planar: qt.Comparison) -> qt.Trajectory:
    return planar.trajectories["qp_gradient"]


def judged(trajectory: qt.Trajectory, **changed: Any) -> tuple[str, str, int] | None:
    task, measured = trajectory.path_task, {"position_error", "band_excess"} & changed.keys()
    of_rows = {name: changed.pop(name) for name in measured}
    made = dataclasses.replace(trajectory, **changed)
    vars(made).update(of_rows)  # in place of what its rows would give
    fault = Judge(task).fault(made)
    return None if fault is None else (fault.kind, fault.joint, fault.waypoint)


def test_a_good_run_has_no_fault(good: qt.Trajectory) -> None:
    assert judged(good) is None


def test_every_fault_is_found_where_it_is(good: qt.Trajectory) -> None:
    ranges = qt.JointRanges.of(good.path_task.model)
    q = good.q.copy()
    q[40:, 1] = ranges.upper[1] + 1e-6
    assert judged(good, q=q) == ("limit", "joint_2", 41)
    q = good.q.copy()
    q[30:, 2] += np.radians(16.0)
    assert judged(good, q=q) == ("jump", "joint_3", 31)
    error = good.position_error.copy()
    error[50] = 2e-4
    assert judged(good, position_error=error) == ("error", "", 51)
    q = good.q.copy()
    q[20:, 0] = ranges.lower[0]
    q[20:, 0] += 1e-6
    error[20] = 2e-4
    steps = np.abs(np.diff(q[:, 0])).max()
    if steps < np.radians(15.0):
        assert judged(good, q=q, position_error=error) == ("held", "joint_1", 21)
    excess = np.zeros(len(good.q))
    excess[7] = 1e-3
    assert judged(good, band_excess=excess) == ("band", "", 8)
    q = good.q.copy()
    q[60] = np.nan
    assert judged(good, q=q) == ("diverged", "", 61)
    assert judged(good, failure="no step at waypoint 12") == ("no step", "", 101)


# ---------------------------------------------------------------- what is stored


def row(sample: int, method: str = "qp") -> dict[str, Any]:
    values = {int: 1, float: 0.5, str: "x", bool: True}
    return {name: values[kind] for name, kind in BASE.items()} | {
        "sample": sample, "method": method, "x": float(sample),
    }  # fmt: skip


@given(st.lists(st.lists(st.integers(0, 99), max_size=5), max_size=6))
@settings(max_examples=25, deadline=None)
def test_rows_come_back_once_and_in_order(
    tmp_path_factory: pytest.TempPathFactory, parts: list[list[int]]
) -> None:
    folder = tmp_path_factory.mktemp("store")
    for part in parts:  # a sample may come again
        with Store(folder, {"x": float}).writing() as add:
            for sample in part:
                add([row(sample, "b"), row(sample, "a")])
    samples = sorted({sample for part in parts for sample in part})
    store = Store(folder, {"x": float})
    store.check()
    table = store.table(["sample", "method", "x", "success", "waypoint"])
    assert table["sample"] == [s for s in samples for _ in "ba"]
    assert table["method"] == ["b", "a"] * len(samples)
    assert table["x"] == table["sample"] and set(table["success"]) <= {True}
    assert [path.name for path in folder.iterdir()] == (["results.sqlite"] if parts else [])


def test_rows_that_were_added_before_a_process_was_killed_are_there(tmp_path: Path) -> None:
    script = (
        "import os, signal, time; from pathlib import Path; from qp_twist.studies.store import *\n"
        f"with Store(Path({str(tmp_path)!r}), {{}}).writing() as add:\n"
        "    for sample in range(3):\n"
        "        add([{'sample': sample, 'method': 'qp'}])\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], check=False, timeout=120)
    assert done.returncode == -signal.SIGKILL
    store = Store(tmp_path, {})
    store.check()
    assert store.table(["sample"])["sample"] == [0, 1, 2]
    with store.writing() as add:  # the lock ended with the process
        add([row(3)])
    assert store.table(["sample"])["sample"] == [0, 1, 2, 3]


def test_a_file_that_is_no_table_or_of_another_study_is_refused(tmp_path: Path) -> None:
    with Store(tmp_path, {"x": float}).writing() as add:
        add([row(0)])
    with pytest.raises(qt.InvalidInput, match="not of this study"):
        Store(tmp_path, {"y": float}).table(["y"])
    (tmp_path / "results.sqlite").write_bytes(b"SQLite not really")
    with pytest.raises(qt.InvalidInput, match="damaged"):
        Store(tmp_path, {"x": float}).table(["x"])


def test_a_table_that_was_altered_is_refused(twelve: qt.Study, tmp_path: Path) -> None:
    """No row is read with other numbers; one that is lost is computed again."""
    shutil.copytree(twelve.folder, tmp_path / "out")
    file = tmp_path / "out" / "results.sqlite"
    whole, rows = file.read_bytes(), content(twelve)
    task = twelve.job.path_task
    for number in range(80):
        file.write_bytes(mutated(whole, number))
        try:
            found = content(qt.Study.open(tmp_path / "out", task))
        except qt.InvalidInput as error:
            assert "results.sqlite: is damaged, was altered" in str(error)
        else:
            assert all(row in rows for row in found)
    file.write_bytes(whole)
    with contextlib.closing(sqlite3.connect(file)) as database:
        database.execute("UPDATE results SET success = 1 - success WHERE sample = 3")
        database.commit()
    with pytest.raises(qt.InvalidInput, match="a row does not fit its checksum"):
        qt.Study.open(tmp_path / "out", task)
    file.write_bytes(whole)
    assert content(qt.Study.open(tmp_path / "out", task)) == rows


# ---------------------------------------------------------------- who does it


def test_a_process_that_dies_costs_a_retry(tmp_path: Path) -> None:
    rows = dict(each(Dying(tmp_path), range(20), jobs=2))
    assert sorted(rows) == list(range(20))
    for index, [found] in rows.items():
        assert found["square"] == (None if index == 11 else index**2)
    assert "process died" in rows[11][0]["message"]
    assert (tmp_path / "3").exists()


# ---------------------------------------------------------------- the whole


def test_a_study_has_a_row_for_every_sample_and_method(twelve: qt.Study) -> None:
    rows = content(twelve)
    assert [(r["sample"], r["method"]) for r in rows] == [
        (s, m) for s in range(12) for m in METHODS
    ]
    for r in rows:
        assert r["success"] == (r["fault"] == "")
        assert (r["waypoint"] is None) == r["success"]
        assert r["feasible"] in (True, None)
        assert r["message"] == "" or r["fault"] in ("start", "raised", "no step")
    assert any(r["success"] for r in rows)
    assert any(not r["success"] for r in rows)
    # Against a run made by itself and judged by hand.
    done = next(r for r in rows if r["success"] and r["method"] == "qp_gradient")
    run = qt.follow(twelve.sample(done["sample"]).path_task, "qp_gradient")
    assert run.z.mean() == pytest.approx(done["mean_z"], rel=1e-9)
    assert run.margins.min() == pytest.approx(done["min_margin"], rel=1e-9)
    assert done["z_over_least"] >= 1.0 - 1e-9


def test_a_study_that_was_stopped_goes_on_and_grows(twelve: qt.Study, tmp_path: Path) -> None:
    task = line_task(tmp_path)
    arguments: dict[str, Any] = {"out": tmp_path / "out", "jobs": 2, "certify": False}

    def interrupt(done: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        qt.study(task, ["placement"], 8, METHODS, progress=interrupt, **arguments)
    stopped = qt.Study.open(tmp_path / "out")
    assert len(stopped.missing()) == 5
    assert "3 of 8 samples" in stopped.title
    counted: list[int] = []
    qt.study(task, ["placement"], 8, METHODS, progress=counted.append, **arguments)
    assert counted == [4, 5, 6, 7, 8]
    grown = qt.study(task, ["placement"], 12, METHODS, **arguments)
    assert content(grown) == content(twelve)


def test_a_study_is_not_mixed_with_another(twelve: qt.Study, tmp_path: Path) -> None:
    task = twelve.folder.parent / "line.toml"
    out = twelve.folder
    with pytest.raises(qt.InvalidInput, match="holds a study with seed = 0, not 1"):
        qt.study(task, ["placement"], 12, METHODS, out=out, seed=1, certify=False)
    with pytest.raises(qt.InvalidInput, match="holds a study with methods"):
        qt.study(task, ["placement"], 12, ["qp"], out=out, certify=False)
    with pytest.raises(qt.InvalidInput, match="has 12 samples already; ask for at least as many"):
        qt.study(task, ["placement"], 5, METHODS, out=out, certify=False)
    changed = line_task(tmp_path, **{"gain = 1.0": "gain = 0.5"})
    with pytest.raises(qt.InvalidInput, match="as it was then"):
        qt.Study.open(out, qt.load_task(changed))
    with pytest.raises(qt.InvalidInput, match="holds no study"):
        qt.Study.open(tmp_path)
    with pytest.raises(qt.InvalidInput, match="holds something else"):
        qt.study(task, ["placement"], 5, METHODS, out=tmp_path)
    with pytest.raises(qt.InvalidInput, match="samples 0 to 11; got 12"):
        twelve.sample(12)


def test_a_study_that_was_stopped_before_its_first_sample_begins_again(tmp_path: Path) -> None:
    task, out = line_task(tmp_path), tmp_path / "stopped"
    out.mkdir()
    for name in ("results.sqlite", ".lock"):  # as a killed process leaves them
        (out / name).touch()
    found = qt.study(task, ["placement"], 2, ["minimum_norm"], out=out, certify=False, jobs=1)
    assert len(found.table(["sample"])["sample"]) == 2


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"vary": ["colour"]}, "cannot vary 'colour'. What can be varied: robot, placement"),
        ({"vary": ["tool"]}, r"add a table \[study.tool\]"),
        ({"vary": "placement"}, "lists of names"),
        ({"vary": []}, "vary is empty"),
        ({"vary": None}, "lists of names"),
        ({"vary": ["start"], "start": "best"}, "cannot vary and be 'best'"),
        ({"samples": 0}, "samples: expected a number of at least 1"),
        ({"samples": 10**30}, "samples: expected a number of at most"),
        ({"samples": 2.5}, "samples: expected a whole number"),
        ({"jobs": 0}, "jobs: expected"),
        ({"seed": -1}, "seed: expected"),
        ({"start": "here"}, "start: expected one of auto, task"),
        ({"methods": ["magic"]}, "unknown method 'magic'"),
        ({"methods": []}, "methods is empty"),
        ({"solver": "magic"}, "magic"),
    ],
)
def test_bad_arguments_are_refused_with_a_sentence(
    tmp_path: Path, arguments: dict[str, Any], sentence: str
) -> None:
    given = {"vary": ["placement"], "samples": 2, "methods": METHODS, **arguments}
    with pytest.raises(qt.InvalidInput, match=sentence):
        qt.study(line_task(tmp_path), out=tmp_path / "out", **given)


def test_what_varies_nothing_is_refused(tmp_path: Path) -> None:
    def refused(sentence: str, vary: str, new: str, methods: list[str] = METHODS) -> None:
        file = line_task(tmp_path, **{"[iteration]": f"{new}\n\n[iteration]"})
        with pytest.raises(qt.InvalidInput, match=sentence):
            qt.study(file, [vary], 2, methods, out=tmp_path / "out")
        assert not (tmp_path / "out").exists()

    refused("lead_deg and tilt_deg are zero", "tool", "[study.tool]")
    refused("has no secondary", "gain", "[study.gain]\nminimum_norm = [0.1, 1.0]")
    refused("gains vary for qp_gradient", "gain", "[study.gain]\nqp_gradient = [0.1, 1.0]", ["sns"])
    refused(r"study.gain", "gain", "[study.gain]")
    refused(r"lowest, highest", "tool", "[study.tool]\nlead_deg = [3, 2]")
    file = line_task(tmp_path, **{"point = [0, 2, 0]": 'point = [0, 2, 0]\nbody = "nothing"'})
    with pytest.raises(qt.InvalidInput, match="has no such body 'nothing'"):
        qt.study(file, ["placement"], 2, METHODS, out=tmp_path / "out")


def test_a_folder_that_cannot_be_used_is_refused(twelve: qt.Study, tmp_path: Path) -> None:
    task = twelve.folder.parent / "line.toml"
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(qt.InvalidInput, match="no folder can be there"):
            qt.study(task, ["placement"], 2, METHODS, out=out)
    with (
        twelve._store().writing(),
        pytest.raises(qt.InvalidInput, match="another study is writing there"),
    ):
        qt.study(task, ["placement"], 12, METHODS, out=twelve.folder, certify=False)
    broken = tmp_path / "broken"
    broken.mkdir()
    for text in ("{", "[]", '{"samples": "x"}'):
        (broken / "study.json").write_text(text, "utf-8")
        with pytest.raises(qt.InvalidInput, match=r"study\.json: cannot be read"):
            qt.Study.open(broken)
    for columns in (["nope"], "sample"):
        with pytest.raises(qt.InvalidInput, match="expected a list of columns out of sample"):
            twelve.table(columns)


WITH_POST = """    <body name="post" pos="3 3 0">
      <geom name="post" type="box" size="0.2 0.2 0.2" contype="1" conaffinity="1"/>
    </body>
  </worldbody>"""


def test_a_study_does_not_go_on_with_a_task_that_has_changed(tmp_path: Path) -> None:
    scene = (ROOT / "scenes" / "planar_3r.xml").read_text("utf-8")
    geom = '<geom name="ball" size="0.05" pos="0.9 0 0" contype="1" conaffinity="1"/></body>'
    assert scene.count("</worldbody>") == 1
    scene = scene.replace("  </worldbody>", WITH_POST)
    last = scene.index("</body>", scene.index("tip"))
    scene = scene[:last] + geom + scene[last + len("</body>") :]
    (tmp_path / "arm.xml").write_text(scene, "utf-8")
    clear = "\n[clearance]\ndistance = 0.01\nignore = []\n\n[iteration]"
    file = line_task(tmp_path, **{"planar_3r.xml": "arm.xml", "[iteration]": clear})
    text = file.read_text("utf-8")
    qt.study(file, ["placement"], 1, ["minimum_norm"], out=tmp_path / "out", jobs=2, certify=False)
    assert qt.Study.open(tmp_path / "out").missing() == []
    for where, before, after in (
        (file, "distance = 0.01", "distance = 0.15"),
        (file, "ignore = []", 'ignore = [["ball", "post"]]'),
        (file, "steps_per_segment = 8", "steps_per_segment = 9"),
        (tmp_path / "arm.xml", 'size="0.2 0.2 0.2"', 'size="0.2 0.2 0.3"'),
        (tmp_path / "arm.xml", 'size="0.05"', 'size="0.06"'),
        (tmp_path / "arm.xml", 'type="box" size="0.2 0.2', 'type="ellipsoid" size="0.2 0.2'),
    ):
        whole = where.read_text("utf-8")
        assert before in whole
        where.write_text(whole.replace(before, after), "utf-8")
        with pytest.raises(qt.InvalidInput, match="as it was then"):
            qt.Study.open(tmp_path / "out")
        with pytest.raises(qt.InvalidInput, match="as it was then"):
            qt.study(file, ["placement"], 2, ["minimum_norm"], out=tmp_path / "out", certify=False)
        where.write_text(whole, "utf-8")
    # What is only said of it, or where it is, changes no sample.
    (tmp_path / "line.toml").write_text(f"# a comment\n{text}", "utf-8")
    assert qt.Study.open(tmp_path / "out").missing() == []


def test_a_sample_that_raises_is_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = qt.load_task(line_task(tmp_path))
    broken = Job(task, ("placement",), 0, tuple(METHODS), "daqp", "auto", certify=False)
    monkeypatch.setattr("qp_twist.studies.rows.draw_sample", lambda *_, **__: 1 / 0)
    for found in broken(5):
        assert (found["sample"], found["fault"], found["success"]) == (5, "raised", False)
        assert found["message"].startswith("ZeroDivisionError: division by zero (test_study.py")


FAR = {
    "steps_per_segment = 8": "steps_per_segment = 2",
    "lower = [-1.0, 1.0, 0.0]": "lower = [9.0, 9.0, 0.0]",
    "upper = [1.0, 2.5, 0.0]": "upper = [9.5, 9.0, 0.0]",
}
"""A line of three waypoints that nothing reaches."""


def test_what_is_infeasible_is_certified(tmp_path: Path) -> None:
    task = qt.load_task(line_task(tmp_path, **FAR))
    methods = ("qp_gradient", "qp_planned")
    job = Job(task, ("placement",), 0, methods, "daqp", "auto", certify=True)
    for job_, fault in ((job, "start"), (dataclasses.replace(job, start="best"), "no plan")):
        for found in job_(0):
            assert found["fault"] == fault
            assert found["feasible"] is False
            assert "does not reach" in found["certificate"]


def test_a_study_says_why_samples_fail(tmp_path: Path) -> None:
    task = line_task(tmp_path, **FAR)
    found = qt.study(task, ["placement"], 2, METHODS, out=tmp_path / "out", jobs=1)
    for summary in found.summary():
        assert summary.infeasible == 2 - summary.all.count == 2
        assert summary.reasons == "infeasible 2"
    [line] = found.failures
    assert line == (
        "2 samples: the arm does not reach waypoints … in any configuration (the first is sample 0)"
    )
    assert line in found.text() and "infeasible 2" in found.text()
    assert found.to_dict()["failures"] == [line]


def test_a_planned_method_follows_its_plan_from_the_best_start(tmp_path: Path) -> None:
    methods = ("qp_gradient", "qp_planned")
    task = qt.load_task(line_task(tmp_path))
    job = Job(task, ("placement",), 0, methods, "daqp", "best", certify=False)
    rows = [row for index in range(4) for row in job(index)]
    feasible = {r["sample"] for r in rows if r["feasible"]}
    assert 0 < len(feasible) < 4
    for r in rows:
        assert r["success"] == (r["sample"] in feasible) or r["method"] == "qp_gradient"
        assert (r["fault"] == "no plan") == (r["sample"] not in feasible)


def test_the_summary_counts_as_one_counts_by_hand(twelve: qt.Study) -> None:
    rows = content(twelve)
    for summary in twelve.summary():
        mine = [r for r in rows if r["method"] == summary.method]
        assert (summary.all.count, summary.all.of) == (sum(r["success"] for r in mine), 12)
        assert any(r["feasible"] is None for r in mine)  # without certificates
        assert (summary.feasible.of, summary.possible.of) == (0, 12)
        faults = Counter(r["fault"] for r in mine if not r["success"])
        assert {kind: sum(j.values()) for kind, j in summary.faults.items()} == dict(faults)
        ratios = [r["z_over_least"] for r in mine if r["success"]]
        assert summary.over_least == pytest.approx(np.median(ratios))


def test_the_report_of_a_study(twelve: qt.Study) -> None:
    written = [Path(path).name for path in twelve.report()]
    assert written == ["summary.json", "summary.txt", "faults.png", "z.png", "maps.png"]
    summary = json.loads((twelve.folder / "summary.json").read_text("utf-8"))
    assert list(summary["methods"]) == METHODS
    for name in written:
        assert (twelve.folder / name).stat().st_size > 500


# ---------------------------------------------------------------- the command


@pytest.mark.usefixtures("undrawn")
def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    task, out = str(line_task(tmp_path)), str(tmp_path / "out")
    main(["study", task, "--samples", "3", "--methods", "qp_gradient", "--no-certify",
          "--jobs", "2", "--out", out])  # fmt: skip
    said = capsys.readouterr().out
    assert "line: 3 samples, seed 0, varied: placement" in said
    assert "qp_gradient" in said
    assert f"wrote {tmp_path / 'out' / 'results.sqlite'}" in said
    main(["study", task, "--samples", "3", "--methods", "qp_gradient", "--no-certify",
          "--jobs", "2", "--out", out, "--json"])  # fmt: skip
    found = json.loads(capsys.readouterr().out)  # nothing else on standard output
    files = found.pop("files")
    assert found == json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))
    assert found["samples"] == 3
    assert all(Path(file).is_file() for file in files)
    main(["compare", task, "--sample", "1", "--from", out, "--out", str(tmp_path / "one")])
    said = capsys.readouterr().out
    assert said.startswith("sample 1: x ")
    comparison = json.loads((tmp_path / "one" / "comparison.json").read_text("utf-8"))
    assert comparison["task"] == "line_1"
    assert list(comparison["methods"]) == ["qp_gradient"]
    for arguments, sentence in (
        (["--sample", "1"], "--sample N and --from DIR belong together"),
        (["--sample", "7", "--from", out], "samples 0 to 2; got 7"),
        (["--sample", "1", "--from", str(tmp_path)], "holds no study"),
    ):
        with pytest.raises(SystemExit) as stopped:
            main(["compare", task, *arguments])
        assert stopped.value.code == 2
        assert sentence in capsys.readouterr().err


# ---------------------------------------------------------------- a cluster


@pytest.fixture
def cluster() -> Iterator[Any]:
    """A scheduler and two workers, each a process of its own on this machine."""
    distributed = pytest.importorskip("distributed", reason="the extra `cluster`")
    import dask

    # Copies of data that two workers hold are dropped at once, not after two seconds: a worker may
    # hold the last one when it dies.
    often = {"distributed.scheduler.active-memory-manager.interval": "5ms"}
    with (
        dask.config.set(often),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as found,
    ):
        yield found


@pytest.mark.filterwarnings("default")
def test_a_killed_worker_changes_nothing(cluster: Any, twelve: qt.Study, tmp_path: Path) -> None:
    pids = {info["id"]: info["pid"] for info in _identities(cluster)}
    assert len(pids) == 2
    killed = []

    def kill_one(done: int) -> None:
        if done == 4:
            killed.append(next(iter(pids.values())))
            os.kill(killed[0], signal.SIGKILL)

    study = qt.study(
        line_task(tmp_path), ["placement"], 12, METHODS, out=tmp_path / "out", certify=False,
        scheduler=cluster.scheduler_address, progress=kill_one,
    )  # fmt: skip
    assert killed
    deadline = time.monotonic() + 20.0
    while Path(f"/proc/{killed[0]}").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not Path(f"/proc/{killed[0]}").exists()
    assert study.missing() == []
    assert content(study) == content(twelve)


def _identities(cluster: Any) -> list[dict[str, Any]]:
    from distributed import Client

    with Client(cluster) as client:
        pids = client.run(os.getpid)
    return [{"id": address, "pid": pid} for address, pid in pids.items()]
