"""The rows of a study in one SQLite file, which grows while the study runs.

The rows of a sample are committed together. Each has a checksum, so that a file that was damaged or
altered is refused.
"""

from __future__ import annotations

import contextlib
import math
import sqlite3
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from qp_twist.errors import InvalidInput
from qp_twist.files import check_regular

Row = dict[str, Any]

BASE: dict[str, type] = {
    "sample": int, "method": str, "solver": str, "success": bool, "fault": str, "joint": str,
    "waypoint": int, "message": str, "waypoints": int, "position_error_max_m": float,
    "axis_error_max_rad": float, "min_margin": float, "mean_z": float, "max_step_deg": float,
    "travel_deg": float, "sigma_min": float, "z_over_least": float, "seconds": float,
    "least_z": float, "feasible": bool, "certificate": str,
}  # fmt: skip
"""Columns common to all studies."""
EMPTY_STORE = {"results.sqlite", "results.sqlite-journal", ".lock", ".lock-journal"}
"""Files of a study that was stopped before its first sample: it may begin again."""
_TYPES = {int: "INTEGER", bool: "INTEGER", float: "REAL", str: "TEXT"}


class Store:
    """The rows in ``results.sqlite``, table ``results``, one per sample and method."""

    def __init__(self, folder: Path, drawn: Mapping[str, type]) -> None:
        """Name the columns; ``drawn`` has the types of those that the study draws."""
        self.file = folder / "results.sqlite"
        self.columns = {**BASE, **drawn}

    @contextlib.contextmanager
    def writing(self) -> Iterator[Callable[[Sequence[Row]], None]]:
        """Lock the folder against other processes, and yield a function that adds a sample's rows.

        Raises:
            InvalidInput: If another process is writing.
        """
        lock = self.file.with_name(".lock")
        columns = ", ".join(f'"{name}" {_TYPES[kind]}' for name, kind in self.columns.items())
        places = ", ".join("?" * (len(self.columns) + 1))
        # A lock of SQLite's ends with its process, on every system.
        with contextlib.closing(sqlite3.connect(lock, timeout=0.0, isolation_level=None)) as held:
            try:
                held.execute("BEGIN EXCLUSIVE")
            except sqlite3.OperationalError:
                raise InvalidInput(
                    f"{lock.parent}: another study is writing there; wait for it, or give another "
                    "folder."
                ) from None
            try:
                with self._connected() as database:
                    database.execute(
                        f"CREATE TABLE IF NOT EXISTS results ({columns}, checksum INTEGER, "
                        "PRIMARY KEY (sample, method))"
                    )

                    def add(rows: Sequence[Row]) -> None:
                        values = [self._values(row) for row in rows]
                        with database:
                            database.executemany(
                                f"INSERT OR REPLACE INTO results VALUES ({places})",
                                [(*v, _checksum(v)) for v in values],
                            )

                    yield add
            finally:
                lock.unlink(missing_ok=True)

    def check(self) -> None:
        """Compare every row with its checksum.

        Raises:
            InvalidInput: If the file is damaged, was altered, or is not of this study.
        """
        for *values, checksum in self._select([*self.columns, "checksum"]):
            if checksum != _checksum(tuple(values)):
                raise self._damaged("a row does not fit its checksum")

    def table(self, columns: Sequence[str]) -> dict[str, list[Any]]:
        """Some columns of all rows, ordered by sample."""
        rows = self._select(columns)
        found = {name: [row[k] for row in rows] for k, name in enumerate(columns)}
        for name in columns:
            if self.columns[name] is bool:
                found[name] = [None if value is None else bool(value) for value in found[name]]
        return found

    def _select(self, columns: Sequence[str]) -> list[tuple[Any, ...]]:
        if not self.file.exists() or self.file.stat().st_size == 0:
            return []
        check_regular(self.file, "table", largest=math.inf)
        names = ", ".join(f'results."{name}"' for name in columns)
        with self._connected() as database:
            # Of one sample the methods stand in the order in which they were added.
            return database.execute(
                f"SELECT {names} FROM results ORDER BY sample, rowid"
            ).fetchall()

    @contextlib.contextmanager
    def _connected(self) -> Iterator[sqlite3.Connection]:
        with contextlib.closing(sqlite3.connect(self.file)) as database:
            try:
                yield database
            except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
                raise self._damaged(str(error)) from None

    def _damaged(self, why: str) -> InvalidInput:
        return InvalidInput(
            f"{self.file}: is damaged, was altered, or is not of this study ({why}). Restore it, "
            "or delete it, and its samples are computed again."
        )

    def _values(self, row: Row) -> tuple[Any, ...]:
        """The values of a row as SQLite returns them: NaN is empty, a flag a number."""
        found: list[Any] = []
        for name, kind in self.columns.items():
            value = row.get(name)
            if value is None or (kind is float and math.isnan(value)):
                found.append(None)
            else:
                found.append(int(value) if kind is bool else kind(value))
        return tuple(found)


def _checksum(values: tuple[Any, ...]) -> int:
    return zlib.crc32(repr(values).encode("utf-8", "backslashreplace"))
