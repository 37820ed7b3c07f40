"""The closed loop in MuJoCo's dynamics: feedback, servos, lag, noise, pushes and limits.

    python benchmarks/closed_loop.py [closed_loop_run] [closed_loop_disturbances]
        [closed_loop_gains] [closed_loop_limits] [--write]
    python benchmarks/closed_loop.py figure

All tables take three to four minutes; the second line draws docs/figures/closed_loop.png.
"""

from page import ROOT, command, markdown_table

# isort: split
import copy
import dataclasses
import sys
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
import mink
import mujoco
import numpy as np
from matplotlib.figure import Figure
from simulated_robot import ClosedLoop, Push, Record, Servos, TimedPath

import qp_twist as qt

PATH = qt.load_task("deburring")
SPEEDS = dict(zip(qt.JointRanges.of(PATH.model).names, PATH.velocity_limits, strict=True))
NOISE = 5e-4
REST = 1.0
"""The loop rests this long before a motion begins, s."""
SERVOS: dict[str, dict[str, Any]] = {
    "position": {"kind": "position"},
    "position, velocity feed-forward": {"kind": "position", "feedforward": 1.0},
    "velocity": {"kind": "velocity"},
}
FEEDBACK = ("integrated", "measured", "blended")
COLOURS = {"integrated": "#0072B2", "measured": "#E69F00", "blended": "#009E73"}
LIMIT = "#D00000"


@dataclasses.dataclass(frozen=True)
class Case:
    """A loop on the deburring robot."""

    servos: str
    feedback: str
    lag: float = 0.02
    noise: float = 0.0
    gain: float = 0.1
    weight_compensated: float = 1.0
    acceleration: float | None = None
    model: mujoco.MjModel = PATH.model
    margin: float = 0.0

    def plant(self) -> Servos:
        """The robot."""
        return Servos(
            self.model,
            lag=self.lag,
            gravity_compensation=self.weight_compensated,
            **SERVOS[self.servos],
        )

    def loop(self) -> tuple[qt.TwistTask, ClosedLoop]:
        """The loop and its task, at rest on the start of the path."""
        task = qt.TwistTask("tool", "site", PATH.projector, gain=self.gain)
        task.set_target(PATH.waypoints[0])
        limits: list[mink.Limit] = [
            qt.PositionLimit(self.model, margin=self.margin),
            mink.VelocityLimit(self.model, SPEEDS),
        ]
        if self.acceleration is not None:
            limits = [
                qt.MotionLimit(
                    self.model, velocity=SPEEDS, acceleration=self.acceleration, margin=self.margin
                )
            ]
        controller = qt.Controller(self.model, [task], limits=limits)
        loop = ClosedLoop(
            controller, self.plant(), PATH.start, feedback=self.feedback, noise=self.noise
        )
        return task, loop

    def edge(self, seconds: float) -> Record:
        """Rest, then the path at its feed: the first edge takes 5.2 s, then comes the corner."""
        task, loop = self.loop()
        return loop.run(seconds, TimedPath(task, PATH.waypoints, PATH.durations, start=REST))

    def pushed(self) -> Record:
        """Rest, with a push of 300 N downwards on the last link for 0.2 s."""
        _, loop = self.loop()
        return loop.run(4.0, pushes=[Push("link_6", force=(0.0, 0.0, -300.0), start=REST)])

    def against_the_limit(self) -> Record:
        """The target swings about the axis of joint 1, at 1.5 rad/s and beyond its range."""
        task, loop = self.loop()
        angles = np.linspace(0.0, 1.2, 61)
        poses = [
            mink.SE3.from_rotation(mink.SO3.from_z_radians(a)) @ PATH.waypoints[0] for a in angles
        ]
        path = TimedPath(task, poses, np.full(61, angles[1] / 1.5), start=REST)
        return loop.run(REST + 1.1, path)


def mm(metres: float) -> str:
    """Three digits, or nothing to speak of."""
    value = 1e3 * metres
    return "0" if value < 5e-4 else f"{value:.3g}" if value < 100 else f"{value:.0f}"


