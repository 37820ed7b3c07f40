"""Draw the figures and write the tables and outputs that the pages show.

    python docs/make_figures.py [NAME ...] [--out FOLDER]

A NAME is that of a table, a text or a figure below docs/generated or docs/figures, without its
ending, or of a task; without one all are made, which takes about three minutes. Everything comes
from the library: the comparisons that ``qp-twist compare`` makes, the same methods at other
settings, and the printed output of the snippets. Wall times are left out: no two machines agree on
them.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import io
import os
import runpy
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from PIL import Image

import qp_twist as qt
from qp_twist.comparison import metrics
from qp_twist.drawing import NoPicture
from qp_twist.drawing.palette import RC, RED
from qp_twist.drawing.picture import draw_scene
from qp_twist.drawing.sight import overview
from qp_twist.pages.method_style import line_style

DOCS = Path(__file__).parent
sys.path.append(str(DOCS.parent / "examples"))  # the simulated robot
FIGURES = {
    "deburring": (
        "scene", "joints", "joints_qp", "joints_qp_rmr", "joints_qp_gradient", "along_the_path",
        "roadmap",
    ),
    "planar_line": ("scene", "roadmap", "joints_qp"),
    "deburring_cell": ("roadmap",),
}  # fmt: skip


def main() -> None:
    """Write everything below the folder given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="what to make; all if absent")
    parser.add_argument("--out", type=Path, default=DOCS, help="folder to write to; docs if absent")
    given = parser.parse_args()
    out: Path = given.out

    def wanted(name: str) -> bool:
        return not given.names or name in given.names

    for name in filter(wanted, FIGURES):
        comparison = qt.compare(name)
        table = comparison_table(comparison)
        write(out / "generated" / "benchmarks" / f"{name}.md", table)
        if (name, out) == ("deburring", DOCS):
            put_into_readme(table)
        draw(comparison, out / "figures")
        if name == "deburring_cell":
            draw_passing(comparison, out / "figures" / "deburring_cell_scene.png")
    for name, (task, runs) in SETTINGS.items():
        if wanted(name):
            write(
                out / "generated" / "benchmarks" / f"{name}.md",
                settings_table(qt.load_task(task), runs),
            )
    if wanted("placement_map"):
        draw_placements(out / "figures" / "placement_map.png")
    if wanted("planar_line_gains"):
        draw_gains(out / "figures" / "planar_line_gains.svg")
    for snippet in snippets_with_output():
        if wanted(snippet.stem):
            write(out / "generated" / "snippets" / f"{snippet.stem}.txt", output_of(snippet))
    if wanted("mink_app"):
        write(out / "generated" / "snippets" / "mink_app.diff", app_difference())
        write(out / "generated" / "snippets" / "mink_app.txt", app_output())


def put_into_readme(table: str) -> None:
    """Put the table between the two comments of the README that mark its place."""
    readme = DOCS.parent / "README.md"
    head, rest = readme.read_text("utf-8").split("docs/make_figures.py -->\n")
    tail = rest.split("<!-- end of table -->")[1]
    write(readme, f"{head}docs/make_figures.py -->\n{table}<!-- end of table -->{tail}")


