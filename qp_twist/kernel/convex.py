"""Distance of two convex shapes: the algorithm of Gilbert, Johnson and Keerthi, on their cores.

A shape is a core and a radius r around it: a point (sphere), a segment (capsule), or, with r = 0, a
box, a cylinder, an ellipsoid or the convex hull of points. With the support function
s(d) = argmax d·x of a core, the point of A − B furthest along d is s_A(d) − s_B(−d), and the
distance of the cores is the least length of a vector in A − B. It is searched on simplices of such
points (Gilbert, Johnson and Keerthi 1988, IEEE J. Robotics and Automation 4(2), 193-203).
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from qp_twist.kernel.compiling import part, plain
from qp_twist.kernel.record import Floats, Integers, RecordType

PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = 0, 2, 3, 4, 5, 6, 7
"""Kinds, as in MuJoCo's ``mjtGeom``."""
MOST_ITERATIONS = 200
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


class CellSizes(NamedTuple):
    """Numbers of what there is in a cell."""

    bodies: int
    moving: int
    """Bodies that move."""
    joints: int
    shapes: int
    vertices: int
    """Of all meshes."""
    pairs: int
    links: int
    """Joints of all pairs together."""


class Shapes(NamedTuple):
    """Shapes in their own frames, and the vertices of the meshes among them; lengths in m."""

    kind: Annotated[Integers, "shapes"]
    size: Annotated[Floats, "shapes", 3]
    """MuJoCo's sizes: radius; half lengths."""
    first: Annotated[Integers, "shapes"]
    """First vertex of a mesh."""
    last: Annotated[Integers, "shapes"]
    """Behind its last one."""
    vertices: Annotated[Floats, "vertices", 3]
    center: Annotated[Floats, "shapes", 3]
    """Centre of a ball that contains the shape, in its frame."""
    ball: Annotated[Floats, "shapes"]
    """Its radius; ∞ for a plane."""
    half: Annotated[Floats, "shapes", 3]
    """Half lengths of a box about that centre that contains the shape."""


class Simplex(NamedTuple):
    """Up to four points of A − B and what they come from; scratch of :func:`pair_distance`."""

    w: Annotated[Floats, 4, 3]
    """Points of A − B."""
    a: Annotated[Floats, 4, 3]
    """Points of A."""
    b: Annotated[Floats, 4, 3]
    """Points of B."""
    share: Annotated[Floats, 4]
    """Barycentric coordinates of the point nearest to the origin."""
    trial: Annotated[Floats, 4]
    """Those of a part of the simplex."""
    v: Annotated[Floats, 3]
    """The point of the simplex nearest to the origin."""
    result: Annotated[Floats, 9]
    """Nearest points of A and B, and the unit vector from B to A."""
    place: Annotated[Floats, 3]
    """Where A is, while it is moved apart."""
    normal: Annotated[Floats, 3]
    """Direction in which it is moved."""
    deepest: Annotated[Floats, 3]
    """The best of them."""
    tried: Annotated[Floats, 38]
    """Gaps along directions: 26 of the world, and the axes of both shapes."""


SHAPES, SIMPLEX = RecordType(Shapes, CellSizes), RecordType(Simplex, CellSizes)


@part
def radius(shapes, g):
    """Radius around the core, m."""
    kind = shapes.kind[g]
    return shapes.size[g, 0] if kind in (SPHERE, CAPSULE) else 0.0


@plain
def _support(shapes, g, x, R, dx, dy, dz, out):
    """Write the point of the core of g, at position x and rotation R, furthest along d."""
    u = R[0] * dx + R[3] * dy + R[6] * dz
    v = R[1] * dx + R[4] * dy + R[7] * dz
    w = R[2] * dx + R[5] * dy + R[8] * dz
    kind, size = shapes.kind[g], shapes.size[g]
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
        for k in range(shapes.first[g], shapes.last[g]):
            p = shapes.vertices[k]
            along = p[0] * u + p[1] * v + p[2] * w
            if along > most:
                most, best = along, k
        p = shapes.vertices[best]
        px, py, pz = p[0], p[1], p[2]
    out[0] = x[0] + R[0] * px + R[1] * py + R[2] * pz
    out[1] = x[1] + R[3] * px + R[4] * py + R[5] * pz
    out[2] = x[2] + R[6] * px + R[7] * py + R[8] * pz


