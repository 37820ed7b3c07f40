"""The speed of the tool along its path against the programmed one: ramps, and dips with causes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.paths import PathTask, Tolerances, in_joint_moves
from qp_twist.paths.toolpath import SAME_POINT
from qp_twist.referee.findings import Finding, Passing, acceleration_use, jerk_use, velocity_use
from qp_twist.referee.joint_motion import JointMotion
from qp_twist.referee.motion_limits import MotionLimits
from qp_twist.referee.path_errors import task_errors

AT_SPEED = 0.98
"""Share of the programmed speed from which the tool counts as at speed: as a check allows the feed
where times are searched, for chords between points and the digits of programs."""
DIP = "dip of the tool's speed"
"""Name of the finding."""
_STEP = 2e-3
"""Largest time between two instants looked at, s: shorter than a controller's period."""
_RISES, _WITHIN = 0.01, 0.05
"""A ramp goes on while the share rises by at least the first within the second, s, in which full
acceleration is there by default. Slower ones hold a speed: they are dips."""
_SAME = 1.1
"""Ratio up to which two programmed speeds count as one."""
_TIGHT = 0.98
"""A limit holds the tool back where this share of it is used."""
_LISTED = 8
"""Most dips that notes list."""
_NAMED = 3
"""Most limits that a dip names."""
_REST = 1e-6
"""The robot rests where all joints are slower, rad/s or m/s."""
_OFF = Tolerances()
"""What the tool may be off."""
CORNER = float(np.radians(10.0))
"""Turn of the path's direction at a point from which it counts as a corner, rad: a tool at 50 mm/s
turns by 9 mm/s there, within some milliseconds."""


class Dip(NamedTuple):
    """A stretch on which the tool is slower than programmed, but for ramps at its ends.

    Attributes:
        first: Waypoint before it, from 1.
        last: Waypoint after it.
        lowest: Waypoint nearest to its lowest speed.
        line: Line of the toolpath file there; ``None`` without a file.
        share: Lowest speed as a share of the programmed one.
        programmed: That speed, m/s; 0 where the tool turns in place.
        seconds: How long it lasts.
        length: Of the path on it, m.
        causes: The limits that are used up, each with its joint, the longest used first, and stops
            and corners; else the most used one with its share.
    """

    first: int
    last: int
    lowest: int
    line: int | None
    share: float
    programmed: float
    seconds: float
    length: float
    causes: tuple[str, ...]

    def __str__(self) -> str:
        """A sentence: why, where, how deep, how long."""
        line = "" if self.line is None else f" (line {self.line})"
        speed = f" of {1e3 * self.programmed:.4g} mm/s" if self.programmed else ""
        return (
            f"{' and '.join(self.causes)}, waypoints {self.first} to {self.last}: down to "
            f"{100.0 * self.share:.2g} %{speed} at waypoint {self.lowest}{line}, "
            f"{self.seconds:.2g} s, {1e3 * self.length:.3g} mm"
        )


