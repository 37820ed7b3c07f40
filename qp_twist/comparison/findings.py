"""What a comparison shows, in sentences computed from its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

from qp_twist.comparison.joint_speeds import OVER, PeakSpeed, peak_speed
from qp_twist.comparison.metrics import BAND_LEFT, TASK_MET_M, TASK_MET_RAD, metrics
from qp_twist.following import Trajectory
from qp_twist.path import METHODS

AS_GOOD = 0.05
"""Two runs that keep limits and task are as good as each other up to this share of z and travel."""
_ALIKE = 1e-3
_MORE_MM, _MORE_DEG = 1e3, math.degrees(1.0)


@dataclass(frozen=True)
class Run:
    """What the sentences about one method are made from.

    Attributes:
        name: Of the method.
        numbers: Its :func:`~qp_twist.comparison.metrics`.
        reached: Number of waypoints that it went through before it ended or diverged.
        waypoints: Number of waypoints of the path.
        speed: Its highest joint speed; ``None`` where the task has no clock or no such limits.
    """

    name: str
    numbers: Mapping[str, Any]
    reached: int
    waypoints: int
    speed: PeakSpeed | None = None

    @classmethod
    def of(cls, trajectory: Trajectory) -> Run:
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
        )

    @property
    def inside(self) -> bool:
        """Whether all joints stayed between their limits."""
        return not self.numbers["violations"]

    @property
    def on_path(self) -> bool:
        """Whether the task was met at every waypoint, to 0.01 mm and 1e-5 rad."""
        return bool(
            self.numbers["position_error_max_m"] <= TASK_MET_M
            and self.numbers["axis_error_max_rad"] <= TASK_MET_RAD
        )

    @property
    def faults(self) -> list[str]:
        """What it did not keep, as ends of a sentence that begins with its name."""
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
            steps = ", taking one step a waypoint" if one_step else ""
            faults.append(f"was off the path by up to {_error(self)}{steps}")
        if self.numbers.get("band_excess_max", 0.0) > BAND_LEFT:
            excess = self.numbers["band_excess_max"]
            faults.append(f"left a tolerance band by up to {excess:.2g} (m or rad)")
        return faults


def findings(
    trajectories: Mapping[str, Trajectory],
    not_run: Mapping[str, str] | None = None,
    bound: float | None = None,
) -> list[str]:
    """What a comparison shows, a sentence or two an entry.

    Args:
        trajectories: By method name.
        not_run: Why a method could not start, by its name.
        bound: What no motion's mean z can be below, where a plan has found it.
    """
    runs = [Run.of(trajectory) for trajectory in trajectories.values()]
    return list(chain.from_iterable(by_topic(runs, not_run or {}, bound).values()))


def by_topic(
    runs: Sequence[Run], not_run: Mapping[str, str] | None = None, bound: float | None = None
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


def _limits(runs: Sequence[Run]) -> list[str]:
    margins = {r.name: r.numbers["min_margin"] for r in runs}
    if all(margin is None for margin in margins.values()):
        return ["No joint has limits, so that there were none to keep."]
    inside = sorted((r for r in runs if r.inside), key=lambda r: -margins[r.name])
    outside = sorted((r for r in runs if not r.inside), key=lambda r: _first_violation(r)[1])
    if not inside:
        said = [f"No method stayed inside the joint limits ({_number(len(runs))} ran)."]
    else:
        if len(runs) == 1:
            who = inside[0].name
        elif outside:
            who = f"{_number(len(inside)).capitalize()} of {_number(len(runs))} methods"
        else:
            who = f"All {_number(len(runs))} methods"
        names = _listed([f"{r.name} {_margin(margins[r.name])}" for r in inside])
        said = [
            f"{who} stayed inside the joint limits. Smallest margin, 1 mid-range and 0 at a limit: "
            f"{names}."
        ]
    if outside:
        first = outside[0]
        joint, waypoint = _first_violation(first)
        text = f"The first to leave them was {first.name}: {joint} at waypoint {waypoint}"
        if outside[1:]:
            others = [
                f"{r.name} ({_first_violation(r)[0]} at {_first_violation(r)[1]})"
                for r in outside[1:]
            ]
            text += f"; then {_listed(others)}"
        worst = min(outside, key=lambda r: margins[r.name])
        beyond = f"{_digits(-100.0 * margins[worst.name])} % of half a joint's range"
        which = "It was" if not outside[1:] else f"{worst.name} was"
        said.append(f"{text}. {which} out by up to {beyond}{', the furthest' * bool(outside[1:])}.")
    return said


def _speeds(runs: Sequence[Run]) -> list[str]:
    timed = [r for r in runs if r.speed is not None]
    if not timed:
        return []
    fast = [r for r in timed if r.speed is not None and r.speed.share > OVER]
    if not fast:
        return [
            "At the task's feed no joint was faster than its limit in "
            f"{_either(len(timed), 'the run', 'any run')}."
        ]
    fast.sort(key=lambda r: -r.speed.share if r.speed is not None else 0.0)
    too_fast = [f"{r.name} ({_speed(r.speed)})" for r in fast if r.speed is not None]
    return [f"At the task's feed joints were too fast in {_listed(too_fast)}."]


def _task(runs: Sequence[Run]) -> list[str]:
    said = []
    off = [r for r in runs if not r.on_path]
    tolerance = f"{_MORE_MM * TASK_MET_M:g} mm and {_digits(_MORE_DEG * TASK_MET_RAD)}°"
    if not off:
        said.append(f"Every waypoint was met by {_either(len(runs), 'it', 'all')} to {tolerance}.")
    elif len(off) == len(runs):
        said.append(f"No method met every waypoint to {tolerance}.")
    if off:
        off.sort(key=lambda r: -r.numbers["position_error_max_m"])
        errors = _listed([f"{r.name} (by up to {_error(r)})" for r in off])
        said.append(f"Off the path by more than {tolerance} at some waypoint: {errors}.")
    ended = [r for r in runs if r.reached < r.waypoints]
    if ended:
        where = _listed([f"{r.name} at waypoint {r.reached}" for r in ended])
        said.append(f"Stopped before the end, of {runs[0].waypoints} waypoints: {where}.")
    left = [r for r in runs if r.numbers.get("band_excess_max", 0.0) > BAND_LEFT]
    if left:
        said.append(
            f"Outside a tolerance band at some waypoint: {_listed([r.name for r in left])}."
        )
    return said


def _best(runs: Sequence[Run], bound: float | None) -> list[str]:
    if len(runs) < 2 or all(r.numbers["min_margin"] is None for r in runs):
        return []
    kept = sorted((r for r in runs if not r.faults), key=lambda r: float(r.numbers["mean_z"]))
    if not kept:
        return ["No method kept limits and task all the way, so that none can be called best in z."]
    best = kept[0]
    z = best.numbers["mean_z"]
    text = (
        f"Of the {_either(len(kept), 'one method', f'{_number(len(kept))} methods')} that kept "
        f"limits and task, {best.name} has the lowest mean z, {_digits(z)}"
    )
    if bound is not None and bound > 0.0:
        text += (
            f": {z / bound:.3g} times the bound {_digits(bound)} that no motion from that start "
        )
        text += "can be below"
    if len(kept) > 1:
        second = kept[1]
        ratio = _ratio(second.numbers["mean_z"], z)
        where = "at the same value" if ratio < 1.0 + _ALIKE else f"at {ratio:.4g} times its value"
        text += f"; next is {second.name}, {where}"
    said = [text + "."]
    if len(kept) > 1:
        said.append(_cost(best, kept))
    lower = [r for r in runs if r.faults and r.numbers["mean_z"] < z * (1.0 - _ALIKE)]
    if lower:
        reasons = [f"{r.name} ({_digits(r.numbers['mean_z'])}) {_listed(r.faults)}" for r in lower]
        said.append(f"A lower mean z came with a fault: {'; '.join(reasons)}.")
    return said


def _cost(best: Run, kept: Sequence[Run]) -> str:
    """What the best z was paid with: travel, time and error beside the least of those that kept."""
    parts = []
    for key, what, unit in (
        ("travel_deg", "travels", "°"), ("time_per_waypoint_us", "takes", " µs a waypoint"),
    ):  # fmt: skip
        least = min(kept, key=lambda r: float(r.numbers[key]))
        mine, theirs = best.numbers[key], least.numbers[key]
        text = f"{what} {mine:.0f}{unit}"
        if least is best:
            text += ", the least"
        elif theirs > 0.0:
            text += f", {_times(mine, theirs)} the least ({least.name})"
        parts.append(text)
    return f"It {', and '.join(parts)}; its error is at most {_error(best)}."


def _pairs(runs: Sequence[Run]) -> list[str]:
    ran = {r.name: r for r in runs}
    said = []
    for run in runs:
        method = METHODS[run.name]
        if method.constrained or method.counterpart not in ran:
            continue
        said.append(_pair(run, ran[method.counterpart]))
    if said:
        said.append(
            f"“As good” means: limits and task kept, mean z and travel no more than "
            f"{100 * AS_GOOD:g} % above. Times are wall times of one run on one machine."
        )
    return said


def _pair(closed: Run, qp: Run) -> str:
    """How a closed form, or another library's step, did beside its QP."""
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
    z = _ratio(closed.numbers["mean_z"], qp.numbers["mean_z"])
    travel = _ratio(closed.numbers["travel_deg"], qp.numbers["travel_deg"])
    low, high = 1.0 / (1.0 + AS_GOOD), 1.0 + AS_GOOD
    amounts = f"mean z {_share(z)}, travel {_share(travel)}, time "
    amounts += _share(
        _ratio(closed.numbers["time_per_waypoint_us"], qp.numbers["time_per_waypoint_us"])
    )
    if max(z, travel) <= high:
        verdict = "was better than" if min(z, travel) < low else "was as good as"
    elif min(z, travel) < low:
        verdict = "traded one thing for another beside"
    else:
        verdict = "kept limits and task, but was not as good as"
    return f"{closed.name} {verdict} {qp.name}: {amounts} of the QP's."


