"""What a run found, as ``bench.json`` keeps it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from qp_twist.bench.accuracy import Accuracy
from qp_twist.bench.machine import Machine
from qp_twist.bench.quantiles import Quantiles
from qp_twist.errors import InvalidInput
from qp_twist.files import read_text, write_atomically

FORMAT = "qp-twist bench"
VERSION = 1
"""Raised when a file of before can no longer be read as one of now."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


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
