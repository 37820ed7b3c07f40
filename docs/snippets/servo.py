"""A servo that is fed with poses, then with nothing, then with a twist."""

import mink
import numpy as np

import qp_twist as qt

path = qt.load_task("deburring")
task = qt.TwistTask("tool", "site", path.projector)
controller = qt.Controller(path.model, [task], limits=[qt.MotionLimit(path.model, velocity=1.5)])
configuration = mink.Configuration(path.model, path.start)
time = [0.0]  # of a simulation; by default it is the machine's
servo = qt.Servo(controller, configuration, period=0.002, clock=lambda: time[0])
start = configuration.get_transform_frame_to_world("tool", "site")

said = ""
for k in range(1500):
    time[0] = t = k * servo.period
    if t < 1.0 and k % 10 == 0:  # 50 poses a second
        servo.track(mink.SE3.from_translation(np.array([0.1 * np.sin(t), 0.0, 0.0])) @ start)
    if 2.0 < t < 2.5:
        servo.jog([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    tick = servo.tick()
    configuration.integrate_inplace(tick.velocity, servo.period)
    if tick.message != said:
        said = tick.message
        print(f"{t:.2f} s  {said}")