def _first_violation(run: Run) -> tuple[str, int]:
    joint, waypoint = min(run.numbers["first_violation"].items(), key=lambda item: item[1])
    return str(joint), int(waypoint)


def _error(run: Run) -> str:
    """The largest errors; the angular one only where there is one."""
    text = f"{_digits(_MORE_MM * run.numbers['position_error_max_m'])} mm"
    angle = run.numbers["axis_error_max_rad"]
    return text + (f" and {_digits(_MORE_DEG * angle)}°" if angle > 0.0 else "")


def _speed(speed: PeakSpeed) -> str:
    times = f"{speed.share:.3g}" if speed.share >= 1.005 else f"{speed.share:.6g}"
    return f"{speed.joint} at {times} times its speed limit at waypoint {speed.waypoint}"


def _ratio(value: float, other: float) -> float:
    """``value / other``, and 1 where both are nothing."""
    if abs(value - other) <= 1e-12:
        return 1.0
    return value / other if other else math.inf


def _share(ratio: float) -> str:
    return (
        f"{100.0 * ratio:.0f} %" if ratio < 10.0 else f"{ratio:.0f} times" if ratio < 1e6 else "∞"
    )


def _times(value: float, least: float) -> str:
    ratio = _ratio(value, least)
    return "the same as" if abs(ratio - 1.0) < _ALIKE else f"{ratio:.3g} times"


def _margin(margin: float | None) -> str:
    if margin is None:
        return "–"
    return f"{max(margin, 0.0):.3f}"


def _digits(value: float) -> str:
    """Three significant digits, without a power of ten where one is not needed."""
    if value == 0.0:
        return "0"
    if 1e-4 <= abs(value) < 1e5:
        return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"
    return f"{value:.1e}"


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
