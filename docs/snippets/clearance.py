import qp_twist as qt

task = qt.load_task("deburring_cell")
(clearance,) = task.clearances
print(clearance)
for method in ("gradient_projection", "qp_gradient"):
    _, near = qt.follow(task, method).nearest
    print(f"{method}: {1e3 * near.distance:.1f} mm, {near.pair}, waypoint {near.at + 1:.0f}")
