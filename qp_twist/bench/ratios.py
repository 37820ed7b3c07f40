"""Ratios of medians: between contenders of one run, and between two runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from qp_twist.bench.record import BenchRun, Case, Measured, Quantiles

CHECKED = ("step:daqp", "step:compiled")
"""Verified steps of this package, as every backend's is; these two are shown."""
AGAINST = {
    "mink:hard": "mink's step with the task as constraint",
    "placo:hard": "PlaCo's whole step, hard tasks",
    "floor:mujoco": "what everybody computes",
}


PLUG_IN = "solve_ik:daqp"
"""The drop-in for one import; compared with mink's own call only."""
PAIRS = (*((ours, other) for ours in CHECKED for other in AGAINST), (PLUG_IN, "mink:hard"))


def ratios(case: Case) -> dict[tuple[str, str], float]:
    """Median of this package's whole step over another's, if both were timed."""
    return _ratios({m.contender: m.warm.median for m in case.results if m.warm})


def ratios_of_calls(case: Case) -> dict[tuple[str, str], float]:
    """The same for the calls alone; a call is not compared with a whole step."""
    return _ratios({m.contender: m.call.median for m in case.results if m.call})


def _ratios(medians: dict[str, float]) -> dict[tuple[str, str], float]:
    return {
        (ours, other): medians[ours] / medians[other]
        for ours, other in PAIRS
        if ours in medians and other in medians
    }


@dataclass(frozen=True)
class Change:
    """A contender on a problem, before and now.

    Attributes:
        case: The problem, in the later run.
        contender: Name of the contender.
        before: Its times in the earlier run, µs.
        now: Its times in the later run, µs.
        worst_before: Its :func:`off_by` in the earlier run.
        worst_now: Its :func:`off_by` in the later run.
    """

    case: Case
    contender: str
    before: Quantiles
    now: Quantiles
    worst_before: float | None
    worst_now: float | None

    @property
    def ratio(self) -> float:
        """Ratio of the medians, later over earlier."""
        return self.now.median / self.before.median

    @property
    def verdict(self) -> Literal["faster", "slower", ""]:
        """Empty if the two ranges p10–p90 overlap: then no difference is shown."""
        if self.now.p90 < self.before.p10:
            return "faster"
        return "slower" if self.now.p10 > self.before.p90 else ""


def changes(before: BenchRun, now: BenchRun) -> list[Change]:
    """The changes of everything that both runs timed, in the order of the later run."""
    earlier = {(case.group, case.x): case for case in before.cases}
    found = []
    for case in now.cases:
        old = earlier.get((case.group, case.x))
        for measured in case.results if old else ():
            assert old is not None
            match = old.of(measured.contender)
            if match is None or match.warm is None or measured.warm is None:
                continue
            then, after = match.warm, measured.warm
            change = Change(case, measured.contender, then, after, off_by(match), off_by(measured))
            found.append(change)
    return found


def off_by(measured: Measured) -> float | None:
    """The largest of residual, excess and error; ``None`` without a velocity to check."""
    accuracy = measured.accuracy
    if accuracy is None:
        return None
    return max(accuracy.residual, accuracy.excess, accuracy.error or 0.0)


def differences(before: BenchRun, now: BenchRun) -> list[str]:
    """A sentence for each difference between the runs other than the code."""
    sentences = []
    if before.machine.in_words() != now.machine.in_words():
        sentences.append(
            f"The runs are of two machines, then {before.machine.in_words()}: the ratios compare "
            "these, too."
        )
    if before.machine.threads != now.machine.threads:
        then = ", ".join(f"{name}={n}" for name, n in before.machine.threads.items())
        sentences.append(f"Threads were set otherwise: {then or 'not at all'} then.")
    versions = [
        f"{name} {before.machine.versions.get(name, 'none')} → {version}"
        for name, version in now.machine.versions.items()
        if before.machine.versions.get(name) != version
    ]
    if versions:
        sentences.append(f"Versions differ: {', '.join(versions)}.")
    if before.seed != now.seed:
        sentences.append(f"The seeds differ ({before.seed} then): so do the trajectories.")
    if before.quick != now.quick:
        sentences.append("One of the runs is quick: it timed fewer steps.")
    here = {m.contender for c in now.cases for m in c.results}
    there = {m.contender for c in before.cases for m in c.results}
    for names, when in (
        (there - here, "then"),
        (here - there, "now"),
    ):
        if names:
            sentences.append(f"Took part only {when}: {', '.join(sorted(names))}.")
    return sentences
