"""A motion, its findings and facts in the words of a person who did not program the robot."""

from __future__ import annotations

import datetime
import html
import math
from importlib.metadata import version
from typing import NamedTuple

import numpy as np

from qp_twist import __version__
from qp_twist.geometry import ProjectorKind, TwistProjector
from qp_twist.paths import PathTask, in_joint_moves
from qp_twist.referee import AFTER, BEFORE, OFF, Finding
from qp_twist.robots import known_robot
from qp_twist.trajectories import Check

BETWEEN = " between"
TOO_NEAR = "Too near an obstacle"
_QUANTITIES = {
    "position error": "Position error",
    "axis error": "Orientation error",
    "outside a band": "Outside a tolerance band",
    "smallest joint margin": "Distance to the joint limits",
    "velocity limits": "Joint speed",
    "joint speed": "Joint speed",
    "acceleration limits": "Joint acceleration",
    "feed": "Speed along the path",
    "time": "Time along the path",
    "outside clearance": TOO_NEAR,
    "outside clearance on joint moves": "Too near on joint moves",
}
_PARTS = {
    BETWEEN: ", between the waypoints",
    BEFORE: ", before the first waypoint",
    AFTER: ", after the last waypoint",
    OFF: ", off the path",
}
"""Ends of the names of findings about parts of a motion, and what they mean."""
_SCALES = {"m": (1e3, "mm"), "rad": (math.degrees(1.0), "°"), "rad/s": (math.degrees(1.0), "°/s")}


class Amount(NamedTuple):
    """A number as it is shown."""

    value: float
    """In the finding's unit."""
    text: str
    unit: str


def amount(value: float, unit: str, *, margin: bool = False) -> Amount:
    """A finding's number: mm instead of m, degrees instead of rad, margins in per cent."""
    scale, shown = (100.0, "%") if margin else _SCALES.get(unit, (1.0, unit))
    if unit == "s":  # as the cycle time
        return Amount(value, f"{value:.4g}", shown)
    return Amount(value, digits(scale * value), shown)


def digits(value: float) -> str:
    """Three significant digits, at most three decimals, without an exponent."""
    if not math.isfinite(value):
        return "∞" if value > 0.0 else "−∞"
    if abs(value) < 5e-4:
        return "0" if value == 0.0 else "<\u20090.001" if value > 0.0 else ">\u2009−0.001"
    places = max(0, 2 - math.floor(math.log10(abs(value))))
    text = f"{value:.{min(places, 3)}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return text.replace("-", "−")


def data(amount: Amount, of: str) -> str:
    """A number of a finding as HTML, with its value in full."""
    return (
        f'<data value="{amount.value!r}" data-of="{html.escape(of, quote=True)}">'
        f"{html.escape(amount.text)}</data>{html.escape(spaced(amount.unit))}"
    )


def spaced(unit: str) -> str:
    """A unit as it follows its number: degrees without a space, nothing for no unit."""
    return unit if unit in ("", "°") else f"\u00a0{unit}"


def quantity(finding: Finding) -> str:
    """What a finding measures."""
    name = finding.name
    for part in _PARTS:
        name = name.removesuffix(part)
    plain = _QUANTITIES.get(name)
    if plain is None:
        plain = name[:1].upper() + name[1:]
    return plain


def part(finding: Finding) -> str:
    """The part of the motion that a finding is about; empty for the waypoints."""
    return next((words for end, words in _PARTS.items() if finding.name.endswith(end)), "")


def is_margin(finding: Finding) -> bool:
    """Whether the finding is the least margin of a joint, as a share of its half range."""
    return finding.name == "smallest joint margin"


def shown(finding: Finding) -> Amount:
    """The finding's value."""
    return amount(finding.value, finding.unit, margin=is_margin(finding))


def problem(finding: Finding, source: str = "") -> str:
    """A sentence for what does not pass, HTML, with the source of its limit if not the task's."""
    found = data(shown(finding), finding.name)
    if quantity(finding) == TOO_NEAR:
        return f"{TOO_NEAR}: by {found}, at {html.escape(finding.where)}."
    if is_margin(finding):
        where = html.escape(finding.where)
        return f"A joint leaves its range: {where} (by {found} of half the range)."
    limit = ""
    if finding.limit is not None:
        allowed = amount(finding.limit, finding.unit)
        limit = f", allowed {allowed.text}{html.escape(spaced(allowed.unit))}"
        limit += source and f" of {html.escape(source)}"
    sentence = f"{quantity(finding)}: {found}{limit}, at {html.escape(finding.where)}"
    if finding.proven:
        return f"{sentence}."
    return (
        f"{sentence}. More than allowed cannot be excluded between the points that were looked at; "
        "points closer together would decide it."
    )


