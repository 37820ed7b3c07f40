"""Draw the figures and write the tables and outputs that the pages show.

    python docs/make_figures.py [--out FOLDER]

Everything comes from the library: the comparisons that ``qp-twist compare`` makes, the same methods
at other settings, and the printed output of the snippets. Takes about two minutes. Wall times are
left out, since no two machines agree on them.
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

import numpy as np

import qp_twist as qt
from qp_twist.comparison import metrics

DOCS = Path(__file__).parent
FIGURES = {
    "deburring": (
        "scene", "joints", "joints_qp", "joints_qp_rmr", "joints_qp_gradient", "along_the_path",
        "roadmap",
    ),
    "planar_line": ("scene", "roadmap", "joints_qp"),
}  # fmt: skip


def main() -> None:
    """Write everything below the folder given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DOCS, help="folder to write to; docs if absent")
    out = parser.parse_args().out
    for name in FIGURES:
        comparison = qt.compare(name)
        table = comparison_table(comparison)
        write(out / "generated" / f"{name}.md", table)
        if (name, out) == ("deburring", DOCS):
            put_into_readme(table)
        draw(comparison, out / "figures")
    for name, table in settings_tables().items():
        write(out / "generated" / f"{name}.md", table)
    for snippet in snippets_with_output():
        write(out / "generated" / f"{snippet.stem}.txt", output_of(snippet))
    write(out / "generated" / "mink_app.diff", app_difference())
    write(out / "generated" / "mink_app.txt", app_output())


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
                shutil.copyfile(drawn, target)
                print(f"wrote {target}")
            else:
                print(said[-1])


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


def settings_tables() -> dict[str, str]:
    """Methods at other settings than the task files'."""
    deburring, planar = qt.load_task("deburring"), qt.load_task("planar_line")
    return {
        "deburring_twa": settings_table(
            deburring,
            [
                ("twa", {"gain": gain, "iterations": iterations})
                for iterations, gains in ((1, (0.0, 0.01, 0.1, 0.3, 1.0)), (3, (0.1, 0.3, 1.0)))
                for gain in gains
            ]
            + [("qp", {"gain": gain}) for gain in (0.0, 0.01, 0.1, 0.3, 1.0)],
        ),
        "deburring_gradient": settings_table(
            deburring,
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
        "planar_line_twa": settings_table(
            planar,
            [
                (method, {"gain": gain})
                for gain in (0.001, 0.01, 0.03, 0.1, 1.0)
                for method in ("twa", "qp")
            ],
        ),
    }


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
    left = {"method", "leaves limits", "weight"}
    head = list(rows[0])
    lines = [head, [":--" if title in left else "--:" for title in head]]
    lines += [list(row.values()) for row in rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


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