@part
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@part
def _of_edge(p, q):
    """Share of q in the point of the line p q that is nearest to the origin."""
    x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    square = x * x + y * y + z * z
    return -(p[0] * x + p[1] * y + p[2] * z) / square if square > 0.0 else -1.0


@part
def _triple(a, b, c):
    """a · (b × c)."""
    return (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )


@part
def _of_triangle(p, q, r, shares):
    """Write the shares of q and r in the point of the plane p q r nearest to the origin."""
    e0, e1, e2 = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    f0, f1, f2 = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    n0, n1, n2 = e1 * f2 - e2 * f1, e2 * f0 - e0 * f2, e0 * f1 - e1 * f0
    square = n0 * n0 + n1 * n1 + n2 * n2
    flat = _FLAT * (e0 * e0 + e1 * e1 + e2 * e2) * (f0 * f0 + f1 * f1 + f2 * f2)
    if square <= flat:
        return False
    # With o = −p in the plane's coordinates: q's share is (o × f)·n/n², r's is (e × o)·n/n².
    a0, a1, a2 = p[2] * f1 - p[1] * f2, p[0] * f2 - p[2] * f0, p[1] * f0 - p[0] * f1
    b0, b1, b2 = p[1] * e2 - p[2] * e1, p[2] * e0 - p[0] * e2, p[0] * e1 - p[1] * e0
    shares[1] = (a0 * n0 + a1 * n1 + a2 * n2) / square
    shares[2] = (b0 * n0 + b1 * n1 + b2 * n2) / square
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
        of_a, of_b, of_c, of_d = (
            _triple(b, c, d), -_triple(a, c, d), _triple(a, b, d), -_triple(a, b, c)
        )  # fmt: skip
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
            if k != kept:
                for axis in range(3):
                    s.w[kept, axis], s.a[kept, axis] = s.w[k, axis], s.a[k, axis]
                    s.b[kept, axis] = s.b[k, axis]
                s.share[kept] = s.share[k]
            kept += 1
    return kept


@plain
def _of_cores(shapes, g, h, x, R, enough, s):
    """Distance of the cores of g and h; a lower bound above ``enough``; 0 if they intersect."""
    count, lower = 0, 0.0
    s.v[0], s.v[1], s.v[2] = x[g, 0] - x[h, 0], x[g, 1] - x[h, 1], x[g, 2] - x[h, 2]
    square = _dot(s.v, s.v)
    if square == 0.0:
        s.v[0] = square = 1.0
    for _ in range(MOST_ITERATIONS):
        v, k = s.v, count
        _support(shapes, g, x[g], R[g], -v[0], -v[1], -v[2], s.a[k])
        _support(shapes, h, x[h], R[h], v[0], v[1], v[2], s.b[k])
        for axis in range(3):
            s.w[k, axis] = s.a[k, axis] - s.b[k, axis]
        along = _dot(v, s.w[k])
        lower = max(lower, along / math.sqrt(square))
        if lower > enough:
            return lower
        if count > 0:
            if square - along <= SETTLED * square:
                break
            again = False
            for j in range(count):
                x0, y0, z0 = s.w[j, 0] - s.w[k, 0], s.w[j, 1] - s.w[k, 1], s.w[j, 2] - s.w[k, 2]
                again = again or x0 * x0 + y0 * y0 + z0 * z0 <= SETTLED * SETTLED * square
            if again:
                break
        before = square
        kept = _nearest(s, count + 1)
        square = _dot(s.v, s.v)
        if kept == 5 or square <= TOUCHING * TOUCHING:
            return 0.0
        if count > 0 and square >= before:  # rounding: no nearer point is found
            count = kept
            break
        count = kept
    for axis in range(3):
        s.result[axis] = s.result[3 + axis] = 0.0
        for k in range(count):
            s.result[axis] += s.share[k] * s.a[k, axis]
            s.result[3 + axis] += s.share[k] * s.b[k, axis]
    return math.sqrt(square)


