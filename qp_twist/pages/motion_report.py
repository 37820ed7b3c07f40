"""The report of one motion: one self-contained page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.drawing import NoPicture, picture_of
from qp_twist.drawing.palette import BLUE, ORANGE, RED, rgb
from qp_twist.files import write_atomically
from qp_twist.following import Trajectory
from qp_twist.pages.motion_facts import facts
from qp_twist.pages.motion_intervals import failing_intervals, slower_intervals
from qp_twist.pages.page import fill_template, still_html
from qp_twist.pages.recordings import DURATION_S, recorded_scene
from qp_twist.paths import PathTask, in_joint_moves
from qp_twist.trajectories import Check, TimedPath, check_trajectory
from qp_twist.trajectories.metadata import with_lift_offs

NAME = "report.html"
"""Name of the page in its folder."""
_LONGEST_S = 30.0
"""Longest playing time; longer motions are played faster."""
_RATE, _FRAMES = 12.0, 300
"""Frames per second of playing time, and their largest number."""
_STRETCHES = 5
"""Largest number of dips that are listed."""
_SEEN = 0.01
"""Share of the path that is coloured to each side of where something fails or is slower."""


class MotionReport(NamedTuple):
    """What :func:`~qp_twist.report` made.

    Attributes:
        path: The page.
        check: The check of the motion, whose numbers it shows.
        remark: Why there is no still picture, for print; empty if there is one.
    """

    path: Path
    check: Check
    remark: str


def report(
    trajectory: TimedPath | Trajectory,
    path_task: PathTask,
    out: str | Path,
    *,
    file: str = "",
    position_tolerance: float | None = None,
    axis_tolerance_deg: float | None = None,
) -> MotionReport:
    """Write ``report.html``: one motion in one page that needs no network and no other file.

    The moving scene, the verdict of :func:`~qp_twist.check_trajectory`, the cycle time, curves of
    what the motion has to keep with their limits, what slows it down, and the facts. It is printed
    on two pages.

    Args:
        trajectory: From :func:`~qp_twist.read_trajectory`, or a computed one.
        path_task: The task of the trajectory.
        out: Folder to write to; created if necessary.
        file: Name of the trajectory's file, for the facts.
        position_tolerance: As of the check: largest linear task error that passes, m.
        axis_tolerance_deg: Likewise, degrees.

    Raises:
        InvalidInput: If the trajectory cannot be checked (:func:`~qp_twist.check_trajectory`).
    """
    path_task = with_lift_offs(path_task, TimedPath.of(trajectory).metadata)
    check = check_trajectory(
        trajectory,
        path_task,
        position_tolerance=position_tolerance,
        axis_tolerance_deg=axis_tolerance_deg,
    )
    return write_report(path_task, check, out, file=file)


def write_report(
    path_task: PathTask, check: Check, out: str | Path, *, file: str = ""
) -> MotionReport:
    """Write the page of a motion that is checked already; see :func:`report`."""
    # With Matplotlib, which takes half a second.
    from qp_twist.pages.motion_charts import motion_charts, off_the_path

    bad = _widened(failing_intervals(path_task, check))
    slow = _widened(slower_intervals(path_task, check))
    colours = np.where(bad, RED, np.where(slow, ORANGE, BLUE)).tolist()
    frames, seconds = _frames(path_task, check)
    speed = check.speed
    dips = [] if speed is None else speed.longest_dips
    picture, remark = _picture(path_task, check, colours)
    page = fill_template(
        "motion", task=path_task.name, title=path_task.title, check=check,
        problems=_problems(check),
        span=float(np.ptp(check.motion.times)) if check.passing.timed else None,
        time=_cycle_time(path_task, check), picture=picture,
        scene=recorded_scene(
            path_task,
            {"motion": frames},
            seconds=seconds,
            path_rgb=np.array([rgb(colour) for colour in colours], dtype=np.uint8),
        ),
        faster=int(np.ceil(np.ptp(check.motion.times) / _LONGEST_S)), slow=ORANGE in colours,
        wrong=RED in colours, lit=bool(path_task.clearances),
        charts=motion_charts(path_task, check), grey=bool(off_the_path(check)), speed=speed,
        slower=dips[:_STRETCHES], more=len(dips[_STRETCHES:]), feed=path_task.durations is not None,
        facts=facts(path_task, check, file),
    )  # fmt: skip
    return MotionReport(write_atomically(Path(out) / NAME, page), check, remark)


def _widened(bad: Mask) -> Mask:
    """Which intervals are drawn in another colour: a single one would be too short to be seen."""
    beside = max(1, round(_SEEN * len(bad)))
    around: Mask = np.convolve(bad, np.ones(2 * beside + 1), mode="same") > 0.5
    return around if len(bad) > 2 * beside else bad


def _frames(path_task: PathTask, check: Check) -> tuple[Array, float]:
    """Configurations at equal times, (K, nq), and the playing time, s."""
    times, seconds = check.motion.times, DURATION_S
    if check.passing.timed:
        span = float(np.ptp(times))
        seconds = span / max(1.0, float(np.ceil(span / _LONGEST_S)))
    count = int(np.clip(_RATE * seconds, 24, _FRAMES))
    q = check.motion.at(np.linspace(times[0], times[-1], count)).q
    return _configurations(path_task, q), seconds


def _configurations(path_task: PathTask, q: Array) -> Array:
    """Positions of the joints (…, nv) as configurations of the model, (…, nq)."""
    found = np.empty((*q.shape[:-1], path_task.model.nq))
    found[..., path_task.model.jnt_qposadr[path_task.model.dof_jntid]] = q
    return found


def _picture(path_task: PathTask, check: Check, colours: list[str]) -> tuple[str, str]:
    """The scene at the start as an element of the page, and why there is none."""
    start = _configurations(path_task, check.motion.q[0])
    drawn = replace(path_task, start=start).shown
    along = ~in_joint_moves(path_task)
    lines = []
    for colour in dict.fromkeys(colours):
        here = (np.array(colours) == colour) & along
        line = drawn.positions.copy()
        line[~(np.append(here, False) | np.insert(here, 0, False))] = np.nan
        lines.append((line, colour))
    text = "The robot at the start of its motion, and the path."
    try:
        picture = picture_of(drawn, text, lines=lines, width=1280, height=800)
    except NoPicture as why:
        return "", str(why)
    return still_html(picture), ""


def _problems(check: Check) -> list[str]:
    """What does not pass; what fails at waypoints and between them is named once."""
    failing = {finding.name: str(finding) for finding in check.findings if not finding.passes}
    once = [text for name, text in failing.items() if name.removesuffix(" between") == name
            or name.removesuffix(" between") not in failing]  # fmt: skip
    return [*check.path_left, *once]


def _cycle_time(path_task: PathTask, check: Check) -> str:
    """What the cycle time is compared with."""
    if not check.passing.timed:
        return "The file has no times."
    if path_task.durations is None:
        return "The task states no feed to compare it with."
    words = f"{path_task.feed_time:.4g} s at the programmed feed"
    if check.path_left:
        return f"It does not follow the whole path, which takes {words}."
    by_name = {finding.name: finding for finding in check.findings}
    if (moves := by_name.get("time of joint moves")) is not None:
        words = f"{moves.value:.4g} s of it in {moves.where}; the path takes {words}"
    if (along := by_name["time"].value) < (1.0 - 1e-3) * np.ptp(check.motion.times):
        words = f"{along:.4g} s of it along the path; {words}"
    return f"{words}."
