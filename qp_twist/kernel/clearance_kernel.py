"""Distances of many pairs of shapes on a tree of hinges and slides, at many configurations."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.kernel.compiling import entry, part, plain
from qp_twist.kernel.convex import SHAPE, SIMPLEX, at_least, cross, dot, minus, pair_distance
from qp_twist.kernel.rotations import rotation_of, turn_about

_F, _I = np.float64, np.int64
FIXED_TO_MOCAP, NO_MOCAP = -1, -2
"""Entries of ``mocap`` that are no number of a mocap body."""

BODY = np.dtype(
    [
        ("parent", _I),
        ("moves", _I),  # whether a joint moves it
        ("mocap", _I),  # its number among the mocap bodies, or one of the two above
        ("offset", _F, 3),  # its position in its parent's frame, m
        ("turned", _F, 9),  # its rotation there
        ("first", _I),  # of its joints
        ("joints", _I),  # their number
        ("x", _F, 3),  # its position in the world, m; given of bodies that do not move
        ("R", _F, 9),
        ("x_now", _F, 3),  # of an obstacle: at the beginning of the step
        ("R_now", _F, 9),
        ("x_then", _F, 3),  # of an obstacle: where it is expected after the step
        ("R_then", _F, 9),
        ("shift", _F),  # of an obstacle: how far it is from where it was expected, m
        ("turn", _F),  # likewise its rotation, as the length 2 sin(θ/2) of a chord
    ],
    align=True,
)
"""A body, numbered as in the model; parents come before their children."""

JOINT = np.dtype(
    [
        ("slides", _I),  # whether it is a slide; else a hinge
        ("own_axis", _F, 3),  # in its body's frame
        ("own_anchor", _F, 3),
        ("address", _I),  # of its coordinate in q
        ("reference", _F),  # its reference coordinate, rad or m
        ("dof", _I),
        ("axis", _F, 3),  # in the world
        ("anchor", _F, 3),
    ],
    align=True,
)

PAIR = np.dtype(
    [
        ("one", _I),  # shape A
        ("other", _I),  # shape B
        ("first", _I),  # index in ``links`` of the first joint that moves A but not B
        ("middle", _I),  # that of the first one that moves B but not A
        ("last", _I),  # behind the last of them
        ("obstacle", _I),  # whether A or B moves with an obstacle
        ("change", _F),  # scratch: largest change of the distance on a way, m
        ("near", _F),  # scratch: distance at the beginning of the way, m
        ("bend", _F),  # scratch: second derivative
        ("unforeseen", _F),  # by how much nearer an obstacle may be than it is expected, m
        # Of one step (clearance_rows):
        ("kept", _F),  # the distance to keep, m
        ("reach", _F),  # from this margin on it matters to no velocity of the step, m
        ("worst", _F),  # least margin on the way, m; a bound if it is above ``reach``
        ("sample", _I),  # number n of the step in which it is found
        ("still", _F),  # the same if nothing else moved, of a pair with an obstacle
        ("floor", _F),  # what may be left of the margin: 0, or less if the pair returns, m
        ("normal", _F, 3),  # direction of the distance where the row is from; 0 without a row
    ],
    align=True,
)


class Cell(NamedTuple):
    """A tree of bodies, the shapes on it, their pairs, and scratch."""

    bodies: npt.NDArray[Any]
    joints: npt.NDArray[Any]
    shapes: npt.NDArray[Any]
    vertices: npt.NDArray[np.float64]
    """Of all meshes, (V, 3), m."""
    pairs: npt.NDArray[Any]
    links: npt.NDArray[np.int64]
    """The joints that change the distance of each pair, from the shape inwards."""
    simplex: npt.NDArray[Any]
    """One ``SIMPLEX``."""

    @classmethod
    def empty(
        cls, bodies: int, joints: int, shapes: int, vertices: int, pairs: int, links: int
    ) -> Cell:
        """Zeros."""
        return cls(
            np.zeros(bodies, BODY), np.zeros(joints, JOINT), np.zeros(shapes, SHAPE),
            np.zeros((vertices, 3)), np.zeros(pairs, PAIR), np.zeros(links, np.int64),
            np.zeros(1, SIMPLEX),
        )  # fmt: skip

    def copy(self) -> Cell:
        """A copy, for another thread."""
        return Cell._make(array.copy() for array in self)


@part
def _in_world(frame, p, out):
    """out = x + R p: a point of a body or shape."""
    x, R = frame.x, frame.R
    out[0] = x[0] + R[0] * p[0] + R[1] * p[1] + R[2] * p[2]
    out[1] = x[1] + R[3] * p[0] + R[4] * p[1] + R[5] * p[2]
    out[2] = x[2] + R[6] * p[0] + R[7] * p[1] + R[8] * p[2]


@part
def _turned(R, v, out):
    """out = R v, with R (9,)."""
    out[0] = R[0] * v[0] + R[1] * v[1] + R[2] * v[2]
    out[1] = R[3] * v[0] + R[4] * v[1] + R[5] * v[2]
    out[2] = R[6] * v[0] + R[7] * v[1] + R[8] * v[2]


@part
def _product(A, B, out):
    """out = A B of rotations (9,)."""
    for i in range(0, 9, 3):
        for j in range(3):
            out[i + j] = A[i] * B[j] + A[i + 1] * B[3 + j] + A[i + 2] * B[6 + j]


@plain
def place(cell, q):
    """Write where bodies, joints and shapes are at a configuration q (nq,)."""
    bodies, shapes = cell.bodies, cell.shapes
    for b in range(len(bodies)):
        body = bodies[b]
        if not body.moves:
            continue
        parent = bodies[body.parent]
        _in_world(parent, body.offset, body.x)
        _product(parent.R, body.turned, body.R)
        for j in range(body.first, body.first + body.joints):
            joint = cell.joints[j]
            travel = q[joint.address] - joint.reference
            _turned(body.R, joint.own_axis, joint.axis)
            _in_world(body, joint.own_anchor, joint.anchor)
            if joint.slides:
                for i in range(3):
                    body.x[i] += travel * joint.axis[i]
                continue
            turn_about(joint.axis, travel, body.R)
            _turned(body.R, joint.own_anchor, body.x)
            for i in range(3):
                body.x[i] = joint.anchor[i] - body.x[i]
    for g in range(len(shapes)):
        shape = shapes[g]
        body = bodies[shape.body]
        _in_world(body, shape.at, shape.x)
        _product(body.R, shape.about, shape.R)
        _in_world(shape, shape.center, shape.middle)


@plain
def show_obstacles(cell, ahead):
    """Place the obstacles where they are now, or where they are expected after the step."""
    for b in range(len(cell.bodies)):
        body = cell.bodies[b]
        if body.mocap != NO_MOCAP:
            x, R = (body.x_then, body.R_then) if ahead else (body.x_now, body.R_now)
            for i in range(3):
                body.x[i] = x[i]
            for i in range(9):
                body.R[i] = R[i]


@entry
def move_obstacles(cell, positions, quaternions, has_moved):
    """Take the poses of obstacles, and expect them to go on as they did since this was last called.

    What is unforeseen is by how much they are not where they were expected now: an obstacle that
    goes on changing its speed as it does is again off by as much.

    ``positions`` (mocap, 3) and ``quaternions`` (mocap, 4) are those of the mocap bodies,
    ``has_moved`` whether their last poses are known. Returned is −1, or the first of these bodies
    whose pose is none; then nothing is changed.
    """
    for number in range(len(positions)):
        square = 0.0
        for i in range(4):
            square += quaternions[number, i] ** 2
        total = positions[number, 0] + positions[number, 1] + positions[number, 2]
        # Written so that NaN is refused.
        if not (abs(total) < math.inf and square > 0.0 and square < math.inf):
            return number
    for b in range(len(cell.bodies)):
        body = cell.bodies[b]
        if body.mocap == NO_MOCAP:
            continue
        if body.mocap == FIXED_TO_MOCAP:
            parent = cell.bodies[body.parent]
            _in_world(parent, body.offset, body.x)
            _product(parent.R, body.turned, body.R)
        else:
            for i in range(3):
                body.x[i] = positions[body.mocap, i]
            rotation_of(quaternions[body.mocap], body.R)
        if has_moved:
            body.shift, body.turn = _apart(body.x, body.x_then), _chord(body.R, body.R_then)
        _expect(body, has_moved)
    for k in range(len(cell.pairs)):
        pair = cell.pairs[k]
        pair.unforeseen = _off(cell, pair.one, pair.other) + _off(cell, pair.other, pair.one)
    return -1


@part
def _apart(a, b):
    """‖a − b‖."""
    difference = minus(a, b)
    return math.sqrt(dot(difference, difference))


@part
def _chord(A, B):
    """The chord 2 sin(θ/2) of the angle θ from one rotation (9,) to another."""
    square = 0.0
    for i in range(9):
        square += (A[i] - B[i]) ** 2
    return math.sqrt(0.5 * square)


@plain
def _expect(body, has_moved):
    """Write the pose of an obstacle now, and where it is after the step if it goes on."""
    R, before = body.R, body.R_now
    for i in range(3):
        body.x_then[i] = body.x[i] + (body.x[i] - body.x_now[i] if has_moved else 0.0)
        body.x_now[i] = body.x[i]
        for j in range(3):
            total = 0.0
            for k in range(3):
                for n in range(3):  # R Rᵀ_before R
                    total += R[3 * i + k] * before[3 * n + k] * R[3 * n + j]
            body.R_then[3 * i + j] = total if has_moved else R[3 * i + j]
    for i in range(9):
        before[i] = R[i]


@plain
def _off(cell, g, h):
    """By how much a point of shape g that may be nearest to h is not where it was expected, m.

    A point at the distance r from the body's origin is off by at most the body's shift plus r times
    its turn.
    """
    shape, other = cell.shapes[g], cell.shapes[h]
    body = cell.bodies[shape.body]
    if body.turn == 0.0:
        return body.shift
    if math.isinf(shape.ball):  # a plane
        lever = _apart(other.middle, body.x) + other.ball
    else:
        own = math.sqrt(dot(shape.center, shape.center)) + shape.ball
        lever = math.sqrt(dot(shape.at, shape.at)) + own
    return body.shift + body.turn * lever


@part
def distance_of(cell, pair, enough, least):
    """Signed distance of a pair, as ``pair_distance``; a lower bound above ``enough``."""
    a, b = cell.shapes[pair.one], cell.shapes[pair.other]
    lower = at_least(a, b, enough)
    if lower > enough:
        return lower
    return pair_distance(a, b, cell.vertices, enough, cell.simplex[0], least)


@entry
def distances(cell, q, enough, out):
    """Write the signed distances of all pairs at configurations q (N, nq) to out (N, P), m.

    A distance above ``enough`` is replaced by a lower bound above it.
    """
    show_obstacles(cell, False)
    for row in range(len(q)):
        place(cell, q[row])
        for k in range(len(cell.pairs)):
            out[row, k] = distance_of(cell, cell.pairs[k], enough, -math.inf)


@entry
def first_below(cell, q, distance, out):
    """Write to out (N,) the first pair nearer than ``distance`` at q (N, nq), or −1."""
    show_obstacles(cell, False)
    enough = max(distance, 0.0)
    for row in range(len(q)):
        place(cell, q[row])
        out[row] = -1
        for k in range(len(cell.pairs)):
            if distance_of(cell, cell.pairs[k], enough, distance) < distance:
                out[row] = k
                break


@part
def _arm_of(joint, shape):
    """Largest distance of the points of a shape's ball from the axis of a hinge, m."""
    across = cross(joint.axis, minus(shape.middle, joint.anchor))
    return math.sqrt(dot(across, across)) + shape.ball