@plain
def _of_plane(shapes, g, h, x, R, s):
    """Signed distance of h from the plane g, with the results of :func:`pair_distance`."""
    nx, ny, nz = R[g, 2], R[g, 5], R[g, 8]
    _support(shapes, h, x[h], R[h], -nx, -ny, -nz, s.b[0])
    b, r = s.b[0], radius(shapes, h)
    distance = nx * (b[0] - x[g, 0]) + ny * (b[1] - x[g, 1]) + nz * (b[2] - x[g, 2]) - r
    normal = (nx, ny, nz)
    for axis in range(3):
        s.result[3 + axis] = b[axis] - r * normal[axis]
        s.result[axis] = s.result[3 + axis] - distance * normal[axis]
        s.result[6 + axis] = -normal[axis]
    return distance


@plain
def _gap(shapes, g, h, x, R, nx, ny, nz, s):
    """Signed gap between the cores of g and h along n, from h to g, m."""
    _support(shapes, g, x[g], R[g], -nx, -ny, -nz, s.a[0])
    _support(shapes, h, x[h], R[h], nx, ny, nz, s.b[0])
    return (
        nx * (s.a[0, 0] - s.b[0, 0]) + ny * (s.a[0, 1] - s.b[0, 1]) + nz * (s.a[0, 2] - s.b[0, 2])
    )


@plain
def _moved_apart(shapes, g, h, x, R, normal, shift, s):
    """Distance of the cores with g shifted along a normal (3,), with its nearest points there."""
    for i in range(3):
        s.place[i] = x[g, i]
        x[g, i] += shift * normal[i]
    apart = _of_cores(shapes, g, h, x, R, math.inf, s)
    for i in range(3):
        x[g, i] = s.place[i]
    return apart


@plain
def _climb(shapes, g, h, x, R, normal, s):
    """Move ``normal`` (3,) to a direction of locally largest gap of two cores; return the gap.

    With g shifted apart by t n, the direction n' of the distance is the largest of
    gap(n') + t n·n', so that its gap is at least that of n: repeated, it climbs.
    """
    gap = _gap(shapes, g, h, x, R, normal[0], normal[1], normal[2], s)
    for _ in range(MOST_CLIMBS):
        apart = _moved_apart(shapes, g, h, x, R, normal, APART - gap, s)
        if apart <= TOUCHING:
            break
        u = (s.result[0] - s.result[3]) / apart
        v = (s.result[1] - s.result[4]) / apart
        w = (s.result[2] - s.result[5]) / apart
        after = _gap(shapes, g, h, x, R, u, v, w, s)
        if after <= gap + CLIMBED:
            break
        gap, normal[0], normal[1], normal[2] = after, u, v, w
    return gap


@part
def _direction(k, R_g, R_h):
    """The k-th of 38 directions: 26 of the world, and the axes of two shapes."""
    if k < 26:
        code = k if k < 13 else k + 1  # 27 less the middle
        a, b, c = code // 9 - 1.0, (code // 3) % 3 - 1.0, code % 3 - 1.0
        length = math.sqrt(a * a + b * b + c * c)
        return a / length, b / length, c / length
    R = R_g if k < 32 else R_h
    column, sign = (k - 26) % 6 // 2, 1.0 if k % 2 else -1.0
    return sign * R[column], sign * R[3 + column], sign * R[6 + column]


@plain
def _penetration(shapes, g, h, x, R, s):
    """Signed distance of cores that intersect, at most 0, with the results of a pair.

    The least translation that separates them is found from the best of many directions, those of
    the shapes' axes among them.
    """
    best = -math.inf
    for k in range(len(s.tried)):
        a, b, c = _direction(k, R[g], R[h])
        s.tried[k] = _gap(shapes, g, h, x, R, a, b, c, s)
    for _ in range(STARTS):
        start = 0
        for k in range(len(s.tried)):
            start = k if s.tried[k] > s.tried[start] else start
        s.tried[start] = -math.inf  # taken
        s.normal[0], s.normal[1], s.normal[2] = _direction(start, R[g], R[h])
        gap = _climb(shapes, g, h, x, R, s.normal, s)
        if gap > best:
            best = gap
            for i in range(3):
                s.deepest[i] = s.normal[i]
    _moved_apart(shapes, g, h, x, R, s.deepest, APART - best, s)
    for i in range(3):
        s.result[i] -= (APART - best) * s.deepest[i]
        s.result[6 + i] = s.deepest[i]
    return min(best, 0.0)


