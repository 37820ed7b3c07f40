import qp_twist as qt

task = qt.load_task("deburring")  # robot, path, and T: the roll about the tool is free
run = qt.follow(task)  # method "qp_gradient": a QP at every step, joint limits as hard bounds
print(f"margin {run.margins.min():.2f}, position error {run.position_error.max():.0e} m")
