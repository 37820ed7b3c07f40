r"""How controllers tell the joints at a pose of the tool: configuration data, from joints and back.

Most poses have eight branches of a six-axis arm with a spherical wrist. With the axes of the known
robot (:class:`~qp_twist.robots.KnownRobot`), at angles θ as its controller counts them without a
coupling, they differ in three ways:

* ``behind``: the centre of the wrist is behind the first axis, x < 0 in the frame that turns with
  it;
* ``folded``: seen from the shoulder (axis 2), the centre is behind the line through the elbow
  (axis 3): :math:`\mathbf y \cdot (\mathbf e - \mathbf s) \times (\mathbf c - \mathbf s) < 0`, with
  y that of the base turned with the first axis;
* the sign of θ₅.

Where an axis has more than a turn, the data also say which. Each rule is a number's meaning as
ranges of single axes, and the two places:

============ ==================================================================================
RAPID        ``[cf1, cf4, cf6, cfx]``: quadrants of axes 1, 4 and 6,
             :math:`\lfloor\theta/90°\rfloor`; cfx = 4 behind + 2 folded + (θ₅ < 0), and 0 of an
             arm with parallel rods
KRL          S = behind + 2 (not folded) + 4 (A5 < 0); bit i − 1 of T: Ai < 0
LS           F (θ₅ > 0) or N, D (folded) or U, B (behind) or T, here as 1 or 0; then the turns
             of J4, J5 and J6, :math:`\lfloor(\theta + 180°)/360°\rfloor`
============ ==================================================================================

Sources. RAPID: ABB, *Technical reference manual, RAPID Instructions, Functions and Data types*
(3HAC050917), confdata; its table of cfx as in ``AXIS_CONFIGURATION.md`` of CEAD-group's
py-opw-kinematics. Arms with parallel rods: the three quadrants of ABB's *RAPID Reference Manual* of
the S4 controllers, confdata; many robots do not use cfx (ABB, *RobotStudio API*,
``ConfigurationData.Cfx``, ``Mechanism.UsesCfx``). That these arms are among them, and that their
rods keep them from folding, is assumed; then the quadrants tell the joints, since axis 1 differs by
180° where the arm is behind it, and axis 4 with the sign of θ₅. KRL: bit 0 as KUKA's expert
programming manual has it (quoted in robot-forum.com, thread 7173); bits 1 and 2 as Beckhoff states
them for its own Status & Turn (TF5200, *Status & Turn (IS, IT)*), and as public programs have them:
S 2 with T 2, 3, 10, 11, 34 and 35, all A5 ≥ 0, and S 6 with T 27, A5 < 0. LS: FANUC, *Operator's
manual*, positional data; the sign of J5 is that of public programs, whose tools point downwards,
J5 = −90°, as ``N U T``.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.geometry import rotation_matrix
from qp_twist.robots.axis_geometry import Line
from qp_twist.robots.known_robots import KnownRobot

_NEAR_DEG = 1e-2
"""How far beyond the end of a range an angle may be, degrees: poses are printed with digits by
which an angle differs by less, unless the arm is so close to a singularity that no rule tells the
joints."""
_NEAR = 1e-5
"""Likewise of the wrist's centre from where branches meet, m."""
_MEETS = 2e-3
"""Distance of axes that meet, m, as in the comparison of axes."""
_ALL = (-np.inf, np.inf)
Range = tuple[float, float]


class ArmPlace(NamedTuple):
    """Distances of the wrist's centre, m: before the first axis, and before the lower arm."""

    before_axis: float
    before_arm: float


class Meaning(NamedTuple):
    """What configuration data say: the range of each axis, degrees, and the places, if any."""

    ranges: tuple[Range, ...]
    behind: bool | None
    folded: bool


class _Rule(NamedTuple):
    """The data of a language from angles, degrees, ``behind`` and ``folded``, and their meaning."""

    numbers: int
    of: Callable[[Array, bool, bool], tuple[int, ...]]
    meaning: Callable[[Sequence[int]], Meaning]


def _bits(*flags: bool | np.bool_) -> int:
    return sum(1 << place for place, flag in enumerate(flags) if flag)


def _quadrant(number: int) -> Range:
    return 90.0 * number, 90.0 * (number + 1)


def _turn(number: int) -> Range:
    return 360.0 * number - 180.0, 360.0 * number + 180.0


