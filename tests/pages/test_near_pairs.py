"""What a report shows of clearance: the nearest pairs, beside MuJoCo's distances."""

import re
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

import qp_twist as qt
from qp_twist.pages.near_pairs import near_geoms, nearest_pair
from qp_twist.paths import Tolerances

TWO = """
<mujoco>
  <worldbody>
    <geom name="block" type="box" size="0.1 0.1 0.1"/>
    <body name="ball" pos="0 0 0.5">
      <joint name="up" type="slide" axis="0 0 1" range="-1 1"/>
      <geom name="ball" type="sphere" size="0.05"/>
    </body>
    <body name="rod" pos="0 1 0">
      <joint name="along" type="slide" axis="1 0 0" range="-1 1"/>
      <geom name="rod" type="capsule" size="0.02" fromto="-0.1 0 0 0.1 0 0"/>
    </body>
  </worldbody>
</mujoco>
"""


def distances(model: mujoco.MjModel, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Distance of each pair at q, m, by MuJoCo."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    return np.array([mujoco.mj_geomDistance(model, data, a, b, 9.0, None) for a, b in pairs])


@pytest.fixture(scope="module")
def cell() -> qt.PathTask:
    return qt.load_task("deburring_cell")


@pytest.fixture(scope="module")
def runs(cell: qt.PathTask) -> dict[str, qt.Trajectory]:
    """One that hits the clamp, and one that passes it."""
    return {name: qt.follow(cell, name) for name in ("gradient_projection", "qp_gradient")}


def test_the_closest_pair_is_that_of_the_least_distance_of_all(
    cell: qt.PathTask, runs: dict[str, qt.Trajectory]
) -> None:
    (clearance,) = cell.clearances
    q = np.vstack([run.q[::40] for run in runs.values()])
    found, which = clearance.closest(q)
    assert found.min() < -0.05  # the one run is inside the clamp
    assert found.max() > 0.03
    violated = clearance.first_violated(q)
    for k, row in enumerate(q):
        every = distances(cell.model, row, clearance.pairs)
        assert found[k] == pytest.approx(every.min(), abs=2e-5)
        assert every[which[k]] == pytest.approx(every.min(), abs=2e-5)
        if abs(every.min() - 0.005) > 1e-5:  # not on the boundary, where the one run goes
            assert (violated[k] < 0) == (every.min() > 0.005)
        if violated[k] >= 0:
            assert every[violated[k]] < 0.005 + 1e-5


def test_the_geoms_of_near_pairs_are_lit() -> None:
    model = mujoco.MjModel.from_xml_string(TWO)
    clearance = qt.Clearance(model, 0.01)
    task = SimpleNamespace(model=model, clearances=(clearance,), tolerances=Tolerances())
    for up, distance in ((0.0, 0.35), (-0.37, -0.02)):
        found = nearest_pair(task, np.array([up, 0.0]))
        assert found is not None
        assert (found.name, found.too_near) == ("block to ball", distance < 0.01)
        assert found.distance == pytest.approx(distance, abs=1e-6)
    block, ball = model.geom("block").id, model.geom("ball").id
    assert near_geoms(task, np.array([[0.0, 0.0]])) == {}
    assert near_geoms(task, np.array([[-0.33, 0.0]])) == {block: False, ball: False}
    assert near_geoms(task, np.array([[-0.345, 0.0], [0.0, 0.0]])) == {block: True, ball: True}


@pytest.mark.usefixtures("without_picture")
def test_the_report_names_what_each_method_is_nearest_to(
    cell: qt.PathTask, runs: dict[str, qt.Trajectory], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(qt.Comparison, "figures", lambda _: {})
    qt.Comparison(cell, "compiled", runs).report(tmp_path)
    page = (tmp_path / "report.html").read_text("utf-8")
    section = page[page.index('<section id="clearance"') : page.index('<section id="z"')]
    rows = re.findall(
        r'<tr><th scope="row">.*?(\w+)</th><td>([^<]+)</td><td>([^<]+)</td><td>([^<]+)</td>'
        r'<td class="(\w+)">([^<]+)</td></tr>', section,
    )  # fmt: skip
    assert [row[0] for row in rows] == list(runs)
    (clearance,) = cell.clearances
    for name, pair, mm, waypoint, mark, words in rows:
        at = float(waypoint) - 1.0
        before = int(at)
        q = runs[name].q
        here = q[before] + (at - before) * (q[min(before + 1, len(q) - 1)] - q[before])
        every = distances(cell.model, here, clearance.pairs)
        assert float(mm.replace("−", "-")) == pytest.approx(1e3 * every.min(), abs=1.5)
        assert clearance.names[int(every.argmin())] == pair
        assert ("clamp_post" in pair) and (mark == "bad") == (words != "✓ kept")
        if name == "gradient_projection":
            assert words == "✗ overlap"
            assert float(mm.replace("−", "-")) < -50.0
    assert 'id="clearance' in section and section.count("<figure>") == 1
    # At a glance it is the same verdict, between waypoints, too.
    for name, _, _, _, mark, _ in rows:
        glance = re.search(rf"<b>{name}</b> <span>([^<]+)</span>", page)
        assert glance is not None
        assert bool(re.search("comes too near|touches by", glance[1])) == (mark == "bad")
        assert (glance[1][0] == "✗") >= (mark == "bad")
