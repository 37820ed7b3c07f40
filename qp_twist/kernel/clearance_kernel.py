"""Distances of many pairs of shapes on a tree of hinges and slides, at many configurations."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from qp_twist.kernel.compiling import entry, part, plain
from qp_twist.kernel.convex import (
    SHAPES,
    SIMPLEX,
    CellSizes,
    Shapes,
    Simplex,
    at_least,
    pair_distance,
)
from qp_twist.kernel.record import Floats, Integers, RecordType, reader
from qp_twist.kernel.rotations import rotation_of, turn_about


class Tree(NamedTuple):
    """Bodies, numbered as in the model, their joints and the shapes on them; lengths in m."""

    moving: Annotated[Integers, "moving"]
    """The bodies that move, parents first."""
    parent: Annotated[Integers, "bodies"]
    offset: Annotated[Floats, "bodies", 3]
    """Position in the parent's frame."""
    turned: Annotated[Floats, "bodies", 9]
    """Rotation there."""
    joint_first: Annotated[Integers, "bodies"]
    """First joint of each body."""
    joint_count: Annotated[Integers, "bodies"]
    slides: Annotated[Integers, "joints"]
    """Whether a joint is a slide."""
    axis: Annotated[Floats, "joints", 3]
    """Its axis in its body's frame."""
    anchor: Annotated[Floats, "joints", 3]
    """Its position there."""
    address: Annotated[Integers, "joints"]
    """Address of its coordinate in q."""
    reference: Annotated[Floats, "joints"]
    """Its reference coordinate, rad or m."""
    body: Annotated[Integers, "shapes"]
    """Body of each shape."""
    at: Annotated[Floats, "shapes", 3]
    """Position of each shape in its body."""
    about: Annotated[Floats, "shapes", 9]
    """Rotation of each shape in its body."""


class Pairs(NamedTuple):
    """Pairs of shapes, and the joints that change their distance."""

    one: Annotated[Integers, "pairs"]
    """Shape A."""
    other: Annotated[Integers, "pairs"]
    """Shape B."""
    first: Annotated[Integers, "pairs"]
    """Index in ``joints`` of the first joint that moves A but not B."""
    middle: Annotated[Integers, "pairs"]
    """That of the first one that moves B but not A."""
    last: Annotated[Integers, "pairs"]
    """Behind the last of them."""
    joints: Annotated[Integers, "links"]
    """Joints, from the shape inwards."""
    dof: Annotated[Integers, "joints"]
    """Degree of freedom of each joint."""
    obstacle: Annotated[Integers, "pairs"]
    """Whether A or B moves with an obstacle."""


class Places(NamedTuple):
    """Where everything is at one configuration, in the world."""

    pose: Annotated[Floats, "bodies", 3]
    """Positions of bodies; those of fixed ones are given."""
    turn: Annotated[Floats, "bodies", 9]
    """Their rotations."""
    axis: Annotated[Floats, "joints", 3]
    anchor: Annotated[Floats, "joints", 3]
    x: Annotated[Floats, "shapes", 3]
    """Positions of shapes."""
    R: Annotated[Floats, "shapes", 9]
    """Their rotations."""
    center: Annotated[Floats, "shapes", 3]
    """Centres of their balls."""
    change: Annotated[Floats, "pairs"]
    """Scratch of :func:`least_distances`."""
    near: Annotated[Floats, "pairs"]
    """Likewise."""
    bend: Annotated[Floats, "pairs"]
    """Likewise."""
    center_before: Annotated[Floats, "shapes", 3]
    """Centres of the balls at the configuration before."""
    R_before: Annotated[Floats, "shapes", 9]
    """Rotations of the shapes there."""
    moved: Annotated[Floats, "shapes"]
    """By how much a point of each shape has moved at most, over all configurations, m."""
    ahead: Annotated[Floats, "shapes"]
    """By how much a point of each shape moves at most on the way that comes next, m."""
    lower: Annotated[Floats, "pairs"]
    """Lower bound of each distance, m, plus how far its shapes had moved when it was found."""
    unforeseen: Annotated[Floats, "pairs"]
    """By how much nearer an obstacle may be than it is expected, m; 0 of where it is now."""


class Cell(NamedTuple):
    """All of it, and scratch."""

    tree: Tree
    shapes: Shapes
    pairs: Pairs
    places: Places
    simplex: Simplex


