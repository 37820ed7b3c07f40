"""Results of a run, as in ``bench.json``."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from qp_twist.errors import InvalidInput
from qp_twist.files import read_text, write_atomically

FORMAT = "qp-twist bench"
VERSION = 1
"""Version of the format; increased when older files can no longer be read."""
_PACKAGES = (
    "qp_twist", "numpy", "scipy", "mujoco", "mink", "qpsolvers", "daqp", "proxsuite", "osqp",
    "piqp", "quadprog", "clarabel", "numba", "pin", "pin-pink", "placo",
)  # fmt: skip
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS", "NUMBA_NUM_THREADS")


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Quantiles(_Strict):
    """Median of times, and the interval of their middle 80 %, µs.

    A mean depends on the scheduler's interruptions, a minimum on the luckiest step.
    """

    median: float
    p10: float
    p90: float
    count: int

    @classmethod
    def of(cls, nanoseconds: Sequence[int]) -> Quantiles | None:
        """From times in ns; ``None`` if there are none."""
        if not nanoseconds:
            return None
        p10, median, p90 = np.percentile(np.asarray(nanoseconds) / 1e3, (10, 50, 90))
        return cls(median=float(median), p10=float(p10), p90=float(p90), count=len(nanoseconds))


class Accuracy(_Strict):
    """Largest errors of a contender's velocities.

    Attributes:
        residual: Largest ‖Uᵀ(J q̇ − t)‖, m/s and rad/s.
        excess: Largest violation of a bound or an inequality row, rad/s.
        error: Largest |q̇ − q̇*| of a joint, rad/s, from the solution of its program;
            ``None`` if it solves another one.
    """

    residual: float
    excess: float
    error: float | None


class Machine(_Strict):
    """The machine, on which times depend.

    Attributes:
        processor: Its name, as the system knows it.
        cores: Number of cores that the system shows.
        system: Operating system and architecture.
        threads: Environment variables that set the number of threads of libraries.
        versions: Versions of Python and of the installed packages.
    """

    processor: str
    cores: int
    system: str
    threads: dict[str, str]
    versions: dict[str, str]

    @classmethod
    def here(cls) -> Machine:
        """The current machine."""
        return cls(
            processor=_processor(),
            cores=os.cpu_count() or 1,
            system=f"{platform.system()} {platform.machine()}",
            threads={name: os.environ[name] for name in _THREADS if name in os.environ},
            versions={"python": platform.python_version()} | _versions(),
        )

    def in_words(self) -> str:
        """A line for tables."""
        return f"{self.processor}, {self.cores} cores, {self.system}"


class Measured(_Strict):
    """A contender on a problem.

    Attributes:
        contender: Its name.
        warm: Times of its steps, µs; in batches the average over the steps of a call.
        call: Times of the call alone, without kinematics and targets, µs; if it can be separated.
        cold: Times of creating it and of its first step, µs.
        first_us: The same for the first time in this process, µs, including one-time loading.
        accuracy: Accuracy of the timed steps; ``None`` without velocities, as for the floor.
        failures: Number of steps that raised an exception; they are not among the times.
        said: Message of the first of them.
    """

    contender: str
    warm: Quantiles | None
    call: Quantiles | None = None
    cold: Quantiles | None = None
    first_us: float | None = None
    accuracy: Accuracy | None = None
    failures: int = 0
    said: str = ""


class Case(_Strict):
    """A problem, and the results of all contenders.

    Attributes:
        group: ``step`` for the table; else the parameter of the series.
        x: Value of that parameter.
        title: Title in tables.
        joints: Degrees of freedom.
        rows: Task rows.
        steps: Number of different steps that were timed.
        active_share: Share of them on which a limit is active, by the reference solution.
        results: Results by contender.
    """

    group: str
    x: int
    title: str
    joints: int
    rows: int
    steps: int
    active_share: float | None
    results: tuple[Measured, ...]

    def of(self, contender: str) -> Measured | None:
        """The result of a contender."""
        return next((m for m in self.results if m.contender == contender), None)


class BenchRun(_Strict):
    """A whole run.

    Attributes:
        format: Identifies the file type.
        version: Version of the format.
        created: Time of the run, ISO 8601, UTC.
        seed: Seed of trajectories and orders.
        quick: Whether only a few steps were timed.
        machine: The machine and the versions.
        skipped: A sentence for each contender that did not take part.
        cases: The problems.
    """

    format: Literal["qp-twist bench"] = "qp-twist bench"
    version: Literal[1] = 1
    created: str
    seed: int
    quick: bool
    machine: Machine
    skipped: tuple[str, ...]
    cases: tuple[Case, ...]


def write_run(run: BenchRun, path: Path) -> Path:
    """Write ``bench.json``."""
    return write_atomically(path, run.model_dump_json(indent=1) + "\n")


def read_run(path: Path) -> BenchRun:
    """Read what :func:`write_run` wrote.

    Raises:
        InvalidInput: If there is no such file, or it has another type or version.
    """
    what = "give the bench.json of an earlier run"
    try:
        text = read_text(path, "bench.json")
    except InvalidInput as error:
        raise InvalidInput(f"--compare {error}") from None
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        raise InvalidInput(
            f"--compare {path}: this is not JSON (line {error.lineno}: {error.msg}); {what}."
        ) from None
    except RecursionError:
        raise InvalidInput(f"--compare {path}: its lists are nested too deep; {what}.") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InvalidInput(f"--compare {path}: qp-twist bench did not write this file; {what}.")
    if content.get("version") != VERSION:
        raise InvalidInput(
            f"--compare {path}: the file has format version {content.get('version')!r}, and this "
            f"release reads {VERSION}; measure again with the older release's code, or compare "
            "with a newer run."
        )
    try:
        # As JSON: lists are the tuples of the classes.
        return BenchRun.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise InvalidInput(
            f"--compare {path}: the file is damaged: {where} is missing or wrong; {what}."
        ) from None


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown processor"


def _versions() -> dict[str, str]:
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
