"""The metrics as CSV, one row per method."""

from __future__ import annotations

import csv
import io
from typing import Any


def csv_table(comparison: dict[str, Any]) -> str:
    """The metrics as CSV, from the content of ``comparison.json``: one row per method.

    Columns are named as in the JSON, with the unit in the name where it has one. ``null`` is an
    empty cell; ``first_violation`` reads ``joint_2 at 3; joint_5 at 40``, ``reconfigurations`` has
    its waypoints separated by spaces. A method that could not start has ``not run: …`` as its
    status and nothing else.
    """
    methods: dict[str, dict[str, Any]] = comparison["methods"]
    keys = list(next(iter(methods.values())))
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["method", *keys])
    for name, numbers in methods.items():
        writer.writerow([name, *(_cell(numbers[key]) for key in keys)])
    for name, why in comparison.get("not_run", {}).items():
        cells = {"status": f"not run: {why}"}
        writer.writerow([name, *(cells.get(key, "") for key in keys)])
    return file.getvalue()


def _cell(value: object) -> object:
    if isinstance(value, dict):
        return "; ".join(f"{joint} at {waypoint}" for joint, waypoint in value.items())
    if isinstance(value, list):
        return " ".join(map(str, value))
    return "" if value is None else value