@plain
def _motion_of(cell, pair, travel, curve):
    """Bounds of the first and second derivative of the vector between points of a pair, m.

    A point of a shape at the distance r from a hinge's axis moves by at most r |θ|, and r changes
    by no more than the joints between them move the shape. A hinge that turns by θ bends the way of
    such a point by θ² r, and by another 2 θ c if the joints behind it move the point by c. Slides
    bend nothing. Second derivatives of the joints, at most ``curve`` (nv,), count as travel does.
    """
    total, change, bend = 0.0, 0.0, 0.0
    for k in range(pair.first, pair.last):
        if k == pair.middle:
            total, change = change, 0.0
        joint = cell.joints[cell.links[k]]
        moved, curved = travel[joint.dof], curve[joint.dof]
        if joint.slides:
            change += moved
            bend += curved
            continue
        arm = _arm_of(joint, cell.shapes[pair.one if k < pair.middle else pair.other]) + change
        bend += moved * (moved * arm + 2.0 * change) + curved * arm
        change += moved * arm
    return total + change, bend


@plain
def change_of(cell, pair, travel):
    """Largest change of a pair's distance while joints travel by at most ``travel`` (nv,), m."""
    return _motion_of(cell, pair, travel, travel)[0]


@plain
def _least_between(near, far, change, bend):
    """Lower bound of a distance on the way, from those at its ends, m; see least_distances."""
    least = max(near - change, far - change, 0.5 * (near + far - change))
    if not (near > 0.0 and far > 0.0 and bend < math.inf):
        return least
    begin, end = near * near, far * far
    curve = 2.0 * change * change + (near + far + change) * bend
    low = min(begin, end)
    if abs(end - begin) < 0.5 * curve:
        low = 0.5 * (begin + end) - 0.125 * curve - (end - begin) ** 2 / (2.0 * curve)
    return max(least, math.sqrt(low)) if low > 0.0 else least


