"""The planar line with joint 1's lower limit raised from 0° to 48°, into the way of the arm."""

import numpy as np

import qp_twist as qt
from qp_twist.comparison import metrics

task = qt.load_task("planar_line")
task.model.jnt_range[0, 0] = np.radians(48)
for method in ("minimum_norm", "weighted_least_norm", "sns", "qp_minimum_norm"):
    run = metrics(qt.follow(task, method))
    print(
        f"{method:20} waypoints outside {run['violations']:3}, smallest margin "
        f"{run['min_margin']:6.3f}, largest step {run['max_step_deg']:.2f} degrees"
    )
