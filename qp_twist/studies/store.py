"""The rows of a study on disk, in Parquet files that are written during the study.

A Parquet file is only readable when complete, since it ends with its index. So rows are written in
parts, each under a temporary name and then renamed; ``compact`` merges them into one file. If the
process is killed, rows that are not yet in a part are lost and computed again. Each file contains
its own checksum, so that one that was altered is refused.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import mmap
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from qp_twist.errors import InvalidInput
from qp_twist.files import check_regular, whole_file

try:
    import fcntl
except ImportError:  # not available on Windows: no lock there
    fcntl = None  # type: ignore[assignment]

try:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq
except ImportError:  # the extra is not installed; check_installed reports it
    pa = None

_ROWS, _SECONDS = 2000, 10.0
"""Number of rows and time after which a part is written."""
_CHECKSUM, _DIGITS = b"sha256:", 64
"""Text before the checksum in a file's metadata, and number of hexadecimal digits."""
_GROUP = 20_000
"""Number of rows of a Parquet row group, which are in memory at a time."""
BASE = {
    "sample": "int64",
    "method": "string",
    "solver": "string",
    "success": "bool",
    "fault": "string",
    "joint": "string",
    "waypoint": "int32",
    "message": "string",
    "waypoints": "int32",
    "position_error_max_m": "float64",
    "axis_error_max_rad": "float64",
    "min_margin": "float64",
    "mean_z": "float64",
    "max_step_deg": "float64",
    "travel_deg": "float64",
    "sigma_min": "float64",
    "z_over_least": "float64",
    "seconds": "float64",
    "least_z": "float64",
    "feasible": "bool",
    "certificate": "string",
}
"""Columns common to all studies."""


def check_installed() -> None:
    """Raise if pyarrow or joblib is missing.

    Raises:
        InvalidInput: With the extra to install.
    """
    if pa is None:
        raise InvalidInput("study: needs joblib and pyarrow; install the extra: qp_twist[study].")


class Store:
    """The rows below a folder: ``results.parquet`` and, while a study runs, ``parts/``."""

    def __init__(self, folder: Path, drawn: Mapping[str, str]) -> None:
        """Open or create the store.

        Args:
            folder: Folder of the study.
            drawn: Type of each column that the study draws, by name.
        """
        check_installed()
        self.file = folder / "results.parquet"
        self._folder = folder / "parts"
        self.schema = pa.schema(
            [(name, pa.type_for_alias(kind)) for name, kind in {**BASE, **drawn}.items()]
        )
        self._waiting: list[dict[str, Any]] = []
        self._since = time.monotonic()

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Lock the folder against other processes; the lock ends with the process.

        Raises:
            InvalidInput: If another process is writing.
        """
        self._folder.mkdir(parents=True, exist_ok=True)
        lock = self.file.with_name(".lock")
        with lock.open("w") as file:
            try:
                if fcntl is not None:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InvalidInput(
                    f"{lock.parent}: another study is writing there; wait for it, or give another "
                    "folder."
                ) from None
            try:
                yield
            finally:
                lock.unlink(missing_ok=True)
                with contextlib.suppress(OSError):  # it contains parts
                    self._folder.rmdir()

    def samples(self) -> set[int]:
        """The samples whose rows are on disk."""
        found: set[int] = set()
        for table in self.tables(["sample"]):
            found.update(table["sample"].to_pylist())
        return found

    def add(self, rows: Sequence[dict[str, Any]]) -> None:
        """Add the rows of a sample; they are on disk ten seconds later."""
        self._waiting.extend(rows)
        if len(self._waiting) >= _ROWS or time.monotonic() - self._since > _SECONDS:
            self.flush()

    def flush(self) -> None:
        """Write the pending rows."""
        if self._waiting:
            number = max((int(part.stem) for part in self._parts()), default=0) + 1
            table = pa.Table.from_pylist(self._waiting, schema=self.schema)
            self._write(self._folder / f"{number:06d}.parquet", [table])
        self._waiting, self._since = [], time.monotonic()

    def compact(self) -> Path:
        """Merge everything into one file, and return its path."""
        self.flush()
        parts = self._parts()
        if parts or not self.file.exists():
            self._write(self.file, self.tables())
            for part in parts:
                part.unlink()
        return self.file

    def tables(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """The stored rows, a bounded number at a time, each sample once.

        With ``columns`` only these and the sample's number.

        A sample is in two files if a study was killed between making one file and removing parts.
        """
        wanted = None if columns is None else list(dict.fromkeys(["sample", *columns]))
        before: set[int] = set()
        for file in [self.file, *self._parts()] if self.file.exists() else self._parts():
            here: set[int] = set()
            for batch in self._batches(file, wanted):
                samples = batch["sample"].to_pylist()
                here.update(samples)
                new = pa.array([sample not in before for sample in samples], pa.bool_())
                yield pa.Table.from_batches([batch]).filter(new)
            before |= here

    def table(self, columns: Sequence[str] | None = None) -> pa.Table:
        """All rows of :meth:`tables`, ordered by sample."""
        names = self.schema.names if columns is None else list(dict.fromkeys(["sample", *columns]))
        empty = pa.schema([self.schema.field(name) for name in names]).empty_table()
        found: pa.Table = pa.concat_tables([empty, *self.tables(columns)])
        return found.take(pc.sort_indices(found, [("sample", "ascending")]))

    def _parts(self) -> list[Path]:
        return sorted(self._folder.glob("[0-9]*.parquet"))

    def _batches(self, file: Path, columns: Sequence[str] | None) -> Iterator[pa.RecordBatch]:
        check_regular(file, "table", largest=math.inf)
        try:
            at, stated, expected = _checksum(file)
        except OSError as error:
            raise InvalidInput(f"{file}: cannot be read ({error.strerror}).") from None
        if at < 0 or stated != expected:
            raise InvalidInput(
                f"{file}: is damaged, was altered, or is not of a study: its checksum does not fit "
                "its content. Restore it, or delete it, and its samples are computed again."
            )
        with pq.ParquetFile(file) as parquet:
            if not parquet.schema_arrow.equals(self.schema):
                raise InvalidInput(
                    f"{file}: has other columns than this study; give another folder with --out."
                )
            yield from parquet.iter_batches(_GROUP, columns=columns)

    def _write(self, path: Path, tables: Iterable[pa.Table]) -> None:
        """Write tables and their checksum to a temporary file, then rename it."""
        with whole_file(path) as unfinished:
            with pq.ParquetWriter(unfinished, self.schema) as writer:
                for table in tables:
                    writer.write_table(table)
                empty = (_CHECKSUM + _DIGITS * b"0").decode()
                writer.add_key_value_metadata({"qp_twist": empty})
            at, _, digest = _checksum(unfinished)
            with unfinished.open("r+b") as file:
                file.seek(at)
                file.write(digest)


def _checksum(path: Path) -> tuple[int, bytes, bytes]:
    """Offset of the checksum in a file, −1 without one; what is stated there; what it should be.

    It is the SHA-256 of the file without these digits.
    """
    with path.open("rb") as file:
        if not path.stat().st_size:
            return -1, b"", b""
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            found = content.rfind(_CHECKSUM)
            at = found + len(_CHECKSUM) if found >= 0 else -1
            digest = hashlib.sha256()
            with memoryview(content) as view:
                digest.update(view[: max(at, 0)])
                digest.update(view[at + _DIGITS :])
                stated = bytes(view[at : at + _DIGITS]) if at >= 0 else b""
        return at, stated, digest.hexdigest().encode()
