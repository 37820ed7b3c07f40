"""How low can the mean of z be along the deburring run, with steps of at most 3° a waypoint?"""

import qp_twist as qt

task = qt.load_task("deburring")
run = qt.follow(task, "qp_gradient")
print(f"qp_gradient:            mean z {run.z.mean():.4f}")
for words, start in (("from the same start", run.q[0]), ("from any start", None)):
    plan = qt.plan(task, "centering", start, max_step_deg=3.0)
    print(f"{'plan ' + words + ':':<23} mean z {plan.value:.4f}, bound {plan.bound:.4f}")
