"""Findings of a comparison, as sentences computed from its numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

from qp_twist.comparison.metrics import (
    EXCESSES,
    compiled_share,
    metrics,
    too_near,
)
from qp_twist.following import Trajectory
from qp_twist.following.joint_speeds import OVER, PeakSpeed, peak_speed
from qp_twist.paths import METHODS, Tolerances

AS_GOOD = 0.05
"""Two runs that keep limits and task count as equally good up to this share of z and travel."""
_COMPARED = {"mean_z": "mean z", "travel_deg": "travel"}
"""The compared metrics, and their names."""
_MORE_MM, _MORE_DEG = 1e3, math.degrees(1.0)


@dataclass(frozen=True)
class MethodRun:
    """Data of one method for the sentences.

    Attributes:
        name: Name of the method.
        numbers: Its :func:`~qp_twist.comparison.metrics`.
        reached: Number of waypoints before it ended or diverged.
        waypoints: Number of waypoints of the path.
        speed: Its highest joint speed; ``None`` without a feed or speed limits.
        compiled: Share of its waypoints that compiled code computed.
        tolerances: Of the verdict on it.
    """

    name: str
    numbers: Mapping[str, Any]
    reached: int
    waypoints: int
    speed: PeakSpeed | None = None
    compiled: float = 0.0
    tolerances: Tolerances = field(default_factory=Tolerances)

    @classmethod
    def of(cls, trajectory: Trajectory) -> MethodRun:
        """The run of a trajectory."""
        reached = len(trajectory.q)
        if trajectory.diverged_at is not None:
            reached = trajectory.diverged_at - 1
        return cls(
            trajectory.method,
            metrics(trajectory),
            reached,
            len(trajectory.path_task.waypoints),
            peak_speed(trajectory),
            compiled_share(trajectory),
            trajectory.path_task.tolerances,
        )

    @property
    def inside(self) -> bool:
        """Whether all joints stayed between their limits."""
        return not self.numbers["violations"]

    @property
    def on_path(self) -> bool:
        """Whether the task was met at every waypoint, by the tolerances of a check."""
        errors = self.numbers["position_error_max_m"], self.numbers["axis_error_max_rad"]
        return bool(self.tolerances.met(*errors))

    @property
    def faults(self) -> list[str]:
        """Its faults, as clauses that follow its name."""
        faults = []
        if self.reached < self.waypoints:
            faults.append(f"stopped at waypoint {self.reached} of {self.waypoints}")
        if not self.inside:
            joint, waypoint = _first_violation(self)
            faults.append(f"left the joint limits ({joint} at waypoint {waypoint})")
        if self.speed is not None and self.speed.share > OVER:
            faults.append(f"needed {_speed(self.speed)}")
        if not self.on_path:
            one_step = "one step a waypoint" in self.numbers["status"]
            steps = " (one step a waypoint)" if one_step else ""
            faults.append(f"was off the path by {_off_by(self)}{steps}")
        for key, what in EXCESSES.items():
            excess = self.numbers.get(key, 0.0)
            if what == "constraint" and too_near(self.numbers, self.tolerances):
                distance = 1e3 * self.numbers["min_clearance_m"]
                faults.append(f"came as near as {distance:.3g} mm to what it must not touch")
            elif excess > self.tolerances.band:
                faults.append(f"left a {what} by up to {excess:.2g} (m or rad)")
        unknown = [what for key, what in _COMPARED.items() if not math.isfinite(self.numbers[key])]
        if unknown:
            faults.append(f"had no finite {_listed(unknown)}")
        return faults

    @property
    def code(self) -> str:
        """The code of its run; times compare only for the same code."""
        if METHODS[self.name].peer:
            return "another library"
        if self.compiled >= 1.0:
            return "compiled"
        return "Python" if self.compiled <= 0.0 else f"{100 * self.compiled:.0f} % compiled"


def findings(
    trajectories: Mapping[str, Trajectory],
    not_run: Mapping[str, str] | None = None,
    bound: float | None = None,
) -> list[str]:
    """Findings of a comparison, one or two sentences each.

    Args:
        trajectories: Trajectories by method name.
        not_run: Why a method could not start, by method name.
        bound: Lower bound of the mean z of all motions, if a plan has one.
    """
    runs = [MethodRun.of(trajectory) for trajectory in trajectories.values()]
    return list(chain.from_iterable(by_topic(runs, not_run or {}, bound).values()))


def by_topic(
    runs: Sequence[MethodRun],
    not_run: Mapping[str, str] | None = None,
    bound: float | None = None,
) -> dict[str, list[str]]:
    """The sentences under short headings; a heading without sentences is left out."""
    topics = {
        "Joint limits": _limits(runs),
        "Joint speeds": _speeds(runs),
        "The task": _task(runs),
        "The best z, and what it cost": _best(runs, bound),
        "Closed forms beside their QPs": _pairs(runs),
        "What did not run": [
            f"{name} could not run: {_ended(why)}" for name, why in (not_run or {}).items()
        ],
    }
    return {heading: sentences for heading, sentences in topics.items() if sentences}


def _limits(runs: Sequence[MethodRun]) -> list[str]:
    margins = {r.name: r.numbers["min_margin"] for r in runs}
    if all(margin is None for margin in margins.values()):
        return ["No joint has limits, so that there were none to keep."]
    # Runs equal as printed stay in the order in which they ran.
    inside = sorted((r for r in runs if r.inside), key=lambda r: -float(_margin(margins[r.name])))
    outside = sorted((r for r in runs if not r.inside), key=lambda r: _first_violation(r)[1])
    if not inside:
        who = _either(
            len(runs),
            f"{runs[0].name} did not stay",
            _either(len(runs) - 1, "Neither method", f"None of {_number(len(runs))} methods")
            + " stayed",
        )
        sentences = [f"{who} inside the joint limits."]
    else:
        if len(runs) == 1:
            who = inside[0].name
        elif outside:
            who = f"{_number(len(inside)).capitalize()} of {_number(len(runs))} methods"
        else:
            who = _either(len(runs) - 1, "Both methods", f"All {_number(len(runs))} methods")
        names = _listed([f"{r.name} {_margin(margins[r.name])}" for r in inside])
        sentences = [
            f"{who} stayed inside the joint limits. Smallest margin, 1 mid-range and 0 at a limit: "
            f"{names}."
        ]
    if outside:
        sentences.append(_left_limits(outside, len(runs)))
    return sentences


def _left_limits(outside: Sequence[MethodRun], count: int) -> str:
    """Which of ``count`` methods left the limits, by waypoint, and how far."""

    def where(run: MethodRun) -> str:
        joint, waypoint = _first_violation(run)
        return f"{run.name} ({joint} at waypoint {waypoint})"

    earliest = _first_violation(outside[0])[1]
    first = [r for r in outside if _first_violation(r)[1] == earliest]
    later = [r for r in outside if r not in first]
    if count == 1:
        joint, waypoint = _first_violation(outside[0])
        text = f"It left them with {joint} at waypoint {waypoint}"
    elif not later and len(first) == 1:
        text = f"The one that left them: {where(first[0])}"
    else:
        text = f"The first to leave {_either(len(first), 'was', 'were')} "
        text += _listed([where(r) for r in first])
    if later:
        text += f", then {_listed([where(r) for r in later])}"
    furthest, beyond = _extreme(outside, lambda r: -100.0 * r.numbers["min_margin"], largest=True)
    out = f"out by up to {beyond} % of half a joint's range"
    if len(outside) == 1:
        return f"{text}. It was {out}."
    who = f"{_listed([r.name for r in furthest])} {_either(len(furthest), 'was', 'were')}"
    return f"{text}. {who} {out}, the furthest."


def _speeds(runs: Sequence[MethodRun]) -> list[str]:
    timed = [r for r in runs if r.speed is not None]
    if not timed:
        return []
    fast = [r for r in timed if r.speed is not None and r.speed.share > OVER]
    if not fast:
        return [
            "At the task's feed no joint was faster than its limit, on average between two "
            f"waypoints{_either(len(timed), '', ', in any run')}."
        ]
    fast.sort(key=lambda r: -r.speed.share if r.speed is not None else 0.0)
    too_fast = [f"{r.name} ({_speed(r.speed)})" for r in fast if r.speed is not None]
    return [f"At the task's feed joints were too fast in {_listed(too_fast)}."]


def _task(runs: Sequence[MethodRun]) -> list[str]:
    sentences = []
    off = [r for r in runs if not r.on_path]
    tolerances = runs[0].tolerances
    linear = f"{_MORE_MM * tolerances.position:g} mm"
    angular = f"{math.degrees(tolerances.axis):g}°"
    tolerance = f"{linear} and {angular}"
    if len(runs) == 1:
        met = "met" if not off else "did not meet"
        sentences.append(f"{runs[0].name} {met} every waypoint to {tolerance}.")
    elif not off:
        sentences.append(f"Every waypoint was met by all methods to {tolerance}.")
    elif len(off) == len(runs):
        sentences.append(f"No method met every waypoint to {tolerance}.")
    if off:
        off.sort(key=lambda r: -r.numbers["position_error_max_m"])
        errors = _listed([f"{r.name} (by {_off_by(r)})" for r in off])
        sentences.append(
            f"Off the path by more than {linear} or {angular} at some waypoint: {errors}."
        )
    ended = [r for r in runs if r.reached < r.waypoints]
    if ended:
        where = _listed([f"{r.name} at waypoint {r.reached}" for r in ended])
        sentences.append(f"Stopped before the end, of {runs[0].waypoints} waypoints: {where}.")
    for key, what in EXCESSES.items():
        left = [r.name for r in runs if r.numbers.get(key, 0.0) > r.tolerances.band]
        if left:
            sentences.append(f"Outside a {what} at some waypoint: {_listed(left)}.")
    return sentences


def _best(runs: Sequence[MethodRun], bound: float | None) -> list[str]:
    if len(runs) < 2 or all(r.numbers["min_margin"] is None for r in runs):
        return []
    kept = [r for r in runs if not r.faults]
    if not kept:
        return ["No method kept limits and task all the way, so that none can be called best in z."]
    best, z = _extreme(kept, _mean_z)
    names = _listed([r.name for r in best])
    if len(kept) == 1:
        text = f"{names} alone kept limits and task; its mean z is {z}"
    else:
        of = _either(len(kept) - 1, "two", _number(len(kept)))
        lowest = _either(len(kept) - 1, "lower", "lowest")
        text = f"Of the {of} methods that kept limits and task, "
        if len(best) == 1:
            text += f"{names} has the {lowest} mean z, {z}"
        elif len(best) == len(kept):
            text += (
                f"{_either(len(kept) - 1, 'both', 'all')} have the same mean z to three digits, {z}"
            )
        else:
            text += f"{names} have the same lowest mean z to three digits, {z}"
    if bound is not None and bound > 0.0:
        ratio = _digits(min(map(_mean_z, best)) / bound)
        times = "" if ratio == "1.00" else f"{ratio} times "
        text += f", {times}the bound {_digits(bound)} that no motion from that start can be below"
    others = [r for r in kept if r not in best]
    if others:
        second, value = _extreme(others, _mean_z)
        text += (
            f"; next {_either(len(second), 'is', 'are')} {_listed([r.name for r in second])} with "
            f"{value}"
        )
    sentences = [text + "."]
    if len(kept) > 1 and len(best) < len(kept):
        sentences += [_cost(run, kept, named=len(best) > 1) for run in best]
    lower = [r for r in runs if r.faults and _mean_z(r) < float(z) and _digits(_mean_z(r)) != z]
    if lower:
        reasons = [f"{r.name} ({_digits(_mean_z(r))}) {_listed(r.faults)}" for r in lower]
        sentences.append(f"A lower mean z came with a fault: {'; '.join(reasons)}.")
    return sentences


def _cost(run: MethodRun, kept: Sequence[MethodRun], *, named: bool) -> str:
    """Costs of the best z: travel, time and error beside the least of the faultless runs."""
    travel, time = run.numbers["travel_deg"], run.numbers["time_per_waypoint_us"]
    parts = [f"travels {travel:.0f}°" + _beside_least(run, kept, "travel_deg")]
    alike = [r for r in kept if r.code == run.code]
    taken = f"takes {time:.0f} µs a waypoint ({run.code})"
    if len(alike) > 1:
        taken += _beside_least(run, alike, "time_per_waypoint_us", f" {_of_code(run.code)}")
    parts.append(taken)
    who = run.name if named else "It"
    return f"{who} {', and '.join(parts)}; its error is at most {_error(run)}."


def _beside_least(run: MethodRun, runs: Sequence[MethodRun], key: str, of: str = "") -> str:
    """A number beside the least of all, as a clause; numbers equal as printed are equal."""
    least, shown = _extreme(runs, lambda r: float(r.numbers[key]), digits="{:.0f}".format)
    if run in least:
        equal = _either(len(least), "the least", "as little as any other")
        return f", {equal}{of}"
    low = min(float(r.numbers[key]) for r in least)
    names = _listed([r.name for r in least]) if len(least) < 4 else f"{_number(len(least))} methods"
    if low <= 0.0:
        return f" beside {shown}, the least{of} ({names})"
    return f", {_digits(run.numbers[key] / low)} times the least{of} ({names})"


def _pairs(runs: Sequence[MethodRun]) -> list[str]:
    ran = {r.name: r for r in runs}
    sentences = []
    for run in runs:
        method = METHODS[run.name]
        if method.constrained or method.counterpart not in ran:
            continue
        sentences.append(_pair(run, ran[method.counterpart]))
    if sentences:
        sentences.append(
            f"“As good” means: limits and task kept, mean z and travel no more than "
            f"{100 * AS_GOOD:g} % above. Times are wall times of one run on one machine, and are "
            "compared where both methods ran compiled or both in Python."
        )
    return sentences


def _pair(closed: MethodRun, qp: MethodRun) -> str:
    """A closed form, or another library's step, compared with its QP."""
    if closed.faults and qp.faults:
        return (
            f"Neither {closed.name} nor {qp.name} kept everything: {closed.name} "
            f"{_listed(closed.faults)}; {qp.name} {_listed(qp.faults)}."
        )
    if closed.faults:
        return (
            f"{closed.name} was not as good as {qp.name}: it {_listed(closed.faults)}, while "
            f"{qp.name} kept limits and task."
        )
    if qp.faults:
        return (
            f"{closed.name} was better than {qp.name}: it kept limits and task, while {qp.name} "
            f"{_listed(qp.faults)}."
        )
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
    return (
        f"{closed.name} {verdict} {qp.name}. Relative to {qp.name}: mean z {_factor(z)}, travel "
        f"{_factor(travel)}, {_time_beside(closed, qp)}."
    )


