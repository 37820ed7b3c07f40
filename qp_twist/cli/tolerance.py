"""``qp-twist tolerance``."""

from __future__ import annotations

from typing import Annotated, Literal, Optional

import numpy as np
import tyro

from qp_twist.cli import app as cli
from qp_twist.cli.path_tasks import load
from qp_twist.cli.place import corner, listed
from qp_twist.cli.progress import load_machine_code, method_progress, progress_bar
from qp_twist.following import follow
from qp_twist.paths import DEFAULT_METHOD, check_method
from qp_twist.studies.part_tolerance import BOX, part_tolerance


@cli.command
def tolerance(
    task: cli.Task,
    method: cli.MethodName = DEFAULT_METHOD,
    box: Annotated[Optional[str], tyro.conf.arg(metavar="X,Y,Z[,RX,RY,RZ]")] = None,
    roll: Literal["free", "held"] = "free",
    samples: cli.Count = 200,
    body: Annotated[Optional[str], tyro.conf.arg(metavar="NAME")] = None,
    json_: cli.Json = False,
) -> None:
    """Say how far the part may be off until the motion along its path can no longer be run.

    The displacement is known when the path is run: measured, or a program's frame set anew. Two
    boxes of displacements are printed: one in which every placement is proven, and a larger one, of
    which random placements were tried. Speeds are not asked about: a motion takes longer.

    Args:
        method: Method name.
        box: Half-widths of a box in m, then degrees, whose multiples are asked about; if omitted,
            1 mm and 0.1° each. Without the last three the part is not turned.
        roll: free: the joints follow the task's own rows, as when it is run again; held: they keep
            the motion's poses, as a program of poses does.
        samples: Number of random placements, all of which must be kept.
        body: Body of the scene that moves with the part; if omitted, that of [study.placement].
    """
    widths = np.array(BOX) if box is None else corner("--box", box)
    path_task = load(task)
    cli.only_json(json_)
    load_machine_code(path_task, [check_method(method)], None)
    with method_progress([method], len(path_task.waypoints) - 1) as progress:
        run = follow(
            path_task,
            method,
            progress=lambda waypoints: progress.done(method, waypoints),
            planning=progress.planning,
        )
    with progress_bar(1.0) as report:
        found = part_tolerance(
            run, widths, roll=roll, samples=samples, body=body,
            progress=lambda what, share: report(share, what),
        )  # fmt: skip
    cli.say(f"{path_task.name} by {method}, about {listed(found.about, 4)} m", str(found))
    if json_:
        cli.show_json({"task": path_task.name, "method": method, **found.to_dict()})
