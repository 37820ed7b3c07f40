"""Gallery and conventions: pictures, what is said of them, and numbers that were measured."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mink
import numpy as np
import pytest
from matplotlib.image import imread
from oracles.scripts import script

import qp_twist as qt
from qp_twist.geometry import angular_error

DOCS = Path(__file__).parents[2] / "docs"
Found = dict[str, Any]


GALLERY = script("docs", "make_gallery.py")


def joints_outside(trajectory: qt.Trajectory) -> dict[str, int]:
    """The first waypoint at which each joint is outside its range, by the model's own numbers."""
    model = trajectory.path_task.model
    lower, upper = model.jnt_range.T
    outside = (trajectory.q < lower - 1e-9) | (trajectory.q > upper + 1e-9)
    return {
        model.joint(j).name: int(np.argmax(outside[:, j])) + 1
        for j in np.flatnonzero(outside.any(0))
    }


def reaches(found: Found) -> None:
    shares = np.divide(found["errors"][2:], found["errors"][1:-1])
    assert shares == pytest.approx(0.6, abs=0.1)  # but for the curvature of the way


def follows(found: Found) -> None:
    assert found["line"].position_error.max() < 1e-8
    assert not joints_outside(found["line"])


def frees_the_roll(found: Found) -> None:
    assert joints_outside(found["prescribed"]) == {"joint_4": 269, "joint_6": 351}
    assert not joints_outside(found["free"])
    assert found["free"].position_error.max() < 1e-8


def goes_along_the_limit(found: Found) -> None:
    assert joints_outside(found["closed"])["joint_1"] == 50
    assert not joints_outside(found["program"])
    assert np.allclose(found["closed"].q[:49], found["program"].q[:49], atol=1e-7)
    assert found["program"].position_error.max() < 1e-8


def keeps_the_direction(found: Found) -> None:
    scaled, relaxed = found["moved"]["scale"], found["moved"]["relax"]
    assert abs(scaled[1]) < 1e-9
    assert abs(relaxed[1]) > 0.05
    asked = found["asked"]
    assert np.linalg.norm(asked - relaxed) < np.linalg.norm(asked - scaled) - 1e-3


def stays_in_the_band(found: Found) -> None:
    inside, outside = (np.abs(found["rolls"](found[name])) for name in ("with_band", "without"))
    assert inside.max() < 45.0 + 1e-3
    assert outside.max() > 90.0


def gives_way_in_order(found: Found) -> None:
    tip, angle = np.array(found["errors"]).T
    assert tip.max() < 1e-3
    assert angle.max() > 0.1
    assert np.mean(angle < 1e-6) > 0.5


def compares(found: Found) -> None:
    runs = found["comparison"].trajectories
    assert joints_outside(runs["twa"])["joint_2"] == 2
    assert not any(joints_outside(run) for name, run in runs.items() if name != "twa")
    assert runs["qp"].margins.min() == pytest.approx(0.0, abs=1e-3)


def does_not_lag(found: Found) -> None:
    # Where nothing is told, the lag is that of a first-order filter: speed × dt / gain.
    lag = max(found["errors"][False])
    assert lag == pytest.approx(1e3 * 0.9 * 0.02 / 0.1, rel=0.1)
    assert max(found["errors"][True][25:]) < lag / 100.0


def drives(found: Found) -> None:
    off = np.linalg.norm(np.array(found["points"]) - np.array(found["hands"]), axis=1)
    assert off.max() < 1e-3
    assert np.ptp(found["bases"], axis=0).min() > 1.0


def plans(found: Found) -> None:
    ranges = found["ranges"]
    nearest = [
        np.degrees(np.minimum(q - ranges.lower, ranges.upper - q).min(axis=1))
        for q in (found["local"].q, found["plan"].q)
    ]
    assert int(np.argmax(nearest[0] < 0.1)) + 1 == 41
    assert nearest[1].min() == pytest.approx(11.4, abs=0.1)
    assert found["plan"].bound < nearest[1].min() + 0.05


def comes_back(found: Found) -> None:
    lines = found["panel"].get_lines()
    largest = [line.get_ydata().max() for line in lines]
    assert largest[0] < largest[1] < largest[2]
    assert lines[0].get_ydata()[-1] < 0.1


CLAIMS: dict[str, Callable[[Found], None]] = {
    "01": reaches, "02": follows, "03": frees_the_roll, "04": goes_along_the_limit,
    "05": keeps_the_direction, "06": stays_in_the_band, "07": gives_way_in_order, "08": compares,
    "09": does_not_lag, "10": drives, "11": plans, "12": comes_back,
}  # fmt: skip


