"""The report: one page, opened in a real browser."""

import base64
import csv
import dataclasses
import html.parser
import io
import json
import re
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from oracles.browser import open_page

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.comparison import csv_table

METHODS = ["gradient_projection", "qp_gradient", "twa", "qp", "qp_planned", "rmr"]
SECTIONS = [
    "scene", "glance", "joints", "error", "z", "sigma", "speed", "times", "roadmap", "table",
    "shows", "methods",
]  # fmt: skip


class WithoutDrawing(qt.Comparison):
    """A comparison whose other figures, tested elsewhere, need no time."""

    def figures(self) -> dict[str, Figure]:
        return {"roadmap": Figure(figsize=(2, 2))}


@pytest.fixture(scope="module")
def folder(planar: qt.Comparison, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the report of some methods was written, with a method that did not run."""
    # With a clock and joint speed limits, so that the page has all its tables.
    durations = np.full(len(planar.path_task.waypoints), 0.1)
    durations[0] = 0.0
    task = dataclasses.replace(
        planar.path_task, title="Line & <end point>", durations=durations,
        velocity_limits=np.full(3, 500.0),
    )  # fmt: skip
    chosen = {
        name: dataclasses.replace(trajectory, path_task=task, durations=durations)
        for name, trajectory in planar.trajectories.items()
        if name in METHODS
    }
    comparison = WithoutDrawing(task, planar.solver, chosen, {"pink": "no <pink> here"})
    out = tmp_path_factory.mktemp("report")
    lines = comparison.report(out)
    assert lines[0] == str(out / "report.html")
    return out


@pytest.fixture(scope="module")
def page(folder: Path) -> str:
    return (folder / "report.html").read_text("utf-8")


def test_the_page_has_its_sections_picture_and_verdict_first(
    page: str, planar: qt.Comparison
) -> None:
    assert re.findall(r'<section id="([^"]*)"', page) == SECTIONS
    assert page.startswith('<!DOCTYPE html>\n<html lang="en">')
    shows = page[page.index('id="shows"') : page.index('id="methods"')]
    assert "was not as good as" in shows
    assert "pink could not run: no &lt;pink&gt; here." in shows
    glance = page[page.index('id="glance"') : page.index('id="joints"')]
    lines = re.findall(r'<li class="(good|bad)">.*?<b>(\w+)</b> <span>(.*?)</span>', glance)
    ranges = qt.JointRanges.of(planar.path_task.model)
    kept = {
        name: bool((ranges.room(t.q) >= -1e-9).all() and t.position_error.max() < 1e-5)
        for name, t in planar.trajectories.items()
        if name in METHODS
    }
    assert {name: mark == "good" for mark, name, _ in lines} == kept
    assert set(kept.values()) == {True, False}
    said = next(words for _, name, words in lines if name == "twa")
    assert re.match("✗ leaves the limits: .*joint_2 at 2", said)
    assert "Line &amp; &lt;end point&gt;" in page
    assert "6 methods, 101 waypoints." in page
    assert len(page.encode()) < 2_500_000


def test_ids_occur_once_and_references_have_their_target(page: str) -> None:
    ids: Counter[str] = Counter()
    used: set[str] = set()
    without_text: list[str] = []

    class Reader(html.parser.HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            given = dict(attrs)
            if "id" in given:
                ids[given["id"] or ""] += 1
            for key, value in attrs:
                if key in ("href", "xlink:href") and value and value.startswith("#"):
                    used.add(value[1:])
                used.update(re.findall(r"url\(#([^)]*)\)", value or ""))
            hidden = given.get("aria-hidden") == "true" or given.get("role") == "img"
            if tag == "svg" and not hidden:
                without_text.append(str(attrs))

    Reader().feed(page)
    assert [name for name, count in ids.items() if count > 1] == []
    assert used <= set(ids)
    assert len(used) > 20
    assert without_text == []


def test_the_report_in_a_browser(folder: Path) -> None:
    with open_page() as opened:
        opened.go(folder / "report.html")
        tab = opened.page
        # One player is enough here, and a small one: without a graphics card they are slow.
        tab.locator("iframe").nth(1).evaluate("iframe => iframe.remove()")
        tab.locator("iframe").evaluate("iframe => { iframe.style.height = '15rem'; }")
        shown = "document.querySelectorAll('#joints .m-{}')[0].getClientRects().length > 0"
        assert tab.evaluate(shown.format("twa"))
        assert not tab.evaluate(shown.format("rmr"))
        # By keyboard alone: to the method's box, then the space bar.
        tab.locator("#selector input[value=rmr]").focus()
        tab.keyboard.press("Space")
        assert tab.evaluate(shown.format("rmr"))
        tab.get_by_role("button", name="QPs").focus()
        tab.keyboard.press("Enter")
        assert not tab.evaluate(shown.format("twa"))
        assert tab.evaluate(shown.format("qp"))
        for width in (800, 1600):
            tab.set_viewport_size({"width": width, "height": 900})
            assert tab.evaluate("document.documentElement.scrollWidth") <= width
        # The scene plays what the keys choose.
        tab.set_viewport_size({"width": 800, "height": 600})
        tab.locator(".view select").first.focus()
        tab.keyboard.press("ArrowDown")
        assert tab.locator(".view select").first.input_value() == "qp"
        assert tab.evaluate(
            "document.querySelector('iframe').srcdoc.includes("
            "document.querySelector('.recording[data-method=qp]').textContent)"
        )
        canvas = tab.frame_locator("iframe").locator("canvas:not([height='0'])").first
        canvas.wait_for(timeout=60_000)
        blue, until = 0.0, time.monotonic() + 20.0
        while blue <= 0.01 and time.monotonic() < until:  # the player fades in
            tab.wait_for_timeout(500)
            # Read from the canvas right after it is drawn: a screenshot may wait for a quiet moment
            # that an animation without a graphics card never leaves.
            drawn = canvas.evaluate(
                "canvas => new Promise("
                "done => requestAnimationFrame(() => done(canvas.toDataURL())))"
            )
            picture = _pixels(base64.b64decode(drawn.partition(",")[2]))
            # White paper, grey grid, and the blue of the arm.
            blue = (picture[:, :, 2] > picture[:, :, 0] + 40).mean()
        assert blue > 0.01
        assert opened.requests == []
        assert opened.errors == []


def test_the_report_is_no_wider_than_a_phone(folder: Path, tmp_path: Path) -> None:
    """Nothing is cut off: what is wider than the page scrolls in itself."""
    text = (folder / "report.html").read_text("utf-8")
    still = tmp_path / "report.html"  # without players, which are slow where software draws
    still.write_text(re.sub(r"<iframe[^>]*></iframe>", "<iframe></iframe>", text), "utf-8")
    with open_page() as opened:
        tab = opened.page
        tab.add_init_script("window.IntersectionObserver = class { observe() {} };")
        opened.go(still)
        assert tab.locator("table").count() == 3
        for scheme in ("light", "dark"):
            tab.emulate_media(color_scheme=scheme)
            paper = tab.evaluate("getComputedStyle(document.body).backgroundColor")
            light = sum(map(int, re.findall(r"\d+", paper)))
            assert light > 600 if scheme == "light" else light < 150
            for width in (320, 360, 390, 768, 1280):
                tab.set_viewport_size({"width": width, "height": 800})
                assert tab.evaluate("document.scrollingElement.scrollWidth") <= width
                cut = tab.evaluate(
                    """() => [...document.querySelectorAll("main *")].filter(element => {
                        if (element.getBoundingClientRect().right <= innerWidth + 1) return false;
                        while (element = element.parentElement)
                            if (getComputedStyle(element).overflowX !== "visible") return false;
                        return true;
                    }).length"""
                )
                assert cut == 0
        tab.set_viewport_size({"width": 360, "height": 800})
        # The method's name leaves most of the table's window to its numbers.
        name, table = tab.locator(".metrics th[scope=row]"), tab.locator(".metrics").locator("..")
        assert name.first.bounding_box()["width"] < 0.5 * table.bounding_box()["width"]
        drawing = tab.locator("#joints .drawing")
        inside = "element => [element.scrollWidth, element.clientWidth]"
        fits, window = drawing.evaluate(inside)
        assert fits <= window
        drawing.click()
        enlarged, window = drawing.evaluate(inside)
        assert enlarged > 1.5 * window
        assert tab.evaluate("document.scrollingElement.scrollWidth") <= 360


def _pixels(png: bytes) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


# ---------------------------------------------------------------- for machines


def test_compare_prints_json_and_nothing_else(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    main(["compare", "planar_line", "--methods", "twa", "--json"])
    content = json.loads(capsys.readouterr().out)
    assert content["methods"]["twa"]["first_violation"]["joint_2"] == 2
    assert list(tmp_path.iterdir()) == []


def test_compare_prints_csv_a_row_a_method(
    planar: qt.Comparison, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    content = planar.to_dict() | {"not_run": {"pink": "none, here"}}
    rows = list(csv.DictReader(io.StringIO(csv_table(content))))
    assert [row["method"] for row in rows] == [*planar.trajectories, "pink"]
    for row, numbers in zip(rows, content["methods"].values(), strict=False):
        assert float(row["mean_z"]) == numbers["mean_z"]
        assert row["status"] == numbers["status"]
    assert rows[-1]["status"] == "not run: none, here"
    monkeypatch.chdir(tmp_path)
    main(["compare", "planar_line", "--methods", "minimum_norm", "--csv"])
    (row,) = csv.DictReader(io.StringIO(capsys.readouterr().out))
    assert (row["method"], row["violations"]) == ("minimum_norm", "0")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("below", ["", "deep/er"])
def test_a_folder_that_cannot_be_is_refused_before_the_methods_run(
    below: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("qp_twist.cli.compare.compare_methods", None)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(SystemExit) as ended:
        main(["compare", "planar_line", "--out", str(tmp_path / "file" / below)])
    assert ended.value.code == 2
    assert "is a file; give another folder" in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "mine"

    def refused(**_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refused)
    with pytest.raises(SystemExit):
        main(["compare", "planar_line", "--out", str(tmp_path / "new")])
    assert "(Permission denied); give another folder" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["compare", "planar_line", "--json", "--csv"])
    assert "give one of them" in capsys.readouterr().err