def _time_beside(closed: MethodRun, qp: MethodRun) -> str:
    """The time of a pair: a ratio where both ran in the same code, else both times and codes."""
    mine, theirs = (float(r.numbers["time_per_waypoint_us"]) for r in (closed, qp))
    if closed.code == qp.code:
        return f"time {_factor(_ratio(mine, theirs))} (both {_in_code(qp.code)})"
    return (
        f"time not comparable ({mine:.0f} µs a waypoint {_in_code(closed.code)}, "
        f"{theirs:.0f} µs {_in_code(qp.code)})"
    )


def _in_code(code: str) -> str:
    return {"Python": "in Python", "another library": "by another library"}.get(code, code)


def _of_code(code: str) -> str:
    names = {"Python": "in Python", "another library": "of other libraries"}
    return names.get(code, f"of those {code}")


def _extreme(
    runs: Sequence[MethodRun],
    value: Callable[[MethodRun], float],
    *,
    largest: bool = False,
    digits: Callable[[float], str] | None = None,
) -> tuple[list[MethodRun], str]:
    """The runs with the smallest or largest value as printed, and that value.

    Runs with equal printed digits share the place.
    """
    shown = digits or _digits
    text = shown((max if largest else min)(map(value, runs)))
    return [r for r in runs if shown(value(r)) == text], text