CELL = RecordType(
    Cell, CellSizes, RecordType(Tree, CellSizes), SHAPES, RecordType(Pairs, CellSizes),
    RecordType(Places, CellSizes), SIMPLEX,
)  # fmt: skip
read_cell = reader(CELL)


@part
def _times(R, v, out):
    """out = R v, with R (9,)."""
    x, y, z = v[0], v[1], v[2]
    out[0] = R[0] * x + R[1] * y + R[2] * z
    out[1] = R[3] * x + R[4] * y + R[5] * z
    out[2] = R[6] * x + R[7] * y + R[8] * z


@part
def _product(A, B, out):
    """out = A B of rotations (9,)."""
    for i in range(0, 9, 3):
        for j in range(3):
            out[i + j] = A[i] * B[j] + A[i + 1] * B[3 + j] + A[i + 2] * B[6 + j]


@plain
def place(cell, q):
    """Write where bodies, joints and shapes are at a configuration q (nq,)."""
    tree, places = cell.tree, cell.places
    for k in range(len(tree.moving)):
        body = tree.moving[k]
        parent = tree.parent[body]
        x, R = places.pose[body], places.turn[body]
        _times(places.turn[parent], tree.offset[body], x)
        for i in range(3):
            x[i] += places.pose[parent, i]
        _product(places.turn[parent], tree.turned[body], R)
        first = tree.joint_first[body]
        for joint in range(first, first + tree.joint_count[body]):
            travel = q[tree.address[joint]] - tree.reference[joint]
            axis, anchor = places.axis[joint], places.anchor[joint]
            _times(R, tree.axis[joint], axis)
            _times(R, tree.anchor[joint], anchor)
            for i in range(3):
                anchor[i] += x[i]
            if tree.slides[joint]:
                for i in range(3):
                    x[i] += travel * axis[i]
                continue
            turn_about(axis, travel, R)
            _times(R, tree.anchor[joint], x)
            for i in range(3):
                x[i] = anchor[i] - x[i]
    for g in range(len(tree.body)):
        R, x = places.turn[tree.body[g]], places.pose[tree.body[g]]
        _times(R, tree.at[g], places.x[g])
        _product(R, tree.about[g], places.R[g])
        for i in range(3):
            places.x[g, i] += x[i]
    for g in range(len(places.x)):
        _times(places.R[g], cell.shapes.center[g], places.center[g])
        for i in range(3):
            places.center[g, i] += places.x[g, i]


@part
def _apart(places, body, x, R, off):
    """Write to ``off`` (2,) how far a pose is from that of a body: its shift, m, and its turn.

    A point at the distance r from the body's origin is off by at most the shift plus r times the
    turn, which is the length 2 sin(θ/2) of the chord.
    """
    shift, turn = 0.0, 0.0
    for i in range(3):
        shift += (places.pose[body, i] - x[i]) ** 2
    for i in range(9):
        turn += (places.turn[body, i] - R[i]) ** 2
    off[0], off[1] = math.sqrt(shift), math.sqrt(0.5 * turn)


