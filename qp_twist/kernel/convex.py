"""Distance of two convex shapes: the algorithm of Gilbert, Johnson and Keerthi, on their cores.

A shape is a core and a radius r around it: a point (sphere), a segment (capsule), or, with r = 0, a
box, a cylinder, an ellipsoid or the convex hull of points. With the support function
s(d) = argmax d·x of a core, the point of A − B furthest along d is s_A(d) − s_B(−d), and the
distance of the cores is the least length of a vector in A − B. It is searched on simplices of such
points (Gilbert, Johnson and Keerthi 1988, IEEE J. Robotics and Automation 4(2), 193-203).
"""

from __future__ import annotations

import math

import numpy as np

from qp_twist.kernel.compiling import part, plain

PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = 0, 2, 3, 4, 5, 6, 7
"""Kinds, as in MuJoCo's ``mjtGeom``."""
MOST_ITERATIONS = 200
"""Support points searched at most; a pair that needs more keeps its last distance."""
APART = 1e-2
"""Distance to which cores that intersect are moved apart to find the next direction, m."""
STARTS, MOST_CLIMBS, CLIMBED = 12, 60, 1e-12
"""Directions from which the depth is searched, largest number of steps, least gain of a step, m."""
SETTLED = 1e-12
"""Share of the squared distance by which it may exceed its proven lower bound."""
TOUCHING = 1e-10
"""Distance at which cores count as intersecting, m."""
_FLAT = 1e-14
"""Share of the product of its edges below which a simplex counts as flat."""
_F, _I = np.float64, np.int64

SHAPE = np.dtype(
    [
        ("kind", _I),
        ("size", _F, 3),  # MuJoCo's: radius; half lengths, m
        ("first", _I),  # of its vertices, if it is a mesh
        ("last", _I),  # behind the last of them
        ("center", _F, 3),  # of a ball that contains it, in its own frame, m
        ("ball", _F),  # radius of that ball, m; ∞ of a plane
        ("half", _F, 3),  # half lengths of a box about the centre that contains it, m
        ("body", _I),
        ("at", _F, 3),  # its position in its body, m
        ("about", _F, 9),  # its rotation there, row-major
        ("x", _F, 3),  # its position in the world, m
        ("R", _F, 9),  # its rotation there, row-major
        ("middle", _F, 3),  # the centre of its ball there
    ],
    align=True,
)
"""A convex shape, where it is on its body and in the world."""

SIMPLEX = np.dtype(
    [
        ("w", _F, (4, 3)),  # points of A − B
        ("a", _F, (4, 3)),  # the points of A that they come from
        ("b", _F, (4, 3)),  # those of B
        ("share", _F, 4),  # barycentric coordinates of the point nearest to the origin
        ("trial", _F, 4),  # those of a part of the simplex
        ("v", _F, 3),  # the point of the simplex nearest to the origin
        ("on_a", _F, 3),  # result: nearest points of A and B
        ("on_b", _F, 3),
        ("away", _F, 3),  # result: the unit vector from B to A
        ("place", _F, 3),  # where A is, while it is moved apart
        ("climb", _F, 3),  # direction in which it is moved
        ("deepest", _F, 3),  # the best of them
        ("gaps", _F, 38),  # along directions: 26 of the world, and the axes of both shapes
    ],
    align=True,
)
"""Up to four points of A − B, and what :func:`pair_distance` finds."""


@part
def dot(a, b):
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@part
def minus(a, b):
    """a − b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@part
def cross(a, b):
    """a × b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@part
def radius(shape):
    """Radius around the core, m."""
    return shape.size[0] if shape.kind in (SPHERE, CAPSULE) else 0.0