def _mean_z(run: MethodRun) -> float:
    return float(run.numbers["mean_z"])


def _first_violation(run: MethodRun) -> tuple[str, int]:
    joint, waypoint = min(run.numbers["first_violation"].items(), key=lambda item: item[1])
    return str(joint), int(waypoint)


def _error(run: MethodRun) -> str:
    """The largest errors; the angular one only if nonzero."""
    text = f"{_digits(_MORE_MM * run.numbers['position_error_max_m'])} mm"
    angle = run.numbers["axis_error_max_rad"]
    return text + (f" and {_digits(_MORE_DEG * angle)}°" if angle > 0.0 else "")


def _off_by(run: MethodRun) -> str:
    """Path error of a run, possibly huge if it diverged."""
    errors = run.numbers["position_error_max_m"], run.numbers["axis_error_max_rad"]
    return f"up to {_error(run)}" if all(map(math.isfinite, errors)) else "an unknown amount"


def _speed(speed: PeakSpeed) -> str:
    times = f"{speed.share:.3g}" if speed.share >= 1.005 else f"{speed.share:.6g}"
    return f"{speed.joint} at {times} times its speed limit at waypoint {speed.waypoint}"


def _ratio(value: float, other: float) -> float:
    """``value / other`` to the printed digits; 1 if both are zero."""
    if abs(value - other) <= 1e-12:
        return 1.0
    return round(value / other, 2) if other else math.inf


def _factor(ratio: float) -> str:
    if not math.isfinite(ratio):
        return "above 0 instead of 0"
    return f"×{ratio:.2f}" if ratio < 10.0 else f"×{ratio:.0f}"


def _margin(margin: float | None) -> str:
    if margin is None:
        return "–"
    return f"{max(margin, 0.0):.3f}"


def _digits(value: float) -> str:
    """Three significant digits, without a power of ten if possible."""
    if not math.isfinite(value):
        return "an unknown number of" if math.isnan(value) else "∞" if value > 0.0 else "−∞"
    if value == 0.0:
        return "0"
    if 1e-4 <= abs(value) < 999.5:
        return f"{value:#.3g}".rstrip(".")
    if 999.5 <= abs(value) < 1e5:
        return f"{value:.0f}"
    return f"{value:.2e}"


def _number(count: int) -> str:
    words = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
    return words[count] if count < len(words) else str(count)


def _either(count: int, one: str, many: str) -> str:
    return one if count == 1 else many


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _ended(sentence: str) -> str:
    text = sentence.strip()
    return text if text.endswith((".", "!", "?")) else text + "."
