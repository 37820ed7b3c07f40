"""Run the benchmark: problems, contenders, and their order."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from qp_twist.bench import many_runs
from qp_twist.bench.contender import Contender, StepOf
from qp_twist.bench.contenders import contenders
from qp_twist.bench.problem import STEPS, Problem
from qp_twist.bench.problems import Planned, growth, table
from qp_twist.bench.record import Accuracy, BenchRun, Case, Machine, Measured, Quantiles
from qp_twist.bench.timer import Cold, Timed, blocks_of, cold, interleaved
from qp_twist.checks import did_you_mean
from qp_twist.errors import InvalidInput

PARTS = ("steps", "growth", "batch")
GROWING = ("step:daqp", "step:compiled", "mink:hard")
"""Contenders of the series, unless others are named."""


@dataclass(frozen=True)
class Extent:
    """Extent of a run.

    Attributes:
        blocks: Runs of consecutive steps along a trajectory.
        length: Number of steps of each.
        rounds: Number of passes over all blocks, for the table and for a series.
        cold: Number of cold starts of each contender.
        sizes: Sizes of batches, in runs.
        calls: Number of calls of each batch.
    """

    blocks: int
    length: int
    rounds: tuple[int, int]
    cold: int
    sizes: tuple[int, ...]
    calls: int


WHOLE = Extent(12, 16, (4, 3), 10, many_runs.SIZES, 9)
QUICK = Extent(6, 8, (1, 1), 3, many_runs.SIZES[:4], 3)

Progress = Callable[[str, float], None]
"""Called with what is being timed, and the share of the run that is done."""


def bench(
    *,
    parts: Sequence[str] = PARTS,
    only: Sequence[str] | None = None,
    quick: bool = False,
    seed: int = 0,
    progress: Progress = lambda what, share: None,
    known: Iterable[Contender] | None = None,
) -> BenchRun:
    """Run the benchmark.

    Args:
        parts: ``steps`` (the table), ``growth`` (the series), ``batch``.
        only: Contenders by name, or by family (the part before the colon).
        quick: Whether to time a few steps only.
        seed: Seed of the trajectories and of the order of contenders.
        progress: Called with the progress of the run.
        known: The contenders to choose from; all of the package by default.

    Raises:
        InvalidInput: If a part or a contender is not known.
        NoProblem: If this seed has no trajectory for a problem.
    """
    _check("--parts", parts, PARTS)
    everyone = list(contenders() if known is None else known)
    names = [c.name for c in everyone]
    if only is not None:
        families = [c.family for c in everyone]
        _check("--only", only, [*names, *many_runs.NAMES], [*families, "batch"])
    skipped: list[str] = []
    present = _present([c for c in everyone if _named(c.name, only)], skipped)
    extent = QUICK if quick else WHOLE
    planned: list[tuple[Planned, list[Contender], int]] = []
    if "steps" in parts:
        planned += [(p, present, extent.rounds[0]) for p in table(seed)]
    if "growth" in parts:
        growing = [c for c in present if only is not None or c.name in GROWING]
        planned += [(p, growing, extent.rounds[1]) for p in growth(seed)]
    runs = [n for n in many_runs.NAMES if "batch" in parts and _named(n, only)]
    taking = [(plan, who, rounds) for plan, who, rounds in planned if who]
    turns = sum(len(who) * rounds for _, who, rounds in taking)
    in_batches = len(runs) * len(extent.sizes) * extent.calls
    meter = _Meter(turns * extent.blocks + 60 * len(taking) + in_batches, progress)
    entered = []
    for plan, who, rounds in taking:
        meter.tell(f"{plan.title}: reference solutions, cold steps")
        entered.append(_Entered(plan, who, rounds, extent, seed, skipped))
        meter.count(60)
    # Interleave the problems in rounds, so that a disturbance does not hit a single one.
    for turn in range(max(extent.rounds)):
        for problem in entered:
            if turn < problem.rounds:
                problem.time(meter)
    cases = [case for problem in entered if (case := problem.judged()).results]
    if runs:
        cases += many_runs.time_calls(extent.sizes, runs, extent.calls, seed, meter.one)
    if not cases:
        why = " ".join(dict.fromkeys(skipped))
        raise InvalidInput(
            f"bench: none of the contenders named takes part in {', '.join(parts)}. {why}".strip()
        )
    return BenchRun(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        seed=seed,
        quick=quick,
        machine=Machine.here(),
        skipped=tuple(dict.fromkeys(skipped)),
        cases=tuple(cases),
    )


class _Entered:
    """A problem with its contenders: started cold, then timed in rounds."""

    def __init__(
        self,
        planned: Planned,
        who: list[Contender],
        rounds: int,
        extent: Extent,
        seed: int,
        skipped: list[str],
    ) -> None:
        self.rounds, self._title = rounds, planned.title
        self._blocks = blocks_of(STEPS, extent.length, extent.blocks)
        self._steps = [k for block in self._blocks for k in block]
        self.problem, self._truth = planned.make(self._steps)
        self._rng = np.random.default_rng([seed, self.problem.x])
        self._who = [c for c in who if c.applies(self.problem)]
        with _no_warnings():
            makers = _prepared(self._who, self.problem, skipped)
            self._cold = cold(makers, self._steps[0], extent.cold, self._rng)
            self._steppers = {name: make() for name, make in makers.items()}
        self._timed = {name: Timed() for name in makers}

    def time(self, meter: _Meter) -> None:
        """Run all blocks once."""

        def count(name: str) -> None:
            meter.one(f"{self._title}: {name}")

        with _no_warnings():
            interleaved(self._steppers, self._blocks, self._rng, count, self._timed)

    def judged(self) -> Case:
        """Times and accuracies."""
        problem, truth = self.problem, self._truth
        results = []
        for contender in self._who:
            timed = self._timed.get(contender.name)
            if timed is None:
                continue
            accuracy = truth.accuracy(contender.variant, timed.velocities)
            results.append(_measured(contender, timed, self._cold[contender.name], accuracy))
        return Case(
            group=problem.group,
            x=problem.x,
            title=problem.title,
            joints=int(problem.model.nv),
            rows=problem.rows,
            steps=len(self._steps),
            active_share=truth.active_share,
            results=tuple(results),
        )


@contextmanager
def _no_warnings() -> Iterator[None]:
    """Suppress warnings of backends that convert dense matrices."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _measured(
    contender: Contender, timed: Timed, started: Cold, accuracy: Accuracy | None
) -> Measured:
    return Measured(
        contender=contender.name,
        warm=Quantiles.of(timed.warm),
        call=Quantiles.of(timed.call),
        cold=Quantiles.of(started.again),
        first_us=started.first / 1e3 if started.first else None,
        accuracy=accuracy,
        failures=timed.failures,
        said=timed.said,
    )