def problems(check: Check) -> list[str]:
    """Where it leaves its path, then the worst of each quantity that does not pass, HTML."""
    worst: dict[str, Finding] = {}
    for finding in check.findings:
        if finding.passes:
            continue
        name = quantity(finding)
        if name not in worst or _excess(finding) > _excess(worst[name]):
            worst[name] = finding
    left = [f"The motion {html.escape(words)}." for words in check.path_left]
    sources = _sources(check)
    others = [problem(finding, sources.get(finding.name, "")) for finding in worst.values()]
    return [*left, *others]


def _sources(check: Check) -> dict[str, str]:
    """Where limits of joints are from that are not the task's, by the finding's name."""
    limits = check.limits
    speeds = f"the {limits.speeds_of}'s data sheet" if limits.speeds_of else ""
    return {"velocity limits": speeds, "acceleration limits": limits.accelerations_of}


def _excess(finding: Finding) -> float:
    if finding.limit is None or is_margin(finding):
        return -finding.value
    return finding.value / max(finding.limit, 1e-12)


def kept(path_task: PathTask, check: Check) -> str:
    """What a motion that passes keeps, in one sentence; with sources of limits not the task's."""
    names = {finding.name for finding in check.findings}
    parts = ["the path"]
    if "smallest joint margin" in names:
        parts.append("the joints' ranges")
    for name, source in _sources(check).items():
        if name in names:
            what = name.replace("velocity", "speed")
            parts.append(f"the joints' {what}{source and f' ({source})'}")
    if path_task.clearances:
        parts.append("the distance from obstacles")
    if "outside a band" in names:
        parts.append("the tolerance bands")
    parts += [
        f"the limits of {constraint.kind}"
        for constraint in path_task.stated_constraints
        if constraint not in path_task.clearances
    ]
    listed = parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
    sentence = f"The motion keeps {listed}: at every waypoint and, proven, everywhere between them."
    found = {part(finding) for finding in check.findings}
    sides = [_PARTS[side].removeprefix(", ") for side in (BEFORE, AFTER) if _PARTS[side] in found]
    if sides:
        where = " and ".join(sides).capitalize()
        sentence += f" {where}, where there is no path, it keeps the rest, proven too."
    return sentence


_HELD = {
    ProjectorKind.FULL: ("position", "orientation", ""),
    ProjectorKind.PLANE: (
        "position in a plane", "direction of one axis", "; free: the rotation about it",
    ),
    ProjectorKind.LINE: (
        "position along a line", "rotation about one axis", "; free: the direction of that axis",
    ),
    ProjectorKind.NONE: ("", "", "; free: the orientation"),
}  # fmt: skip
"""What a projector holds as a linear block, as an angular one, and what this leaves free."""


def what_is_free(projector: TwistProjector) -> str:
    """What the task holds, and what it leaves free."""
    angular = _HELD[projector.angular.kind]
    return " and ".join(filter(None, (_HELD[projector.linear.kind][0], angular[1]))) + angular[2]


def facts(path_task: PathTask, check: Check, file: str) -> dict[str, str]:
    """What a motion was made of: robot, tool, path, files, versions, in plain text.

    Args:
        path_task: The task.
        check: The check of the motion.
        file: Name of the motion's file; empty without one.
    """
    steps = np.linalg.norm(np.diff(path_task.positions, axis=0), axis=1)
    length = float(steps[~in_joint_moves(path_task)].sum())
    held = dict.fromkeys(what_is_free(projector) for projector in path_task.projectors)
    found = {
        "Robot": _robot(path_task),
        "Moving frame": f"{path_task.frame_name} ({path_task.frame_type})",
        "Path lies on": path_task.relative_to or "",
        "Held along the path": "; then ".join(held),
        "Toolpath": _toolpath(path_task),
        "Path": f"{len(path_task.waypoints)} waypoints, {digits(length)} m",
        "Task file": "built in Python" if path_task.source is None else path_task.source.name,
        "Motion": f"{file + ', ' if file else ''}{check.rows} points",
        "Tolerances": f"{digits(1e3 * check.tolerances.position)} mm, "
        f"{digits(math.degrees(check.tolerances.axis))}°",
        "Limits": "; ".join(check.sources),
        "Notes": "; ".join(check.notes),
        "Date": datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M"),
        "Made by": f"qp_twist {__version__}, MuJoCo {version('mujoco')}",
    }
    return {name: text for name, text in found.items() if text}


def _robot(path_task: PathTask) -> str:
    """The known robot and where its figures are from; else the scene's name."""
    names = (path_task.scene.stem, path_task.scene.parent.name)
    known = known_robot(*path_task.arm, names)
    if known is not None:
        return f"{known.name}, recognised by name and geometry ({known.source})"
    title = path_task.model.names.split(b"\0", 1)[0].decode(errors="replace")
    name = title if title and title != "MuJoCo Model" else path_task.scene.stem
    return f"{name}, {path_task.scene.name}; not in the table of known robots"


def _toolpath(path_task: PathTask) -> str:
    toolpath = path_task.toolpath
    if toolpath is None:
        return "stated in the task file"
    curves = len(toolpath.curves)
    return f"{toolpath.source.name}, {curves} {'curve' if curves == 1 else 'curves'}"