def run_table() -> str:
    """Feedback, servos, lag and noise, on an edge and a corner of the path."""
    rows = []
    for servos in SERVOS:
        for lag in (0.0, 0.02):
            for feedback in FEEDBACK:
                clean = Case(servos, feedback, lag).edge(6.8).summary(since=REST)
                noisy = clean
                if feedback != "integrated":  # which does not look at what is measured
                    noisy = Case(servos, feedback, lag, NOISE).edge(6.8).summary(since=REST)
                cells = [mm(clean["position_error_rms"]), mm(clean["position_error_max"])]
                cells += [f"{clean['acceleration_rms']:.2f}", mm(noisy["position_error_rms"])]
                cells += [f"{noisy['acceleration_rms']:.2f}"]
                cells += [f"{np.degrees(noisy['command_step_rms']):.2f}"]
                rows.append([servos, f"{1e3 * lag:.0f}", feedback, *cells])
    heads = ["servos", "lag, ms", "feedback", "error, mm", "largest", "acceleration, rad/s²"]
    heads += ["with noise: error, mm", "acceleration, rad/s²", "command step, °/s"]
    return markdown_table(heads, rows, left=3)


def disturbance_table() -> str:
    """A push, and a weight of which a twentieth is not compensated."""
    rows = []
    for servos in SERVOS:
        for feedback in FEEDBACK:
            push = Case(servos, feedback).pushed()
            heavy = Case(servos, feedback, weight_compensated=0.95).loop()[1].run(5.0)
            after = [push.position_error[push.time >= t - 1e-9][0] for t in (1.7, 3.0)]
            weight = [heavy.position_error[heavy.time >= t - 1e-9][0] for t in (1.0, 4.9)]
            cells = map(mm, [push.position_error.max(), *after, *weight])
            rows.append([servos, feedback, *cells])
    heads = ["servos", "feedback", "push: largest, mm", "0.5 s later", "1.8 s later"]
    heads += ["weight: after 1 s, mm", "after 4.9 s"]
    return markdown_table(heads, rows, left=2)


def gain_table() -> str:
    """What the gain of the task does, with noise."""
    gains = (0.05, 0.1, 0.3, 0.5, 1.0)
    rows = []
    for servos in SERVOS:
        for feedback in ("measured", "blended"):
            cells = []
            for gain in gains:
                s = Case(servos, feedback, 0.02, NOISE, gain).edge(3.0).summary(since=1.5)
                cells.append(f"{mm(s['position_error_rms'])} ({s['acceleration_rms']:.2g})")
            rows.append([servos, feedback, *cells])
    return markdown_table(["servos", "feedback", *(f"gain {g:g}" for g in gains)], rows, left=2)


def short_range() -> mujoco.MjModel:
    """The robot with half a radian of room for joint 1."""
    model = copy.copy(PATH.model)
    model.jnt_range[0, 1] = PATH.start[0] + 0.5
    return model


def recommended_margin(case: Case, record: Record) -> float:
    """Speed × (delay of the servos + period) + 4 σ of the noise, rad."""
    speed = float(np.abs(record.velocity[:, 0]).max())
    return speed * (case.plant().delay + record.period) + 4.0 * case.noise


def limit_table() -> str:
    """How far the true position leaves the range, and what a narrower one does."""
    model, rows = short_range(), []
    for servos, feedback in (
        ("position", "integrated"),
        ("position, velocity feed-forward", "integrated"),
        ("position", "measured"),
        ("velocity", "measured"),
        ("velocity", "blended"),
    ):
        for lag in (0.0, 0.02):
            cells = []
            for acceleration in (None, 10.0):  # rad/s²
                case = Case(servos, feedback, lag, NOISE, model=model, acceleration=acceleration)
                record = case.against_the_limit()
                margin = recommended_margin(case, record)
                kept = dataclasses.replace(case, margin=margin).against_the_limit()
                cells += [f"{max(0.0, -1e3 * r.room.min()):.1f}" for r in (record, kept)]
                cells.insert(-1, f"{1e3 * margin:.0f}")
            rows.append([servos, f"{1e3 * lag:.0f}", feedback, *cells])
    heads = ["beyond, mrad", "margin, mrad", "beyond with it"]
    heads = ["servos", "lag, ms", "feedback", *heads, *(f"10 rad/s²: {h}" for h in heads)]
    return markdown_table(heads, rows, left=3)