@dataclass(frozen=True, eq=False)
class ToolSpeed:
    """The tool's speed along the path, from the motion and the task alone.

    Attributes:
        times: Instants on the path, s, (K,), none of them in a joint move.
        spans: Time that each stands for, s, (K,).
        speed: Of the tool, m/s, (K,).
        programmed: The task's, m/s, (K,); 0 where the tool turns in place.
        share: The speed, or where it turns in place the rate of turning, over the task's, (K,).
        dips: In the order of the path.
        ramps: How many ramps there are at ends of curves, lift-offs and changes of the feed.
        ramp_seconds: How long they take together, s.
        ramp_length: The longest, m.
    """

    times: Array
    spans: Array
    speed: Array
    programmed: Array
    share: Array
    dips: tuple[Dip, ...]
    ramps: int
    ramp_seconds: float
    ramp_length: float

    @property
    def at_speed(self) -> float:
        """Share of the path's length, joint moves excepted, at the programmed speed."""
        way = self.speed * self.spans
        whole = float(way.sum())
        return float(way[self.share >= AT_SPEED].sum()) / whole if whole else 1.0

    @property
    def whole(self) -> str:
        """A sentence on the share of the path at speed, and on the ramps."""
        between = "" if self.dips else ", and there is no dip between them"
        fastest = float(self.share.max())
        over = f", at most {100.0 * fastest:.4g} % of it" if fastest > 2.0 - AT_SPEED else ""
        return (
            f"the tool has its programmed speed on {100.0 * self.at_speed:.4g} % of the path"
            f"{over}; "
            f"{self.ramps} ramps at ends of curves, lift-offs and changes of speed take "
            f"{self.ramp_seconds:.2g} s, the longest {1e3 * self.ramp_length:.3g} mm{between}"
        )

    @property
    def longest_dips(self) -> list[Dip]:
        """The dips, the longest first."""
        return sorted(self.dips, key=lambda dip: -dip.seconds)

    @property
    def sentences(self) -> list[str]:
        """What a person has to know: the share at speed with the ramps, then the longest dips."""
        more = len(self.dips) - _LISTED
        listed = [f"dip: {dip}" for dip in sorted(self.longest_dips[:_LISTED])]
        return [
            self.whole,
            *listed,
            *([f"{more} more dips, all of them shorter"] if more > 0 else []),
        ]

    def to_dict(self) -> dict[str, Any]:
        """What was found, ready for JSON."""
        return {
            "share_at_speed": self.at_speed,
            "ramps": self.ramps,
            "ramp_seconds": self.ramp_seconds,
            "dips": [{**dip._asdict(), "causes": list(dip.causes)} for dip in self.dips],
        }

    def finding(self, max_dip: float | None) -> Finding:
        """The deepest dip in percent of the programmed speed, against the largest that passes."""
        deepest = min(self.dips, key=lambda dip: dip.share, default=None)
        depth = 0.0 if deepest is None else 1.0 - deepest.share
        where = "the whole path"
        if deepest is not None:
            where = f"waypoint {deepest.lowest}, {' and '.join(deepest.causes)}"
        limit = None if max_dip is None else 100.0 * max_dip
        passes = max_dip is None or depth <= max_dip
        return Finding(DIP, 100.0 * depth, limit, "%", where, passes)