@entry
def move_obstacles(
    now, then, integers, bodies, numbers, positions, quaternions, off, pose, has_moved
):  # fmt: skip
    """Take the poses of obstacles, and expect them to go on as they did since this was last called.

    What is unforeseen is by how much they are not where they were expected now: an obstacle that
    goes on changing its speed as it does is again off by as much.

    Args:
        now: Floats of the cell.
        then: The same, with obstacles where they are expected at the next call.
        integers: Its integers.
        bodies: The bodies that are obstacles or fixed to one, parents first, (M,).
        numbers: Number of each among the mocap bodies; −1 of one that is fixed to another, (M,).
        positions: Of the mocap bodies, (mocap, 3).
        quaternions: Their rotations, (mocap, 4).
        off: Scratch, (bodies, 2), 0 for other bodies.
        pose: Scratch, (12,).
        has_moved: Whether their last poses are known.

    Returns:
        −1; or the first of the mocap bodies whose pose is none, then nothing is changed.
    """
    for number in range(len(positions)):
        square = 0.0
        for i in range(4):
            square += quaternions[number, i] ** 2
        place = positions[number, 0] + positions[number, 1] + positions[number, 2]
        # Written so that NaN is refused.
        if not (abs(place) < math.inf and square > 0.0 and square < math.inf):
            return number
    cell, ahead = read_cell(now, integers, integers), read_cell(then, integers, integers)
    tree, here, there = cell.tree, cell.places, ahead.places
    x, R = pose[:3], pose[3:]
    for k in range(len(bodies)):
        body = bodies[k]
        if numbers[k] >= 0:
            for i in range(3):
                x[i] = positions[numbers[k], i]
            rotation_of(quaternions[numbers[k]], R)
        else:
            parent = tree.parent[body]
            _times(here.turn[parent], tree.offset[body], x)
            for i in range(3):
                x[i] += here.pose[parent, i]
            _product(here.turn[parent], tree.turned[body], R)
        off[body, 0] = off[body, 1] = 0.0
        if has_moved:
            _apart(there, body, x, R, off[body])
        _expect(here, there, body, x, R, has_moved)
    for pair in range(len(cell.pairs.one)):
        here_off = 0.0
        for side in range(2):
            g = cell.pairs.one[pair] if side == 0 else cell.pairs.other[pair]
            h = cell.pairs.other[pair] if side == 0 else cell.pairs.one[pair]
            body = tree.body[g]
            if off[body, 0] > 0.0 or off[body, 1] > 0.0:
                here_off += off[body, 0] + off[body, 1] * _lever(cell, g, h, body)
        there.unforeseen[pair] = here_off
    return -1


@plain
def _expect(here, there, body, x, R, has_moved):
    """Write the pose of a body now, and where it is then if it goes on."""
    for i in range(3):
        there.pose[body, i] = x[i] + (x[i] - here.pose[body, i] if has_moved else 0.0)
        here.pose[body, i] = x[i]
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                for n in range(3):  # R Rᵀ_before R
                    total += R[3 * i + k] * here.turn[body, 3 * n + k] * R[3 * n + j]
            there.turn[body, 3 * i + j] = total if has_moved else R[3 * i + j]
    for i in range(9):
        here.turn[body, i] = R[i]


@plain
def _lever(cell, g, h, body):
    """Distance from a body's origin within which its shape g may be nearest to h, m."""
    shapes, places, reach = cell.shapes, cell.places, 0.0
    if math.isinf(shapes.ball[g]):  # a plane
        for i in range(3):
            reach += (places.center[h, i] - places.pose[body, i]) ** 2
        return math.sqrt(reach) + shapes.ball[h]
    middle = 0.0
    for i in range(3):
        reach += cell.tree.at[g, i] ** 2
        middle += shapes.center[g, i] ** 2
    return math.sqrt(reach) + math.sqrt(middle) + shapes.ball[g]


@plain
def distance_of(cell, pair, enough, deep):
    """Signed distance of a pair, as ``pair_distance``; a lower bound above ``enough``."""
    g, h, at = cell.pairs.one[pair], cell.pairs.other[pair], cell.places
    lower = at_least(cell.shapes, g, h, at.x, at.R, at.center, enough)
    if lower > enough:
        return lower
    return pair_distance(cell.shapes, g, h, at.x, at.R, enough, cell.simplex, deep)


@plain
def _place_next(cell, q, is_first):
    """Place everything at the next configuration, and add up how far each shape has moved at most.

    The motion of a shape is at most that of its ball's centre, and the chord of its turn times the
    ball's radius. Along a path or through a layer configurations follow each other closely: a pair
    that was far apart is known to be so at many of them.
    """
    place(cell, q)
    shapes, places = cell.shapes, cell.places
    for g in range(len(places.x)):
        shift, turn = 0.0, 0.0
        for i in range(3):
            shift += (places.center[g, i] - places.center_before[g, i]) ** 2
            places.center_before[g, i] = places.center[g, i]
        for i in range(9):
            turn += (places.R[g, i] - places.R_before[g, i]) ** 2
            places.R_before[g, i] = places.R[g, i]
        if is_first:
            places.moved[g] = 0.0
            continue
        places.moved[g] += math.sqrt(shift)
        if turn > 0.0:  # a plane, whose ball is infinite, mostly stands still
            places.moved[g] += math.sqrt(0.5 * turn) * shapes.ball[g]
    if is_first:
        for pair in range(len(places.lower)):
            places.lower[pair] = -math.inf