@pytest.mark.parametrize("script", GALLERY.SCRIPTS, ids=lambda path: path.stem)
def test_a_script_draws_the_picture_of_the_page_and_does_what_it_says(
    script: Path, tmp_path: Path
) -> None:
    picture = tmp_path / "picture.png"
    found = GALLERY.draw(script, picture)
    CLAIMS[script.name[:2]](found)
    drawn, kept = (
        imread(path)[..., :3].mean(axis=2)
        for path in (picture, DOCS / "figures" / GALLERY.picture_name(script))
    )
    assert drawn.shape == kept.shape
    assert kept.std() > 0.05  # it is not blank
    # Ink in the same places, seen coarsely: fonts differ by a pixel from one release to the next.
    rows, columns = (16 * (n // 16) for n in drawn.shape)
    coarse = [
        p[:rows, :columns].reshape(rows // 16, 16, columns // 16, 16).mean(axis=(1, 3))
        for p in (drawn, kept)
    ]
    assert np.corrcoef(*(p.ravel() for p in coarse))[0, 1] > 0.9


def test_the_page_shows_every_script_under_its_picture() -> None:
    page = (DOCS / "gallery.md").read_text("utf-8")
    shown = re.findall(
        r"\{figure\} figures/(\S+)\n.*?literalinclude\} gallery/(\S+)", page, re.DOTALL
    )
    assert shown == [(GALLERY.picture_name(s), s.name) for s in GALLERY.SCRIPTS]
    assert [script.name[:2] for script in GALLERY.SCRIPTS] == sorted(CLAIMS)


# ---------------------------------------------------------------- conventions


def test_the_pictures_of_the_conventions_are_those_of_the_script(tmp_path: Path) -> None:
    conventions = script("docs", "make_conventions.py")
    page = (DOCS / "conventions.md").read_text("utf-8")
    for draw in conventions.PICTURES:
        kept = DOCS / "figures" / f"conventions_{draw.__name__}.svg"
        assert kept.stat().st_size > 10_000
        assert f"figures/{kept.name}" in page
        assert draw().axes  # what it asserts of rotations holds
    once, again = (conventions.save(conventions.roll, tmp_path / k) for k in "ab")
    assert once.read_bytes() == again.read_bytes()


def test_the_conventions_are_those_of_the_code() -> None:
    """What the page says in words, by arithmetic of its own."""
    z = np.array([0.0, 0.0, 1.0])
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x to y: right-handed
    error = angular_error(np.eye(3), quarter, qt.Projector.line(z), moves_with_body=False)
    assert error == pytest.approx(np.pi / 2 * z)
    turns = [np.eye(3) for _ in range(3)]
    for k, angle in enumerate((0.1, 0.2, 0.3)):
        i, j = (k + 1) % 3, (k + 2) % 3
        turns[k][[i, j], [i, j]] = np.cos(angle)
        turns[k][j, i] = np.sin(angle)
        turns[k][i, j] = -np.sin(angle)
    said = mink.SO3.from_rpy_radians(0.1, 0.2, 0.3).as_matrix()
    assert turns[2] @ turns[1] @ turns[0] == pytest.approx(said)
    assert mink.SE3.identity().wxyz_xyz == pytest.approx([1, 0, 0, 0, 0, 0, 0])
    ranges = qt.JointRanges.of(qt.load_task("planar_line").model)
    at_limit = np.array([ranges.upper[0], ranges.middle[1], ranges.middle[2]])
    assert ranges.centering(at_limit) == pytest.approx(1 / 8)
    assert ranges.margins(at_limit) == pytest.approx([0.0, 1.0, 1.0])


# ---------------------------------------------------------------- numbers


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def table_of(name: str) -> dict[str, dict[str, str]]:
    """A generated table by the name of its method, and weight and gain if it has them."""
    lines = [
        cells(line)
        for line in (DOCS / "generated" / "benchmarks" / name).read_text("utf-8").splitlines()
        if line.startswith("|")
    ]
    head = lines[0]
    keys = 2 if head[0] == "weight" else 1
    return {" ".join(row[:keys]): dict(zip(head, row, strict=True)) for row in lines[2:]}


def rows_below(page: str, heading: str) -> list[dict[str, str]]:
    """The first table after a line of a page."""
    lines = (DOCS / page).read_text("utf-8").split(heading)[1].splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("|"))
    found = []
    for line in lines[first + 2 :]:
        if not line.startswith("|"):
            break
        found.append(dict(zip(cells(lines[first]), cells(line), strict=True)))
    return found


def test_the_numbers_that_choose_a_method_are_those_measured() -> None:
    run, places, weights = (
        table_of(f"{name}.md") for name in ("deburring", "placements", "deburring_gradient")
    )
    shown = rows_below("choose.md", "## One run")
    assert len(shown) == 7
    for row in shown:
        kept = run[row["method"]]
        for heading in ("margin", "mean z", "position mm", "travel °", "step °"):
            assert row[heading] == kept[heading]
        assert (row["leaves limits"] == "no") == (kept["leaves limits"] == "no")
    shown = rows_below("choose.md", "## A thousand runs")
    assert len(shown) == 10
    for row in shown:
        name, _, setting = row["method"].partition(", ")
        kept = places[name[:-1] + "_tuned`" if setting.startswith("tuned") else name]
        assert row["finishes %"] == kept["of feasible from the start %"]
        assert row["best of 3 starts %"] == kept["of feasible, 3 starts %"]
    shown = rows_below("choose.md", "**Weight and gain**")
    assert len(shown) == 5
    for row in shown:
        kept = weights[f"{row['weight']} {row['gain']}"]
        for heading in ("mean z", "travel °", "step °"):
            assert row[heading] == kept[heading]


def test_the_command_that_times_a_step_runs() -> None:
    text = (DOCS / "bench.md").read_text("utf-8")
    [(setup, statement)] = re.findall(r'timeit -p -n 1000 -s "(.*?)" \\\n"(.*?)"', text, re.DOTALL)
    names: Found = {}
    exec(setup, names)
    assert eval(statement, names).status is qt.Status.SOLVED