def tool_speed(
    path_task: PathTask, motion: JointMotion, passing: Passing, limits: MotionLimits,
    stops: Array | None = None,
) -> ToolSpeed | None:  # fmt: skip
    r"""The tool's speed on a motion, and where it is below the programmed one.

    Between two waypoints the task states the speed :math:`\|\Delta\mathbf p\|/\delta t` of the
    frame's origin, in the linear rows of T; where these do not move, the rate of turning. The
    motion has :math:`\|\mathbf J\dot{\mathbf q}\|` in the same rows, at instants at most 2 ms
    apart, none of them a row, at which a velocity may jump. Below 98 % of the task's the tool is
    slow. From the ends of curves, from rests of parts (approach, contact, retreat, transfer) and
    from changes of the feed on, a stretch is a ramp while the share rises away from them by 1 %
    in 50 ms and no joint has used up its speed limit; what else is slow is a dip.

    Args:
        path_task: The task.
        motion: Of its joints.
        passing: When it passes the waypoints.
        limits: Of the joints, to name causes.
        stops: Times at which a controller with ramps of its own comes to rest, which the motion
            does not show, s; the tool is slow at the instants beside them.

    Returns:
        ``None`` if the task has no feed or the motion no times, or it passes no path in time.
    """
    at = passing.times
    if path_task.durations is None or not passing.timed or len(at) < 2:
        return None
    times, spans = _instants(motion, float(at[0]), float(at[-1]))
    piece = np.clip(np.searchsorted(at, times, side="right") - 1, 0, len(at) - 2)
    on_path = ~in_joint_moves(path_task, len(at))[piece]
    times, spans, piece = times[on_path], spans[on_path], piece[on_path]
    if not len(times):
        return None
    of_path, turning = programmed_rates(path_task, len(at))
    state = motion.at(times)
    linear, angular = _rates(path_task, state.q, state.velocities, piece + 1)
    share = _shares(linear, angular, of_path[piece], turning[piece])
    share[(of_path[piece] <= 0.0) & (turning[piece] <= 0.0)] = 1.0
    stops = np.zeros(0) if stops is None else stops[(stops >= times[0]) & (stops <= times[-1])]
    after = np.searchsorted(times, stops)
    stands = np.isin(np.arange(len(times)), [np.maximum(after - 1, 0), after])
    share[stands] = 0.0
    found: list[Dip] = []
    ramps, seconds, longest = 0, 0.0, 0.0
    run = np.cumsum(np.append(True, _begins(path_task, of_path)))[piece]
    rows = np.clip(np.searchsorted(motion.times, times) - 1, 0, len(motion.times) - 2)
    held = np.diff(motion.times)[rows] * (motion.degree == 1)
    speeds = np.abs(state.velocities)
    spent: Mask = np.any(speeds >= _TIGHT * limits.velocity, axis=1)
    slow = _joined(share < AT_SPEED, run, times)
    edges = np.flatnonzero(np.diff(slow.astype(np.int8)) | (np.diff(run) != 0)) + 1
    for part in np.split(np.arange(len(times)), edges):
        if not slow[part[0]]:
            continue
        ends = [
            part[0] == 0 or run[part[0] - 1] != run[part[0]],
            part[-1] == len(times) - 1 or run[part[-1] + 1] != run[part[-1]],
        ]
        up, down = _ramps(
            times[part], share[part], held[part], spent[part], stands[part],
            begins=ends[0], ends=ends[1],
        )  # fmt: skip
        for ramp in (part[:up], part[down:]):
            if len(ramp):
                ramps += 1
                seconds += float(spans[ramp].sum())
                longest = max(longest, float((linear * spans)[ramp].sum()))
        if up < down:
            dip = part[up:down]
            k = int(dip[np.argmin(share[dip])])
            begin, end = times[dip[0]] - 0.5 * spans[dip[0]], times[dip[-1]] + 0.5 * spans[dip[-1]]
            near = int(np.argmin(np.abs(at - times[k])))
            stopped = bool(((stops >= begin) & (stops <= end)).any())
            why = causes(path_task, motion, limits, begin, end, stopped=stopped)
            found.append(Dip(
                int(piece[dip[0]]) + 1, int(piece[dip[-1]]) + 2, near + 1,
                None if path_task.lines is None else int(path_task.lines[near]),
                float(share[k]), float(of_path[piece[k]]), float(spans[dip].sum()),
                float((linear * spans)[dip].sum()),
                (*_corner(path_task, at, begin, end), *why),
            ))  # fmt: skip
    programmed = of_path[piece]
    return ToolSpeed(times, spans, linear, programmed, share, tuple(found), ramps, seconds, longest)


def feed_shares(path_task: PathTask, q: Array, velocities: Array, waypoints: Indices) -> Array:
    """Speed of the tool, or its rate of turning in place, over the task's, (K,).

    Of configurations and joint velocities (K, nv) on the way to these waypoints (K,), from 0; 0
    where the task states no speed, as in joint moves.
    """
    linear, angular = _rates(path_task, q, velocities, waypoints)
    of_path, turning = (rate[waypoints - 1] for rate in programmed_rates(path_task))
    moves = in_joint_moves(path_task, len(path_task.waypoints))[waypoints - 1]
    return np.where(moves, 0.0, _shares(linear, angular, of_path, turning))


def _shares(linear: Array, angular: Array, of_path: Array, turning: Array) -> Array:
    """Speeds over the programmed ones, or rates of turning where those are 0; 0 where both are."""
    asked = np.where(of_path > 0.0, of_path, turning)
    return np.where(of_path > 0.0, linear, angular) / np.where(asked > 0.0, asked, np.inf)


