"""The table: each closed form next to its QP counterpart."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from qp_twist.comparison.metrics import BAND_LEFT, EXCESSES, too_near
from qp_twist.paths import METHODS
from qp_twist.pictures.style import pair_of

WIDTH = 128
"""Width of the widest table, that with bands, in characters."""


def rich_table(comparison: dict[str, Any]) -> Table:
    """The table for a terminal, from the content of ``comparison.json``."""
    table = Table(
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
    table.add_column("leaves limits", no_wrap=True)
    for heading in (
        "min\nmargin", "mean\nz", "position\nerror mm", "axis\nerror °", "travel\n°",
        "max\nstep °", "σ min", "µs per\nwaypoint",
    ):  # fmt: skip
        table.add_column(heading, justify="right", no_wrap=True)
    excesses = _excesses(comparison)
    for key in excesses:
        if any(key in numbers for numbers in comparison["methods"].values()):
            heading = key.removesuffix("_max").replace("_", "\n")
            table.add_column(heading, justify="right", no_wrap=True)
    if _has_clearance(comparison):
        table.add_column("clearance\nmm", justify="right", no_wrap=True)
    methods = list(comparison["methods"])
    for index, name in enumerate(methods):
        following = methods[index + 1] if index + 1 < len(methods) else None
        together = following is not None and pair_of(following) == pair_of(name)
        cells = _row(name, comparison["methods"][name], comparison["compiled"][name], excesses)
        table.add_row(*cells, end_section=not together)
    return table


def _excesses(comparison: dict[str, Any]) -> list[str]:
    """The columns of excesses: where clearance has a column, remarks say what else is left."""
    clearance = _has_clearance(comparison)
    return [key for key in EXCESSES if not (clearance and key == "constraint_excess_max")]


def _has_clearance(comparison: dict[str, Any]) -> bool:
    return any("min_clearance_m" in numbers for numbers in comparison["methods"].values())


def plain_table(comparison: dict[str, Any]) -> str:
    """The table without colour, and a note for each method whose status is not ok."""
    console = Console(file=io.StringIO(), width=WIDTH, color_system=None, force_terminal=False)
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


def time_in_code(microseconds: float, compiled: float) -> str:
    """A time per waypoint, marked if compiled code computed all waypoints, or some."""
    sign = "*" if compiled >= 1.0 else "(*)" if compiled > 0.0 else ""
    return f"{whole(microseconds)}{sign}"


def _row(
    name: str, numbers: dict[str, Any], compiled: float, excesses: Sequence[str]
) -> list[Text | str]:
    first = numbers["first_violation"]
    where = "\n".join(f"{joint} at {index}" for joint, index in first.items()) or "no"
    margin = numbers["min_margin"]
    style = "bold" if METHODS[name].constrained else ""
    cells = [
        Text(name, style=style),
        Text(where, style="red" if first else "green"),
        "–" if margin is None else Text(f"{margin:.3f}", style="red" if margin < 0.0 else ""),
        significant(numbers["mean_z"]),
        significant(1e3 * numbers["position_error_max_m"]),
        significant(math.degrees(numbers["axis_error_max_rad"])),
        whole(numbers["travel_deg"]),
        significant(numbers["max_step_deg"], digits=2),
        significant(numbers["sigma_min"]),
        time_in_code(numbers["time_per_waypoint_us"], compiled),
    ]
    for excess in (numbers[key] for key in excesses if key in numbers):
        cells.append(Text(significant(excess), style="red" if excess > BAND_LEFT else ""))
    if "min_clearance_m" in numbers:
        clearance = f"{1e3 * numbers['min_clearance_m']:.1f}"
        cells.append(Text(clearance, style="red" if too_near(numbers) else ""))
    return cells


def significant(value: float, digits: int = 4) -> str:
    """A number to a few decimals; tiny ones as an upper bound, huge ones as a power."""
    if value and abs(value) < 10.0**-digits:
        return f"{value:.0e}"
    return f"{value:.{digits}f}" if abs(value) < 1e3 else f"{value:.1e}"


def whole(value: float) -> str:
    """A number without decimals; a huge one as a power."""
    return f"{value:.0f}" if abs(value) < 1e6 else f"{value:.0e}"
