"""Findings of a comparison, as sentences computed from its numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from qp_twist.comparison.metrics import compiled_share, faults, metrics
from qp_twist.following import Trajectory
from qp_twist.following.joint_speeds import OVER, peak_speed
from qp_twist.paths import METHODS

KEPT = "What was kept"
AS_GOOD = 0.05
"""Two runs that keep limits and task count as equally good up to this share of z and travel."""


class MethodRun(NamedTuple):
    """Data of one method for the sentences."""

    name: str
    numbers: Mapping[str, Any]
    """Its :func:`~qp_twist.comparison.metrics`."""
    faults: Sequence[str] = ()
    """What it did not keep; empty if it kept all."""
    code: str = "in Python"
    """What computed it; times compare only for the same."""

    @classmethod
    def of(cls, trajectory: Trajectory) -> MethodRun:
        """The run of a trajectory."""
        numbers, speed = metrics(trajectory), peak_speed(trajectory)
        found = faults(trajectory, numbers)
        if speed is not None and speed.share > OVER:
            times = f"{speed.share:.3g}" if speed.share >= 1.005 else "just over 1"
            found.append(
                f"needs {times} times the speed limit of {speed.joint} at waypoint {speed.waypoint}"
            )
        compiled = compiled_share(trajectory)
        code = "compiled" if compiled >= 1.0 else "partly compiled" if compiled else "in Python"
        if METHODS[trajectory.method].peer:
            code = "by another library"
        return cls(trajectory.method, numbers, found, code)

    @property
    def z(self) -> float:
        """The mean z."""
        return float(self.numbers["mean_z"])

    @property
    def travel(self) -> float:
        """The travel, degrees."""
        return float(self.numbers["travel_deg"])


def by_topic(
    runs: Sequence[MethodRun], not_run: Mapping[str, str] | None = None, bound: float | None = None
) -> dict[str, list[str]]:
    """What a comparison shows: sentences under short headings, of which none is empty.

    ``not_run`` says why a method could not start; ``bound`` is a lower bound of the mean z of all
    motions, if a plan has one.
    """
    topics = {
        KEPT: _kept(runs),
        "The best z, and what it cost": _best(runs, bound),
        "Closed forms beside their QPs": _pairs(runs),
        "What did not run": [
            f"{name} could not run: {why.strip().removesuffix('.')}."
            for name, why in (not_run or {}).items()
        ],
    }
    return {heading: sentences for heading, sentences in topics.items() if sentences}


def _kept(runs: Sequence[MethodRun]) -> list[str]:
    names = [run.name for run in runs if not run.faults]
    return [
        f"{_listed(names) if names else 'No method'} kept limits and task all the way.",
        *(f"{run.name}: {'; '.join(run.faults)}." for run in runs if run.faults),
    ]


def _best(runs: Sequence[MethodRun], bound: float | None) -> list[str]:
    """The least mean z of the runs that kept everything, and its travel; ties as printed."""
    kept = [run for run in runs if not run.faults]
    if not kept or len(runs) < 2 or all(run.numbers["min_margin"] is None for run in runs):
        return []
    best, z = _least({run.name: run.z for run in kept}, _digits)
    text = f"Of the methods that kept limits and task, the least mean z, {z}, is that of {best}"
    if bound is not None and bound > 0.0:
        ratio = _digits(min(run.z for run in kept) / bound)
        times = "" if ratio == "1.00" else f"{ratio} times "
        text += f"; it is {times}the bound {_digits(bound)} that no motion from that start is below"
    sentences = [f"{text}."]
    if len(kept) > 1:
        names, travel = _least({run.name: run.travel for run in kept}, "{:.0f}".format)
        costs = [f"{run.name} travels {run.travel:.0f}°" for run in kept if _digits(run.z) == z]
        sentences.append(f"{_listed(costs)}; the least travel is {travel}°, of {names}.")
    lower = [f"{run.name} ({_digits(run.z)})" for run in runs
             if run.faults and run.z < float(z) and _digits(run.z) != z]  # fmt: skip
    if lower:
        sentences.append(f"A lower mean z came with a fault: {_listed(lower)}.")
    return sentences


def _pairs(runs: Sequence[MethodRun]) -> list[str]:
    ran = {run.name: run for run in runs}
    sentences = [
        _pair(run, ran[method.counterpart])
        for run in runs
        if (method := METHODS[run.name]).counterpart in ran and not method.constrained
    ]
    if sentences:
        sentences.append(
            f"“As good” means: limits and task kept, mean z and travel no more than "
            f"{100 * AS_GOOD:g} % above. Times are wall times of one run on one machine."
        )
    return sentences


def _pair(closed: MethodRun, qp: MethodRun) -> str:
    """A closed form, or another library's step, compared with its QP."""
    if closed.faults and qp.faults:
        return f"Neither {closed.name} nor {qp.name} kept limits and task."
    if closed.faults:
        return f"{closed.name} was not as good as {qp.name}, which kept limits and task."
    if qp.faults:
        return f"{closed.name} was better than {qp.name}: it kept limits and task."
    # Compare as printed: differences below the digits do not count.
    z, travel = _ratio(closed.z, qp.z), _ratio(closed.travel, qp.travel)
    low, high = 1.0 / (1.0 + AS_GOOD), 1.0 + AS_GOOD
    if max(z, travel) <= high:
        verdict = "was better than" if min(z, travel) < low else "was as good as"
    elif min(z, travel) < low:
        verdict = "traded one thing for another beside"
    else:
        verdict = "kept limits and task, but was not as good as"
    mine, theirs = (float(run.numbers["time_per_waypoint_us"]) for run in (closed, qp))
    time = f"time {_factor(_ratio(mine, theirs))} (both {qp.code})"
    if closed.code != qp.code:  # compiled code beside Python says nothing of the methods
        time = f"{mine:.0f} µs a waypoint {closed.code} beside {theirs:.0f} µs {qp.code}"
    return (
        f"{closed.name} {verdict} {qp.name}. Relative to {qp.name}: mean z {_factor(z)}, travel "
        f"{_factor(travel)}, {time}."
    )


def _least(values: Mapping[str, float], shown: Callable[[float], str]) -> tuple[str, str]:
    """The names of the least values as printed, listed, and the text that is printed."""
    text = shown(min(values.values()))
    return _listed([name for name, value in values.items() if shown(value) == text]), text


def _ratio(value: float, other: float) -> float:
    """``value / other`` to the printed digits; 1 if both are zero."""
    if abs(value - other) <= 1e-12:
        return 1.0
    return round(value / other, 2) if other else math.inf


def _factor(ratio: float) -> str:
    if not math.isfinite(ratio):
        return "above 0 instead of 0"
    return f"×{ratio:.2f}" if ratio < 10.0 else f"×{ratio:.0f}"


def _digits(value: float) -> str:
    """Three significant digits, without a power of ten if possible."""
    if 1e-4 <= abs(value) < 999.5:
        return f"{value:#.3g}".rstrip(".")
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e5 else f"{value:.3g}"


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
