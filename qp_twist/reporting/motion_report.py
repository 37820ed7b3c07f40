"""The report of one motion: one self-contained page."""

from __future__ import annotations

import html
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.drawing import scene_picture
from qp_twist.drawing.sight import overview
from qp_twist.drawing.surroundings import framed
from qp_twist.files import write_atomically
from qp_twist.following import Trajectory
from qp_twist.paths import PathTask, in_joint_moves
from qp_twist.pictures.player import SCRIPT, player_data, still
from qp_twist.pictures.recordings import recordings
from qp_twist.pictures.template import filled
from qp_twist.referee import AXIS_TOLERANCE_DEG, POSITION_TOLERANCE
from qp_twist.reporting.facts import facts
from qp_twist.reporting.failing import failing_intervals
from qp_twist.reporting.slower import SLOWER, Stretch, slower_intervals, slower_stretches
from qp_twist.reporting.words import (
    amount,
    data,
    digits,
    kept,
    part,
    problems,
    quantity,
    shown,
    spaced,
)
from qp_twist.trajectories import Check, JointRows, TimedTrajectory, check_trajectory

_FOLDER = Path(__file__).parent
NAME = "report.html"
"""Name of the page in its folder."""
_LONGEST_S = 30.0
"""Longest playing time; longer motions are played faster."""
_RATE, _FRAMES = 12.0, 300
"""Frames per second of playing time, and their largest number."""
_STRETCHES = 5
"""Largest number of stretches that are listed."""
_FINE, _SLOW, _BAD = (0, 114, 178), (230, 159, 0), (208, 0, 0)
"""Colours of the path."""
_SEEN = 0.01
"""Share of the path that is coloured to each side of where something fails or is slower."""
_STILL_PX = 1100


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
    trajectory: JointRows | Trajectory | TimedTrajectory,
    path_task: PathTask,
    out: str | Path,
    *,
    file: str = "",
    position_tolerance: float = POSITION_TOLERANCE,
    axis_tolerance_deg: float = AXIS_TOLERANCE_DEG,
    progress: Callable[[str], None] | None = None,
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
        position_tolerance: Largest linear task error that passes, m.
        axis_tolerance_deg: Largest angular task error that passes, degrees.
        progress: Called with what is done next.

    Raises:
        InvalidInput: If the trajectory cannot be checked (:func:`~qp_twist.check_trajectory`).
    """
    say = progress or (lambda _: None)
    say("checking")
    check = check_trajectory(
        trajectory,
        path_task,
        position_tolerance=position_tolerance,
        axis_tolerance_deg=axis_tolerance_deg,
    )
    say("drawing the scene")
    bad = _widened(failing_intervals(path_task, check))
    slow = _widened(slower_intervals(path_task, check))
    path_rgb = np.where(bad[:, None], _BAD, np.where(slow[:, None], _SLOW, _FINE))
    frames, seconds = _frames(path_task, check)
    found = recordings(
        path_task, {"motion": frames}, seconds=seconds, path_rgb=path_rgb.astype(np.uint8)
    )
    with tempfile.TemporaryDirectory() as temporary:
        picture, remark = _picture(path_task, check, path_rgb, Path(temporary))
    say("drawing the curves")
    page = _page(
        path_task, check, found, picture, file, slow=bool(slow.any()), wrong=bool(bad.any())
    )
    return MotionReport(write_atomically(Path(out) / NAME, page), check, remark)


def _widened(bad: Mask) -> Mask:
    """Which intervals are drawn in another colour: a single one would be too short to be seen."""
    beside = max(1, round(_SEEN * len(bad)))
    around: Mask = np.convolve(bad, np.ones(2 * beside + 1), mode="same") > 0.5
    return around if len(bad) > 2 * beside else bad


def _frames(path_task: PathTask, check: Check) -> tuple[Array, float]:
    """Configurations at equal times, (K, nq), and the playing time, s."""
    motion = check.motion
    span = float(motion.times[-1] - motion.times[0])
    seconds = 8.0
    if check.passing.timed:
        seconds = span if span <= _LONGEST_S else span / float(np.ceil(span / _LONGEST_S))
    count = int(np.clip(_RATE * seconds, 24, _FRAMES))
    q = motion.at(np.linspace(motion.times[0], motion.times[-1], count)).q
    frames = np.empty((count, path_task.model.nq))
    frames[:, path_task.model.jnt_qposadr[path_task.model.dof_jntid]] = q
    return frames, seconds


def _picture(path_task: PathTask, check: Check, path_rgb: Array, folder: Path) -> tuple[str, str]:
    """The scene at the start as an element of the page, and why there is none."""
    scene, out = folder / f"{path_task.scene.stem}.mjb", folder / "scene.png"
    mujoco.mj_saveModel(framed(path_task.shown), str(scene), None)
    start = np.empty(path_task.model.nq)
    start[path_task.model.jnt_qposadr[path_task.model.dof_jntid]] = check.motion.q[0]
    shown = replace(path_task, start=start).shown
    points = shown.positions
    traces, along = {}, ~in_joint_moves(path_task)
    for colour in dict.fromkeys(map(tuple, path_rgb.tolist())):
        here = (path_rgb == colour).all(axis=1) & along
        line = points.copy()
        line[~(np.append(here, False) | np.insert(here, 0, False))] = np.nan
        traces[str(colour)] = (line, (*(channel / 255.0 for channel in colour), 1.0))
    sentence = scene_picture.draw_scene(
        scene, [shown.start], points[:0], out, traces=traces, camera=overview(shown.model),
        height=800,
    )  # fmt: skip
    if sentence is not None:
        return "", sentence
    return still(out, "The robot at the start of its motion, and the path.", pixels=_STILL_PX), ""


def _page(
    path_task: PathTask,
    check: Check,
    found: dict[str, str],
    picture: str,
    file: str,
    *,
    slow: bool,
    wrong: bool,
) -> str:
    # With Matplotlib, which takes half a second.
    from qp_twist.reporting.charts import charts, off_the_path

    stretches = slower_stretches(path_task, check)
    return filled(
        _FOLDER / "page.html.j2",
        task=path_task.name,
        title=path_task.title,
        passes=check.passes,
        problems=problems(check),
        kept=kept(path_task, check),
        unchecked=check.unchecked,
        time=_cycle_time(path_task, check),
        picture=picture,
        player=player_data(found),
        speed=_playing(check),
        slow=slow,
        wrong=wrong,
        lit=bool(path_task.clearances),
        charts=charts(path_task, check),
        grey=bool(off_the_path(check)),
        slower=[str(stretch) for stretch in stretches[:_STRETCHES]],
        more=_more(stretches[_STRETCHES:]),
        not_slower=_not_slower(path_task, check),
        findings=[_row(check, k) for k in range(len(check.findings))],
        facts=facts(path_task, check, file),
        style=(_FOLDER / "page.css").read_text("utf-8"),
        script=SCRIPT.read_text("utf-8"),
    )


def _cycle_time(path_task: PathTask, check: Check) -> tuple[str, str]:
    """The cycle time, HTML, and what it is compared with."""
    if not check.passing.timed:
        return "–", "The file has no times."
    motion = check.motion
    span = float(motion.times[-1] - motion.times[0])
    number = data(amount(span, "s")._replace(text=f"{span:.4g}"), "cycle time")
    if path_task.durations is None:
        return number, "The task states no feed to compare it with."
    along = next(f.value for f in check.findings if f.name == "time")
    words = f"{path_task.feed_time:.4g} s at the programmed feed"
    if check.path_left:
        return number, f"It does not follow the whole path, which takes {words}."
    moves = next((f for f in check.findings if f.name == "time of joint moves"), None)
    if moves is not None:
        words = f"{moves.value:.4g} s of it in {moves.where}; the path takes {words}"
    if along < (1.0 - 1e-3) * span:
        words = f"{along:.4g} s of it along the path; {words}"
    return number, f"{words}."


def _playing(check: Check) -> str:
    motion = check.motion
    span = float(motion.times[-1] - motion.times[0])
    if not check.passing.timed:
        return "The file has no times: the speed of the picture means nothing."
    if span <= _LONGEST_S:
        return "It moves in real time."
    return f"It moves {int(np.ceil(span / _LONGEST_S))} times as fast as the robot."


def _more(stretches: list[Stretch]) -> str:
    if not stretches:
        return ""
    lost = sum(stretch.lost for stretch in stretches)
    return f"{len(stretches)} more, {lost:.2g}\u00a0s in all"


def _not_slower(path_task: PathTask, check: Check) -> str:
    """What is said where nothing slows the motion."""
    if not check.passing.timed:
        return "The file has no times, so that nothing can be said about its speed."
    if path_task.durations is None:
        return "The task states no feed, so that nothing is slower than it."
    use = next((f for f in check.findings if f.name == "velocity limits"), None)
    nearest = ""
    if use is not None and use.passes:
        nearest = (
            f" Closest to its speed limit, at {digits(use.value)}\u00a0% of it: "
            f"{html.escape(use.where)}."
        )
    return (
        f"Nothing: the whole path runs at the programmed feed, to {100.0 * SLOWER:.0f}\u00a0%."
        f"{nearest}"
    )


def _row(check: Check, k: int) -> dict[str, str | bool]:
    """A line of the table of everything that was checked."""
    finding = check.findings[k]
    limit = "–"
    if finding.limit is not None:
        allowed = amount(finding.limit, finding.unit)
        limit = allowed.text + spaced(allowed.unit)
    if finding.name == "smallest joint margin":
        limit = "0 %"
    # Where nothing is exceeded, the largest excess is at no place.
    none = finding.name.startswith("outside ") and finding.value == 0.0
    return {
        "name": quantity(finding) + part(finding),
        "value": data(shown(finding), finding.name) + ("" if finding.proven else ", not proven"),
        "limit": limit,
        "where": "nowhere" if none else finding.where,
        "passes": finding.passes,
    }
