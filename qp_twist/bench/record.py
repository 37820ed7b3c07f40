"""What a run found, as ``bench.json`` keeps it."""

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
"""Raised when a file of before can no longer be read as one of now."""
_PACKAGES = (
    "qp_twist", "numpy", "scipy", "mujoco", "mink", "qpsolvers", "daqp", "proxsuite", "osqp",
    "piqp", "quadprog", "clarabel", "numba", "pin", "pin-pink", "placo",
)  # fmt: skip
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS", "NUMBA_NUM_THREADS")


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Quantiles(_Strict):
    """The median of times, and between what four fifths of them lie, µs.

    A mean would follow the scheduler's interruptions, and a minimum the luckiest step.
    """

    median: float
    p10: float
    p90: float
    count: int

    @classmethod
    def of(cls, nanoseconds: Sequence[int]) -> Quantiles | None:
        """Of times in ns; ``None`` if there are none."""
        if not nanoseconds:
            return None
        p10, median, p90 = np.percentile(np.asarray(nanoseconds) / 1e3, (10, 50, 90))
        return cls(median=float(median), p10=float(p10), p90=float(p90), count=len(nanoseconds))


class Accuracy(_Strict):
    """The worst of a contender's answers.

    Attributes:
        residual: Largest ‖Uᵀ(J q̇ − t)‖, m/s and rad/s.
        excess: Farthest beyond a bound or an inequality row, rad/s.
        error: Largest |q̇ − q̇*| of a joint, rad/s, from the exact solution of the program that it
            was asked; ``None`` where it solves another one.
    """

    residual: float
    excess: float
    error: float | None


class Machine(_Strict):
    """What times depend on beside the code.

    Attributes:
        processor: Its name, as the system knows it.
        cores: How many the system shows.
        system: Operating system and architecture.
        threads: Environment variables that say how many threads libraries take.
        versions: Of Python and of the packages that are installed.
    """

    processor: str
    cores: int
    system: str
    threads: dict[str, str]
    versions: dict[str, str]

    @classmethod
    def here(cls) -> Machine:
        """This one."""
        return cls(
            processor=_processor(),
            cores=os.cpu_count() or 1,
            system=f"{platform.system()} {platform.machine()}",
            threads={name: os.environ[name] for name in _THREADS if name in os.environ},
            versions={"python": platform.python_version()} | _versions(),
        )

    def in_words(self) -> str:
        """A line for people."""
        return f"{self.processor}, {self.cores} cores, {self.system}"


class Measured(_Strict):
    """A contender on a problem.

    Attributes:
        contender: Its name.
        warm: Of its steps, µs; in batches of the steps of a call, on average.
        call: Of the call alone, without kinematics and targets, µs; where it can be told apart.
        cold: Of making it and its first step, µs.
        first_us: The same the first time in this process, µs: what is loaded once is loaded here.
        accuracy: Of the answers that were timed; ``None`` where there are none, as of the floor.
        failures: Steps that ended with an exception; they are not among the times.
        said: What the first of them said.
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
    """A problem, and what everybody made of it.

    Attributes:
        group: ``step`` for the table; else what grows.
        x: How large it is.
        title: For people.
        joints: Degrees of freedom.
        rows: Task rows.
        steps: Different steps that were timed.
        active_share: Share of them on which a limit is active, by the exact solution.
        results: By contender.
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
        """What a contender made of it."""
        return next((m for m in self.results if m.contender == contender), None)


class Run(_Strict):
    """A whole run.

    Attributes:
        format: What file this is.
        version: Of the format.
        created: When, ISO 8601, UTC.
        seed: Of trajectories and orders.
        quick: Whether few steps were timed.
        machine: Where, and with which versions.
        skipped: A sentence for each contender that took no part.
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


def write_run(run: Run, path: Path) -> Path:
    """Write ``bench.json``."""
    return write_atomically(path, run.model_dump_json(indent=1) + "\n")


def read_run(path: Path) -> Run:
    """Read what :func:`write_run` wrote.

    Raises:
        InvalidInput: If there is no such file, or it is something else or of another version.
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
        return Run.model_validate_json(text)
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
