"""What results look like at a prompt and in a notebook: one line, or a small table."""

import dataclasses
import io
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import qp_twist as qt


class Reader(HTMLParser):
    """Checks that every tag is closed, and collects the text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.tags: set[str] = set()
        self.feed(page)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)
        self.tags.add(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def line(steps: int = 20, **changes: object) -> qt.PathTask:
    task = qt.load_task("planar_line")
    waypoints = task.waypoints[::steps]
    timed = {"durations": np.append(0.0, np.full(len(waypoints) - 1, 2.0))}
    return dataclasses.replace(
        task, waypoints=waypoints, flipped_waypoints=None, **(timed | changes)
    )


def shown(result: object) -> str:
    """Its repr: one line, not long."""
    text = repr(result)
    assert "\n" not in text
    assert "array(" not in text
    assert len(text) < 300
    return text


def test_a_plan_prints_its_value_and_bound_in_one_line() -> None:
    plan = qt.plan(line())
    found = re.fullmatch(
        r"Plan\('planar_line', centering: mean z (0\.\d{4}) >= bound (0\.\d{4}), 6 waypoints\)",
        shown(plan),
    )
    assert found is not None
    assert [float(x) for x in found.groups()] == pytest.approx([plan.value, plan.bound], abs=5e-5)
    assert re.search(r"margin: \d+\.\d\d° <= bound \d+\.\d\d°", shown(qt.plan(line(), "margin")))
    weights = {"centering": 1.0, "travel": 0.001}
    assert "'travel': 0.001}: 0." in shown(qt.plan(line(), weights))


def test_a_plan_that_is_none_says_why() -> None:
    task = line()
    task.model.jnt_range[1] = np.radians([0.0, 30.0])
    plan = qt.plan(task)
    assert "centering: none: no configuration at waypoint" in shown(plan)
    page = Reader(plan._repr_html_())
    assert str(plan.certificate) in page.text


@pytest.mark.parametrize("name", ["planar <b>line</b>", 'a "quoted" & <script>alert(1)</script>'])
def test_tables_are_small_closed_and_escaped(name: str) -> None:
    task = line(name=name)
    plan, run = qt.plan(task), qt.follow(task, "qp")
    comparison = qt.compare(task, ["qp", "minimum_norm"])
    for result in (plan, run, comparison, qt.time_trajectory(run)):
        text = result._repr_html_()
        assert len(text) < 6000
        page = Reader(text)
        assert page.tags <= {"table", "caption", "b", "thead", "tbody", "tr", "th", "td"}
        assert any(name in part for part in page.text)
        assert "http" not in text
    assert f"{plan.value:.4f}" in "".join(Reader(plan._repr_html_()).text)
    assert {"qp", "minimum_norm"} <= set(Reader(comparison._repr_html_()).text)
    left_out = dataclasses.replace(comparison, not_run={"rmr": "no <i>room</i>"})
    assert "not run: no <i>room</i>" in Reader(left_out._repr_html_()).text


def test_a_check_is_a_table_with_its_verdict() -> None:
    task = line(name="<i>line</i>")
    check = qt.check_trajectory(qt.follow(task, "qp"), task)
    page = Reader(check._repr_html_())
    assert check.verdict in page.text
    for finding in check.findings:
        assert any(finding.name in part for part in page.text)


def test_a_run_is_drawn_with_its_joints_and_errors() -> None:
    task = line()
    run = qt.follow(task, "qp")
    figure = run.plot()
    panels = {p.get_title(loc="left"): p for p in figure.axes if p.get_visible()}
    assert sorted(panels) == ["axis error", *run.joint_names, "position error"]
    for column, name in enumerate(run.joint_names):
        curve = panels[name].lines[0]
        np.testing.assert_allclose(curve.get_ydata(), np.degrees(run.q[:, column]))
        low, high = np.degrees(task.model.jnt_range[column])
        heights = {round(float(limit.get_ydata()[0]), 6) for limit in panels[name].lines[1:]}
        assert heights == {round(float(low), 6), round(float(high), 6)}
    drawn = panels["position error"].lines[0].get_ydata()
    np.testing.assert_allclose(drawn, np.maximum(1e3 * run.position_error, 1e-9))


def test_a_task_is_shown_as_a_picture(tmp_path: Path) -> None:
    try:
        picture = line().show(width=200, height=150)
    except qt.QpTwistError as error:
        pytest.skip(str(error))
    assert picture._repr_png_() == picture.save(tmp_path / "a.png").read_bytes()
    image = Image.open(io.BytesIO(picture.png)).convert("RGB")
    assert image.size == (200, 150)
    red = np.asarray(image).astype(int)
    assert ((red[:, :, 0] > red[:, :, 1] + 60) & (red[:, :, 0] > red[:, :, 2] + 60)).sum() > 20


@pytest.mark.usefixtures("without_picture")
def test_without_opengl_there_is_an_exception() -> None:
    with pytest.raises(qt.QpTwistError, match="No picture"):
        line().show()
