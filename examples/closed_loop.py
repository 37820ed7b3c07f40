"""The deburring run in MuJoCo's dynamics: choose servos, feedback, lag and noise; see what happens.

    python examples/closed_loop.py [--servos velocity] [--feedback measured] [--lag 0.02]
        [--noise 0.0005] [--gain 0.1] [--seconds 22] [--figure closed_loop.png]

The arm rests for a second and then follows the path at its feed of 50 mm/s. Prints the record in
numbers, and draws it. The whole run takes about ten seconds.
"""

import argparse
from pathlib import Path

import mink
import numpy as np
from simulated_robot import ClosedLoop, Servos, TimedPath

import qp_twist as qt


def main() -> None:
    """Run the loop, print what the record says, draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--servos", choices=["position", "velocity"], default="velocity")
    parser.add_argument(
        "--feedback", choices=["measured", "integrated", "blended"], default="measured"
    )
    parser.add_argument("--lag", type=float, default=0.02, help="first-order lag, s")
    parser.add_argument("--noise", type=float, default=5e-4, help="of measured positions, rad")
    parser.add_argument("--gain", type=float, default=0.1, help="share of the error in a step")
    parser.add_argument("--seconds", type=float, default=22.0, help="the run ends at 21.8 s")
    parser.add_argument("--figure", type=Path, help="draw the record to this file")
    args = parser.parse_args()

    path = qt.load_task("deburring")
    speeds = dict(zip(qt.JointRanges.of(path.model).names, path.velocity_limits, strict=True))
    task = qt.TwistTask("tool", "site", path.projector, gain=args.gain)
    controller = qt.Controller(
        path.model,
        [task],
        limits=[qt.PositionLimit(path.model), mink.VelocityLimit(path.model, speeds)],
    )
    plant = Servos(path.model, kind=args.servos, lag=args.lag)
    loop = ClosedLoop(
        controller, plant, path.start, period=0.01, feedback=args.feedback, noise=args.noise
    )
    record = loop.run(args.seconds, TimedPath(task, path.waypoints, path.durations, start=1.0))

    s = record.summary(since=1.0)
    print(record)
    print(
        f"error of the tool: {1e3 * s['position_error_rms']:.3f} mm rms, "
        f"{1e3 * s['position_error_max']:.3f} mm at most; of its axis "
        f"{np.degrees(s['angle_error_max']):.3f}° at most"
    )
    print(
        f"nearest limit {s['min_room']:.3f} rad, lowest margin {s['min_margin']:.3f}; joint "
        f"accelerations {s['acceleration_rms']:.2f} rad/s² rms, {s['acceleration_max']:.1f} at most"
    )
    if args.figure is not None:
        record.figure(f"{args.servos} servos, {args.feedback}").savefig(args.figure, dpi=110)
        print(f"wrote {args.figure}")


if __name__ == "__main__":
    main()
