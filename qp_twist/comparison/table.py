"""The table of metrics: each closed form next to its QP counterpart."""

from __future__ import annotations

import csv
import io
import math
from itertools import groupby
from typing import TYPE_CHECKING, Any

from qp_twist.comparison.metrics import EXCESSES, tolerances_of, too_near
from qp_twist.pages.tables import TIME, Cell, Table
from qp_twist.paths import METHODS, Tolerances

if TYPE_CHECKING:
    from rich.table import Table as RichTable

_WIDTH = 128
"""Width of the widest table, that with bands, in characters."""
_COLUMNS = (
    "leaves limits", "min\nmargin", "mean\nz", "position\nerror mm", "axis\nerror °", "travel\n°",
    "max\nstep °", "σ min", TIME,
)  # fmt: skip
_COLOURS = {"good": "green", "bad": "red", "": ""}


def metrics_table(comparison: dict[str, Any]) -> Table:
    """The table, from the content of ``comparison.json``: a row for each method.

    Where clearance has a column, remarks say what other constraints are left.
    """
    methods: dict[str, dict[str, Any]] = comparison["methods"]
    clear = any("min_clearance_m" in numbers for numbers in methods.values())
    excesses = [
        key
        for key in EXCESSES
        if any(key in numbers for numbers in methods.values())
        and not (clear and key == "constraint_excess_max")
    ]
    headings = [key.removesuffix("_max").replace("_", "\n") for key in excesses]
    rows, tolerances = {}, tolerances_of(comparison)
    for name, numbers in methods.items():
        cells = _cells(numbers, comparison["compiled"][name], tolerances)
        for excess in (numbers[key] for key in excesses):
            cells.append(_cell(significant(excess), bad=excess > tolerances.band))
        if clear:
            distance = f"{1e3 * numbers['min_clearance_m']:.1f}"
            cells.append(_cell(distance, bad=too_near(numbers, tolerances)))
        rows[name] = cells
    return Table([*_COLUMNS, *headings, *(["clearance\nmm"] if clear else [])], rows)


def _cells(numbers: dict[str, Any], compiled: float, tolerances: Tolerances) -> list[Cell]:
    first, margin = numbers["first_violation"], numbers["min_margin"]
    where = "\n".join(f"{joint} at {index}" for joint, index in first.items())
    position, axis = numbers["position_error_max_m"], numbers["axis_error_max_rad"]
    # A time of compiled code has a star.
    code = "*" if compiled >= 1.0 else "(*)" if compiled > 0.0 else ""
    return [
        Cell(where, "bad") if first else Cell("no", "good"),
        Cell("–") if margin is None else _cell(f"{margin:.3f}", bad=margin < 0.0),
        Cell(significant(numbers["mean_z"])),
        _cell(significant(1e3 * position), bad=position > tolerances.position),
        _cell(significant(math.degrees(axis)), bad=axis > tolerances.axis),
        Cell(whole(numbers["travel_deg"])),
        Cell(significant(numbers["max_step_deg"], digits=2)),
        Cell(significant(numbers["sigma_min"])),
        Cell(whole(numbers["time_per_waypoint_us"]) + code),
    ]


def _cell(text: str, *, bad: bool) -> Cell:
    return Cell(text, "bad" if bad else "")


def rich_table(comparison: dict[str, Any]) -> RichTable:
    """The table for a terminal, from the content of ``comparison.json``."""
    from rich import box
    from rich.table import Table as RichTable
    from rich.text import Text

    content = metrics_table(comparison)
    table = RichTable(
        title=Text(
            f"{comparison['task']}: {comparison['waypoints']} waypoints, "
            f"QPs by {comparison['solver']}"
        ),
        title_justify="left",
        box=box.SIMPLE_HEAD,
        title_style="bold",
        caption="margin: 1 mid-range, 0 at a limit, negative outside; z: ½‖W(θ̄ − θ)‖²; errors: "
        "largest after the\ninner iterations, task rows only; σ min: of the task rows.",
        caption_justify="left",
    )
    table.add_column("method", no_wrap=True)
    for number, heading in enumerate(content.columns):
        table.add_column(heading, justify="right" if number else "left", no_wrap=True)
    for _, names in groupby(content.rows, key=lambda name: METHODS[name].qp):
        for name in names:
            method = Text(name, style="bold" if METHODS[name].constrained else "")
            cells = content.rows[name]
            table.add_row(method, *(Text(cell.text, _COLOURS[cell.state]) for cell in cells))
        table.add_section()
    return table


def plain_table(comparison: dict[str, Any]) -> str:
    """The table without colour, and a note for each method whose status is not ok."""
    from rich.console import Console

    console = Console(file=io.StringIO(), width=_WIDTH, color_system=None, force_terminal=False)
    console.print(rich_table(comparison))
    for line in notes(comparison):
        console.print(line, markup=False, soft_wrap=True)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def notes(comparison: dict[str, Any]) -> list[str]:
    """``method: status`` for each method whose status is not ok, or that could not start."""
    return [
        f"{name}: {numbers['status']}"
        for name, numbers in comparison["methods"].items()
        if numbers["status"] != "ok"
    ] + [f"{name}: not run: {why}" for name, why in comparison.get("not_run", {}).items()]


def csv_table(comparison: dict[str, Any]) -> str:
    """The metrics as CSV, from the content of ``comparison.json``: one row per method.

    Columns are named as in the JSON, with the unit in the name where it has one. ``null`` is an
    empty cell; ``first_violation`` reads ``joint_2 at 3; joint_5 at 40``, ``reconfigurations`` has
    its waypoints separated by spaces. A method that could not start has ``not run: …`` as its
    status and nothing else.
    """
    methods: dict[str, dict[str, Any]] = comparison["methods"]
    file = io.StringIO()
    writer = csv.DictWriter(file, ["method", *next(iter(methods.values()))], lineterminator="\n")
    writer.writeheader()
    for name, numbers in methods.items():
        writer.writerow({"method": name, **{k: _csv_cell(v) for k, v in numbers.items()}})
    for name, why in comparison.get("not_run", {}).items():
        writer.writerow({"method": name, "status": f"not run: {why}"})
    return file.getvalue()


def _csv_cell(value: object) -> object:
    if isinstance(value, dict):
        return "; ".join(f"{joint} at {waypoint}" for joint, waypoint in value.items())
    if isinstance(value, list):
        return " ".join(map(str, value))
    return "" if value is None else value


def significant(value: float, digits: int = 4) -> str:
    """A number to a few decimals; tiny ones as an upper bound, huge ones as a power."""
    if value and abs(value) < 10.0**-digits:
        return f"{value:.0e}"
    return f"{value:.{digits}f}" if abs(value) < 1e3 else f"{value:.1e}"


def whole(value: float) -> str:
    """A number without decimals; a huge one as a power."""
    return f"{value:.0f}" if abs(value) < 1e6 else f"{value:.0e}"
