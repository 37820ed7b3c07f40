"""Findings of a comparison, as sentences computed from its numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from qp_twist.comparison.metrics import compiled_share, faults, metrics
from qp_twist.following import Trajectory
from qp_twist.following.joint_speeds import OVER, peak_speed
from qp_twist.paths import METHODS

KEPT = "What was kept"
AS_GOOD = 0.05
"""Two runs that keep limits and task count as equally good up to this share of z and travel."""


@dataclass(frozen=True)
class MethodRun:
    """Data of one method for the sentences.

    Attributes:
        name: Name of the method.
        numbers: Its :func:`~qp_twist.comparison.metrics`.
        faults: What it did not keep; empty if it kept all.
        compiled: Share of its waypoints that compiled code computed.
    """

    name: str
    numbers: Mapping[str, Any]
    faults: Sequence[str] = ()
    compiled: float = 0.0

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
        return cls(trajectory.method, numbers, found, compiled_share(trajectory))

    @property
    def code(self) -> str:
        """The code of its run; times compare only for the same code."""
        if METHODS[self.name].peer:
            return "by another library"
        if self.compiled >= 1.0:
            return "compiled"
        return "in Python" if self.compiled <= 0.0 else f"{100 * self.compiled:.0f} % compiled"


def by_topic(
    runs: Sequence[MethodRun],
    not_run: Mapping[str, str] | None = None,
    bound: float | None = None,
) -> dict[str, list[str]]:
    """What a comparison shows: sentences under short headings, of which none is empty.

    Args:
        runs: The runs of the methods.
        not_run: Why a method could not start, by method name.
        bound: Lower bound of the mean z of all motions, if a plan has one.
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
    who = _listed(names) if names else "No method"
    return [
        f"{who} kept limits and task all the way.",
        *(f"{run.name}: {'; '.join(run.faults)}." for run in runs if run.faults),
    ]


def _best(runs: Sequence[MethodRun], bound: float | None) -> list[str]:
    """The least mean z of the runs that kept everything, and its travel; ties as printed."""
    kept = [run for run in runs if not run.faults]
    if not kept or len(runs) < 2 or all(run.numbers["min_margin"] is None for run in runs):
        return []
    best, z = _least(kept, _mean_z, _digits)
    text = f"Of the methods that kept limits and task, the least mean z, {z}, is that of "
    text += _listed([run.name for run in best])
    if bound is not None and bound > 0.0:
        ratio = _digits(min(map(_mean_z, best)) / bound)
        times = "" if ratio == "1.00" else f"{ratio} times "
        text += f"; it is {times}the bound {_digits(bound)} that no motion from that start is below"
    sentences = [f"{text}."]
    least, travel = _least(kept, lambda run: float(run.numbers["travel_deg"]), "{:.0f}".format)
    costs = [f"{run.name} travels {run.numbers['travel_deg']:.0f}°" for run in best]
    if len(kept) > 1:
        names = _listed([run.name for run in least])
        sentences.append(f"{_listed(costs)}; the least travel is {travel}°, of {names}.")
    lower = [
        f"{run.name} ({_digits(_mean_z(run))})"
        for run in runs
        if run.faults and _mean_z(run) < float(z) and _digits(_mean_z(run)) != z
    ]
    if lower:
        sentences.append(f"A lower mean z came with a fault: {_listed(lower)}.")
    return sentences


def _pairs(runs: Sequence[MethodRun]) -> list[str]:
    ran = {run.name: run for run in runs}
    sentences = []
    for run in runs:
        counterpart = METHODS[run.name].counterpart
        if counterpart in ran and not METHODS[run.name].constrained:
            sentences.append(_pair(run, ran[counterpart]))
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
    z = _ratio(closed.numbers["mean_z"], qp.numbers["mean_z"])
    travel = _ratio(closed.numbers["travel_deg"], qp.numbers["travel_deg"])
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


def _least(
    runs: Sequence[MethodRun], value: Callable[[MethodRun], float], shown: Callable[[float], str]
) -> tuple[list[MethodRun], str]:
    """The runs with the least value as printed, and that value."""
    text = shown(min(map(value, runs)))
    return [run for run in runs if shown(value(run)) == text], text


def _mean_z(run: MethodRun) -> float:
    return float(run.numbers["mean_z"])


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
    if not math.isfinite(value):
        return "∞" if value > 0.0 else "−∞"
    if 1e-4 <= abs(value) < 999.5:
        return f"{value:#.3g}".rstrip(".")
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e5 else f"{value:.3g}"


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