@plain
def _support(shape, vertices, dx, dy, dz, out):
    """Write the point of the core of a shape furthest along d."""
    R, size, kind = shape.R, shape.size, shape.kind
    u = R[0] * dx + R[3] * dy + R[6] * dz
    v = R[1] * dx + R[4] * dy + R[7] * dz
    w = R[2] * dx + R[5] * dy + R[8] * dz
    px, py, pz = 0.0, 0.0, 0.0
    if kind == CAPSULE:
        pz = math.copysign(size[1], w)
    elif kind == BOX:
        px, py, pz = math.copysign(size[0], u), math.copysign(size[1], v), math.copysign(size[2], w)
    elif kind == CYLINDER:
        length = math.sqrt(u * u + v * v)
        if length > 0.0:
            px, py = size[0] * u / length, size[0] * v / length
        pz = math.copysign(size[1], w)
    elif kind == ELLIPSOID:
        px, py, pz = size[0] * size[0] * u, size[1] * size[1] * v, size[2] * size[2] * w
        length = math.sqrt(px * u + py * v + pz * w)
        if length > 0.0:
            px, py, pz = px / length, py / length, pz / length
        else:
            px, py, pz = size[0], 0.0, 0.0
    elif kind == MESH:
        best, most = 0, -math.inf
        for k in range(shape.first, shape.last):
            along = vertices[k, 0] * u + vertices[k, 1] * v + vertices[k, 2] * w
            if along > most:
                most, best = along, k
        px, py, pz = vertices[best, 0], vertices[best, 1], vertices[best, 2]
    out[0] = shape.x[0] + R[0] * px + R[1] * py + R[2] * pz
    out[1] = shape.x[1] + R[3] * px + R[4] * py + R[5] * pz
    out[2] = shape.x[2] + R[6] * px + R[7] * py + R[8] * pz


@part
def _of_edge(p, q):
    """Share of q in the point of the line p q that is nearest to the origin."""
    edge = minus(q, p)
    square = dot(edge, edge)
    return -dot(p, edge) / square if square > 0.0 else -1.0


@part
def _of_triangle(p, q, r, shares):
    """Write the shares of q and r in the point of the plane p q r nearest to the origin."""
    e, f = minus(q, p), minus(r, p)
    n = cross(e, f)
    square = dot(n, n)
    if square <= _FLAT * dot(e, e) * dot(f, f):
        return False
    # With o = −p in the plane's coordinates: q's share is (o × f)·n/n², r's is (e × o)·n/n².
    shares[1] = dot(cross(f, p), n) / square
    shares[2] = dot(cross(p, e), n) / square
    shares[0] = 1.0 - shares[1] - shares[2]
    return True


