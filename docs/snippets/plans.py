"""Three plans of the planar line, and why there is none within narrower limits."""

import dataclasses

import numpy as np

import qp_twist as qt

task = qt.load_task("planar_line")
for objective, unit in (("centering", "mean z"), ("travel", "degrees"), ("margin", "degrees")):
    plan = qt.plan(task, objective)
    print(f"{objective:<9} {plan.value:7.4f} {unit}, bound {plan.bound:7.4f}")

task.model.joint("joint_2").range = np.radians([0.0, 30.0])
print("with joint_2 up to 30°:", qt.plan(task).certificate)
task.model.joint("joint_2").range = np.radians([0.0, 90.0])
fewer = dataclasses.replace(task, waypoints=task.waypoints[::5])
print("with steps of 1.5°:", qt.plan(fewer, max_step_deg=1.5).certificate)
