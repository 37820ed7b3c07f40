"""The report of one motion, opened in a real browser and printed."""

import dataclasses
import json
import re
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
from oracles.browser import Opened, open_page
from oracles.joint_paths import joint_path

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.pages import MotionReport

pytestmark = pytest.mark.xdist_group("motion report")
STILL = "window.IntersectionObserver = class { observe() {} };"
"""Without the player, which is slow where software draws."""


@dataclasses.dataclass(frozen=True)
class Made:
    """A report, and the motion that it is about."""

    report: MotionReport
    task: qt.PathTask
    page: str


def made(motion: object, task: qt.PathTask, folder: Path) -> Made:
    found = qt.report(motion, task, folder, file="motion.json")  # type: ignore[arg-type]
    return Made(found, task, found.path.read_text("utf-8"))


@pytest.fixture(scope="module")
def timed() -> qt.TimedPath:
    """Ten waypoints of the deburring task."""
    task = qt.load_task("deburring")
    assert task.durations is not None
    task = dataclasses.replace(
        task, waypoints=task.waypoints[:10], durations=task.durations[:10], flipped_waypoints=None
    )
    return qt.time_trajectory(qt.follow(task, "qp_minimum_norm", slow_down=True))


@pytest.fixture(scope="module")
def passing(timed: qt.TimedPath, tmp_path_factory: pytest.TempPathFactory) -> Made:
    task = timed.trajectory.path_task
    return made(timed, task, tmp_path_factory.mktemp("passing"))


