"""Certificate of a search: why there is a plan, or none."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from qp_twist.planning.graph import LayerPath
from qp_twist.planning.hard_constraints import WITHIN
from qp_twist.planning.levels import Grid, Level
from qp_twist.planning.problem import OF_PATH, JudgedPath, Problem
from qp_twist.planning.sentence import UNSAID, Sentence

CLOSE = tuple((np.arange(1, 16) / 16.0).tolist())
"""Shares of an interval at which edges are evaluated where something was met between others."""
_SHOWN = 8


@dataclass(frozen=True)
class Certificate:
    """What a search has proven or found.

    Attributes:
        kind: ``"path"``: there is a motion; ``"unreachable"``, ``"limits"`` and ``"band"``:
            waypoints that the arm does not reach, or with no configuration inside the joint limits,
            or inside both these and the hard bands and constraints; ``"speed"``: two waypoints
            between which every connection that was searched breaks the speed limits or the largest
            step; ``"move"``: two between which no joint move was found, which is no proof. With a
            detail, it names only what the best motion found violates, which is no proof either.
        waypoints: The waypoints concerned, counted from 1; of those that are out of reach or
            outside the limits only such as were looked at, of which a note has the number.
        joints: The joints whose limits exclude a motion.
        grid: The grid that was searched.
        covered: Whether the layers contain all configurations to the grid's spacing. They do not
            where the task leaves more than two degrees free, nor where hard constraints cut the
            nets of self-motion manifolds into pieces; "none" then means "none was found".
        detail: How close the search came, if the grid has a motion but no correction brings it
            inside the limits; of a waypoint out of reach, by how much it is missed.
        bands: The hard bands and the constraints that exclude a motion, by number and repr.
        slower: How many times slower the path has a motion, if only its speed prevents one; of a
            motion that is slower somewhere, the largest factor; NaN if there is none.
        note: What else is known, in words: about slower motions, or what the task prescribes.
        step_limit: What limits the steps between waypoints, in words.
        at_other_speed: Why there is no motion at another speed: at the feed where there is a slower
            one, otherwise a slower one; ``None`` if none was searched.
    """

    kind: Literal["path", "unreachable", "limits", "band", "speed", "move"]
    grid: Grid
    waypoints: tuple[int, ...] = ()
    joints: tuple[str, ...] = ()
    covered: bool = True
    detail: Sentence = UNSAID
    bands: tuple[str, ...] = ()
    slower: float = math.nan
    note: Sentence = UNSAID
    step_limit: str = "the speed limits"
    at_other_speed: Certificate | None = None

    def __str__(self) -> str:
        return self.reason + "."

    @property
    def reason(self) -> str:
        """The certificate in words, without a full stop."""
        where = _listed(self.waypoints)
        joints, bands = " and ".join(self.joints), " and ".join(self.bands[:_SHOWN])
        bands += f" and {len(self.bands) - _SHOWN} more" if len(self.bands) > _SHOWN else ""
        match self.kind, bool(self.detail):
            case "path", _:
                kinds = dict.fromkeys(re.split(r"[,\[]", name)[0] for name in self.bands)
                text = "there is a motion inside all limits"
                text += "".join(f" and {'hard bands' if k == 'bands' else k}" for k in kinds)
                text += " that is slower than the feed" if self.slower > 1.0 else ""
            case "unreachable", _:
                text = f"the arm does not reach {where} in any configuration"
            case "limits", True:
                text = "no motion was found inside the joint limits"
            case "limits", False:
                text = f"no configuration at {where} is inside the limits"
                text += f"; forbidden by {joints}" if joints else ""
            case "band", True:
                text = f"no motion was found that keeps {bands}"
            case "band", False:
                text = f"no configuration at {where} is inside both the joint limits and {bands}"
            case "speed", True:
                text = f"no motion was found that keeps {self.step_limit}"
            case "speed", False if self.covered:
                text = f"between {where} every connection breaks {self.step_limit}"
                text += f", of {joints} at least" if joints else ""
            case "speed", False:
                text = f"between {where} no connection was found that keeps {self.step_limit}"
            case _:
                text = f"between {where} no joint move was found"
        text += f" ({self.grid})"
        text += "".join(f"; {part}" for part in (self.detail, self.note) if part)
        if self.at_other_speed is not None:
            at_feed = self.kind == "path"
            text += "; at the feed, " if at_feed else "; nor was one found that is slower: "
            text += self.at_other_speed.reason
        if not self.covered:
            text += "; not all configurations were looked at: this is no proof"
        return text

    def later(self, by: int) -> Certificate:
        """That of the same path as a part of one with so many waypoints before."""
        other = self.at_other_speed
        return replace(
            self, waypoints=tuple(k + by for k in self.waypoints), detail=self.detail.later(by),
            note=self.note.later(by), at_other_speed=other and other.later(by),
        )  # fmt: skip


def _listed(waypoints: tuple[int, ...]) -> str:
    if len(waypoints) == 1:
        return f"waypoint {waypoints[0]}"
    shown = ", ".join(str(w) for w in waypoints[:_SHOWN])
    more = f" and {len(waypoints) - _SHOWN} more" if len(waypoints) > _SHOWN else ""
    if len(waypoints) == 2:
        shown = f"{waypoints[0]} and {waypoints[1]}"
    return f"waypoints {shown}{more}"


def empty_layers(level: Level, covered: bool) -> Certificate:
    """Waypoints out of reach; if none, those outside the limits, or else outside the bands."""
    roadmap, grid = level.roadmap, level.grid
    pairs = list(zip(level.waypoints, level.layers, strict=True))
    unreached = [index for index, layer in pairs if layer.solutions == 0]
    sampled = all(roadmap.samples_all(index) for index in level.waypoints)
    seen, count = len(level.waypoints), len(roadmap.path_task.waypoints)
    note = Sentence("" if seen == count else f"{seen} of {count} waypoints were looked at")
    if unreached:
        at = tuple(index + 1 for index in unreached)
        missed = roadmap.missed(unreached)
        return Certificate("unreachable", grid, at, (), sampled, missed, note=note)
    outside = [(index + 1, layer.outside) for index, layer in pairs if layer.outside]
    if outside:
        joints = tuple(dict.fromkeys(name for _, names in outside for name in names))
        at = tuple(at for at, _ in outside)
        return Certificate("limits", grid, at, joints, sampled, note=note)
    barred = [(index, layer.bands) for index, layer in pairs if not len(layer.q)]
    names = tuple(dict.fromkeys(name for _, bands in barred for name in bands))
    proven = covered and all(roadmap.covers(index) for index, _ in barred)
    at = tuple(k + 1 for k, _ in barred)
    return Certificate("band", grid, at, (), proven, bands=names, note=note)


def ended_path(problem: Problem, level: Level, way: LayerPath, covered: bool) -> Certificate:
    """The constraints that block the motion between the last layer of a path and the next."""
    ended = max(len(way.nodes), 1)
    before, after = level.waypoints[ended - 1], level.waypoints[ended]
    at = before + 1, after + 1
    here, there = level.layers[ended - 1].q[way.nodes[-1]], level.layers[ended].q
    apart = problem.unwound(there - here)
    share = np.abs(apart) / problem.limits.steps[before:after].sum(axis=0)
    best = int(np.argmin(share.max(axis=1)))
    names: tuple[str, ...] = ()
    hard = problem.rows.hard
    if share[best].max() <= 1.0 and hard and after == before + 1:
        # The speed limits allow a connection, bands or constraints do not.
        shares = np.array((0.0, *CLOSE, 1.0))
        begin, end = (np.tile(q, (len(shares), 1)) for q in (here, here + apart[best]))
        margins = hard.margins_between(begin, end, np.full(len(shares), before), shares).min(axis=0)
        names = tuple(hard.names[k] for k in np.flatnonzero(margins < -WITHIN))
    allowed = problem.limits.step_limit
    if names:
        detail = Sentence(
            "between waypoints ", at[0], " and ", at[1],
            f" no connection was found that keeps {allowed}, too",
        )  # fmt: skip
        return Certificate("band", level.grid, at, (), covered, detail, names)
    # A sampled layer may lack the configurations near this one: it says nothing about joints.
    beyond = zip(problem.limits.ranges.names, share[best], strict=True)
    joints = tuple(name for name, of_step in beyond if of_step > 1.0) if covered else ()
    return Certificate("speed", level.grid, at, joints, covered, step_limit=allowed)


def violating_path(
    problem: Problem, path: JudgedPath | None, grid: Grid, covered: bool
) -> Certificate:
    """What the best path violates that was found through a level; ``None``: it left the task."""
    allowed = problem.limits.step_limit
    if path is None:
        detail = Sentence("the grid's path leaves the task")
        return Certificate("speed", grid, (), (), covered, detail, step_limit=allowed)
    worst = problem.limits.worst(path.q)
    at = worst.waypoint + 1
    amount = amount_of(worst.excess, worst.unit)
    if worst.kind == "band":
        where: tuple[int, ...] = (at,)
        detail = Sentence("at waypoint ", at, f" the best is outside by {amount}")
        if worst.between:
            where = at - 1, at
            what = (
                ", where joints go straight, the best is outside by "
                f"{amount} more than what is allowed there; put more waypoints there"
            )
            if worst.name == OF_PATH:
                what = " the best jumps to another branch"
            detail = Sentence("between waypoints ", at - 1, " and ", at, what)
        return Certificate("band", grid, where, (), covered, detail, (worst.name,))
    if worst.kind == "position":
        detail = Sentence("at waypoint ", at, f" the best has {worst.name} outside by {amount}")
        return Certificate("limits", grid, (at,), (worst.name,), covered, detail)
    times, number, name = problem.limits.pace(path.q)
    at = number + 1
    detail = Sentence(
        "between waypoints ", at, " and ", at + 1,
        f" the best needs {times:.3g} times the step that {name} may do",
    )  # fmt: skip
    return Certificate("speed", grid, (at, at + 1), (name,), covered, detail, step_limit=allowed)


def amount_of(excess: float, unit: str) -> str:
    """A violation, rad or m, in words."""
    return f"{1e3 * excess:.3g} mm" if unit == "m" else f"{np.degrees(excess):.3g}°"