def _signed(negative: int | bool, most: float = np.inf) -> Range:
    return (-most, 0.0) if negative else (0.0, most)


def _rapid(data: Sequence[int]) -> Meaning:
    one, four, six, x = data
    if not 0 <= x <= 7:
        raise InvalidInput(f"cfx is {x}; expected 0 to 7.")
    ranges = (_quadrant(one), _ALL, _ALL, _quadrant(four), _signed(x & 1), _quadrant(six))
    return Meaning(ranges, bool(x & 4), bool(x & 2))


def _rods(data: Sequence[int]) -> Meaning:
    one, four, six, x = data
    if x:
        raise InvalidInput(f"cfx is {x}; of an arm with parallel rods expected 0.")
    less = (-180.0, 180.0)  # than half a turn to either side
    return Meaning((_quadrant(one), less, less, _quadrant(four), less, _quadrant(six)), None, False)


def _krl(data: Sequence[int]) -> Meaning:
    status, turn = data
    if not (0 <= status <= 31 and 0 <= turn <= 63):
        raise InvalidInput(f"S {status}, T {turn}; expected S from 0 to 31, and T from 0 to 63.")
    ranges = [_signed(turn >> k & 1, 360.0) for k in range(6)]
    if (turn >> 4 & 1) != (status >> 2 & 1):
        ranges[4] = (0.0, 0.0)  # then both say that A5 is 0, or contradict each other
    return Meaning(tuple(ranges), bool(status & 1), not status & 2)


def _ls(data: Sequence[int]) -> Meaning:
    flip, down, back, four, five, six = data
    bent = _signed(not flip)
    low, high = _turn(five)
    ranges = (_ALL, _ALL, _ALL, _turn(four), (max(low, bent[0]), min(high, bent[1])), _turn(six))
    return Meaning(ranges, bool(back), bool(down))


