"""Plan a path that no single motion follows: the tool lifts off, as rarely as possible."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from qp_twist.checks import Array
from qp_twist.following.stretches import plan_stretches
from qp_twist.paths import LiftOffs, PathTask
from qp_twist.planning import Certificate, Grid, Plan
from qp_twist.planning.fewest_cuts import Cuts, FewestCuts
from qp_twist.planning.objective import Objective
from qp_twist.planning.sentence import Sentence

_ATTEMPTS = 12
"""How often the interruptions are searched again after a plan between them has failed."""


def plan_with_fewest_cuts(
    search: FewestCuts, goal: Objective, planned: Callable[[PathTask, Array | None], Plan]
) -> Plan:
    """The plan of a path with the fewest lift-offs; see :func:`qp_twist.plan`.

    Where a plan between the interruptions of the search fails, it looks at every waypoint around;
    if it already had, the path is interrupted there. Where the tool cannot lift off, or no joint
    move leads on, the path is interrupted elsewhere. ``goal`` is the stated objective, of any path:
    stretches have times and preferred poses of their own. ``planned`` plans a path from a start
    (nv,).
    """
    task, start = search.problem.path_task, search.problem.start
    known: dict[tuple[bytes, bytes | None], Plan] = {}

    def once(task: PathTask, start: Array | None) -> Plan:
        """Stretches stay as they are where others change."""
        key = task.positions.tobytes(), None if start is None else start.tobytes()
        if key not in known:
            known[key] = planned(task, start)
        return known[key]

    least: Cuts | None = None
    unfit = len(search.barred)
    for _ in range(_ATTEMPTS):
        cuts = search.found()
        if cuts is None:
            break
        if least is None or not (search.blocked or len(search.barred) > unfit):
            least = cuts  # of all motions, whatever plan fails
        lift_offs = LiftOffs.of(task, cuts.after)
        plan = plan_stretches(lift_offs.task, goal, start, once)
        if plan.q is not None:
            if not cuts.after:
                return plan
            note, own = _fewest(cuts.after, least, search.grid), plan.certificate.note
            if own:  # where it is slower than the feed, on its path with the lift-offs
                note += f"; with the waypoints of the lift-offs counted, {own}"
            return _noted(plan, note)
        if not _looks_elsewhere(search, lift_offs, plan.certificate):
            break
    plan = plan_stretches(task, goal, start, once)
    if plan.q is None and least is not None and least.after:
        plan = _noted(plan, "nor was one found that lifts the tool off")
    return plan


def _noted(plan: Plan, note: str) -> Plan:
    certificate = dataclasses.replace(plan.certificate, note=Sentence(note))
    return dataclasses.replace(plan, certificate=certificate)


def _fewest(after: tuple[int, ...], least: Cuts, grid: Grid) -> str:
    """Where the tool lifts off, and whether it could do so less often."""
    waypoints = f"waypoint{'s' if len(after) > 1 else ''} {', '.join(map(str, after))}"
    less = f"no motion lifts it off less often ({grid})"
    if len(after) > len(least.after):
        less = (
            f"no motion was found that does so less often; {len(least.after)} times may be enough"
        )
    elif not least.covered:
        less = "none was found that does so less often, which is no proof"
    return f"the tool lifts off after {waypoints}; {less}"


def _looks_elsewhere(search: FewestCuts, lift_offs: LiftOffs, why: Certificate) -> bool:
    """Have the search avoid what has failed; false if interruptions do not help there."""
    at, after = [k - 1 for k in why.waypoints], lift_offs.after
    # Of a lead, or a joint move, the interval in which the tool cannot lift off.
    ends = lift_offs.added[at] if why.kind != "move" else np.ones(len(at), dtype=bool)
    leads = {int(k) for k in lift_offs.beside[at][ends]}
    barred = {k - 1 for k in after if leads & {k - 1, k}}
    if barred:
        search.barred |= barred
        return True
    hopeless = why.kind in ("unreachable", "limits", "band") and not why.detail
    if not at or why.kind == "move" or hopeless:
        return False
    k = int(lift_offs.source[at[0]]) - (len(at) == 1 and at[0] > 0)
    if not search.look_about(k):
        search.blocked.add(k)
    return True
