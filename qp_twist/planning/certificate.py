"""Certificate of a search: why there is a plan, or none."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from qp_twist.planning.roadmap import Grid

_SHOWN = 8


@dataclass(frozen=True)
class Certificate:
    """What a search has proven or found.

    Attributes:
        kind: ``"path"``: there is a motion; ``"unreachable"``: waypoints that the arm does not
            reach; ``"limits"``: waypoints with no configuration inside the joint limits;
            ``"band"``: waypoints with no configuration inside both the joint limits and the hard
            tolerance bands and constraints; ``"speed"``: two waypoints between which every
            connection that was searched breaks the speed limits or the largest step; ``"move"``:
            two waypoints between which no joint move was found, which is no proof. With a detail,
            ``"limits"``, ``"band"`` and ``"speed"`` name only what the best motion found violates;
            this is not a proof.
        waypoints: The waypoints concerned, counted from 1; at most twelve that are out of reach or
            outside the limits.
        joints: The joints whose limits exclude a motion.
        grid: The grid that was searched.
        covered: Whether the layers contain all configurations to the grid's spacing. They do not
            where the task leaves more than two degrees free, nor where hard constraints cut the
            nets of self-motion manifolds into pieces; "none" then means "none was found".
        detail: How close the search came, if the grid has a motion but no correction brings it
            inside the limits; of a waypoint out of reach, by how much it is missed.
        bands: The hard bands and the constraints that exclude a motion, by number and repr.
        slower: How many times slower the path has a motion, if only its speed prevents one; NaN if
            none was found.
        note: What else is known, in words: about slower motions, or what the task prescribes.
        step_limit: What limits the steps between waypoints, in words.
    """

    kind: Literal["path", "unreachable", "limits", "band", "speed", "move"]
    grid: Grid
    waypoints: tuple[int, ...] = ()
    joints: tuple[str, ...] = ()
    covered: bool = True
    detail: str = ""
    bands: tuple[str, ...] = ()
    slower: float = math.nan
    note: str = ""
    step_limit: str = "the speed limits"

    def __str__(self) -> str:
        where = _listed(self.waypoints)
        joints, bands = " and ".join(self.joints), " and ".join(self.bands)
        match self.kind:
            case "path":
                text = "there is a motion inside all limits"
                kinds = dict.fromkeys(
                    name.partition(",")[0].partition("[")[0] for name in self.bands
                )
                text += "".join(f" and {'hard bands' if k == 'bands' else k}" for k in kinds)
            case "unreachable":
                text = f"the arm does not reach {where} in any configuration"
            case "limits" if self.detail:
                text = "no motion was found inside the joint limits"
            case "limits":
                text = f"no configuration at {where} is inside the limits"
                text += f"; forbidden by {joints}" if joints else ""
            case "band" if not self.detail:
                text = f"no configuration at {where} is inside both the joint limits and {bands}"
            case "band":
                text = f"no motion was found that keeps {bands}"
            case "speed" if self.detail:
                text = f"no motion was found that keeps {self.step_limit}"
            case "speed" if not self.covered:
                text = f"between {where} no connection was found that keeps {self.step_limit}"
            case "speed":
                text = f"between {where} every connection breaks {self.step_limit}"
                text += f", of {joints} at least" if joints else ""
            case "move":
                text = f"between {where} no joint move was found"
        text += f" ({self.grid})"
        text += "".join(f"; {part}" for part in (self.detail, self.note) if part)
        if not self.covered:
            text += "; not all configurations were looked at: this is no proof"
        return text + "."


def _listed(waypoints: tuple[int, ...]) -> str:
    if len(waypoints) == 1:
        return f"waypoint {waypoints[0]}"
    shown = ", ".join(str(w) for w in waypoints[:_SHOWN])
    more = f" and {len(waypoints) - _SHOWN} more" if len(waypoints) > _SHOWN else ""
    if len(waypoints) == 2:
        shown = f"{waypoints[0]} and {waypoints[1]}"
    return f"waypoints {shown}{more}"
