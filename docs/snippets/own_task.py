import qp_twist as qt

for file in ("minimal.toml", "weld.toml"):
    task = qt.load_task(f"./{file}")
    trajectory = qt.follow(task, "qp_gradient")
    reached = trajectory.position_error.max() < 1e-8
    print(f"{task}: every waypoint reached: {reached}")