@plain
def _next_distance_of(cell, pair, enough, deep):
    """As :func:`distance_of` after :func:`_place_next`, not computed where a bound is known."""
    places = cell.places
    moved = places.moved[cell.pairs.one[pair]] + places.moved[cell.pairs.other[pair]]
    lower = places.lower[pair] - moved
    if lower > enough:
        return lower
    lower = distance_of(cell, pair, enough, deep)
    places.lower[pair] = lower + moved
    return lower


@entry
def distances(floats, integers, q, enough, out):
    """Write the signed distances of all pairs at configurations q (N, nq) to out (N, P), m.

    A distance above ``enough`` is replaced by a lower bound above it.
    """
    cell = read_cell(floats, integers, integers)
    for row in range(len(q)):
        _place_next(cell, q[row], row == 0)
        for pair in range(len(cell.pairs.one)):
            out[row, pair] = _next_distance_of(cell, pair, enough, True)


@entry
def first_below(floats, integers, q, distance, out):
    """Write to out (N,) the first pair nearer than ``distance`` at q (N, nq), or −1."""
    cell = read_cell(floats, integers, integers)
    for row in range(len(q)):
        _place_next(cell, q[row], row == 0)
        out[row] = -1
        for pair in range(len(cell.pairs.one)):
            if _next_distance_of(cell, pair, distance, False) < distance:
                out[row] = pair
                break


@part
def _arm_of(cell, joint, g):
    """Largest distance of the points of a shape's ball from the axis of a hinge, m."""
    a, p, c = cell.places.axis[joint], cell.places.anchor[joint], cell.places.center[g]
    x, y, z = c[0] - p[0], c[1] - p[1], c[2] - p[2]
    u, v, w = a[1] * z - a[2] * y, a[2] * x - a[0] * z, a[0] * y - a[1] * x
    return math.sqrt(u * u + v * v + w * w) + cell.shapes.ball[g]


@part
def _motion_of(cell, pair, travel, curve):
    """Bounds of the first and second derivative of the vector between points of a pair, m.

    A point of a shape at the distance r from a hinge's axis moves by at most r |θ|, and r changes
    by no more than the joints between them move the shape. A hinge that turns by θ bends the way of
    such a point by θ² r, and by another 2 θ c if the joints behind it move the point by c. Slides
    bend nothing. Second derivatives of the joints, at most ``curve`` (nv,), count as travel does.
    """
    tree, pairs = cell.tree, cell.pairs
    total, change, bend = 0.0, 0.0, 0.0
    for k in range(pairs.first[pair], pairs.last[pair]):
        if k == pairs.middle[pair]:
            total, change = change, 0.0
        joint = pairs.joints[k]
        moved, curved = travel[pairs.dof[joint]], curve[pairs.dof[joint]]
        if tree.slides[joint]:
            change += moved
            bend += curved
            continue
        g = pairs.one[pair] if k < pairs.middle[pair] else pairs.other[pair]
        arm = _arm_of(cell, joint, g) + change
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


@plain
def _look_ahead(cell, travel):
    """Write by how much each shape moves at most while joints travel by ``travel`` (nv,).

    As :func:`change_of` bounds it, with all joints between the shape and the world.
    """
    tree, pairs, places = cell.tree, cell.pairs, cell.places
    for g in range(len(places.ahead)):
        change, body = 0.0, tree.body[g]
        while body > 0:
            first = tree.joint_first[body]
            for k in range(tree.joint_count[body]):
                joint = first + tree.joint_count[body] - 1 - k
                moved = travel[pairs.dof[joint]]
                if moved == 0.0:
                    continue
                if tree.slides[joint]:
                    change += moved
                    continue
                change += moved * (_arm_of(cell, joint, g) + change)
            body = tree.parent[body]
        places.ahead[g] = change


@entry
def changes(floats, integers, q, travel, out):
    """Write bounds (N, P) of the distances' variation on motions from q (N, nq), m."""
    cell = read_cell(floats, integers, integers)
    for row in range(len(q)):
        place(cell, q[row])
        for pair in range(len(cell.pairs.one)):
            out[row, pair] = change_of(cell, pair, travel[row])


