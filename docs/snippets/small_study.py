"""A small study: four placements of the line for the planar arm."""

import dataclasses
import tempfile

import qp_twist as qt

line = qt.load_task("planar_line")
task = dataclasses.replace(line, waypoints=line.waypoints[::5])
with tempfile.TemporaryDirectory() as folder:
    study = qt.study(task, ["placement"], 4, ["minimum_norm", "qp_gradient"], out=folder)
    print(study.text())

    table = study.table(["method", "success", "fault", "joint", "waypoint"])
    failed = table["success"].index(False)
    print({name: column[failed] for name, column in table.items()})

    sample = study.sample(3)
    print(sample)
    trajectory = qt.follow(sample.path_task, "qp_gradient")
    print(f"{len(trajectory.q)} waypoints, smallest margin {trajectory.margins.min():.3f}")
