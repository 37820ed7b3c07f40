"""A 6R arm deburrs a part: position and tool axis are held, the roll about the tool is free."""

import mink
import numpy as np
from app import DT, off, run

import qp_twist as qt

path = qt.load_task("deburring")  # robot, waypoints and their times
assert path.durations is not None
times = np.cumsum(path.durations)
configuration = mink.Configuration(path.model, path.start)

tool = qt.TwistTask.axis_free("tool", "site")
ranges = qt.JointRanges.of(path.model)
controller = qt.Controller(
    path.model,
    [tool],
    # Roll is spent on keeping the joints near the middle of their ranges.
    secondary=[qt.JointCentering(path.model, weight="natural", gain=0.01)],
    metric=ranges.metric,
    limits=[qt.MotionLimit(path.model, velocity=path.velocity_limits, acceleration=20.0)],
)
start = path.waypoints[0]
errors, rolls, statuses = [], [], {}


def target(t: float) -> mink.SE3:
    """Where the tool shall be: between the waypoints, at the feed of the task."""
    k = int(np.clip(np.searchsorted(times, t, side="right"), 1, len(times) - 1))
    share = float(np.clip((t - times[k - 1]) / (times[k] - times[k - 1]), 0.0, 1.0))
    return path.waypoints[k - 1].interpolate(path.waypoints[k], share)


def step(t: float) -> None:
    now, then = target(t), target(t + DT)
    tool.set_target(now, qt.target_twist(now, then, DT))
    made = controller.step(configuration, DT)
    configuration.integrate_inplace(made.velocity, DT)
    statuses[made.status.name] = statuses.get(made.status.name, 0) + 1
    tool.set_target(then)
    errors.append(off(tool, configuration))
    rolls.append(configuration.q[5])


run(configuration, step, lasts=float(times[-1]))
print(f"{len(errors)} steps, {statuses}")
print(f"largest error {max(errors):.1e} (m, rad)")
print(f"joint 6 turned by {np.degrees(np.ptp(rolls)):.0f} deg")
