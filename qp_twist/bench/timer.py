"""Times of contenders that take turns."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from qp_twist.bench.contender import Parted, StepOf
from qp_twist.checks import Array

LEAD_IN = 2
"""Untimed steps before a block: caches and warm starts are then the contender's own."""


@dataclass(eq=False)
class Timed:
    """What a contender did.

    Attributes:
        warm: Time of each step, ns.
        call: Of its call alone, where it can be told apart.
        velocities: Its answer at each step that was timed last, by the step's number.
        failures: Steps that ended with an exception, or with a velocity that is not finite.
        said: What the first of them said.
    """

    warm: list[int] = field(default_factory=list)
    call: list[int] = field(default_factory=list)
    velocities: dict[int, Array] = field(default_factory=dict)
    failures: int = 0
    said: str = ""


@dataclass(eq=False)
class Cold:
    """Times to make a contender and take its first step, ns."""

    first: int = 0
    again: list[int] = field(default_factory=list)


def blocks_of(steps: int, length: int, count: int) -> list[range]:
    """``count`` runs of ``length`` consecutive steps, spread evenly, each after a lead-in."""
    starts = np.linspace(LEAD_IN, steps - length, count).astype(int)
    return [range(start, start + length) for start in starts.tolist()]


def interleaved(
    contenders: Mapping[str, StepOf],
    blocks: Sequence[range],
    rng: np.random.Generator,
    done: Callable[[str], None] = lambda name: None,
    found: dict[str, Timed] | None = None,
) -> dict[str, Timed]:
    """Every contender on every block, in an order that is drawn anew for each block.

    What disturbs the machine for a while disturbs all of them, and nobody is always the first.
    ``found`` is what was timed before, which is added to.
    """
    found = {name: Timed() for name in contenders} if found is None else found
    for block in blocks:
        for name in rng.permutation(list(contenders)).tolist():
            with without_collection():
                _run(contenders[name], block, found[name])
            done(name)
    return found


def cold(
    makers: Mapping[str, Callable[[], StepOf]], k: int, times: int, rng: np.random.Generator
) -> dict[str, Cold]:
    """Make every contender and take step k; once, and ``times`` times more."""
    found = {name: Cold() for name in makers}
    for turn in range(times + 1):
        for name in rng.permutation(list(makers)).tolist():
            with without_collection():
                began = time.perf_counter_ns()
                try:
                    makers[name]()(k)
                except Exception:
                    continue  # told by the warm steps
                took = time.perf_counter_ns() - began
            if turn == 0:
                found[name].first = took
            else:
                found[name].again.append(took)
    return found


def _run(step: StepOf, block: range, timed: Timed) -> None:
    for k in range(block.start - LEAD_IN, block.stop):
        velocity: Array | None
        began = between = time.perf_counter_ns()
        try:
            if isinstance(step, Parted):
                given = step.before(k)
                between = time.perf_counter_ns()
                velocity = step.call(given)
            else:
                velocity = step(k)
        except Exception as error:  # whatever a library raises, its step has failed
            if k in block:
                timed.failures += 1
                timed.said = timed.said or f"{type(error).__name__}: {error}".splitlines()[0]
            continue
        ended = time.perf_counter_ns()
        if k not in block:
            continue
        if velocity is not None and not np.isfinite(velocity).all():
            timed.failures += 1
            timed.said = timed.said or "the velocity is not finite"
            continue
        timed.warm.append(ended - began)
        if isinstance(step, Parted):
            timed.call.append(ended - between)
        if velocity is not None:
            timed.velocities[k] = np.array(velocity)  # a copy: it may be overwritten


@contextmanager
def without_collection() -> Iterator[None]:
    """Python's garbage collector does not run inside."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