@plain
def pair_distance(shapes, g, h, x, R, enough, s, deep):
    """Signed distance of two shapes, m.

    Args:
        shapes: The shapes.
        g: Index of A.
        h: Index of B.
        x: Positions of the shapes' frames, (G, 3), m.
        R: Their rotations, (G, 9).
        enough: A distance above it need not be exact: a lower bound above it is returned.
        s: Scratch. Its ``result`` receives the nearest points of A and B, (3,) each, and the
            direction in which A moves away from B, (3,), where the distance is exact.
        deep: Whether depths are needed; otherwise −∞ is returned where cores intersect.

    Returns:
        The distance; negative by the depth of penetration.
    """
    if shapes.kind[g] == PLANE:
        return _of_plane(shapes, g, h, x, R, s)
    if shapes.kind[h] == PLANE:
        distance = _of_plane(shapes, h, g, x, R, s)
        for axis in range(3):
            here = s.result[axis]
            s.result[axis], s.result[3 + axis] = s.result[3 + axis], here
            s.result[6 + axis] = -s.result[6 + axis]
        return distance
    one, other = radius(shapes, g), radius(shapes, h)
    apart = _of_cores(shapes, g, h, x, R, enough + one + other, s)
    if apart > enough + one + other:
        return apart - one - other
    if apart <= TOUCHING and not deep:
        return -math.inf
    if apart <= TOUCHING:
        apart = _penetration(shapes, g, h, x, R, s)
    else:
        for axis in range(3):
            s.result[6 + axis] = (s.result[axis] - s.result[3 + axis]) / apart
    for axis in range(3):
        normal = s.result[6 + axis]
        s.result[axis] -= one * normal
        s.result[3 + axis] += other * normal
    return apart - one - other


@part
def _from_box(shapes, g, x, R, px, py, pz):
    """Distance of a point from the box that contains the shape g, m."""
    dx, dy, dz = px - x[g, 0], py - x[g, 1], pz - x[g, 2]
    u = R[g, 0] * dx + R[g, 3] * dy + R[g, 6] * dz - shapes.center[g, 0]
    v = R[g, 1] * dx + R[g, 4] * dy + R[g, 7] * dz - shapes.center[g, 1]
    w = R[g, 2] * dx + R[g, 5] * dy + R[g, 8] * dz - shapes.center[g, 2]
    a = max(abs(u) - shapes.half[g, 0], 0.0)
    b = max(abs(v) - shapes.half[g, 1], 0.0)
    c = max(abs(w) - shapes.half[g, 2], 0.0)
    return math.sqrt(a * a + b * b + c * c)


@part
def at_least(shapes, g, h, x, R, middle, enough):
    """A lower bound of the distance, above ``enough`` if one is known that is.

    First that of the balls around the shapes, then that of the ball around one from the box around
    the other.

    Args:
        shapes: The shapes.
        g: Index of A.
        h: Index of B.
        x: Positions, (G, 3), m.
        R: Rotations, (G, 9).
        middle: Centres of the shapes' balls in the world, (G, 3), m.
        enough: m.
    """
    if shapes.kind[g] == PLANE or shapes.kind[h] == PLANE:
        p, b = (g, h) if shapes.kind[g] == PLANE else (h, g)
        return (
            R[p, 2] * (middle[b, 0] - x[p, 0])
            + R[p, 5] * (middle[b, 1] - x[p, 1])
            + R[p, 8] * (middle[b, 2] - x[p, 2])
            - shapes.ball[b]
        )
    u, v = middle[g, 0] - middle[h, 0], middle[g, 1] - middle[h, 1]
    w, both = middle[g, 2] - middle[h, 2], shapes.ball[g] + shapes.ball[h]
    square, apart = u * u + v * v + w * w, both + max(enough, 0.0)
    if square > apart * apart:
        return math.sqrt(square) - both
    of_g = _from_box(shapes, g, x, R, middle[h, 0], middle[h, 1], middle[h, 2]) - shapes.ball[h]
    of_h = _from_box(shapes, h, x, R, middle[g, 0], middle[g, 1], middle[g, 2]) - shapes.ball[g]
    return max(of_g, of_h)