def figure() -> Figure:
    """Four panels: path, push, noise, limit. Colour: feedback; dashed: position servos."""
    drawn = Figure(figsize=(8.0, 9.6), layout="constrained")
    run, push, noise, limit = drawn.subplots(4, 1)
    kinds = [(s, f) for s in ("position", "velocity") for f in FEEDBACK]
    for servos, feedback in kinds:
        case = Case(servos, feedback)
        plot(run, case, case.edge(6.8), lambda r: 1e3 * r.position_error)
        plot(push, case, case.pushed(), lambda r: 1e3 * r.position_error)
    for panel, lowest, highest in ((run, 4e-3, 30.0), (push, 0.02, 600.0)):
        panel.set_yscale("log")
        panel.set_ylim(lowest, highest)
        panel.yaxis.set_major_formatter("{x:g}")
    run.set_xlim(0.8, 6.8)
    push.set_xlim(0.8, 3.2)
    run.set_title("an edge of the path, and the corner at 6.2 s: error of the tool, mm")
    push.set_title(
        "300 N on the last link from 1.0 to 1.2 s, the target rests: error of the tool, mm"
    )
    for feedback in ("measured", "blended"):
        case = Case("velocity", feedback, noise=NOISE)
        plot(noise, case, case.edge(3.0), lambda r: np.degrees(r.command[:, 4]))
    noise.set_xlim(0.8, 3.0)
    noise.set_title("noise of 0.5 mrad on the measured joints: commanded speed of joint 5, °/s")
    model = short_range()
    upper = model.jnt_range[0, 1]

    def beyond(record: Record) -> np.ndarray:
        return 1e3 * (record.q[:, 0] - upper)

    for servos, feedback in (("position", "integrated"), ("velocity", "measured")):
        case = Case(servos, feedback, model=model)
        record = case.against_the_limit()
        plot(limit, case, record, beyond)
        if feedback == "measured":
            kept = dataclasses.replace(case, margin=recommended_margin(case, record))
            [line] = plot(
                limit, kept, kept.against_the_limit(), lambda r: 1e3 * (r.q[:, 0] - upper)
            )
            line.set(linestyle=(0, (1, 1.2)), label="velocity, measured, narrowed range")
    limit.axhline(0.0, color=LIMIT, linewidth=1.2)
    limit.text(1.005, 4.0, "limit of joint 1", color=LIMIT, fontsize=8)
    limit.set_xlim(1.0, 2.0)
    limit.set_ylim(-160.0, 45.0)
    limit.set_title("a target beyond the range of joint 1: its position beyond the limit, mrad")
    limit.set_xlabel("time, s")
    run.legend(ncols=3, loc="lower center")
    limit.legend(loc="lower right")
    noise.legend(loc="upper right", ncols=2)
    for panel in drawn.axes:
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(color="#DDDDDD", linewidth=0.5)
    return drawn


def plot(panel: Any, case: Case, record: Record, values: Callable[[Record], np.ndarray]) -> Any:
    """One curve in the colours of all figures."""
    return panel.plot(
        record.time,
        values(record),
        color=COLOURS[case.feedback],
        linestyle=(0, (4, 2)) if case.servos == "position" else "solid",
        linewidth=1.4,
        label=f"{case.servos}, {case.feedback}",
    )


def closed_loop_figure() -> str:
    """Draw the figure."""
    style: Any = {"font.size": 9, "axes.titlesize": 9, "axes.titlelocation": "left",
                  "legend.frameon": False, "legend.fontsize": 8}  # fmt: skip
    file = ROOT / "docs" / "figures" / "closed_loop.png"
    with mpl.rc_context(style):
        figure().savefig(file, dpi=130)
    return f"{file}\n"


if __name__ == "__main__":
    parts = {
        "closed_loop_run": run_table,
        "closed_loop_disturbances": disturbance_table,
        "closed_loop_gains": gain_table,
        "closed_loop_limits": limit_table,
    }
    if "figure" in sys.argv[1:]:
        print(closed_loop_figure())
    else:
        sys.exit(command(__doc__, parts))
