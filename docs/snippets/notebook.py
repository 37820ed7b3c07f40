"""What a notebook shows of a task and of a run."""

import qp_twist as qt

task = qt.load_task("deburring")
run = qt.follow(task)
figure = run.plot()  # Matplotlib: each joint between its limits, and the errors
print(sorted(panel.get_title(loc="left") for panel in figure.axes))
check = qt.check_trajectory(qt.time_trajectory(qt.refine_trajectory(run)), task)
print(check.verdict)
