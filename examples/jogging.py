"""Jog a tool with the keyboard: the roll is free, limits hold, and a released key stops the arm.

In the window: arrow keys move the tool sideways and to and fro, page up and page down along z,
comma and full stop tilt it, T goes over between the axes of the world and those of the tool.
"""

from types import SimpleNamespace

import mink
import numpy as np
from app import DT, HEADLESS, run

import qp_twist as qt

LINEAR, ANGULAR = 0.15, 0.5  # m/s, rad/s
RIGHT, LEFT, DOWN, UP, PAGE_UP, PAGE_DOWN, COMMA, STOP = 262, 263, 264, 265, 266, 267, 44, 46
TWISTS = {
    RIGHT: (0, LINEAR), LEFT: (0, -LINEAR), UP: (1, LINEAR), DOWN: (1, -LINEAR),
    PAGE_UP: (2, LINEAR), PAGE_DOWN: (2, -LINEAR), COMMA: (3, ANGULAR), STOP: (3, -ANGULAR),
}  # fmt: skip

path_task = qt.load_task("deburring")
task = qt.TwistTask("tool", "site", path_task.projector)
controller = qt.Controller(
    path_task.model,
    [task],
    secondary=[qt.JointCentering(path_task.model, gain=0.002)],
    limits=[qt.MotionLimit(path_task.model, velocity=1.5, acceleration=10.0)],
)
configuration = mink.Configuration(path_task.model, path_task.start)
now = SimpleNamespace(time=0.0, axes="world", message="")
servo = qt.Servo(
    controller,
    configuration,
    period=DT,
    stale_after=0.3,  # the window repeats a key that is held, after a while
    stop_within=0.2,
    clock=lambda: now.time,
)


def key(code: int) -> None:
    """Jog for as long as the key is repeated."""
    if code == ord("T"):
        now.axes = "tool" if now.axes == "world" else "world"
    elif code in TWISTS:
        place, speed = TWISTS[code]
        twist = np.zeros(6)
        twist[place] = speed
        servo.jog(twist, axes=now.axes)


def step(t: float) -> None:
    """One tick; without a window somebody holds page up for two seconds."""
    now.time = t
    if HEADLESS and 0.5 < t < 2.5:
        key(PAGE_UP)
    tick = servo.tick()
    configuration.integrate_inplace(tick.velocity, DT)
    if tick.message != now.message:
        now.message = tick.message
        print(f"{t:5.2f} s  {tick.message}")


run(configuration, step, lasts=4.0 if HEADLESS else 600.0, key=key)
print(f"{servo.times.count} ticks, {servo.times.late_by_itself} late by their own work")