@entry
def changes(cell, q, travel, out):
    """Write bounds (N, P) of the distances' variation on motions from q (N, nq), m."""
    show_obstacles(cell, False)
    for row in range(len(q)):
        place(cell, q[row])
        for k in range(len(cell.pairs)):
            out[row, k] = change_of(cell, cell.pairs[k], travel[row])


@entry
def least_distances(cell, before, after, travel, curve, distance, out):
    r"""Write lower bounds (N, P) of the distances on the way between two configurations, m.

    With the distances d₀ and d₁ at the ends and a variation of at most c, the least is at least
    d₀ − c, d₁ − c and (d₀ + d₁ − c)/2.

    It is more where the second derivatives of the joints are bounded, too. Two points of the shapes
    that are nearest at an instant are at other instants s at least d apart. The square of their
    distance is ‖w‖², with the second derivative 2‖w′‖² + 2 w·w″, where ‖w′‖ ≤ c, and ‖w″‖ ≤ A by
    :func:`_motion_of`. As d is at most (d₀ + d₁ + c)/2, no second derivative of d² is above

    .. math:: K = 2 c^2 + (d_0 + d_1 + c) A, \qquad
        d^2(s) \ge (1 - s)\,d_0^2 + s\,d_1^2 - \tfrac12 K s (1 - s).

    ``travel`` (N, nv) bounds the joints' path lengths, or, where their second derivatives are
    bounded by ``curve`` (N, nv), their first derivatives with respect to s, from 0 to 1. Bounds
    above ``distance`` may be less sharp.
    """
    show_obstacles(cell, False)
    for row in range(len(before)):
        place(cell, before[row])
        left = False
        for k in range(len(cell.pairs)):
            pair = cell.pairs[k]
            pair.change, pair.bend = _motion_of(cell, pair, travel[row], curve[row])
            pair.near = distance_of(cell, pair, distance + pair.change, -math.inf)
            out[row, k] = pair.near - pair.change
            left = left or out[row, k] < distance
        if not left:
            continue
        place(cell, after[row])
        for k in range(len(cell.pairs)):
            if out[row, k] < distance:
                pair = cell.pairs[k]
                far = distance_of(cell, pair, distance + pair.change, -math.inf)
                out[row, k] = _least_between(pair.near, far, pair.change, pair.bend)


@plain
def gradient_of(cell, pair, row):
    """Write the derivatives (nv,) of a pair's distance, from the nearest points."""
    found = cell.simplex[0]
    for j in range(len(row)):
        row[j] = 0.0
    for k in range(pair.first, pair.last):
        joint = cell.joints[cell.links[k]]
        moves_one = k < pair.middle
        if joint.slides:
            along = dot(joint.axis, found.away)
        else:
            arm = minus(found.on_a if moves_one else found.on_b, joint.anchor)
            along = dot(cross(joint.axis, arm), found.away)
        row[joint.dof] = along if moves_one else -along


@entry
def gradients(cell, q, which, out):
    """Write the derivatives (N, k, nv) of the distances of pairs ``which`` (N, k), −1 for none."""
    show_obstacles(cell, False)
    for row in range(len(q)):
        place(cell, q[row])
        for k in range(which.shape[1]):
            if which[row, k] < 0:
                continue
            pair = cell.pairs[which[row, k]]
            distance_of(cell, pair, math.inf, -math.inf)
            gradient_of(cell, pair, out[row, k])
