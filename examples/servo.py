"""A servo at 500 Hz against a simulated robot: poses at 50 Hz, a gap in the stream, jogging.

python examples/servo.py [--figure out/servo.png]
"""

import argparse
from pathlib import Path

import mink
import numpy as np
from simulated_robot import ClosedLoop, Servos

import qp_twist as qt

parser = argparse.ArgumentParser()
parser.add_argument("--figure", type=Path, help="PNG file to write")
arguments = parser.parse_args()

path_task = qt.load_task("deburring")
task = qt.TwistTask("tool", "site", path_task.projector)
controller = qt.Controller(
    path_task.model,
    [task],
    secondary=[qt.JointCentering(path_task.model, gain=0.001)],
    limits=[qt.MotionLimit(path_task.model, velocity=1.5, acceleration=15.0)],
)
configuration = mink.Configuration(path_task.model, path_task.start)
servo = qt.Servo(controller, configuration, period=0.002)
loop = ClosedLoop(servo, Servos(path_task.model), path_task.start)
start = configuration.get_transform_frame_to_world("tool", "site")


def feed(t: float) -> None:
    """What an operator sends: a circle, nothing for a second, a jog upwards."""
    if t < 3.0 and round(t / servo.period) % 10 == 0:
        circle = np.array([0.08 * np.sin(2.0 * t), 0.08 * (1.0 - np.cos(2.0 * t)), 0.0])
        servo.track(mink.SE3.from_translation(circle) @ start)
    if 4.0 < t < 5.5:
        servo.jog([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])


record = loop.run(6.0, feed)
seconds = {
    state.name: sum(s is state for s in record.states) * servo.period
    for state in set(record.states)
}
for name, spent in sorted(seconds.items(), key=lambda item: -item[1]):
    print(f"{name:12s} {spent:.2f} s")
fastest = np.abs(np.diff(record.command, axis=0)).max() / servo.period
print(f"largest acceleration commanded: {fastest:.1f} rad/s²")
if arguments.figure:
    arguments.figure.parent.mkdir(parents=True, exist_ok=True)
    record.figure("a servo at 500 Hz").savefig(arguments.figure, dpi=110)
