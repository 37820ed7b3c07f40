import dataclasses

import numpy as np

import qp_twist as qt

task = qt.load_task("approach_contact_retreat")
print(f"{task!r}")
for blend in (0, 5, 10):
    segments = tuple(dataclasses.replace(s, blend=blend) for s in task.segments)
    run = qt.follow(dataclasses.replace(task, segments=segments), "qp_gradient")
    steps = np.degrees(np.diff(run.q, axis=0))
    print(f"blend = {blend}: the largest change of a joint's step, degrees")
    for s, rows in zip(segments, ("6 to 5", "5 to 3"), strict=True):
        jumps = np.abs(np.diff(steps, axis=0))[s.first - 2 : s.first + blend - 1]
        print(f"  {rows} rows, from waypoint {s.first + 1} on: {jumps.max():.2f}")