RULES: dict[str, _Rule] = {
    "rapid": _Rule(
        4,
        lambda deg, behind, folded: (
            *(int(deg[k] // 90.0) for k in (0, 3, 5)), _bits(deg[4] < 0.0, folded, behind)
        ),
        _rapid,
    ),
    "rapid, rods": _Rule(
        4, lambda deg, behind, folded: (*(int(deg[k] // 90.0) for k in (0, 3, 5)), 0), _rods
    ),
    "krl": _Rule(
        2,
        lambda deg, behind, folded: (
            _bits(behind, not folded, deg[4] < 0.0), _bits(*(deg < 0.0))
        ),
        _krl,
    ),
    "ls": _Rule(
        6,
        lambda deg, behind, folded: (
            int(deg[4] > 0.0), int(folded), int(behind),
            *(int((angle + 180.0) // 360.0) for angle in deg[3:]),
        ),
        _ls,
    ),
}  # fmt: skip
"""By the language of the controller."""


def _rule_of(robot: KnownRobot) -> _Rule:
    refuse_without_rule(robot)
    rods = robot.program == "rapid" and robot.coupling is not None
    return RULES["rapid, rods" if rods else str(robot.program)]


def refuse_without_rule(robot: KnownRobot) -> None:
    """Refuse an arm for which no rule is known.

    Raises:
        InvalidInput: With the reason.
    """
    lines = robot.lines
    if robot.program not in RULES:
        why = f"is programmed in {robot.program or 'none of the languages'}, which has none"
    elif len(lines) != 6 or _wrist(lines) is None or _sine(lines[1], lines[2]) > 1e-6:
        why = "is no arm of six axes with a spherical wrist, the second parallel to the third"
    else:
        return
    raise InvalidInput(
        f"no configuration data are known for the {robot.name}: it {why}. Write points as joint "
        "angles."
    )


def configuration(robot: KnownRobot, theta: Array) -> tuple[int, ...]:
    """The configuration data at angles θ, rad, (6,).

    Raises:
        InvalidInput: If no rule is known for the robot.
    """
    rule, place = _rule_of(robot), arm_place(robot, theta)
    return rule.of(np.degrees(theta), place.before_axis < 0.0, place.before_arm < 0.0)


def angles_of(
    robot: KnownRobot, branches: Array, data: Sequence[int], near: Array | None = None
) -> Array:
    """The one of the branches of a pose, with its turns, that configuration data name, rad, (6,).

    Args:
        robot: The robot.
        branches: Angles θ of the branches, rad, (B, 6), up to whole turns.
        data: The data.
        near: Angles, rad, (6,), to the nearest of which goes what the data leave open: turns of
            axes of which they say none. ``None``: that is refused.

    Raises:
        InvalidInput: If none has these data inside the ranges of the robot, or several.
    """
    meaning = meaning_of(robot, data)
    found: list[Array] = []
    for theta in np.degrees(branches):
        choices = []
        for axis, (angle, bounds) in enumerate(zip(theta, meaning.ranges, strict=True)):
            low, high = bounds if robot.range_deg is None else _both(bounds, robot.range_deg[axis])
            low, high = max(low, -720.0) - _NEAR_DEG, min(high, 720.0) + _NEAR_DEG
            first = angle + 360.0 * np.ceil((low - angle) / 360.0)
            choices.append(np.arange(first, high, 360.0))
        for each in itertools.product(*choices):
            angles = np.radians(each)
            if _is_placed(arm_place(robot, angles), meaning):
                found.append(angles)
    if near is not None:
        found.sort(key=lambda each: float(np.abs(each - near).max()))
        found = found[:1]
    apart = 0.0 if len(found) < 2 else max(float(np.abs(x - found[0]).max()) for x in found)
    if not found or apart > np.radians(_NEAR_DEG):
        count = "several joint positions have" if found else "no joint position in its ranges has"
        raise InvalidInput(
            f"at this pose of the {robot.name} {count} the configuration "
            f"[{', '.join(map(str, data))}]."
        )
    return found[0]


def meaning_of(robot: KnownRobot, data: Sequence[int]) -> Meaning:
    """What configuration data say of a robot.

    Raises:
        InvalidInput: If no rule is known for it, or the data are none of its language.
    """
    rule = _rule_of(robot)
    if len(data) != rule.numbers:
        raise InvalidInput(f"expected {rule.numbers} numbers of a configuration, got {len(data)}.")
    return rule.meaning(data)


def has_configuration(robot: KnownRobot, theta: Array, data: Sequence[int]) -> bool:
    """Whether angles θ, rad, (6,), are those that configuration data name."""
    meaning, degrees = meaning_of(robot, data), np.degrees(theta)
    inside = all(
        low - _NEAR_DEG <= angle <= high + _NEAR_DEG
        for angle, (low, high) in zip(degrees, meaning.ranges, strict=True)
    )
    return inside and _is_placed(arm_place(robot, theta), meaning)


def arm_place(robot: KnownRobot, theta: Array) -> ArmPlace:
    """Where the wrist's centre is at angles θ, rad, (6,)."""
    lines = robot.lines
    centre = _wrist(lines)
    assert centre is not None
    shoulder, elbow = lines[1].point, lines[2].point
    # In the plane of the arm: along axis 2 from each point nothing changes.
    for line, angle in ((lines[2], theta[2]), (lines[1], theta[1])):
        turn = rotation_matrix(angle * line.axis)
        centre = line.point + turn @ (centre - line.point)
        if line is lines[1]:
            elbow = shoulder + turn @ (elbow - shoulder)
    aside = np.array([0.0, 1.0, 0.0])
    arm = elbow - shoulder
    before = float(aside @ np.cross(arm, centre - shoulder)) / float(np.linalg.norm(arm))
    return ArmPlace(float(centre[0] - lines[0].point[0]), before)


def _is_placed(place: ArmPlace, meaning: Meaning) -> bool:
    """Whether the wrist's centre is where the data have it."""
    pairs = zip((meaning.behind, meaning.folded), place, strict=True)
    return all(wrong is None or (-each if wrong else each) >= -_NEAR for wrong, each in pairs)


def _both(one: Range, other: Range) -> Range:
    return max(one[0], other[0]), min(one[1], other[1])


def _sine(one: Line, two: Line) -> float:
    return float(np.linalg.norm(np.cross(one.axis, two.axis)))


def _wrist(lines: Sequence[Line]) -> Array | None:
    """The point where the last three axes meet, m; ``None`` if they do not."""
    across = [np.eye(3) - np.outer(line.axis, line.axis) for line in lines[3:]]
    target = sum(side @ line.point for side, line in zip(across, lines[3:], strict=True))
    point = np.asarray(np.linalg.solve(sum(across), target), dtype=float)
    off = [
        np.linalg.norm(side @ (point - line.point))
        for side, line in zip(across, lines[3:], strict=True)
    ]
    return point if max(off) < _MEETS else None
