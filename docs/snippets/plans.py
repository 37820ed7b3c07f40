"""Three plans of the planar line, thinned out, and why there is none in narrower limits."""

import dataclasses

import numpy as np

import qp_twist as qt

line = qt.load_task("planar_line")
task = dataclasses.replace(line, waypoints=line.waypoints[::10])
for objective, unit in (("centering", "mean z"), ("travel", "degrees"), ("margin", "degrees")):
    plan = qt.plan(task, objective)
    print(f"{objective:<9} {plan.value:7.4f} {unit}, bound {plan.bound:7.4f}")

task.model.joint("joint_2").range = np.radians([0.0, 30.0])
print("with joint_2 up to 30°:", qt.plan(task).certificate)
task.model.joint("joint_2").range = np.radians([0.0, 90.0])
print("with steps of 3°:", qt.plan(task, max_step_deg=3.0).certificate)