def _prepared(
    taking: list[Contender], problem: Problem, skipped: list[str]
) -> dict[str, Callable[[], StepOf]]:
    makers = {}
    for contender in taking:
        try:
            makers[contender.name] = contender.prepare(problem)
        except Exception as error:  # any exception of a library; the others continue
            why = str(error).splitlines()[0] if str(error) else type(error).__name__
            skipped.append(f"skipped {contender.name} with {problem.title}: {why}")
    return makers


def _present(chosen: list[Contender], skipped: list[str]) -> list[Contender]:
    """The contenders that can take part; for the others a sentence for each reason."""
    why = {c.name: c.missing() for c in chosen}
    for reason in dict.fromkeys(r for r in why.values() if r):
        names = ", ".join(name for name, cause in why.items() if cause == reason)
        skipped.append(f"skipped {names}: {reason}")
    return [c for c in chosen if not why[c.name]]


def _named(name: str, only: Sequence[str] | None) -> bool:
    return only is None or name in only or name.partition(":")[0] in only


def _check(
    option: str, given: Sequence[str], known: Sequence[str], also: Sequence[str] = ()
) -> None:
    if not given:
        raise InvalidInput(f"{option}: no name in it; known: {', '.join(dict.fromkeys(known))}.")
    for name in given:
        if name not in known and name not in also:
            families = f"; families: {', '.join(dict.fromkeys(also))}" if also else ""
            raise InvalidInput(
                f"{option} {name!r}: not known{did_you_mean(name, [*known, *also])} Known: "
                f"{', '.join(dict.fromkeys(known))}{families}."
            )


class _Meter:
    """Progress of a run."""

    def __init__(self, total: int, progress: Progress) -> None:
        self._total, self._progress, self._done = max(1, total), progress, 0

    def tell(self, what: str) -> None:
        """Report the current phase."""
        self._progress(what, min(1.0, self._done / self._total))

    def count(self, turns: int) -> None:
        """Report that this many turns are done."""
        self._done += turns

    def one(self, what: str) -> None:
        """Report that a turn of a contender is done."""
        self.count(1)
        self.tell(what)
