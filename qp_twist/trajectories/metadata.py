"""Metadata of a trajectory file about its task."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from qp_twist import __version__
from qp_twist.checks import Indices
from qp_twist.errors import InvalidInput
from qp_twist.geometry import Projector
from qp_twist.kinematics import JointRanges
from qp_twist.paths import LiftOffs, PathTask, joint_move_ends
from qp_twist.referee import JointMotion, MotionLimits

if TYPE_CHECKING:
    from qp_twist.following import Trajectory
    from qp_twist.trajectories.timed_path import TimedPath


def metadata_of(
    rows: Trajectory,
    motion: JointMotion | None = None,
    limits: MotionLimits | None = None,
    at: Indices | None = None,
) -> dict[str, Any]:
    """Metadata of a trajectory, with its times or without, ready for JSON and of no machine.

    ``at`` (N,) are the indices of its rows in the file, if that has further ones.
    """
    task = rows.path_task
    ranges = JointRanges.of(task.model)
    numbers = 1 + (np.arange(len(rows.q)) if at is None else at)
    numbers = np.append(numbers, numbers[-1] + 1)  # of what the trajectory does not reach
    firsts = [1, *numbers[np.searchsorted(rows.s, [s.first for s in task.segments])].tolist()]
    found: dict[str, Any] = {
        "generator": f"qp_twist {__version__}",
        "versions": {name: version(name) for name in ("mujoco", "mink")},
        "task": task.name,
        "title": task.title,
        "method": rows.method,
        "robot": task.scene.name,
        "frame": {"name": task.frame_name, "type": task.frame_type},
        **({} if task.relative_to is None else {"relative_to": task.relative_to}),
        "projectors": [
            {
                "first_row": first,
                "linear": _block(projector.linear),
                "angular": _block(projector.angular),
                "frame": projector.frame,
            }
            for first, projector in zip(firsts, task.projectors, strict=True)
        ],
        "units": dict(zip(ranges.names, ranges.units, strict=True)),
        "interpolation": None if motion is None else motion.interpolation,
        "position_error_max_m": float(rows.position_error.max()),
        "axis_error_max_rad": float(rows.axis_error.max()),
    }
    if task.joint_moves:  # rows, from 1, where each begins and ends
        ends = [end for end in joint_move_ends(task) if end[1] <= rows.s[-1]]
        found["joint_moves"] = numbers[np.searchsorted(rows.s, ends)].tolist()
    if task.cuts:
        found["cuts"] = [] if task.cuts == "fewest" else list(task.cuts)
    if limits is not None:
        for kind, most, source in (
            ("acceleration", limits.acceleration, limits.accelerations_of),
            ("jerk", limits.jerk, limits.jerks_of),
        ):
            known = zip(ranges.names, most.tolist(), strict=True)
            if source:
                found[f"{kind}_limits"] = {n: limit for n, limit in known if np.isfinite(limit)}
    return found


def with_lift_offs(path_task: PathTask, metadata: dict[str, Any]) -> PathTask:
    """The task with the lift-offs that metadata state, if it leaves open where they are."""
    cuts = metadata.get("cuts")
    if path_task.cuts != "fewest" or not isinstance(cuts, list):
        return path_task
    try:
        return LiftOffs.of(path_task, cuts).task
    except InvalidInput:  # those of another path
        return path_task


def stating_lift_offs(rows: TimedPath, metadata: dict[str, Any]) -> TimedPath:
    """The rows of a file with the lift-offs that metadata of its motion state, if it has none."""
    stated = {"cuts": metadata["cuts"]} if "cuts" in metadata else {}
    return replace(rows, metadata={**stated, **rows.metadata})


def read_metadata(text: str) -> dict[str, Any]:
    """Parse the metadata of a file; empty if this package did not write them."""
    try:
        found = read_json(text)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def read_json(text: str) -> Any:
    """Parse JSON; integers beyond the range of a float become infinite, as other numbers do.

    Raises:
        ValueError: If it is no JSON.
        RecursionError: If it is nested too deep.
    """
    return json.loads(text, parse_int=lambda word: int(word) if len(word) < 300 else float(word))


def disagreements(metadata: dict[str, Any], path_task: PathTask, limits: MotionLimits) -> list[str]:
    """Sentences about contradictions between a file's metadata and the task and its limits.

    They do not affect the verdict: a file may contain any metadata.
    """
    ranges = JointRanges.of(path_task.model)
    frame, units = (
        value if isinstance(value := metadata.get(key), dict) else {} for key in ("frame", "units")
    )
    facts = {"task": path_task.name, "robot": path_task.scene.name}
    claims = [(key, metadata[key], fact) for key, fact in facts.items() if key in metadata]
    if "name" in frame:
        claims.append(("frame", frame["name"], path_task.frame_name))
    if "frame" in metadata:
        carrier = metadata.get("relative_to") or "the world"
        claims.append(("the path lies on", carrier, path_task.relative_to or "the world"))
    here = zip(ranges.names, ranges.units, strict=True)
    claims += [(f"unit of {name}", units[name], unit) for name, unit in here if name in units]
    notes = [
        f"the file's metadata say {key} {str(value)[:60]!r}, but it is checked with {fact!r}"
        for key, value, fact in claims
        if value != fact
    ]
    stated = metadata.get("acceleration_limits")
    if isinstance(stated, dict):
        checked = zip(ranges.names, limits.acceleration.tolist(), strict=True)
        others = [name for name, a in checked if name in stated and not _same(stated[name], a)]
        if others:
            notes.append(
                f"the file's metadata state acceleration limits of {', '.join(others)} that are "
                "not those of this check"
            )
    return notes


def _same(stated: object, limit: float) -> bool:
    """Whether a number of the metadata, which may be anything, is a limit."""
    if not isinstance(stated, (int, float)):
        return False
    return (1.0 - 1e-6) * limit <= stated <= (1.0 + 1e-6) * limit


def _block(block: Projector) -> str | dict[str, list[float]]:
    """A projector as written in task files."""
    word = block.kind.name.lower()
    return word if block.axis is None else {word: block.axis.tolist()}
