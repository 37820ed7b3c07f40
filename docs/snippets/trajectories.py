import dataclasses
import json
import tempfile
from pathlib import Path

import numpy as np

import qp_twist as qt
from qp_twist.trajectories import (
    check_trajectory,
    read_trajectory,
    refine_trajectory,
    time_trajectory,
    write_trajectory,
)

task = qt.load_task("./weld.toml")
task = dataclasses.replace(task, acceleration_limits=np.full(6, 2.0))  # rad/s²

trajectory = qt.follow(task, "qp_minimum_norm", slow_down=True)
timed = time_trajectory(refine_trajectory(trajectory))
print(f"{timed.times[-1]:.3f} s, {task.durations.sum():.3f} s at the feed")
for stretch in timed.slowed:
    print("slower at", stretch)

with tempfile.TemporaryDirectory() as folder:
    file = write_trajectory(timed, Path(folder) / "weld.csv")
    first, _, *rows = file.read_text("utf-8").splitlines()
    print("\nweld.csv, its first columns")
    print(first)
    for row in rows[:2]:
        print(", ".join(cell[:13] for cell in row.split(",")[:5]), "…")
    file = write_trajectory(timed, Path(folder) / "weld.json")
    document = json.loads(file.read_text("utf-8"))
    print("\nweld.json")
    print(", ".join(document))
    print("joint_names:", document["joint_names"])
    print("points[1]:", ", ".join(document["points"][1]))
    print("points[1].time_from_start:", document["points"][1]["time_from_start"])
    print("metadata:", ", ".join(document["metadata"]))
    check = check_trajectory(read_trajectory(file), task)
print()
for finding in check.findings:
    if finding.name in ("position error between", "smallest joint margin", "acceleration limits"):
        print(finding)
print(check.verdict)
