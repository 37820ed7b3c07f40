"""Time contenders in turns."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from qp_twist.bench.contender import SplitStep, StepOf
from qp_twist.checks import Array

Clock = Callable[[], int]
Result = TypeVar("Result")
LEAD_IN = 2
"""Number of untimed steps before a block, to fill caches and warm starts."""


@dataclass(eq=False)
class Timed:
    """Times and velocities of a contender.

    Attributes:
        warm: Time of each step, ns.
        call: Times of its call alone, if it can be separated.
        velocities: Its last velocity at each timed step, by step index.
        failures: Number of steps that raised an exception, or returned a velocity that is not
            finite.
        said: Message of the first of them.
        blocks: Median time of each block, ns; NaN where all steps failed.
    """

    warm: list[int] = field(default_factory=list)
    call: list[int] = field(default_factory=list)
    velocities: dict[int, Array] = field(default_factory=dict)
    failures: int = 0
    said: str = ""
    blocks: list[float] = field(default_factory=list)

    def ratio_to(self, other: Timed) -> Array:
        """Median, 10th and 90th percentile over the blocks of this time over another's, (3,).

        Both were timed by the same call of :func:`interleaved`, so that what disturbs the machine
        during a block disturbs both times of its ratio.
        """
        shares = np.asarray(self.blocks) / np.asarray(other.blocks)
        found: Array = np.nanpercentile(shares, (50, 10, 90))
        return found


@dataclass(eq=False)
class Cold:
    """Times to create a contender and compute its first step, ns."""

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
    clock: Clock = time.perf_counter_ns,
) -> dict[str, Timed]:
    """Run every contender on every block, in a random order for each block.

    So a disturbance of the machine affects all contenders, and none is always the first. New times
    are appended to ``found``. ``clock`` returns ns: of the wall, or of the processor alone.
    """
    found = {name: Timed() for name in contenders} if found is None else found
    for block in blocks:
        for name in rng.permutation(list(contenders)).tolist():
            with without_collection():
                _run(contenders[name], block, found[name], clock)
            done(name)
    return found


def cold(
    makers: Mapping[str, Callable[[], StepOf]], k: int, times: int, rng: np.random.Generator
) -> dict[str, Cold]:
    """Create every contender and compute step k, once and ``times`` times more."""
    found = {name: Cold() for name in makers}
    for turn in range(times + 1):
        for name in rng.permutation(list(makers)).tolist():
            make = makers[name]
            try:
                took, _ = once(lambda make=make: make()(k))  # type: ignore[misc]
            except Exception:
                continue  # reported by the warm steps
            if turn == 0:
                found[name].first = took
            else:
                found[name].again.append(took)
    return found


def once(call: Callable[[], Result]) -> tuple[int, Result]:
    """Time of one call, ns, without garbage collection, and what it returns."""
    with without_collection():
        began = time.perf_counter_ns()
        result = call()
        return time.perf_counter_ns() - began, result


def _run(step: StepOf, block: range, timed: Timed, clock: Clock) -> None:
    first = len(timed.warm)
    for k in range(block.start - LEAD_IN, block.stop):
        velocity: Array | None
        began = between = clock()
        try:
            if isinstance(step, SplitStep):
                arguments = step.before(k)
                between = clock()
                velocity = step.call(arguments)
            else:
                velocity = step(k)
        except Exception as error:  # any exception of a library is a failure of its step
            if k in block:
                timed.failures += 1
                timed.said = timed.said or f"{type(error).__name__}: {error}".splitlines()[0]
            continue
        ended = clock()
        if k not in block:
            continue
        if velocity is not None and not np.isfinite(velocity).all():
            timed.failures += 1
            timed.said = timed.said or "the velocity is not finite"
            continue
        timed.warm.append(ended - began)
        if isinstance(step, SplitStep):
            timed.call.append(ended - between)
        if velocity is not None:
            timed.velocities[k] = np.array(velocity)  # a copy: it may be overwritten
    timed.blocks.append(float(np.median(timed.warm[first:])) if timed.warm[first:] else np.nan)


@contextmanager
def without_collection() -> Iterator[None]:
    """Disable Python's garbage collector inside."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