@entry
def least_distances(floats, integers, before, after, travel, curve, distance, out):
    r"""Write lower bounds (N, P) of the distances on the way between two configurations, m.

    With the distances d₀ and d₁ at the ends and a variation of at most c, the least is at least
    d₀ − c, d₁ − c and (d₀ + d₁ − c)/2.

    It is more where the second derivatives of the joints are bounded, too. Two points of the shapes
    that are nearest at an instant are at other instants s at least d apart. The square of their
    distance is ‖w‖², with the second derivative 2‖w′‖² + 2 w·w″, where ‖w′‖ ≤ c, and ‖w″‖ ≤ A by
    :func:`_motion_of`. As d is at most (d₀ + d₁ + c)/2, no second derivative of d² is above

    .. math:: K = 2 c^2 + (d_0 + d_1 + c) A, \qquad
        d^2(s) \ge (1 - s)\,d_0^2 + s\,d_1^2 - \tfrac12 K s (1 - s).

    Distances are computed only where a bound of d₀ does not show that ``distance`` is kept, and the
    variation of a pair only where the motion of its two shapes, each for itself, could take it
    there from the bound known at the row before.

    Args:
        floats: The floats of the cell.
        integers: Its integers.
        before: Configurations at the beginning, (N, nq).
        after: Those at the end, (N, nq).
        travel: Bounds of the joints' path lengths, rad or m, (N, nv); where their second
            derivatives are bounded, of their first derivatives with respect to s.
        curve: Bounds of their second derivatives, rad or m, (N, nv); s goes from 0 to 1.
        distance: Bounds above this distance may be less sharp, m.
        out: The bounds.
    """
    cell = read_cell(floats, integers, integers)
    pairs, places = cell.pairs, cell.places
    for row in range(len(before)):
        _place_next(cell, before[row], row == 0)
        _look_ahead(cell, travel[row])
        left = False
        for pair in range(len(pairs.one)):
            g, h = pairs.one[pair], pairs.other[pair]
            lower = places.lower[pair] - places.moved[g] - places.moved[h]
            lower -= places.ahead[g] + places.ahead[h]
            if lower > distance:
                out[row, pair] = lower
                continue
            change, bend = _motion_of(cell, pair, travel[row], curve[row])
            near = _next_distance_of(cell, pair, distance + change, True)
            out[row, pair] = near - change
            places.change[pair], places.near[pair], places.bend[pair] = change, near, bend
            left = left or near - change < distance
        if not left:
            continue
        place(cell, after[row])
        for pair in range(len(pairs.one)):
            if out[row, pair] < distance:
                change, near = places.change[pair], places.near[pair]
                far = distance_of(cell, pair, distance + change, True)
                out[row, pair] = _least_between(near, far, change, places.bend[pair])


@plain
def gradient_of(cell, pair, row):
    """Write the derivatives (nv,) of a pair's distance, from the nearest points."""
    tree, pairs, places, found = cell.tree, cell.pairs, cell.places, cell.simplex.result
    for k in range(len(row)):
        row[k] = 0.0
    for k in range(pairs.first[pair], pairs.last[pair]):
        moves_one = k < pairs.middle[pair]
        joint = pairs.joints[k]
        a, p, at = places.axis[joint], places.anchor[joint], 0 if moves_one else 3
        if tree.slides[joint]:
            u, v, w = a[0], a[1], a[2]
        else:
            x, y, z = found[at] - p[0], found[at + 1] - p[1], found[at + 2] - p[2]
            u, v, w = a[1] * z - a[2] * y, a[2] * x - a[0] * z, a[0] * y - a[1] * x
        along = u * found[6] + v * found[7] + w * found[8]
        row[pairs.dof[joint]] = along if moves_one else -along


@entry
def gradients(floats, integers, q, which, out):
    """Write the derivatives of the distances of some pairs.

    Args:
        floats: The floats of the cell.
        integers: Its integers.
        q: Configurations, (N, nq).
        which: Index of a pair at each of them, (N, k); −1 for none.
        out: Derivatives, (N, k, nv), m/rad or 1.
    """
    cell = read_cell(floats, integers, integers)
    for row in range(len(q)):
        place(cell, q[row])
        for k in range(which.shape[1]):
            pair = which[row, k]
            if pair < 0:
                continue
            distance_of(cell, pair, math.inf, True)
            gradient_of(cell, pair, out[row, k])
