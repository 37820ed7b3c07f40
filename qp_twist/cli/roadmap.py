"""``qp-twist roadmap``."""

from __future__ import annotations

import json
from pathlib import Path

from qp_twist.cli.app import Json, Names, OptionalFile, Solver, Task, app, check_file, say
from qp_twist.cli.path_tasks import load, method_names
from qp_twist.cli.progress import method_progress, working
from qp_twist.comparison import compare as compare_methods
from qp_twist.errors import InvalidInput


@app.command
def roadmap(
    task: Task,
    methods: Names = None,
    solver: Solver = None,
    out: OptionalFile = None,
    json_: Json = False,
) -> None:
    """Draw the feasible free motion along the path, with the motions of the methods over it.

    For six hinges with a closed form and a free roll: the margin over waypoint and roll, one panel
    per branch. For a planar arm with one free degree of freedom: its self-motion manifolds, joint
    by joint.

    Args:
        task: Name of a shipped task, or path to a .toml file.
        methods: Method names separated by commas; if omitted, all applicable ones.
        solver: Backend of the QPs; if omitted, machine code.
        out: PNG file to write; if omitted, out/TASK/roadmap.png.
        json_: Print the file and the numbers of the methods over it as JSON.
    """
    from qp_twist.drawing.figures import save_figure  # with matplotlib
    from qp_twist.pages.roadmap import check_applies, roadmap_figure

    path_task = load(task)
    names = method_names(path_task, methods)
    target = out or Path("out") / path_task.name / "roadmap.png"
    check_applies(path_task)
    check_file(target)
    if target.suffix.lower() != ".png":
        raise InvalidInput(f"--out {target}: expected a file that ends in .png.")
    with method_progress(names, len(path_task.waypoints) - 1) as progress:
        comparison = compare_methods(
            path_task, names, solver=solver, progress=progress.done, planning=progress.planning
        )
    with working("evaluating the roadmap"):
        save_figure(roadmap_figure(path_task, comparison.trajectories), target)
    if not json_:
        say(f"wrote {target}")
        return
    print(json.dumps({"file": str(target), **comparison.to_dict()}, ensure_ascii=False, indent=2))