def write(path: Path, text: str) -> None:
    """Write a text file and say so."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    print(f"wrote {path}")


def draw(comparison: qt.Comparison, folder: Path) -> None:
    """The figures of a comparison that the pages show."""
    name = comparison.path_task.name
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as report:
        said = comparison.report(report)
        for figure in FIGURES[name]:
            drawn = Path(report) / f"{figure}.png"
            target = folder / f"{name}_{figure}.png"
            if (name, figure) == ("deburring", "scene"):
                target = folder / "scene.png"  # the README shows it too
            if drawn.exists():
                save_small(drawn, target)
                print(f"wrote {target}")
            else:
                print(said[-1])


def save_small(drawn: Path, target: Path) -> None:
    """A picture with 128 colours: the repository keeps it."""
    with Image.open(drawn) as picture:
        picture.convert("RGB").quantize(128).save(target, optimize=True)


def draw_placements(path: Path) -> None:
    """Placements of the deburring run in a box that is larger than the reach of the arm."""
    box = np.array([0.8, 0.6, 0.4])
    found = qt.best_placement(qt.load_task("deburring"), -box, box, seconds=40.0)
    with tempfile.TemporaryDirectory() as folder:
        found.figure().savefig(drawn := Path(folder) / "map.png")
        save_small(drawn, path)
    print(f"wrote {path}")


PASSING = 107
"""Index of the waypoint at which a closed form is deepest in the clamp of the cell."""


def draw_passing(comparison: qt.Comparison, path: Path) -> None:
    """The arm that passes the clamp, and as a ghost the one that does not."""
    task, runs = comparison.path_task, comparison.trajectories
    lines, camera = [(task.positions, RED)], overview(task.model)
    try:
        pngs = [
            draw_scene(task.model, runs[name].q[PASSING], lines, camera=camera)
            for name in ("qp_gradient", "gradient_projection")
        ]
    except NoPicture as error:
        print(error)
        return
    passes, ghost = (Image.open(io.BytesIO(png)).convert("RGB") for png in pngs)
    width, height = passes.size
    part = (0.22 * width, 0.06 * height, 0.92 * width, height)
    shown = Image.blend(passes, ghost, 0.28).crop(tuple(map(int, part)))
    shown.quantize(128).save(path, optimize=True)
    print(f"wrote {path}")


# ---------------------------------------------------------------- tables


def comparison_table(comparison: qt.Comparison) -> str:
    """The metrics of every method, without wall times."""
    return markdown_table(
        [{"method": f"`{name}`", **cells(t)} for name, t in comparison.trajectories.items()]
    )


def cells(trajectory: qt.Trajectory) -> dict[str, str]:
    """A row by heading; what means nothing for the task is left out."""
    task, numbers = trajectory.path_task, metrics(trajectory)
    row = {
        "leaves limits": leaves_limits(numbers),
        "margin": f"{numbers['min_margin']:.3f}",
        "mean z": f"{numbers['mean_z']:.4f}",
        "position mm": error_cell(1e3 * numbers["position_error_max_m"]),
    }
    if task.projector.angular.rank:
        row["axis °"] = error_cell(np.degrees(numbers["axis_error_max_rad"]))
    row["travel °"] = f"{numbers['travel_deg']:.0f}"
    row["step °"] = f"{numbers['max_step_deg']:.1f}"
    if np.allclose(task.positions[0], task.positions[-1]):
        row["closure °"] = f"{np.degrees(numbers['closure_rad']):.0f}"
    if trajectory.nearest is not None:
        near = trajectory.nearest[1]
        row["clearance mm"] = f"{1e3 * near.distance:.1f}"
        row["nearest pair"] = near.pair
    if np.isfinite(task.velocity_limits).any():
        row["speed"] = f"{speed_share(trajectory):.2f}"
    return row


def leaves_limits(numbers: dict[str, Any]) -> str:
    """Joints and first waypoints, or no."""
    first = numbers["first_violation"]
    return "<br>".join(f"{joint}\u00a0at\u00a0{index}" for joint, index in first.items()) or "no"


def error_cell(error: float) -> str:
    """An error in mm or degrees; 0 stands for less than 1e-5, which is within the tolerances."""
    return "0" if error < 1e-5 else f"{error:.2g}" if error < 0.1 else f"{error:.3g}"


def speed_share(trajectory: qt.Trajectory) -> float:
    """Largest joint speed between two waypoints at the task's feed, as a share of its limit."""
    task = trajectory.path_task
    assert task.durations is not None
    steps = np.abs(np.diff(trajectory.q, axis=0))
    return float((steps / (task.velocity_limits * task.durations[1:, None])).max())


PLANAR_GAINS = (0.0, 0.0005, 0.001, 0.003, 0.006, 0.01, 0.03, 0.1, 1.0)
SETTINGS: dict[str, tuple[str, list[tuple[str, dict[str, Any]]]]] = {
    "deburring_twa": (
        "deburring",
        [
            ("twa", {"gain": gain, "iterations": iterations})
            for iterations, gains in (
                (1, (0.0, 0.001, 0.003, 0.01, 0.1, 0.3, 1.0)),
                (3, (0.1, 0.3, 1.0)),
            )
            for gain in gains
        ]
        + [("qp", {"gain": gain}) for gain in (0.0, 0.001, 0.003, 0.01, 0.1, 0.3, 1.0)],
    ),
    "deburring_gradient": (
        "deburring",
        [
            ("qp_gradient", {"weight": weight, "gain": gain})
            for weight, gains in (
                ("gradient", (0.1, 0.3, 1.0, 3.0)),
                ("paper", (0.01, 0.1, 0.3, 1.0)),
                ("natural", (0.01, 0.05, 0.1, 0.3, 1.0)),
            )
            for gain in gains
        ],
    ),
    "planar_line_twa": (
        "planar_line",
        [(method, {"gain": gain}) for gain in PLANAR_GAINS for method in ("twa", "qp")],
    ),
}
"""Task and runs of the tables of methods at other settings than the task files'."""


def settings_table(task: qt.PathTask, runs: Sequence[tuple[str, dict[str, Any]]]) -> str:
    """One run of ``follow(task, method, **options)`` a row."""
    rows = []
    for method, given in runs:
        settings = {**task.settings(method).model_dump(), **given}
        options = dict.fromkeys(key for _, options in runs for key in options)
        row = {"method": f"`{method}`", **{key: str(settings[key]) for key in options}}
        row |= cells(qt.follow(task, method, **given))
        for heading in ("axis °", "closure °"):
            row.pop(heading, None)
        rows.append(row)
    same = {
        heading: cell
        for heading, cell in rows[0].items()
        if all(row[heading] == cell for row in rows) and heading != "gain"
    }
    table = markdown_table([{k: v for k, v in row.items() if k not in same} for row in rows])
    if same:
        table += f"\nThe same in all rows: {', '.join(' '.join(item) for item in same.items())}.\n"
    return table


