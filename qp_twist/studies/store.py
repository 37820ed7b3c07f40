"""The rows of a study in one SQLite file, which grows while the study runs.

If the process is killed, the rows of the last second are lost and computed again. Each row has a
checksum, so that a file that was damaged or altered is refused.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import sqlite3
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from qp_twist.errors import InvalidInput
from qp_twist.files import check_regular

Row = dict[str, Any]

_SECONDS = 1.0
"""Time after which rows are committed."""
BASE: dict[str, type] = {
    "sample": int,
    "method": str,
    "solver": str,
    "success": bool,
    "fault": str,
    "joint": str,
    "waypoint": int,
    "message": str,
    "waypoints": int,
    "position_error_max_m": float,
    "axis_error_max_rad": float,
    "min_margin": float,
    "mean_z": float,
    "max_step_deg": float,
    "travel_deg": float,
    "sigma_min": float,
    "z_over_least": float,
    "seconds": float,
    "least_z": float,
    "feasible": bool,
    "certificate": str,
}
"""Columns common to all studies."""
_TYPES = {int: "INTEGER", bool: "INTEGER", float: "REAL", str: "TEXT"}


class Store:
    """``results.sqlite`` of a study.

    Its table ``results`` has a row per sample and method, its table ``settings`` the arguments of
    the study as JSON.
    """

    def __init__(self, folder: Path, drawn: Mapping[str, type] | None = None) -> None:
        """Name the columns.

        Args:
            folder: Folder of the study.
            drawn: Type of each column that the study draws, by name.
        """
        self.file = folder / "results.sqlite"
        self.columns = {**BASE, **(drawn or {})}

    def settings(self) -> dict[str, Any] | None:
        """The arguments of the study that is there; ``None`` without one.

        Raises:
            InvalidInput: If the file is damaged or of another program.
        """
        if not os.path.lexists(self.file):
            return None
        found = self._select("SELECT content, checksum FROM settings")
        if len(found) != 1 or _checksum(found[0][:1]) != found[0][1]:
            raise self._damaged("its settings do not fit their checksum")
        content: dict[str, Any] = json.loads(found[0][0])
        return content

    @contextlib.contextmanager
    def writing(self, settings: Mapping[str, Any]) -> Iterator[Callable[[Sequence[Row]], None]]:
        """Lock the folder against other processes, and yield a function that adds a sample's rows.

        With the first rows the settings replace those that are there.

        Raises:
            InvalidInput: If another process is writing.
        """
        lock = self.file.with_name(".lock")
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
                with contextlib.ExitStack() as opened:
                    yield self._adding(opened, settings)
            finally:
                lock.unlink(missing_ok=True)

    def _adding(
        self, opened: contextlib.ExitStack, settings: Mapping[str, Any]
    ) -> Callable[[Sequence[Row]], None]:
        database: sqlite3.Connection | None = None  # a run without a sample leaves no file
        committed = -math.inf

        def add(rows: Sequence[Row]) -> None:
            nonlocal database, committed
            if database is None:
                database = opened.enter_context(self._connected())
                self._begin(database, settings)
            values = [self._values(row) for row in rows]
            places = ", ".join("?" * (len(self.columns) + 1))
            database.executemany(
                f"INSERT OR REPLACE INTO results VALUES ({places})",
                [(*row, _checksum(row)) for row in values],
            )
            if time.monotonic() - committed > _SECONDS:
                database.commit()
                committed = time.monotonic()

        return add

    def _begin(self, database: sqlite3.Connection, settings: Mapping[str, Any]) -> None:
        names = ", ".join(f'"{name}" {_TYPES[kind]}' for name, kind in self.columns.items())
        database.execute(
            f"CREATE TABLE IF NOT EXISTS results ({names}, checksum INTEGER, "
            "PRIMARY KEY (sample, method))"
        )
        database.execute("CREATE TABLE IF NOT EXISTS settings (content TEXT, checksum INTEGER)")
        database.execute("DELETE FROM settings")
        content = json.dumps(settings)
        database.execute("INSERT INTO settings VALUES (?, ?)", (content, _checksum((content,))))

    def check(self) -> None:
        """Compare every row with its checksum.

        Raises:
            InvalidInput: If the file is damaged, was altered, or is not of this study.
        """
        for *values, checksum in self._rows([*self.columns, "checksum"]):
            if checksum != _checksum(tuple(values)):
                raise self._damaged("a row does not fit its checksum")

    def table(self, columns: Sequence[str]) -> dict[str, list[Any]]:
        """Some columns of all rows, ordered by sample."""
        rows = self._rows(columns)
        found: dict[str, list[Any]] = {}
        for name, values in zip(columns, zip(*rows, strict=True) if rows else (), strict=False):
            flag = self.columns[name] is bool
            found[name] = [bool(v) if flag and v is not None else v for v in values]
        return found or {name: [] for name in columns}

    def _rows(self, columns: Sequence[str]) -> list[tuple[Any, ...]]:
        if not os.path.lexists(self.file):
            return []
        names = ", ".join(f'results."{name}"' for name in columns)
        # Of one sample the methods stand in the order in which they were added.
        return self._select(f"SELECT {names} FROM results ORDER BY sample, rowid")

    def _select(self, query: str) -> list[tuple[Any, ...]]:
        check_regular(self.file, "table", largest=math.inf)
        with self._connected() as database:
            return database.execute(query).fetchall()

    @contextlib.contextmanager
    def _connected(self) -> Iterator[sqlite3.Connection]:
        """A connection; what was added is committed at its end, however that comes."""
        with contextlib.closing(sqlite3.connect(self.file)) as database:
            try:
                try:
                    yield database
                finally:
                    database.commit()
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
