"""Ticks of a servo under a random stream, in one process without dynamics: how long they take.

    python benchmarks/servo_ticks.py [--ticks 100000] [--seed 0] [--acceleration 10]

The stream has poses (at 20 to 500 Hz, some of them far away, some out of reach), twists and joint
velocities, gaps, and inputs that are not finite. Time is the servo's own: no tick waits for the
clock. A tick is late if it takes longer than the period of 2 ms; `by their own work` are those of
the late ones in which the thread's processor time was as long, which on a virtual machine includes
time that its host took away. So the step of such a tick is computed again at once, twice.
"""

from page import command

# isort: split
import contextlib
import gc
import sys
import time
from collections import Counter

import mink
import numpy as np

import qp_twist as qt

PERIOD = 0.002


class Operator:
    """Random inputs: one kind for a while, then another."""

    def __init__(self, servo: qt.Servo, model: object, start: mink.SE3, seed: int) -> None:
        self.servo, self.start = servo, start
        self.rng = np.random.default_rng(seed)
        self.until, self.kind, self.every = 0, "none", 1
        self.nv = model.nv  # type: ignore[attr-defined]

    def feed(self, k: int) -> None:
        """The input of tick k, if there is one."""
        rng = self.rng
        if k >= self.until:
            self.until = k + int(rng.integers(100, 1500))
            self.kind = str(rng.choice(["track", "track", "jog", "move", "none", "far", "junk"]))
            self.every = int(rng.choice([1, 2, 5, 16, 25]))
            self.phase, self.size = rng.uniform(0.0, 6.0, 3), rng.uniform(0.0, 0.15, 3)
            self.twist = np.concatenate([rng.normal(size=3) * 0.15, rng.normal(size=3) * 0.5])
            self.velocity = rng.normal(size=self.nv) * 0.5
            self.far = rng.normal(size=3) * (2.0 if rng.random() < 0.3 else 0.3)
        if k % self.every:
            return
        if self.kind == "track":
            shift = self.size * np.sin(0.002 * k + self.phase)
            self.servo.track(mink.SE3.from_translation(shift) @ self.start)
        elif self.kind == "far":
            self.servo.track(mink.SE3.from_translation(self.far) @ self.start)
        elif self.kind == "jog":
            self.servo.jog(self.twist, axes="tool" if self.every > 2 else "world")
        elif self.kind == "move":
            self.servo.move(self.velocity)
        elif self.kind == "junk":
            with contextlib.suppress(qt.InvalidTarget):
                self.servo.jog(np.full(6, np.nan))


def again(servo: qt.Servo, before: np.ndarray, after: np.ndarray) -> float:
    """Processor time of the last tick's step, computed again: the shorter of two, s."""
    taken = []
    for _ in range(2):
        began = time.thread_time()
        servo.controller.step(servo.configuration, PERIOD, velocity=before)
        taken.append(time.thread_time() - began)
    servo.controller.note(after)
    return min(taken)


def servo_ticks(ticks: int, seed: int, acceleration: float) -> str:
    """Feed a servo for so many ticks; the acceleration limit is in rad/s²."""
    path_task = qt.load_task("deburring")
    model, now = path_task.model, [0.0]
    task = qt.TwistTask("tool", "site", path_task.projector)
    motion = qt.MotionLimit(model, velocity=1.5, acceleration=acceleration)
    controller = qt.Controller(
        model, [task], secondary=[qt.JointCentering(model, gain=0.001)], limits=[motion]
    )
    configuration = mink.Configuration(model, path_task.start)
    servo = qt.Servo(controller, configuration, period=PERIOD, clock=lambda: now[0])
    start = configuration.get_transform_frame_to_world("tool", "site")
    operator = Operator(servo, model, start, seed)
    gc.freeze()
    states: Counter[str] = Counter()
    before, worst_change, worst_excess = np.zeros(model.nv), 0.0, -np.inf
    lower, upper = model.jnt_range.T
    late, left, by_reference, repeated = 0, 0, 0, [0.0]
    for k in range(ticks):
        now[0] = k * PERIOD
        operator.feed(k)
        tick = servo.tick()
        states[tick.state.name] += 1
        velocity = tick.velocity
        if servo.times.late_by_itself > late:
            late = servo.times.late_by_itself
            by_reference += controller.reference_steps > left
            repeated.append(again(servo, before, velocity))
        left = controller.reference_steps
        worst_change = max(worst_change, float(np.abs(velocity - before).max()))
        before = velocity
        configuration.integrate_inplace(velocity, PERIOD)
        q = configuration.q
        worst_excess = max(worst_excess, float(np.maximum(lower - q, q - upper).max()))
    return "\n".join((
        str(servo.times),
        f"late by their own work: {late}, {by_reference} of them with a step of the reference; "
        f"computed again {sum(r > PERIOD for r in repeated)} were late, the longest took "
        f"{1e6 * max(repeated):.0f} µs",
        "states: " + ", ".join(f"{name} {count}" for name, count in states.most_common()),
        f"inputs refused: {dict(servo.refused)}",
        f"largest change of a velocity: {worst_change / PERIOD:.6f} rad/s² (limit "
        f"{acceleration:g}); joints outside their ranges by {worst_excess:.2g} rad",
        f"steps that the kernel left to the reference: {controller.reference_steps}",
    ))  # fmt: skip


if __name__ == "__main__":
    parts = {"servo_ticks": servo_ticks}
    sys.exit(command(__doc__, parts, ticks=100_000, seed=0, acceleration=10.0))