def markdown_table(rows: Sequence[dict[str, str]]) -> str:
    """A table in Markdown from rows by heading; numbers to the right."""
    left = {"method", "leaves limits", "weight", "nearest pair"}
    head = list(rows[0])
    lines = [head, [":--" if title in left else "--:" for title in head]]
    lines += [list(row.values()) for row in rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


# ---------------------------------------------------------------- the gain on the planar line


SHOWN_GAIN = 0.003


def draw_gains(path: Path) -> None:
    """Mean z of twa and qp over the gain, and the joints of the paper's Fig. 4 at a small one."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    task = qt.load_task("planar_line")
    ranges = qt.JointRanges.of(task.model)
    shortest = qt.follow(task, "minimum_norm")
    # No motion has less than the plan's bound, and here the plan has no more.
    lowest = qt.plan(task).bound
    gains = np.geomspace(1e-4, 0.1, 31)
    with mpl.rc_context(RC | {"svg.fonttype": "none", "svg.hashsalt": path.stem}):
        figure = Figure(figsize=(7.2, 6.4), layout="constrained")
        FigureCanvasAgg(figure)
        top, bottom = figure.subfigures(2, 1, height_ratios=[1.0, 1.0])
        ax = top.subplots()
        for method in ("twa", "qp"):
            runs = [qt.follow(task, method, gain=gain) for gain in gains]
            ax.plot(gains, [run.z.mean() for run in runs], **line_style(method))
            outside = [run.margins.min() < -1e-9 for run in runs]
            if any(outside):
                ax.axvline(
                    gains[outside.index(True)],
                    color=RED,
                    label=f"from here on {method} leaves the limits",
                )
        none = qt.follow(task, "twa", gain=0.0).z.mean()
        for level, colour, side, words in (
            (shortest.z.mean(), "#009E73", "bottom", "minimum norm"),
            (none, "#555555", "top", "twa at gain 0"),
            (lowest, "#000000", "bottom", "least at each waypoint"),
        ):
            ax.axhline(level, color=colour, linewidth=1.0, linestyle=(0, (1, 1.5)))
            ax.annotate(
                f"{words}, {level:.4f}", (0.99, level), xycoords=("axes fraction", "data"),
                xytext=(0, 3 if side == "bottom" else -3), textcoords="offset points",
                ha="right", va=side, fontsize=8, color=colour,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
            )  # fmt: skip
        ax.set_xscale("log")
        ax.set_ylim(0.0515, 0.0600)
        ax.set_xlabel("gain (weight paper)")
        ax.set_title("Mean z over the line")
        ax.legend(loc="upper left")
        avoiding = qt.follow(task, "twa", gain=SHOWN_GAIN)
        still = qt.follow(task, "twa", gain=0.0)
        for joint, panel in enumerate(bottom.subplots(1, 3)):
            for run, style, words in (
                (shortest, {"color": "#009E73"}, "minimum norm"),
                (avoiding, {"color": "#0072B2"}, f"twa, gain {SHOWN_GAIN}"),
                (still, {"color": "#0072B2", "linestyle": (0, (1, 1.5))}, "twa, gain 0"),
            ):
                panel.plot(np.arange(1, len(run.q) + 1), np.degrees(run.q[:, joint]), **style,
                           label=words)  # fmt: skip
            for limit in (ranges.lower[joint], ranges.upper[joint]):
                panel.axhline(np.degrees(limit), color=RED, linewidth=1.2)
            panel.set_title(f"{ranges.names[joint]}, degrees")
            panel.set_xlabel("waypoint")
        bottom.legend(*panel.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, metadata={"Date": None})
    print(f"wrote {path}")


# ---------------------------------------------------------------- snippets


def snippets_with_output() -> list[Path]:
    """The snippets whose printed output a page shows."""
    examples = DOCS.parent / "examples"
    return [*sorted((DOCS / "snippets").glob("*.py")), examples / "one_step.py"]


def output_of(snippet: Path) -> str:
    """What a snippet prints, run beside copies of the task files it reads."""
    printed = io.StringIO()
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(printed):
        for file in (DOCS / "snippets").glob("*.toml"):
            shutil.copy(file, folder)
        os.chdir(folder)
        try:
            runpy.run_path(str(snippet), run_name="__main__")
        finally:
            os.chdir(here)
    return printed.getvalue()


APP = tuple(DOCS.parent / "examples" / f"mink_app_{when}.py" for when in ("before", "after"))
APP_SECONDS = "5"


def app_difference() -> str:
    """How the example app changes."""
    texts = [path.read_text("utf-8").splitlines(keepends=True) for path in APP]
    return "".join(difflib.unified_diff(*texts, *(path.name for path in APP), n=1))


def app_output() -> str:
    """What the app prints, before and after."""
    lines = []
    for path in APP:
        command = [sys.executable, str(path), "--headless", "--seconds", APP_SECONDS]
        ended = subprocess.run(command, check=True, capture_output=True, text=True)
        lines.append(f"{path.name}: {ended.stdout}")
    return "".join(lines)


if __name__ == "__main__":
    main()