def _instants(motion: JointMotion, begin: float, end: float) -> tuple[Array, Array]:
    """Middles of equal parts of the pieces between rows, from ``begin`` to ``end``, and lengths."""
    edges = np.unique(np.clip(motion.times, begin, end))
    counts = np.maximum(np.ceil(np.diff(edges) / _STEP).astype(np.intp), 2)
    spans = np.repeat(np.diff(edges) / counts, counts)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    inside = np.arange(len(spans)) - first + 0.5
    return np.repeat(edges[:-1], counts) + inside * spans, spans


def _rates(
    path_task: PathTask, q: Array, velocities: Array, waypoints: Indices
) -> tuple[Array, Array]:
    """‖v‖ and ‖ω‖ of the frame in the rows in force at waypoints, m/s and rad/s, (K,) each."""
    chain = SerialChain.of(path_task.model, path_task.frame_name, path_task.frame_type)
    R, _, J = chain.poses_and_jacobians(q)
    twists = np.einsum("kij,kj->ki", J, velocities)
    found = np.zeros((len(q), 2))
    targets, held = path_task.poses[0], path_task.in_force
    ids = np.array([id(projector) for projector in held])[waypoints]
    for projector in {id(t): t for t in held}.values():
        here = np.flatnonzero(ids == id(projector))
        axes = {"body": R[here], "target": targets[waypoints[here]]}.get(projector.frame)
        for k, block in enumerate((projector.linear, projector.angular)):
            part = twists[here, 3 * k : 3 * k + 3]
            part = part if axes is None else np.einsum("kji,kj->ki", axes, part)
            found[here, k] = np.linalg.norm(part @ block.basis, axis=1)
    return found[:, 0], found[:, 1]


def programmed_rates(path_task: PathTask, count: int | None = None) -> tuple[Array, Array]:
    """Speed and rate of turning that the task states before each waypoint but the first.

    The speed is 0 where the tool turns in place: it moves by less than a check lets it be off, and,
    in terms of what passes, turns by more. The speed of so short a way would be that of its errors.
    """
    assert path_task.durations is not None
    (R, p), count = path_task.poses, count or len(path_task.waypoints)
    T = path_task.durations[1:count]
    steps = task_errors(
        R[: count - 1], p[: count - 1], R[1:count], p[1:count], path_task.in_force[1:count]
    )
    moved, turned = np.linalg.norm(steps.reshape(-1, 2, 3), axis=2).T
    rate = np.divide(1.0, T, out=np.zeros_like(T), where=T > 0.0)
    stands = (moved < _OFF.position) & (moved / _OFF.position < turned / _OFF.axis)
    moved = np.where((moved < SAME_POINT) | stands, 0.0, moved)
    return moved * rate, turned * rate


def _begins(path_task: PathTask, of_path: Array) -> Mask:
    """Before which intervals but the first the tool may be slower, since another part begins."""
    before, after = of_path[:-1], of_path[1:]
    changed = np.maximum(before, after) > _SAME * np.minimum(before, after)
    changed &= (before > 0.0) & (after > 0.0)
    ways = np.array(path_task.ways[: len(of_path)])
    changed |= ways[:-1] != ways[1:]
    return changed


def _joined(slow: Mask, run: Indices, times: Array) -> Mask:
    """The slow instants (K,), with what is at speed between two of them for a moment only."""
    found = slow.copy()
    at = np.flatnonzero(slow)
    for a, b in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
        if b > a + 1 and times[b] - times[a] < _WITHIN and run[a] == run[b]:
            found[a:b] = True
    return found