@part
def _take(s, count, at, shares, best):
    """Accept the point with shares of the vertices ``at`` if it is the nearest one so far."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(count):
        w = s.w[at[k]]
        x, y, z = x + shares[k] * w[0], y + shares[k] * w[1], z + shares[k] * w[2]
    square = x * x + y * y + z * z
    if square >= best:
        return best
    s.v[0], s.v[1], s.v[2] = x, y, z
    for k in range(4):
        s.share[k] = 0.0
    for k in range(count):
        s.share[at[k]] = shares[k]
    return square


@plain
def _nearest(s, count):
    """Find the point of the simplex nearest to the origin; return the number of points kept.

    Every part of the simplex with its newest point is tried: the nearest of those whose shares are
    positive is the answer. 5 is returned if the origin is inside.
    """
    new, shares = count - 1, s.trial
    shares[0] = 1.0
    best = _take(s, 1, (new, 0, 0), shares, math.inf)
    if count == 4:
        a, b, c, d = s.w[0], s.w[1], s.w[2], s.w[3]
        # Signed volumes of the tetrahedra with the origin in place of a vertex.
        of_a, of_b = dot(b, cross(c, d)), -dot(a, cross(c, d))
        of_c, of_d = dot(a, cross(b, d)), -dot(a, cross(b, c))
        whole = of_a + of_b + of_c + of_d
        if whole < 0.0:
            of_a, of_b, of_c, of_d, whole = -of_a, -of_b, -of_c, -of_d, -whole
        if whole > 0.0 and of_a >= 0.0 and of_b >= 0.0 and of_c >= 0.0 and of_d >= 0.0:
            s.share[0], s.share[1] = of_a / whole, of_b / whole
            s.share[2], s.share[3] = of_c / whole, of_d / whole
            s.v[0] = s.v[1] = s.v[2] = 0.0
            return 5
    for i in range(new):
        share = _of_edge(s.w[new], s.w[i])
        if 0.0 < share < 1.0:
            shares[0], shares[1] = 1.0 - share, share
            best = _take(s, 2, (new, i, 0), shares, best)
        for j in range(i):
            if not _of_triangle(s.w[new], s.w[i], s.w[j], shares):
                continue
            if shares[0] >= 0.0 and shares[1] >= 0.0 and shares[2] >= 0.0:
                best = _take(s, 3, (new, i, j), shares, best)
    kept = 0
    for k in range(count):
        if s.share[k] > 0.0:
            for axis in range(3):
                s.w[kept, axis], s.a[kept, axis] = s.w[k, axis], s.a[k, axis]
                s.b[kept, axis] = s.b[k, axis]
            s.share[kept] = s.share[k]
            kept += 1
    return kept


@plain
def _depth_in_simplex(s):
    """Least distance of the origin, inside the four points of A − B, from their faces, m.

    The ball of this radius is in A − B: no shorter translation separates the cores.
    """
    depth = math.inf
    for k in range(4):
        p, q, r = s.w[k], s.w[(k + 1) % 4], s.w[(k + 2) % 4]
        n = cross(minus(q, p), minus(r, p))
        length = math.sqrt(dot(n, n))
        depth = min(depth, abs(dot(n, p)) / length if length > 0.0 else 0.0)
    return depth


@plain
def _of_cores(a, b, vertices, enough, s):
    """Distance of the cores, m, or a lower bound above ``enough``.

    At most 0 if they intersect, and then an upper bound of the signed distance.
    """
    count, lower = 0, 0.0
    s.v[0], s.v[1], s.v[2] = minus(a.x, b.x)
    square = dot(s.v, s.v)
    if square == 0.0:
        s.v[0] = square = 1.0
    for _ in range(MOST_ITERATIONS):
        v, k = s.v, count
        _support(a, vertices, -v[0], -v[1], -v[2], s.a[k])
        _support(b, vertices, v[0], v[1], v[2], s.b[k])
        for axis in range(3):
            s.w[k, axis] = s.a[k, axis] - s.b[k, axis]
        along = dot(v, s.w[k])
        lower = max(lower, along / math.sqrt(square))
        if lower > enough:
            return lower
        if count > 0:
            if square - along <= SETTLED * square:
                break
            again = False
            for j in range(count):
                apart = minus(s.w[j], s.w[k])
                again = again or dot(apart, apart) <= SETTLED * SETTLED * square
            if again:
                break
        before = square
        kept = _nearest(s, count + 1)
        square = dot(s.v, s.v)
        if kept == 5 or square <= TOUCHING * TOUCHING:
            return -_depth_in_simplex(s) if kept == 5 else 0.0
        if count > 0 and square >= before:  # rounding: no nearer point is found
            count = kept
            break
        count = kept
    for axis in range(3):
        s.on_a[axis] = s.on_b[axis] = 0.0
        for k in range(count):
            s.on_a[axis] += s.share[k] * s.a[k, axis]
            s.on_b[axis] += s.share[k] * s.b[k, axis]
    return math.sqrt(square)


@plain
def _of_plane(plane, b, vertices, s):
    """Signed distance of b from a plane, with the results of :func:`pair_distance`."""
    n = plane.R[2], plane.R[5], plane.R[8]
    _support(b, vertices, -n[0], -n[1], -n[2], s.b[0])
    r = radius(b)
    distance = dot(n, minus(s.b[0], plane.x)) - r
    for axis in range(3):
        s.on_b[axis] = s.b[0, axis] - r * n[axis]
        s.on_a[axis] = s.on_b[axis] - distance * n[axis]
        s.away[axis] = -n[axis]
    return distance


@plain
def _gap(a, b, vertices, n, s):
    """Signed gap between the cores of a and b along n, from b to a, m."""
    _support(a, vertices, -n[0], -n[1], -n[2], s.a[0])
    _support(b, vertices, n[0], n[1], n[2], s.b[0])
    return dot(n, minus(s.a[0], s.b[0]))


@plain
def _moved_apart(a, b, vertices, normal, shift, s):
    """Distance of the cores with a shifted along a normal (3,), with its nearest points there."""
    for i in range(3):
        s.place[i] = a.x[i]
        a.x[i] += shift * normal[i]
    apart = _of_cores(a, b, vertices, math.inf, s)
    for i in range(3):
        a.x[i] = s.place[i]
    return apart


@plain
def _climb(a, b, vertices, s):
    """Move ``climb`` to a direction of locally largest gap of two cores; return the gap.

    With a shifted apart by t n, the direction n' of the distance is the largest of
    gap(n') + t n·n', so that its gap is at least that of n: repeated, it climbs.
    """
    n = s.climb[0], s.climb[1], s.climb[2]
    gap = _gap(a, b, vertices, n, s)
    for _ in range(MOST_CLIMBS):
        apart = _moved_apart(a, b, vertices, n, APART - gap, s)
        if apart <= TOUCHING:
            break
        u, v, w = minus(s.on_a, s.on_b)
        higher = u / apart, v / apart, w / apart
        after = _gap(a, b, vertices, higher, s)
        if after <= gap + CLIMBED:
            break
        gap, n = after, higher
    s.climb[0], s.climb[1], s.climb[2] = n
    return gap


@part
def _direction(k, R_a, R_b):
    """The k-th of 38 directions: 26 of the world, and the axes of two shapes."""
    if k < 26:
        code = k if k < 13 else k + 1  # 27 less the middle
        x, y, z = code // 9 - 1.0, (code // 3) % 3 - 1.0, code % 3 - 1.0
        length = math.sqrt(x * x + y * y + z * z)
        return x / length, y / length, z / length
    R = R_a if k < 32 else R_b
    column, sign = (k - 26) % 6 // 2, 1.0 if k % 2 else -1.0
    return sign * R[column], sign * R[3 + column], sign * R[6 + column]


@plain
def _penetration(a, b, vertices, s):
    """Signed distance of cores that intersect, at most 0, with the results of a pair.

    The least translation that separates them is found from the best of many directions, those of
    the shapes' axes among them.
    """
    best = -math.inf
    for k in range(len(s.gaps)):
        s.gaps[k] = _gap(a, b, vertices, _direction(k, a.R, b.R), s)
    for _ in range(STARTS):
        start = 0
        for k in range(len(s.gaps)):
            start = k if s.gaps[k] > s.gaps[start] else start
        s.gaps[start] = -math.inf  # taken
        s.climb[0], s.climb[1], s.climb[2] = _direction(start, a.R, b.R)
        gap = _climb(a, b, vertices, s)
        if gap > best:
            best = gap
            for i in range(3):
                s.deepest[i] = s.climb[i]
    n = s.deepest[0], s.deepest[1], s.deepest[2]
    _moved_apart(a, b, vertices, n, APART - best, s)
    for i in range(3):
        s.on_a[i] -= (APART - best) * n[i]
        s.away[i] = n[i]
    return min(best, 0.0)


@plain
def pair_distance(a, b, vertices, enough, s, least):
    """Signed distance of two shapes, m.

    It is negative by the depth of penetration; −∞ where a bound of it is below ``least``, which
    takes far less time than the depth. Above ``enough`` it is a lower bound, else s, a ``SIMPLEX``,
    receives the nearest points of A and B and the direction in which A moves away from B.
    ``vertices`` (V, 3) are those of all meshes.
    """
    if a.kind == PLANE:
        return _of_plane(a, b, vertices, s)
    if b.kind == PLANE:
        distance = _of_plane(b, a, vertices, s)
        for axis in range(3):
            s.on_a[axis], s.on_b[axis] = s.on_b[axis], s.on_a[axis]
            s.away[axis] = -s.away[axis]
        return distance
    one, other = radius(a), radius(b)
    apart = _of_cores(a, b, vertices, enough + one + other, s)
    if apart > enough + one + other:
        return apart - one - other
    if apart <= TOUCHING and min(apart, 0.0) - one - other < least:
        return -math.inf
    if apart <= TOUCHING:
        apart = _penetration(a, b, vertices, s)
    else:
        for axis in range(3):
            s.away[axis] = (s.on_a[axis] - s.on_b[axis]) / apart
    for axis in range(3):
        s.on_a[axis] -= one * s.away[axis]
        s.on_b[axis] += other * s.away[axis]
    return apart - one - other


@part
def _from_box(shape, p):
    """Distance of a point from the box that contains the shape, m."""
    R, (x, y, z) = shape.R, minus(p, shape.x)
    u = abs(R[0] * x + R[3] * y + R[6] * z - shape.center[0]) - shape.half[0]
    v = abs(R[1] * x + R[4] * y + R[7] * z - shape.center[1]) - shape.half[1]
    w = abs(R[2] * x + R[5] * y + R[8] * z - shape.center[2]) - shape.half[2]
    u, v, w = max(u, 0.0), max(v, 0.0), max(w, 0.0)
    return math.sqrt(u * u + v * v + w * w)


@part
def at_least(a, b, enough):
    """A lower bound of the distance of two shapes, m; cheap tests first, until one is > ``enough``.

    The first is that of the balls around them, the second that of one's ball and the other's box.
    """
    if PLANE in (a.kind, b.kind):
        plane, c = (a, b) if a.kind == PLANE else (b, a)
        return dot((plane.R[2], plane.R[5], plane.R[8]), minus(c.middle, plane.x)) - c.ball
    between, both = minus(a.middle, b.middle), a.ball + b.ball
    square, apart = dot(between, between), both + max(enough, 0.0)
    if square > apart * apart:
        return math.sqrt(square) - both
    return max(_from_box(a, b.middle) - b.ball, _from_box(b, a.middle) - a.ball)