@pytest.fixture(scope="module")
def failing(timed: qt.TimedPath, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """The same with joint 4 a hundredth of a rad off at the fifth waypoint, at 40 times the speed,
    which keeps nothing but the joints' ranges, and that only just.
    """
    task = timed.trajectory.path_task
    q = timed.q.copy()
    q[4, 3] += 0.01
    rows = qt.TimedPath(timed.trajectory.joint_names, q, timed.times / 40.0)
    return made(rows, task, tmp_path_factory.mktemp("failing"))


def numbers(page: str) -> dict[str, list[float]]:
    """The different numbers of the page, by what they are of."""
    found: dict[str, set[float]] = {}
    for value, of in re.findall(r'<data value="([^"]*)" data-of="([^"]*)">', page):
        found.setdefault(of, set()).add(float(value))
    return {of: sorted(values) for of, values in found.items()}


@pytest.mark.parametrize("which", ["passing", "failing"])
def test_the_numbers_are_those_of_the_check(
    which: str, request: pytest.FixtureRequest, timed: qt.TimedPath
) -> None:
    report: Made = request.getfixturevalue(which)
    motion: object = timed
    if which == "failing":
        motion = qt.TimedPath(
            timed.trajectory.joint_names, report.report.check.motion.q,
            report.report.check.motion.times,
        )  # fmt: skip
    check = qt.check_trajectory(motion, report.task)  # type: ignore[arg-type]
    shown = numbers(report.page)
    assert shown.pop("cycle time") == [pytest.approx(float(check.motion.times[-1]))]
    assert check.speed is not None
    assert shown.pop("share at speed") == [pytest.approx(100.0 * check.speed.at_speed)]
    assert {name: [f.value for f in check.findings if f.name == name] for name in shown} == shown
    assert {finding.name for finding in check.findings} == set(shown)
    assert len(shown) > 6


def test_the_numbers_are_those_of_the_joints(failing: Made) -> None:
    """From positions and times alone, without the referee."""
    motion, task = failing.report.check.motion, failing.task
    speeds = np.abs(np.diff(motion.q, axis=0) / np.diff(motion.times)[:, None])
    share = 100.0 * float((speeds / task.velocity_limits).max())
    assert share > 100.0
    assert numbers(failing.page)["velocity limits"] == [pytest.approx(share, rel=1e-6)]
    ranges = qt.JointRanges.of(task.model)
    half = 0.5 * (ranges.upper - ranges.lower)
    margin = (1.0 - np.abs(motion.q - ranges.lower - half) / half).min()
    assert numbers(failing.page)["smallest joint margin"] == [pytest.approx(float(margin))]
    data = mujoco.MjData(task.model)
    data.qpos[:] = motion.q[4]
    mujoco.mj_kinematics(task.model, data)
    off = 1e3 * float(np.linalg.norm(data.site("tool").xpos - task.positions[4]))
    assert off > 0.1
    assert numbers(failing.page)["position error"] == [pytest.approx(off, rel=1e-6)]


def test_the_page_says_first_what_does_not_pass(passing: Made, failing: Made) -> None:
    for report, title, badge in (
        (passing, "Passes: deburring", "✓ Passes"),
        (failing, "Does not pass: deburring", "✗ Does not pass"),
    ):
        assert f"<title>{title}</title>" in report.page
        body = re.sub(r"<[^>]*>", " ", report.page[report.page.index("<body>") :])
        assert body.split()[: len(badge.split())] == badge.split()
        sections = re.findall(r'<section id="([^"]*)"', report.page)
        assert sections == [
            "picture", "verdict", "time", "figures", "slower", "checked", "facts",
        ]  # fmt: skip
    verdict = failing.page[failing.page.index('id="verdict"') : failing.page.index('id="time"')]
    for words in ("position error", "waypoint 5", "velocity limits", "limit 100", "joint_4"):
        assert words in verdict
    assert "smallest joint margin" not in verdict
    # A limit that nobody stated is named as what it is.
    for report in (passing, failing):
        first = report.page[report.page.index('id="verdict"') : report.page.index('id="time"')]
        assert "Accelerations checked against the default: full speed within 0.25 s." in first


@pytest.mark.usefixtures("without_picture")
def test_what_slows_the_path_is_named(timed: qt.TimedPath, tmp_path: Path) -> None:
    """With a tenth of joint 4's speed, that joint and no other is what costs time."""
    task = timed.trajectory.path_task
    limits = task.velocity_limits.copy()
    limits[3] = 0.005
    slow = dataclasses.replace(task, velocity_limits=limits)
    trajectory = dataclasses.replace(timed.trajectory, path_task=slow)
    page = made(qt.time_trajectory(trajectory), slow, tmp_path).page
    slower = page[page.index('id="slower"') : page.index('id="checked"')]
    assert re.search(r"joint_4&#39;s speed, waypoints \d+ to \d+", slower), slower
    assert not re.search(r"joint_[12356]", slower)


@pytest.mark.usefixtures("without_picture")
def test_the_least_distance_from_obstacles_is_shown(tmp_path: Path) -> None:
    """Two cubes of 0.2 m: the gap is the distance of their centres less 0.2 m."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom name="still" type="box" size="0.1 0.1 0.1"/>
        <body><joint name="x" type="slide" axis="1 0 0" limited="true" range="-1 1"/>
        <geom name="moving" type="box" size="0.1 0.1 0.1"/><site name="tool"/></body>
        </worldbody></mujoco>"""
    )
    q, times = np.array([[0.5], [0.3], [0.5]]), np.array([0.0, 1.0, 2.0])
    task = joint_path(model, q, times).path_task
    page = made(qt.TimedPath(("x",), q, times), task, tmp_path).page
    assert numbers(page)["clearance"] == [pytest.approx(100.0, abs=1e-3)]
    # From −0.2 m/s to 0.2 m/s in a second a cubic with equal ends goes 0.05 m further.
    rows = qt.TimedPath(("x",), q[[1, 1]], times[:2], np.array([[-0.2], [0.2]]))
    page = made(rows, joint_path(model, q[[1, 1]], times[:2]).path_task, tmp_path).page
    assert numbers(page)["clearance"] == [pytest.approx(50.0, abs=1e-2)]


@pytest.fixture(scope="module")
def still() -> Iterator[Opened]:
    """One browser for all pages that need no player."""
    with open_page() as opened:
        opened.page.add_init_script(STILL)
        yield opened


