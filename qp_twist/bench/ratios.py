"""Ratios of medians: of contenders in one run, and of two runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from qp_twist.bench.quantiles import Quantiles
from qp_twist.bench.record import Case, Measured, Run

CHECKED = ("step:daqp", "step:compiled")
"""The steps of this package that are verified: every backend's is; these two are shown."""
AGAINST = {
    "mink:hard": "mink's step with the task as constraint",
    "placo:hard": "PlaCo's whole step, hard tasks",
    "floor:mujoco": "what everybody computes",
}


def ratios_of_calls(case: Case) -> dict[tuple[str, str], float]:
    """The same of the calls alone; what has no call of its own is taken whole."""
    found = {}
    for ours in CHECKED:
        mine = case.of(ours)
        if mine is None or mine.call is None:
            continue
        for other in AGAINST:
            theirs = case.of(other)
            times = theirs and (theirs.call or theirs.warm)
            if times:
                found[ours, other] = mine.call.median / times.median
    return found


def ratios(case: Case) -> dict[tuple[str, str], float]:
    """Median of a checked step over that of another contender, where both were timed."""
    medians = {m.contender: m.warm.median for m in case.results if m.warm}
    return {
        (ours, other): medians[ours] / medians[other]
        for ours in CHECKED
        for other in AGAINST
        if ours in medians and other in medians
    }


@dataclass(frozen=True)
class Change:
    """A contender on a problem, before and now.

    Attributes:
        case: The problem now.
        contender: Whose.
        before: Its times then, µs.
        now: Its times now, µs.
        worst_before: Its :func:`off_by` then.
        worst_now: Its :func:`off_by` now.
    """

    case: Case
    contender: str
    before: Quantiles
    now: Quantiles
    worst_before: float | None
    worst_now: float | None

    @property
    def ratio(self) -> float:
        """Median now over median before."""
        return self.now.median / self.before.median

    @property
    def verdict(self) -> Literal["faster", "slower", ""]:
        """Empty where the two spans from p10 to p90 overlap: then nothing has been shown."""
        if self.now.p90 < self.before.p10:
            return "faster"
        return "slower" if self.now.p10 > self.before.p90 else ""


def changes(before: Run, now: Run) -> list[Change]:
    """What both runs timed, in the order of the run now."""
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
    """The largest of residual, excess and error; ``None`` where there is no answer to judge."""
    accuracy = measured.accuracy
    if accuracy is None:
        return None
    return max(accuracy.residual, accuracy.excess, accuracy.error or 0.0)


def differences(before: Run, now: Run) -> list[str]:
    """A sentence for each thing beside the code that the two runs do not share."""
    said = []
    if before.machine.in_words() != now.machine.in_words():
        said.append(
            f"The runs are of two machines, then {before.machine.in_words()}: the ratios compare "
            "these, too."
        )
    if before.machine.threads != now.machine.threads:
        then = ", ".join(f"{name}={n}" for name, n in before.machine.threads.items())
        said.append(f"Threads were set otherwise: {then or 'not at all'} then.")
    versions = [
        f"{name} {before.machine.versions.get(name, 'none')} → {version}"
        for name, version in now.machine.versions.items()
        if before.machine.versions.get(name) != version
    ]
    if versions:
        said.append(f"Versions differ: {', '.join(versions)}.")
    if before.seed != now.seed:
        said.append(f"The seeds differ ({before.seed} then): so do the trajectories.")
    if before.quick != now.quick:
        said.append("One of the runs is quick: it timed fewer steps.")
    here = {m.contender for c in now.cases for m in c.results}
    there = {m.contender for c in before.cases for m in c.results}
    for names, when in (
        (there - here, "then"),
        (here - there, "now"),
    ):
        if names:
            said.append(f"Took part only {when}: {', '.join(sorted(names))}.")
    return said