def _ramps(
    times: Array, share: Array, held: Array, spent: Mask, stands: Mask, *, begins: bool, ends: bool
) -> tuple[int, int]:
    """Where the ramp at the begin of a slow stretch ends, and where that at its end begins.

    ``held`` (K,) is the time for which the joints keep their speeds at each instant, s; where a
    joint has ``spent`` (K,) its speed limit, or the tool ``stands`` (K,) behind where it has moved,
    it is not on its way to a higher speed.
    """
    count, within = len(times), _WITHIN + held

    def rising(t: Array, x: Array, places: slice) -> int:
        t, x, later = t[places], x[places], t[places] + within[places]
        again = stands[places] & np.logical_or.accumulate(~stands[places])
        stays = (np.interp(later, t, x) - x < _RISES) & (later <= t[-1]) | spent[places] | again
        return int(np.argmax(stays)) if stays.any() else len(t)

    top = int(np.argmax(share)) if begins and ends else count
    up = rising(times, share, slice(0, top + 1)) if begins else 0
    down = count
    if ends:
        last = top - 1 if begins and top > 0 else None
        down -= rising(-times, share, slice(None, last, -1))
    return min(up, count), max(down, 0)


def turns_of(positions: Array) -> Array:
    """Turn of the path's direction at each of its points (N, 3) but the ends, rad, (N − 2,)."""
    steps = np.diff(positions, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    units = steps / np.where(lengths > SAME_POINT, lengths, np.inf)[:, None]
    known = (lengths[:-1] > SAME_POINT) & (lengths[1:] > SAME_POINT)
    cosines = np.where(known, (units[:-1] * units[1:]).sum(axis=1), 1.0)
    return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)))


def _corner(path_task: PathTask, at: Array, begin: float, end: float) -> list[str]:
    """The sharpest corner of the path between two times, s."""
    turns = turns_of(path_task.positions[: len(at)])
    turns[(at[1:-1] < begin) | (at[1:-1] > end)] = 0.0
    if turns.max(initial=0.0) < CORNER:
        return []
    k = int(np.argmax(turns))
    return [f"a corner of {np.degrees(turns[k]):.3g}° at waypoint {k + 2}"]


def causes(
    path_task: PathTask, motion: JointMotion, limits: MotionLimits, begin: float, end: float, *,
    stopped: bool = False,
) -> list[str]:  # fmt: skip
    """The limits that are used up between two times, s, the longest used one first, and stops.

    If none is, the times of the rows are what slows the tool: that is said, with the most used
    limit and its share.
    """
    names = JointRanges.of(path_task.model).names
    spent: dict[str, float] = {}
    most = 0.0, ""
    for kind, of_joints, use in (
        ("speed", limits.velocity, velocity_use),
        ("acceleration", limits.acceleration, acceleration_use),
        ("jerk", limits.jerk, jerk_use),
    ):
        shares = use(motion, of_joints)[1] if np.isfinite(of_joints).any() else of_joints[:0]
        if not len(shares):
            continue
        opens, closes = motion.times[:-1], motion.times[1:]
        if len(shares) != len(opens):  # at the rows between the pieces
            opens = closes = motion.times[1:-1]
        here = (opens < end) & (closes > begin)
        if not here.any():
            continue
        shares = shares[here]
        joint = int(np.argmax(shares.max(axis=0)))
        most = max(most, (float(shares[:, joint].max()), f"{names[joint]}'s {kind}"))
        lasting = np.maximum((closes - opens)[here], _REST)
        for dof in np.flatnonzero((shares >= _TIGHT).any(axis=0)):
            spent[f"{names[dof]}'s {kind}"] = float(lasting[shares[:, dof] >= _TIGHT].sum())
    found = sorted(spent, key=lambda cause: -spent[cause])[:_NAMED]
    if motion.velocities is not None:
        rests = (np.abs(motion.velocities) < _REST).all(axis=1)
        stopped |= bool((rests & (motion.times > begin) & (motion.times < end)).any())
    if stopped:
        found.append("a stop")
    if not found and most[0] > 0.0:
        found = [f"no joint's limit ({most[1]} is used to {100.0 * most[0]:.2g} %)"]
    return found
