"""``qp-twist roadmap``."""

from __future__ import annotations

from pathlib import Path

from qp_twist.cli import app as cli
from qp_twist.cli.path_tasks import load, method_names
from qp_twist.cli.progress import method_progress, working
from qp_twist.comparison import compare as compare_methods
from qp_twist.errors import InvalidInput


@cli.command
def roadmap(
    task: cli.Task,
    methods: cli.Names = None,
    solver: cli.Solver = None,
    out: cli.OptionalFile = None,
    json_: cli.Json = False,
) -> None:
    """Draw the feasible free motion along the path, with the motions of the methods over it.

    For six hinges with a closed form and a free roll: the margin over waypoint and roll, one panel
    per branch. For a planar arm with one free degree of freedom: its self-motion manifolds, joint
    by joint.

    Args:
        out: PNG file to write; if omitted, out/TASK/roadmap.png.
    """
    from qp_twist.drawing.figures import save_figure  # with matplotlib
    from qp_twist.pages.roadmap import check_applies, roadmap_figure

    path_task = load(task)
    names = method_names(path_task, methods)
    target = out or Path("out") / path_task.name / "roadmap.png"
    check_applies(path_task)
    cli.check_file(target)
    if target.suffix.lower() != ".png":
        raise InvalidInput(f"--out {target}: expected a file that ends in .png.")
    with method_progress(names, len(path_task.waypoints) - 1) as progress:
        comparison = compare_methods(
            path_task, names, solver=solver, progress=progress.done, planning=progress.planning
        )
    with working("evaluating the roadmap"):
        save_figure(roadmap_figure(path_task, comparison.trajectories), target)
    if not json_:
        cli.say(f"wrote {target}")
        return
    cli.show_json({"file": str(target), **comparison.to_dict()})