def test_the_page_in_a_browser(passing: Made) -> None:
    with open_page((900, 600)) as opened:
        opened.go(passing.report.path)
        canvas = opened.page.frame_locator("iframe").locator("canvas:not([height='0'])").first
        canvas.wait_for(timeout=60_000)
        for scheme in ("light", "dark"):
            opened.page.emulate_media(color_scheme=scheme)
            paper = opened.page.evaluate("getComputedStyle(document.body).backgroundColor")
            assert sum(map(int, re.findall(r"\d+", paper))) > 600 or scheme == "dark"
            assert sum(map(int, re.findall(r"\d+", paper))) < 150 or scheme == "light"
        assert opened.requests == []
        assert opened.errors == []


@pytest.mark.parametrize("which", ["passing", "failing"])
def test_the_page_is_no_wider_than_a_phone(
    which: str, still: Opened, request: pytest.FixtureRequest
) -> None:
    still.page.emulate_media(media="screen")
    still.page.set_viewport_size({"width": 320, "height": 640})
    still.go(request.getfixturevalue(which).report.path)
    for width in (320, 390, 800, 1280):
        still.page.set_viewport_size({"width": width, "height": 640})
        assert still.page.evaluate("document.scrollingElement.scrollWidth") <= width
        cut = still.page.evaluate(
            """() => [...document.querySelectorAll("body *")].filter(
                element => element.getBoundingClientRect().right > innerWidth + 1).length"""
        )
        assert cut == 0
    # On a desk the picture and the verdict are seen without scrolling.
    for part in ("#picture .view", "#verdict", "#time .big"):
        box = still.page.locator(part).bounding_box()
        assert box is not None and box["y"] < 640


@pytest.mark.parametrize("which", ["passing", "failing"])
def test_the_page_is_printed_on_two_pages(
    which: str, still: Opened, request: pytest.FixtureRequest
) -> None:
    still.go(request.getfixturevalue(which).report.path)
    still.page.emulate_media(media="print")
    printed = still.page.pdf(prefer_css_page_size=True, print_background=True)
    assert len(re.findall(rb"/Type\s*/Page\b(?!s)", printed)) == 2
    boxes = re.findall(rb"/MediaBox\s*\[([^\]]*)\]", printed)
    sizes = {tuple(round(float(x) / 72.0 * 25.4) for x in box.split()) for box in boxes}
    assert sizes == {(0, 0, 210, 297)}


@pytest.mark.usefixtures("without_picture")
def test_without_a_picture_for_print_it_says_so(timed: qt.TimedPath, tmp_path: Path) -> None:
    report = made(timed, timed.trajectory.path_task, tmp_path)
    assert report.report.remark == "No picture of the scene."
    assert "<img" not in report.page


@pytest.mark.usefixtures("without_picture")
def test_the_command_writes_one_file_and_says_what_fails(
    timed: qt.TimedPath, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    q = qt.follow(qt.load_task("planar_line"), "qp_gradient").q
    joints = ["joint_1", "joint_2", "joint_3"]
    for name, rows in (("good", q), ("off", q + 1e-3)):
        points = [{"positions": row.tolist()} for row in rows]
        Path(f"{name}.json").write_text(json.dumps({"joint_names": joints, "points": points}))
    main(["report", "good.json", "planar_line"])
    assert [p.name for p in Path("out/good_report").iterdir()] == ["report.html"]
    said = capsys.readouterr()
    assert "wrote out/good_report/report.html" in said.out
    assert "passes" in said.out.splitlines()[-1]
    with pytest.raises(SystemExit) as caught:
        main(["report", "off.json", "planar_line", "--out", "here"])
    assert caught.value.code == 1
    assert "does not pass: position error" in capsys.readouterr().err
    assert "✗ Does not pass" in Path("here/report.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [(["nosuch.json", "planar_line"], "there is no such trajectory file"),
     (["bad.json", "planar_line"], "bad.json"),
     (["bad.json", "planar_line", "--out", "bad.json"], "is a file; give another folder"),
     (["bad.json", "nosuch_task"], "nosuch_task")],
)  # fmt: skip
def test_bad_input_is_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("bad.json").write_text("{")
    with pytest.raises(SystemExit) as caught:
        main(["report", *words])
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert sentence in said and len(said.strip().splitlines()) == 1
    assert not Path("out").exists()
