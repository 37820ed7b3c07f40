"""Ratios of medians: of contenders in one run, and of two runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from qp_twist.bench.record import Case, Measured, Quantiles, Run

CHECKED = ("step:daqp", "step:compiled")
"""The steps of this package that are verified: every backend's is; these two are shown."""
AGAINST = {
    "mink:hard": "mink's step with the task as constraint",
    "placo:hard": "PlaCo's whole step, hard tasks",
    "floor:mujoco": "what everybody computes",
}


PLUG_IN = "solve_ik:daqp"
"""What an app that changes one import gets: it stands beside mink's own call alone."""
PAIRS = (*((ours, other) for ours in CHECKED for other in AGAINST), (PLUG_IN, "mink:hard"))


def ratios(case: Case) -> dict[tuple[str, str], float]:
    """Median of a whole step of ours over another's whole step, where both were timed."""
    return _ratios({m.contender: m.warm.median for m in case.results if m.warm})


def ratios_of_calls(case: Case) -> dict[tuple[str, str], float]:
    """The same of the calls alone, where both have one: a call is not held against a whole step."""
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
