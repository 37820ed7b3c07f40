"""Time calls in turns: of the contenders of a step, or of any calls."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from qp_twist.checks import Array

Clock = Callable[[], int]
Result = TypeVar("Result")
LEAD_IN = 2
"""Number of untimed steps before a block, to fill caches and warm starts."""

StepOf = Callable[[int], Array | None]
"""Computes the k-th step of a problem, kinematics included: q̇, rad/s, (nv,); ``None`` for a
contender that computes the kinematics only (``floor:…``)."""


@dataclass(frozen=True)
class SplitStep:
    """A step whose call is also timed alone, without kinematics and targets.

    Attributes:
        before: Prepares step k; returns the arguments of the call.
        call: The step itself.
    """

    before: Callable[[int], Any]
    call: Callable[[Any], Array]

    def __call__(self, k: int) -> Array:
        """The whole step."""
        return self.call(self.before(k))


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


def quantiles(nanoseconds: Sequence[int]) -> list[float] | None:
    """Median, 10th and 90th percentile, µs; ``None`` without times.

    A mean depends on the scheduler's interruptions, a minimum on the luckiest step.
    """
    if not nanoseconds:
        return None
    found: list[float] = np.percentile(np.asarray(nanoseconds) / 1e3, (50, 10, 90)).tolist()
    return found


def blocks_of(steps: int, length: int, count: int) -> list[range]:
    """``count`` runs of ``length`` consecutive steps, spread evenly, each after a lead-in."""
    starts = np.linspace(LEAD_IN, steps - length, count).astype(int)
    return [range(start, start + length) for start in starts.tolist()]


def interleaved(
    contenders: Mapping[str, StepOf],
    blocks: Sequence[range],
    rng: np.random.Generator,
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
    return found


def once(call: Callable[[], Result], clock: Clock = time.perf_counter_ns) -> tuple[int, Result]:
    """Time of one call, ns, without garbage collection, and what it returns."""
    with without_collection():
        began = clock()
        result = call()
        return clock() - began, result


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
